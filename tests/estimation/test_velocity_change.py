"""The change of the velocity in a step is found by its rows, and is as uncertain as claimed."""

from dataclasses import replace

import numpy as np
import pytest

from calibrated_steps import calibrated
from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rig_jitter import RigJitter
from probevo.camera.rolling_shutter import Twists, change_sensitivity, without_readout
from probevo.config import OdometryConfig
from probevo.estimation import self_calibration
from probevo.estimation.joint_equations import JointEquations
from probevo.estimation.motion_model import MotionModel
from probevo.estimation.reprojection import solve_reprojection
from probevo.estimation.self_calibration import CalibratedMotion
from probevo.estimation.visual_estimator import VisualEstimator
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise import Fixed
from probevo.tracking.corrected_tracks import CorrectedTracks
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, seen_twice

READOUT_S = 0.02
DURATION_S = 0.05
TURN = se3.exp(np.array([0.01, -0.02, -0.05, 0.02, -0.03, 0.01]))
"""Motion of a step of a rig in a hand: 1 m/s, and 45 degrees a second."""
MEAN_S = se3.log(TURN) / DURATION_S
EXPECTED = np.array([0.1, 0.05, -0.2, 0.1, -0.2, 0.1])
"""Change of the velocity from the last step's mean to that of this one."""
SIGMA_PX = 0.2
CONFIG = OdometryConfig.model_validate({"solver": {"noise_scale": "model"}})
MODEL = replace(
    MotionModel.at_start(CONFIG.motion_model).after_solve(DURATION_S, TURN, 1e-8 * np.eye(6)),
    twist=MEAN_S - EXPECTED,
)
CHANGE_COV = MODEL.twist_change_cov(DURATION_S)


def twists_of(change: FloatArray) -> Twists:
    """Return the velocities at both frames of the step, between which they change by this."""
    return Twists(MEAN_S - 0.5 * change, MEAN_S + 0.5 * change, duration_s=DURATION_S)


def corrected(tracks: Tracks, twists: Twists) -> Tracks:
    """Return the tracks without the readout of their rows."""

    def moved(pixels: FloatArray, twist: FloatArray) -> FloatArray:
        return without_readout(pixels, READOUT_S, twist, CAMERA, acceleration=twists.acceleration)

    return replace(
        tracks,
        prev_px=moved(tracks.prev_px, twists.prev),
        curr_px=moved(tracks.curr_px, twists.curr),
    )


def rolling(tracks: Tracks, twists: Twists) -> Tracks:
    """Return the tracks as a rolling shutter shows them: those that the correction takes back."""
    seen = tracks
    for _ in range(30):
        found = corrected(seen, twists)
        seen = replace(
            seen,
            prev_px=seen.prev_px + tracks.prev_px - found.prev_px,
            curr_px=seen.curr_px + tracks.curr_px - found.curr_px,
        )
    return seen


def test_the_change_acts_on_the_residuals_as_its_sensitivity_says() -> None:
    """∂e/∂c against central differences of y' − f(T g(y)), T held."""
    tracks = seen_twice(np.random.default_rng(0), 50, TURN)

    def residuals(change: FloatArray) -> FloatArray:
        found = corrected(tracks, twists_of(change))
        return found.curr_px - CAMERA.project(
            se3.transform(TURN, CAMERA.triangulate(found.prev_px))
        )

    steps = 1e-4 * np.eye(6)
    numeric = np.stack([(residuals(h) - residuals(-h)) / 2e-4 for h in steps], axis=2)
    noise = Fixed().predict(np.zeros((len(tracks), 0)))
    observations = StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=CAMERA)
    refined = solve_reprojection(observations, guess=TURN).features.refined
    sensitivity = change_sensitivity(TURN, READOUT_S, DURATION_S, CAMERA, refined=refined)
    # It is to first order in the readout time, in which a point moves by a hundredth of its depth.
    np.testing.assert_allclose(sensitivity, numeric, atol=0.02 * np.abs(numeric).max())


def estimated(tracks: Tracks) -> CalibratedMotion:
    """Return the motion of tracks of a rig that does not jitter, whose readout time is known."""
    rig = RigCalibration.initial(RigJitter.initial(1e-12 * np.eye(3)), readout_s=READOUT_S)
    visual = VisualEstimator(
        CAMERA, Fixed(SIGMA_PX**2 * np.eye(4)), CONFIG, predicts_from_motion=False
    )
    corrected_tracks = CorrectedTracks.of(tracks, rig, CAMERA, Twists(MODEL.twist, MODEL.twist))
    return calibrated(visual, corrected_tracks, MODEL, DURATION_S)


def average_nees(seen: list[Tracks]) -> float:
    """Return the average NEES of steps whose true motion is TURN.

    The covariance is without the consider term of the calibration, which is exact here.
    """
    found = [estimated(tracks) for tracks in seen]
    nees = normalized_error_squared(
        np.tile(TURN, (len(found), 1, 1)),
        np.array([one.accepted().T_curr_prev for one in found]),
        np.array([one.visual.accepted_solution.cov + one.velocity_cov for one in found]),
    )
    return float(nees.mean())


def test_the_motion_is_as_uncertain_as_it_claims(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 60 steps whose velocities change as the motion model expects; without an estimate of their
    changes, the NEES is a multiple."""
    rng = np.random.default_rng(1)
    seen = []
    for _ in range(60):
        change = rng.multivariate_normal(EXPECTED, CHANGE_COV)
        exact = rolling(seen_twice(rng, 150, TURN), twists_of(change))
        prev_noise, curr_noise = SIGMA_PX * rng.normal(size=(2, 150, 4))
        seen.append(
            replace(exact, prev_px=exact.prev_px + prev_noise, curr_px=exact.curr_px + curr_noise)
        )
    low, high = chi2_interval(6, len(seen))
    assert low < average_nees(seen) < high
    monkeypatch.setattr(self_calibration, "CHANGE_ITERATIONS", 0)
    assert average_nees(seen) > 5.0 * high


def test_eliminating_leaves_what_the_joint_covariance_says() -> None:
    """The marginal covariance of the last two of a joint Gaussian of six, three, and these."""
    rng = np.random.default_rng(2)
    root = rng.normal(size=(11, 20))
    joint = root @ root.T
    prior = np.diag([1.0, 2.0, 3.0])
    of_prior = np.zeros((11, 11))
    of_prior[6:9, 6:9] = prior
    gradient = rng.normal(size=11)
    equations = JointEquations(
        hessian=joint[:6, :6],
        cross=-joint[:6, 6:],
        other_hessian=joint[6:, 6:],
        gradient=gradient[:6],
        others_gradient=gradient[6:],
    )
    pull = rng.normal(size=3)
    left = equations.eliminating(3, prior, pull).solved()
    cov = np.linalg.inv(joint + of_prior)
    np.testing.assert_allclose(np.linalg.inv(left.information), cov[9:, 9:], rtol=1e-9)
    pulled = gradient + np.concatenate([np.zeros(6), pull, np.zeros(2)])
    step = np.linalg.solve(left.information, left.gradient)
    np.testing.assert_allclose(step, (cov @ pulled)[9:], rtol=1e-9)
