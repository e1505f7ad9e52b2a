"""The rig's jitter in the solve: derivatives, weights, and a consistent covariance."""

from dataclasses import replace

import numpy as np

from intervals import chi2_interval
from probevo.camera.rig_jitter import jitter_offsets
from probevo.estimation.reprojection import solve_reprojection
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.base import MOTION
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise import Fixed
from worlds import CAMERA, FORWARD, seen_twice

COV = np.diag([2e-4, 1e-3, 2e-4]) ** 2
COUNT = 80


def observations(rng: np.random.Generator, *, knows: bool = True) -> StereoObservations:
    """Both frames of a rig that moves by ``COV``, with noise of 0.2 px."""
    tracks = seen_twice(rng, COUNT, sigma_px=0.2)
    seen = []
    for pixels in (tracks.prev_px, tracks.curr_px):
        omega = rng.multivariate_normal(np.zeros(3), COV)
        pixels = pixels.copy()
        pixels[:, 2:] += jitter_offsets(pixels, CAMERA) @ omega
        seen.append(pixels)
    noise = Fixed().predict(np.zeros((COUNT, 0)))
    noise = replace(noise, jitter_cov=COV if knows else None)
    return StereoObservations.of(seen[0], seen[1], noise, camera=CAMERA)


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
