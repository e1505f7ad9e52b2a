"""Of vehicles all around and a street that fewer features agree on, the street stands still."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.config import OdometryConfig
from probevo.estimation.motion_model import MotionPrediction
from probevo.estimation.ransac import Consensus, InlierThreshold, find_consensus
from probevo.estimation.rival_motion import Hypothesis, outranks, rival_near_prediction
from probevo.geometry import se3
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, both, tracks_of

CONFIG = OdometryConfig()
DRIVING = se3.from_parts(np.eye(3), np.array([0.0, 0.0, -0.8]))
AT_REST = np.eye(4)
SIGMA = np.repeat([0.05, 0.002], 3)


def predicted(T_curr_prev: FloatArray) -> MotionPrediction:
    return MotionPrediction(T_curr_prev, np.diag(SIGMA**2), velocity_sensitivity=np.diag(SIGMA))


def box(
    rng: np.random.Generator, count: int, T_curr_prev: FloatArray, size_m: float, depth_m: float
) -> Tracks:
    """Return points of a cube ahead, seen before and after a motion."""
    points = rng.uniform(-0.5, 0.5, (count, 3)) * size_m + [0.0, 0.0, depth_m]
    return seen(points, T_curr_prev, rng)


def seen(points: FloatArray, T_curr_prev: FloatArray, rng: np.random.Generator) -> Tracks:
    """Return points, [N, 3], seen before and after a motion with noise of 0.2 px."""
    prev_px = CAMERA.project(points) + 0.2 * rng.normal(size=(len(points), 4))
    moved = se3.transform(T_curr_prev, points)
    curr_px = CAMERA.project(moved) + 0.2 * rng.normal(size=(len(points), 4))
    return tracks_of(prev_px, curr_px)


def van(rng: np.random.Generator, count: int) -> Tracks:
    """Return points of a van that drives ahead at the speed of the camera."""
    return box(rng, count, AT_REST, 2.0, 8.0)


def street(rng: np.random.Generator, count: int, size_m: float = 12.0) -> Tracks:
    return box(rng, count, DRIVING, size_m, 14.0)


def most_agree(tracks: Tracks) -> Consensus:
    return find_consensus(
        tracks,
        CAMERA,
        np.random.default_rng(0),
        guess=DRIVING,
        threshold=InlierThreshold(2.0),
    )


def rival(tracks: Tracks, prediction: MotionPrediction) -> Consensus | None:
    return rival_near_prediction(
        most_agree(tracks),
        tracks,
        CAMERA,
        prediction,
        config=CONFIG,
        rng=np.random.default_rng(0),
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_street_is_found_near_the_prediction_though_a_van_has_more_features(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tracks = both(van(rng, 60), street(rng, 20))
    assert most_agree(tracks).inliers[:60].all()
    found = rival(tracks, predicted(DRIVING))
    assert found is not None
    assert found.inliers[60:].mean() > 0.9
    assert np.linalg.norm(found.T_curr_prev[:3, 3] - DRIVING[:3, 3]) < 0.1


def test_a_street_that_is_not_where_it_is_predicted_is_no_rival() -> None:
    rng = np.random.default_rng(0)
    backwards = se3.inverse(DRIVING)
    assert rival(both(van(rng, 60), street(rng, 20)), predicted(backwards)) is None


def test_a_van_that_moves_as_predicted_is_no_rival_of_a_street_that_does_not() -> None:
    """The camera was picked up, say: all around moves."""
    rng = np.random.default_rng(1)
    assert rival(both(street(rng, 60), van(rng, 20)), predicted(AT_REST)) is None


def test_fewer_than_a_solve_needs_are_no_rival() -> None:
    rng = np.random.default_rng(2)
    few = CONFIG.solver.min_tracks - 1
    assert rival(both(van(rng, 60), street(rng, few)), predicted(DRIVING)) is None
    assert rival(both(van(rng, 60), street(rng, 2 * few)), predicted(DRIVING)) is not None


def test_points_that_agree_with_both_do_not_count() -> None:
    """Without their share of both sets, the van would spread as far as the street."""
    rng = np.random.default_rng(3)
    far = box(rng, 40, AT_REST, 30.0, 400.0)
    of_van = Hypothesis(AT_REST, both(van(rng, 60), far))
    of_street = Hypothesis(DRIVING, both(street(rng, 30), far))
    assert outranks(of_street, of_van, CAMERA, fewest=20, against_px=3.0)
    assert not outranks(of_van, of_street, CAMERA, fewest=20, against_px=3.0)
    assert not outranks(of_street, of_van, CAMERA, fewest=40, against_px=3.0)


def test_a_road_without_anything_beside_it_outranks_a_lorry() -> None:
    """Its points take up no volume, but more area."""
    rng = np.random.default_rng(5)
    points = rng.uniform([-2.0, 1.65, 6.0], [6.0, 1.65, 22.0], (60, 3))
    of_road = Hypothesis(DRIVING, seen(points, DRIVING, rng))
    lorry = rng.uniform([-2.3, -1.9, 6.0], [-2.1, 1.6, 14.0], (60, 3))
    of_lorry = Hypothesis(AT_REST, seen(lorry, AT_REST, rng))
    assert outranks(of_road, of_lorry, CAMERA, fewest=12, against_px=3.0)
    assert not outranks(of_lorry, of_road, CAMERA, fewest=12, against_px=3.0)


def test_points_behind_the_camera_contradict() -> None:
    rng = np.random.default_rng(4)
    past = replace(
        predicted(AT_REST), T_curr_prev=se3.from_parts(np.eye(3), np.array([0, 0, -9.0]))
    )
    assert rival(both(van(rng, 60), street(rng, 20)), past) is None
