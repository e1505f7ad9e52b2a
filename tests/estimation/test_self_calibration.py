"""A step is solved again where its tracks show a jitter, or a delay, that was not expected."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calibrated_steps import calibrated
from probevo.arrays import FloatArray
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rig_jitter import RigJitter, jitter_offsets
from probevo.camera.rolling_shutter import Twists
from probevo.config import OdometryConfig
from probevo.estimation.motion_estimate import Status
from probevo.estimation.motion_model import MotionModel
from probevo.estimation.self_calibration import (
    MAX_REPEATED_SOLVES,
    CalibratedMotion,
)
from probevo.estimation.visual_estimator import VisualEstimator
from probevo.estimation.visual_motion import MotionPriors
from probevo.geometry import se3
from probevo.noise import StudentT
from probevo.tracking.corrected_tracks import CorrectedTracks
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, at_infinity, motion_error, seen_twice

CONFIG = OdometryConfig()
DURATION_S = 0.1
TWIST_S = se3.log(FORWARD) / DURATION_S
MODEL = MotionModel.at_start(CONFIG.motion_model).after_solve(DURATION_S, FORWARD, 1e-6 * np.eye(6))
TIGHT = RigJitter.initial(1e-12 * np.eye(3), frames=1.0)
"""A rig that is said not to jitter, on the evidence of one frame."""


class CountedEstimator(VisualEstimator):
    """Counts how often it is asked, and keeps the jitter that it was told of last."""

    num_solves = 0
    last_jitter_cov: FloatArray | None = None

    def estimate(self, tracks: Tracks, phi: FloatArray, priors: MotionPriors, **more: Any) -> Any:
        self.num_solves += 1
        self.last_jitter_cov = priors.jitter_cov
        return super().estimate(tracks, phi, priors, **more)


def estimate(
    tracks: Tracks, rig: RigCalibration | None, twist: FloatArray | None = TWIST_S
) -> tuple[CalibratedMotion, int]:
    """Return the motion of tracks, and how often it was solved for.

    The jitter that it says the solve assumed is always that of the last one.
    """
    visual = CountedEstimator(CAMERA, StudentT(), CONFIG, predicts_from_motion=False)
    twists = None if twist is None else Twists(twist, twist)
    found = calibrated(
        visual,
        CorrectedTracks.of(tracks, rig, CAMERA, twists),
        MODEL,
        DURATION_S,
        last=None if twist is None else replace(MODEL, twist=twist),
    )
    assert found.jitter_cov is visual.last_jitter_cov
    return found, visual.num_solves


def jittered(tracks: Tracks, angle_rad: FloatArray) -> Tracks:
    """Return the tracks with the right camera turned in the current frame."""
    curr_px = tracks.curr_px.copy()
    curr_px[:, 2:] += jitter_offsets(curr_px, CAMERA) @ angle_rad
    return replace(tracks, curr_px=curr_px)


def test_a_rig_that_is_as_expected_is_solved_once() -> None:
    tracks = seen_twice(np.random.default_rng(0), 200, sigma_px=0.2)
    found, num_solves = estimate(tracks, RigCalibration.initial())
    assert num_solves == 1
    assert found.visual.status is Status.OK
    assert found.rig is not None
    assert found.common_mode.columns.any()


def test_without_self_calibration_there_is_neither_rig_nor_common_mode() -> None:
    tracks = seen_twice(np.random.default_rng(0), 200, sigma_px=0.2)
    found, num_solves = estimate(tracks, None)
    assert num_solves == 1
    assert found.rig is None
    assert not found.common_mode.columns.any()


def test_a_jitter_that_the_noise_model_has_learned_is_that_of_the_solve() -> None:
    """Without self-calibration, too, so that a window knows of it."""
    cov = np.diag([1e-4, 2e-4, 1e-4]) ** 2
    visual = VisualEstimator(CAMERA, StudentT(jitter_cov=cov), CONFIG, predicts_from_motion=False)
    tracks = seen_twice(np.random.default_rng(0), 200, sigma_px=0.2)
    corrected = CorrectedTracks.of(tracks, None, CAMERA, Twists(TWIST_S, TWIST_S))
    found = calibrated(visual, corrected, MODEL, DURATION_S)
    np.testing.assert_array_equal(found.jitter_cov, cov)


def test_more_jitter_than_expected_is_solved_again() -> None:
    """With what the tracks show of it, and no more often than it may."""
    tracks = seen_twice(np.random.default_rng(0), 200, sigma_px=0.1)
    moved = jittered(tracks, np.array([0.0, 1e-3, 0.0]))
    rig = replace(RigCalibration.initial(), jitter=TIGHT)
    estimate(jittered(tracks, np.array([0.0, 1e-2, 0.0])), rig)  # more than it may solve again for
    found, num_solves = estimate(moved, rig)
    assert 1 < num_solves <= 1 + MAX_REPEATED_SOLVES
    assert found.rig is not None
    assert found.rig.jitter.exceeds(TIGHT.cov)


@pytest.mark.parametrize("twist", [TWIST_S, None])
def test_a_late_right_camera_is_corrected_by_the_motion_that_was_found(
    twist: FloatArray | None,
) -> None:
    """The tracks are of points seen 5 ms later. Behind a blackout, nobody knows the last
    velocity."""
    tracks = seen_twice(np.random.default_rng(0), 300, sigma_px=0.05)
    late = replace(tracks, prev_px=tracks.prev_px.copy(), curr_px=tracks.curr_px.copy())
    later = se3.exp(0.005 * TWIST_S)
    for pixels in (late.prev_px, late.curr_px):
        pixels[:, 2:] = CAMERA.project(se3.transform(later, CAMERA.triangulate(pixels)))[:, 2:]
    rig = RigCalibration.initial()
    for _ in range(5):
        rig = rig.with_delay(late.curr_px, TWIST_S, CAMERA)
    found, num_solves = estimate(late, rig, twist)
    assert num_solves >= 2
    assert found.corrected_tracks.delay_s == pytest.approx(0.005, abs=3e-4)
    assert np.linalg.norm(motion_error(found.accepted().T_curr_prev)[:3]) < 0.02


def test_a_step_that_was_not_accepted_teaches_the_rows_only() -> None:
    """Points at infinity show no translation."""
    tracks = at_infinity(np.random.default_rng(0), 200)
    rig = RigCalibration.initial()
    found, _ = estimate(tracks, rig)
    assert found.visual.status is not Status.OK
    assert found.rig is found.corrected_tracks.rig
    assert found.rig is not None
    np.testing.assert_array_equal(found.rig.disparity, rig.disparity)
    reckoned = found.dead_reckoned(MODEL, MODEL.predict(DURATION_S, None), DURATION_S)
    assert reckoned.status is found.visual.status
    np.testing.assert_allclose(reckoned.T_curr_prev, FORWARD, atol=1e-12)
    with pytest.raises(ValueError, match="no accepted solution"):
        found.accepted()
