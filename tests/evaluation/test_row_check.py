"""Rows and delay of the right image: known errors come back within their covariance."""

from __future__ import annotations

import numpy as np
import pytest

from probevo.camera.rig_calibration import row_basis
from probevo.evaluation.row_check import DELAY, RowSamples, check_rows
from probevo.geometry import se3
from worlds import CAMERA, random_pixels

ROWS_PX = np.array([0.3, -0.2, 0.1, 0.0, 0.5, 0.0, 0.2])


def drive(delay_s: float, rows_px: np.ndarray, frames: int = 60, seed: int = 0) -> list[RowSamples]:
    """A car that nods: each frame pitches by some milliradians."""
    rng = np.random.default_rng(seed)
    samples = []
    for frame in range(frames):
        rate_rad_s = np.array([0.04, 0.03, 0.0]) * rng.normal(size=3)
        true_px = random_pixels(rng, 100)
        ids = np.arange(100) + 100 * frame
        perfect = RowSamples.of(true_px, true_px, ids, rate_rad_s=rate_rad_s, camera=CAMERA)
        raw_px = perfect.pixels + 0.2 * rng.normal(size=perfect.pixels.shape)
        raw_px[:, 3] += row_basis(perfect.pixels, CAMERA) @ rows_px
        raw_px[:, 3] += delay_s * perfect.row_speed_px_s
        # The odometry corrects its tracks only by what it knows; here, by nothing.
        samples.append(
            RowSamples.of(raw_px, raw_px, perfect.ids, rate_rad_s=rate_rad_s, camera=CAMERA)
        )
    return samples


def test_rows_move_as_the_points_do() -> None:
    """Against the same points after a short turn of the camera."""
    rate_rad_s = np.array([0.3, -0.2, 0.1])
    pixels = random_pixels(np.random.default_rng(1), 50)
    turn = np.r_[np.zeros(3), 1e-4 * rate_rad_s]
    after = CAMERA.project(se3.transform(se3.exp(turn), CAMERA.triangulate(pixels)))
    samples = RowSamples.of(pixels, pixels, np.arange(50), rate_rad_s=rate_rad_s, camera=CAMERA)
    expected = (after - pixels)[:, 1] / 1e-4
    np.testing.assert_allclose(samples.row_speed_px_s, expected, rtol=2e-3, atol=0.05)


@pytest.mark.parametrize("delay_s", [0.0, 0.004])
def test_rows_and_delay_come_back(delay_s: float) -> None:
    found = check_rows(drive(delay_s, ROWS_PX), CAMERA)
    z = (found.values - np.r_[ROWS_PX, delay_s]) / found.sigma
    assert np.abs(z).max() < 3.5, z
    assert found.sigma[DELAY] < 1e-3


def test_a_flawless_pair_has_nothing_significant() -> None:
    found = check_rows(drive(0.0, np.zeros(7)), CAMERA)
    p_values = [
        found.p_value(value, sigma) for value, sigma in zip(found.values, found.sigma, strict=True)
    ]
    assert min(p_values) > 0.01 / len(p_values)


def test_a_late_right_image_is_significant() -> None:
    found = check_rows(drive(0.004, np.zeros(7)), CAMERA)
    assert found.p_value(found.values[DELAY], found.sigma[DELAY]) < 1e-3


def test_a_rig_that_flexes_slowly_is_hardly_marked() -> None:
    """The right camera nods by 0.1 px, of which it keeps 0.9 from frame to frame, in 50 recordings
    of 50 frames. By the correlation over a fixed number of frames, 11 were marked."""
    num_frames = 50
    kept = 0.9
    is_marked = []
    for seed in range(50):
        rng = np.random.default_rng(seed)
        nod = rng.normal(size=num_frames)
        for k in range(1, num_frames):
            nod[k] = kept * nod[k - 1] + np.sqrt(1.0 - kept**2) * nod[k]
        samples = drive(0.0, np.zeros(7), num_frames, seed=seed)
        for k, frame in enumerate(samples):
            frame.pixels[:, 3] += 0.1 * nod[k]
        found = check_rows(samples, CAMERA)
        p_values = [
            found.p_value(value, sigma)
            for value, sigma in zip(found.values, found.sigma, strict=True)
        ]
        is_marked.append(min(p_values) < 0.01 / len(p_values))
    assert sum(is_marked) <= 2
