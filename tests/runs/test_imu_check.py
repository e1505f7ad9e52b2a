"""``probevo info`` on an IMU: the usual mistakes are named, and a good IMU raises no warning."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.geometry import se3, so3
from probevo.runs.imu_check import ImageRotations, imu_warning, sample_warnings
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration

CALIBRATION = ImuCalibration(se3.exp(np.array([0.1, 0.2, -0.3, 0.3, -1.2, 0.5])), 1e-3, 0.02)
BIAS_RAD_S = np.array([0.02, -0.03, 0.01])
LATER_NS = 30_000_000
SLOW = 0.02
"""The share of rotation of a car on a straight road."""


def drive(size: float = 1.0) -> tuple[ImageRotations, ImuStream]:
    """Six seconds of a camera that is swung about two axes, and its gyro at 200 Hz, with a bias."""
    stamps_ns = np.arange(0, 6_200_000_000, 5_000_000)
    time_s = 1e-9 * stamps_ns
    rates = size * np.column_stack(
        [0.3 * np.sin(4.0 * time_s), 0.5 * np.cos(3.0 * time_s), 0.0 * time_s]
    )
    gyro = rates @ CALIBRATION.C_cam_imu + BIAS_RAD_S
    frames_ns = np.arange(100_000_000, 6_100_000_000, 100_000_000)
    stream = ImuStream.checked(
        stamps_ns, gyro, np.full_like(gyro, np.nan), frames_ns=frames_ns, where="imu.csv"
    )
    between_ns = np.column_stack([frames_ns[:-1], frames_ns[1:]])
    unbiased = replace(stream, gyro_rad_s=stream.gyro_rad_s - BIAS_RAD_S)
    nothing = ImageRotations(between_ns, np.zeros((len(between_ns), 3)))
    return ImageRotations(
        between_ns,
        nothing.gyro_rotation_rad(unbiased, replace(CALIBRATION, gyro_bias_sigma_rad_s=0.0)),
    ), stream


def frames_of(images: ImageRotations) -> np.ndarray:
    """Return the stamps of all frames, ns."""
    return np.append(images.frame_stamps_ns[:, 0], images.frame_stamps_ns[-1, 1])


def test_a_gyro_that_agrees_with_the_images_raises_no_warning() -> None:
    assert imu_warning(*drive(), CALIBRATION) == ""


@pytest.mark.parametrize(
    ("scale", "later_ns", "C_cam_imu", "fragment"),
    [
        (np.rad2deg(1.0), 0, CALIBRATION.C_cam_imu, "Is the gyro in degrees per second?"),
        (1.0, 10 * LATER_NS, CALIBRATION.C_cam_imu, ""),
        (1.0, 5 * LATER_NS, CALIBRATION.C_cam_imu, "with its stamps shifted by -150 ms"),
        (-1.0, 0, CALIBRATION.C_cam_imu, "Has the gyro the opposite sign?"),
        (1.0, 0, CALIBRATION.C_cam_imu.T, "by the inverse of T_cam_imu"),
        (1.0, 0, so3.exp(np.array([0.01, 0.01, 0.01])) @ CALIBRATION.C_cam_imu, None),
    ],
    ids=["degrees", "very late", "late", "sign", "transposed", "a degree off"],
)
def test_mistakes_are_named(
    scale: float, later_ns: int, C_cam_imu: np.ndarray, fragment: str | None
) -> None:
    """Every mistake raises a warning, if not always with its cause; a misalignment of a degree does
    not, and does not disturb the odometry either."""
    images, stream = drive()
    wrong = replace(
        stream, gyro_rad_s=scale * stream.gyro_rad_s, stamps_ns=stream.stamps_ns + later_ns
    )
    warning = imu_warning(
        images, wrong, replace(CALIBRATION, T_cam_imu=se3.from_parts(C_cam_imu, np.zeros(3)))
    )
    assert (
        (warning == "")
        if fragment is None
        else ("its rotations differ from those of the images by" in warning)
    )
    assert (fragment or "") in warning


def test_with_little_rotation_or_few_steps_there_is_no_warning() -> None:
    images, stream = drive(SLOW)
    assert imu_warning(images, replace(stream, gyro_rad_s=-stream.gyro_rad_s), CALIBRATION) == ""
    few = ImageRotations(images.frame_stamps_ns[:5], images.rotation_rad[:5])
    assert imu_warning(few, stream, CALIBRATION) == ""


@pytest.mark.parametrize(
    ("rate", "text"),
    [
        (1e300, "have an angular rate over 2000 rad/s; they are left out"),
        (1e18, "have an angular rate over 2000 rad/s; they are left out"),
        (40.0, "are spikes of the gyro, and left out"),
        (4.0, "are spikes of the gyro, and left out"),
    ],
)
def test_implausible_rates_and_spikes_are_counted(rate: float, text: str) -> None:
    images, stream = drive()
    gyro = stream.gyro_rad_s.copy()
    gyro[[100, 200, 400], [0, 1, 2]] = [rate, -rate, rate]
    gyro[700:, 0] += 12.0  # the vehicle turns faster from here on, which is no spike
    found = sample_warnings(replace(stream, gyro_rad_s=gyro), frames_of(images))
    assert found == [f"3 of 1,240 {text}"]


def test_implausible_forces_are_counted() -> None:
    images, stream = drive()
    accel = np.full_like(stream.gyro_rad_s, 9.81)
    accel[7] = 1e18
    assert sample_warnings(replace(stream, accel_m_s2=accel), frames_of(images)) == [
        "1 of 1,240 have a specific force over 1e+06 m/s²; it is left out"
    ]


def test_plausible_samples_raise_no_warning() -> None:
    images, stream = drive()
    assert sample_warnings(stream, frames_of(images)) == []
