"""What a frame lacks, as a value and as text."""

from probevo.sequences.missing_data import Defect, MissingData


def test_as_text_it_is_a_phrase() -> None:
    of_imu = MissingData(Defect.RATE_NOT_FINITE, 3, 20)
    assert str(of_imu) == "3 of 20 IMU samples without a finite angular rate"
    of_features = MissingData(Defect.PIXEL_TOO_LARGE, 1, 9)
    assert str(of_features) == "1 of 9 features with implausible pixels"
