import cv2
import numpy as np

from probevo.output.drawing import draw_tracks

GRAY = np.full((300, 960), 128, dtype=np.uint8)


def decode(jpeg: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(jpeg, dtype=np.uint8), cv2.IMREAD_COLOR).astype(float)


def test_trusted_and_distrusted_points_differ_in_hue() -> None:
    prev = np.array([[100.0, 100, 90, 100], [500.0, 100, 490, 100]])
    picture = decode(
        draw_tracks(GRAY, prev, prev + np.array([20.0, 0, 20, 0]), weights=np.array([0.0, 1.0]))
    )
    blue, _, red = np.moveaxis(picture, -1, 0)
    assert red[100, 120] > blue[100, 120] + 60
    assert blue[100, 520] > red[100, 520] + 60
    np.testing.assert_allclose(blue[200, 700], red[200, 700], atol=4)


def test_place_follows_the_scale() -> None:
    """At half the width a point at u = 401 lands on column 200."""
    prev = np.array([[401.0, 101, 390, 101]])
    wide = np.full((600, 1920), 128, dtype=np.uint8)
    blue, _, red = np.moveaxis(
        decode(draw_tracks(wide, prev, prev, weights=np.array([0.0]))), -1, 0
    )
    rows, columns = np.nonzero(red[:100] > blue[:100] + 40)
    np.testing.assert_allclose([columns.mean(), rows.mean()], [200.25, 50.25], atol=0.6)


def test_no_tracks_is_a_picture_too() -> None:
    empty = np.empty((0, 4))
    assert decode(draw_tracks(GRAY, empty, empty, weights=np.empty(0))).shape == (300, 960, 3)


def test_the_letters_of_the_legend_can_be_read_at_half_the_width() -> None:
    """Light letters on a dark ground, more than 12 px high at 960 px, in a picture of mid-grey."""
    empty = np.empty((0, 4))
    picture = decode(draw_tracks(GRAY, empty, empty, weights=np.empty(0))).mean(axis=2)
    letters = np.flatnonzero((picture[-50:, 12:120] > 180.0).any(axis=1))
    assert np.ptp(letters) + 1 > 12
