"""The rig's jitter in the solve: derivatives, weights, and a consistent covariance."""

from dataclasses import replace

import numpy as np

from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.camera.rig_jitter import jitter_offsets
from probevo.estimation.reprojection import solve_reprojection
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.stereo_observations import StereoObservations
from probevo.measurements.variables import MOTION
from probevo.noise import Fixed
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, moved, seen_twice

COV = np.diag([2e-4, 1e-3, 2e-4]) ** 2
COUNT = 80


def seen_by_a_loose_rig(rng: np.random.Generator) -> Tracks:
    """Both frames of a rig that moves by ``COV``, with noise of 0.2 px."""
    tracks = seen_twice(rng, COUNT, sigma_px=0.2)
    for pixels in (tracks.prev_px, tracks.curr_px):
        omega = rng.multivariate_normal(np.zeros(3), COV)
        pixels[:, 2:] += jitter_offsets(pixels, CAMERA) @ omega
    return tracks


def observations(rng: np.random.Generator, *, knows: bool = True) -> StereoObservations:
    """Its observations; whether the noise ``knows`` of the jitter."""
    tracks = seen_by_a_loose_rig(rng)
    noise = Fixed().predict(np.zeros((COUNT, 0)))
    noise = replace(noise, jitter_cov=COV if knows else None)
    return StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=CAMERA)


def test_gradient_against_central_differences() -> None:
    found = observations(np.random.default_rng(0))
    assert found.jitter is not None
    variable = found.jitter.variable
    start = {MOTION: FORWARD, variable: np.array([0.3, -0.5, 0.2, -0.4, 0.6, 0.1])}
    found = found.propagated(start)
    gradient = found.linearize(start).gradient
    for k, step in enumerate(1e-6 * np.eye(12)):
        cost = [
            found.linearize(
                {
                    MOTION: se3.exp(sign * step[:6]) @ FORWARD,
                    variable: start[variable] + sign * step[6:],
                }
            ).cost
            for sign in (1.0, -1.0)
        ]
        np.testing.assert_allclose(-(cost[0] - cost[1]) / 2e-6, gradient[k], rtol=1e-4, atol=1e-2)


def test_columns_against_central_differences() -> None:
    """The previous frame's jitter moves the points, and so the prediction."""
    found = observations(np.random.default_rng(2))
    assert found.jitter is not None
    found = found.propagated({MOTION: FORWARD, found.jitter.variable: np.zeros(6)})
    jitter = found.jitter
    assert jitter is not None
    assert found.linearized_jitter is not None
    columns = found.linearized_jitter.columns
    refined = found.propagated_noise.refined
    sensitivity = jitter.effects.sensitivity[:, :3]

    def predicted(eta: FloatArray) -> FloatArray:
        u, v, d = (refined + sensitivity @ eta).T
        return moved(np.column_stack([u, v, u - d, v]), FORWARD)

    for k, step in enumerate(1e-5 * np.eye(3)):
        change = (predicted(step) - predicted(-step)) / 2e-5
        np.testing.assert_allclose(columns[:, :, 3 + k], change, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(columns[:, 2:, :3], jitter.effects.basis)


def test_a_turn_of_the_right_camera_moves_the_point_by_its_opposite() -> None:
    """All of what the previous frame's jitter adds to an observation is taken off its point."""
    tracks = seen_by_a_loose_rig(np.random.default_rng(3))
    found = observations(np.random.default_rng(3))
    assert found.jitter is not None
    root = np.linalg.cholesky(COV)
    offsets = jitter_offsets(tracks.prev_px, CAMERA) @ root
    # The rows of both images weigh alike, and the disparity falls where u_r grows.
    np.testing.assert_allclose(
        found.jitter.effects.sensitivity[:, 1], -0.5 * offsets[:, 1], atol=1e-12
    )
    np.testing.assert_allclose(found.jitter.effects.sensitivity[:, 2], offsets[:, 0], atol=1e-12)


def test_covariance_is_consistent_only_with_the_jitter() -> None:
    nees = {}
    for knows in (True, False):
        rng = np.random.default_rng(1)
        solved = [
            solve_reprojection(observations(rng, knows=knows), guess=FORWARD) for _ in range(200)
        ]
        nees[knows] = np.mean(
            [normalized_error_squared(FORWARD, s.T_curr_prev, s.cov) for s in solved]
        )
    low, high = chi2_interval(6, 200, confidence=0.999)
    assert low < nees[True] < high
    assert nees[False] > 2.0 * high
