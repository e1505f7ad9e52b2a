"""The factors of other back ends have the cost of the solve, and right derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.config import SolverConfig
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.reprojection import solve_reprojection
from probevo.estimation.track_factors import FactorLinearization, TrackFactors
from probevo.estimation.two_frame import TwoFrameEstimator
from probevo.geometry import se3
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise import StereoNoise, StudentT
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, seen_twice, tracks_of

CORRELATED = 0.04 * np.array(
    [[1.0, 0.1, 0.6, 0.0], [0.1, 1.0, 0.0, -0.3], [0.6, 0.0, 1.2, 0.1], [0.0, -0.3, 0.1, 0.9]]
)
COUNT = 60
JITTER_COV = np.diag([2e-4, 5e-4, 3e-4]) ** 2


def two_steps(jitter_cov: FloatArray | None = None) -> tuple[Tracks, DisparityFilter]:
    """A second step, and the disparity filter after the first."""
    rng = np.random.default_rng(0)
    first = seen_twice(rng, COUNT, sigma_px=0.2)
    points = CAMERA.triangulate(first.curr_px)
    next_px = CAMERA.project(se3.transform(FORWARD, points)) + 0.2 * rng.normal(size=(COUNT, 4))
    noise = replace(StudentT().predict(np.zeros((COUNT, 0))), jitter_cov=jitter_cov)
    estimator = TwoFrameEstimator(CAMERA, SolverConfig())
    estimate = estimator.estimate(first, noise, DisparityFilter.none(), guess=FORWARD)
    return tracks_of(first.curr_px, next_px), estimate.disparities


def minimum_over_point(
    factors: TrackFactors, track: int, T_curr_prev: FloatArray, common: FloatArray
) -> float:
    """Return rᵀ cov⁻¹ r of a factor at its most likely point."""
    information = np.linalg.inv(factors.cov[track])
    point = factors.point[track].copy()
    for _ in range(30):
        at = factors.linearize(track, T_curr_prev, point, common)
        weighted = at.point.T @ information
        point -= np.linalg.solve(weighted @ at.point, weighted @ at.residual)
    residual = factors.linearize(track, T_curr_prev, point, common).residual
    return float(residual @ information @ residual)


@pytest.mark.parametrize("jitter_cov", [None, JITTER_COV], ids=["rigid", "loose"])
@pytest.mark.parametrize("with_history", [False, True])
@pytest.mark.parametrize("refers_to", ["observation", "residual"])
def test_cost_is_that_of_the_solve(
    refers_to: str, with_history: bool, jitter_cov: FloatArray | None
) -> None:
    """Correlated, biased noise, with a time-correlated part if it is of observations."""
    tracks, disparities = two_steps(jitter_cov)
    if refers_to == "residual":
        if with_history:
            pytest.skip("without a time-correlated error there is no history")
        disparities = DisparityFilter.none()
    noise = StereoNoise(
        scale=np.tile(CORRELATED, (COUNT, 1, 1)),
        dof=np.full(COUNT, 4.0),
        bias=np.tile([0.05, -0.03, 0.02, 0.04], (COUNT, 1)),
        refers_to=refers_to,
        time_correlated=np.full(COUNT, 0.02) if refers_to == "observation" else None,
        jitter_cov=jitter_cov,
    )
    history = disparities if with_history else DisparityFilter.none()
    factors = TrackFactors.of(tracks, noise, CAMERA, history)
    solution = solve_reprojection(
        StereoObservations.of(
            tracks.prev_px,
            tracks.curr_px,
            noise,
            camera=CAMERA,
            disparity_prior=history.of_tracks(tracks).states,
        ),
        guess=FORWARD,
    )
    assert (len(history.ids) > COUNT / 2) == with_history
    common = np.zeros(factors.common.shape[2])
    if solution.jitter is not None:
        common[6:] = solution.jitter.eta
    squared = [
        minimum_over_point(factors, track, solution.T_curr_prev, common)
        for track in range(len(factors))
    ]
    # The solve linearises at points that it has refined once.
    np.testing.assert_allclose(squared, solution.features.mahalanobis_sq, rtol=2e-3, atol=1e-3)


def test_derivatives_against_central_differences() -> None:
    tracks, disparities = two_steps(JITTER_COV)
    noise = replace(StudentT().predict(np.zeros((COUNT, 0))), jitter_cov=JITTER_COV)
    factors = TrackFactors.of(tracks, noise, CAMERA, disparities)
    track = int(disparities.ids[0])
    assert np.abs(factors.common[track]).max() > 0.0
    point = factors.point[track] + [0.3, -0.2, 0.1]
    common = np.linspace(-1.0, 1.0, 12)

    def at(xi: FloatArray, ds: FloatArray, dc: FloatArray) -> FactorLinearization:
        return factors.linearize(track, se3.exp(xi) @ FORWARD, point + ds, common + dc)

    exact = at(np.zeros(6), np.zeros(3), np.zeros(12))
    for name, columns, first in (("motion", 6, 0), ("point", 3, 6), ("common", 12, 9)):
        for column in range(columns):
            step = np.zeros(21)
            step[first + column] = 1e-5
            ahead = at(*np.split(step, [6, 9])).residual
            behind = at(*np.split(-step, [6, 9])).residual
            np.testing.assert_allclose(
                getattr(exact, name)[:, column], (ahead - behind) / 2e-5, rtol=1e-6, atol=1e-5
            )


def test_point_behind_the_camera_moves_nothing() -> None:
    tracks, _ = two_steps()
    factors = TrackFactors.of(tracks, StudentT().predict(np.zeros((COUNT, 0))), CAMERA)
    far_ahead = se3.exp(np.array([0.0, 0.0, -1000.0, 0.0, 0.0, 0.0]))
    at = factors.linearize(0, far_ahead, factors.point[0], np.zeros(6))
    assert not at.motion.any()
    assert not at.point[3:].any()
    assert np.abs(at.residual[3:]).min() > 100.0
