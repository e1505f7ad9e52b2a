"""Which tracks to solve with, and where to start: pre-filter, PROBE's centroids, RANSAC's modes."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.config import OdometryConfig, SolverConfig
from probevo.estimation.initial_motion import are_enough, initial_motion
from probevo.estimation.motion_model import MotionPrediction
from probevo.estimation.ransac import MIN_INLIER_SHARE, Consensus
from probevo.geometry import se3, so3
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.variables import MOTION
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, at_infinity, both, motion_error, seen_twice, tracks_of

TURNING = se3.from_parts(so3.exp(np.array([0.01, -0.05, 0.02])), np.zeros(3))
"""A turn by 3.1° on the spot."""


def start_of(
    tracks: Tracks,
    T_predicted: FloatArray | None = None,
    gyro: RelativeRotation | None = None,
    *,
    prefilter_deg: float = 0.0,
    **ransac: object,
) -> Consensus:
    """RANSAC is off unless a mode is given."""
    settings = {"ransac": {"mode": "off"} | ransac, "gyro": {"prefilter_deg": prefilter_deg}}
    prediction = MotionPrediction(
        T_curr_prev=np.eye(4) if T_predicted is None else T_predicted,
        cov=np.eye(6),
        velocity_sensitivity=np.eye(6),
    )
    return initial_motion(
        tracks,
        CAMERA,
        prediction,
        gyro=gyro,
        config=OdometryConfig.model_validate(settings),
        rng=np.random.default_rng(0),
    )


def mismatched(tracks: Tracks, count: int) -> Tracks:
    """The first few are outliers by 40 px along the rows."""
    curr_px = tracks.curr_px.copy()
    curr_px[:count, [0, 2]] += 40.0
    return tracks_of(tracks.prev_px, curr_px)


def at(directions: FloatArray) -> FloatArray:
    """Pixels of points at infinity, [N, 3] to [N, 4]."""
    u, v = (directions[:, :2] / directions[:, 2:]).T
    u = CAMERA.fu_px * u + CAMERA.cu_px
    v = CAMERA.fv_px * v + CAMERA.cv_px
    return np.column_stack([u, v, u, v])


def test_without_ransac_and_pre_filter_all_are_used() -> None:
    assert start_of(mismatched(seen_twice(np.random.default_rng(0), 50), 20)).inliers.all()


def test_what_turns_as_predicted_passes_any_pre_filter() -> None:
    tracks = at_infinity(np.random.default_rng(1), 50, TURNING)
    assert start_of(tracks, TURNING, prefilter_deg=1e-3).inliers.all()
    assert not start_of(tracks, np.eye(4), prefilter_deg=1.0).inliers.any()


@pytest.mark.parametrize(
    ("limit_deg", "passes"), [(0.0, True), (1.0, False), (1.99, False), (2.01, True), (90, True)]
)
@pytest.mark.parametrize("around", [0.0, 1.0, 2.5])
def test_the_pre_filter_drops_what_turns_by_more_than_its_angle(
    limit_deg: float, passes: bool, around: float
) -> None:
    """One feature in thirty is 2° from where the predicted rotation takes it, in any direction."""
    C = TURNING[:3, :3]
    rays = np.column_stack([np.random.default_rng(2).uniform(-0.4, 0.4, (30, 2)), np.ones(30)])
    turned = rays @ C.T
    ray = turned[7] / np.linalg.norm(turned[7])
    across = so3.exp(around * ray) @ np.cross(ray, [0.0, 1.0, 0.0])
    turned[7] = so3.exp(np.radians(2.0) * across / np.linalg.norm(across)) @ ray
    found = start_of(tracks_of(at(rays), at(turned)), TURNING, prefilter_deg=limit_deg).inliers
    np.testing.assert_array_equal(found, np.where(np.arange(30) == 7, passes, True))


def test_the_parallax_of_near_points_counts_against_them() -> None:
    """The pre-filter knows the rotation only: a point beside the car seems to turn by far more than
    5°."""
    tracks = seen_twice(np.random.default_rng(3), 200, depth_m=(3.0, 60.0))
    near = tracks.prev_px[:, 0] - tracks.prev_px[:, 2] > 80.0
    found = start_of(tracks, FORWARD, prefilter_deg=5.0).inliers
    assert found[~near].mean() > found[near].mean() + 0.2


@pytest.mark.parametrize("wrong", [0, 20])
def test_without_ransac_the_start_is_that_of_probe(wrong: int) -> None:
    """Eqs. 5-6: the predicted rotation, and the translation that moves the middle of the points as
    it moved.

    Exact without noise; mismatches of four in ten do no more than shift the median.
    """
    T_predicted = se3.from_parts(FORWARD[:3, :3], np.array([7.0, 8.0, 9.0]))
    tracks = mismatched(seen_twice(np.random.default_rng(4), 50), wrong)
    start = start_of(tracks, T_predicted).T_curr_prev
    np.testing.assert_array_equal(start[:3, :3], FORWARD[:3, :3])
    error_m = np.linalg.norm(motion_error(start)[:3])
    assert error_m < (0.5 if wrong else 1e-9)


def test_far_points_have_no_middle() -> None:
    """Where they lie is a matter of noise; a few near points say how the camera moves, or else the
    prediction does."""
    rng = np.random.default_rng(5)
    far = at_infinity(rng, 50)
    T_predicted = se3.from_parts(FORWARD[:3, :3], np.array([0.0, 0.0, -0.9]))
    np.testing.assert_array_equal(start_of(far, T_predicted).T_curr_prev, T_predicted)
    two, three = (both(far, seen_twice(np.random.default_rng(6), count)) for count in (2, 3))
    np.testing.assert_array_equal(start_of(two, T_predicted).T_curr_prev, T_predicted)
    start = start_of(three, T_predicted).T_curr_prev
    assert np.linalg.norm(motion_error(start)[:3]) < 1e-9


@pytest.mark.parametrize("count", [0, 1, 2])
@pytest.mark.parametrize("mode", ["off", "guess", "reject"])
def test_few_tracks_start_from_the_prediction(mode: str, count: int) -> None:
    found = start_of(
        seen_twice(np.random.default_rng(7), count), FORWARD, mode=mode, prefilter_deg=5.0
    )
    assert found.inliers.shape == (count,)
    assert np.abs(motion_error(found.T_curr_prev)).max() < 1e-9


@pytest.mark.parametrize("prefilter_deg", [0.0, 60.0])
def test_ransac_rejects_or_guesses(prefilter_deg: float) -> None:
    """Both find the same motion; only one keeps the outliers out."""
    tracks = mismatched(seen_twice(np.random.default_rng(8), 100), 30)
    reject, guess = (
        start_of(tracks, mode=mode, prefilter_deg=prefilter_deg) for mode in ("reject", "guess")
    )
    np.testing.assert_array_equal(reject.T_curr_prev, guess.T_curr_prev)
    np.testing.assert_array_equal(reject.inliers, np.arange(100) >= 30)
    assert guess.inliers.all()
    assert np.abs(motion_error(reject.T_curr_prev)).max() < 1e-3


def test_ransac_sees_only_what_passed_the_pre_filter() -> None:
    """Sixty of a hundred agree on a turn by 10° that is not the camera's: they fill the image,
    but not the solve."""
    rng = np.random.default_rng(9)
    bus = se3.from_parts(so3.exp(np.array([0.0, np.radians(10.0), 0.0])), np.zeros(3))
    tracks = both(
        seen_twice(rng, 60, bus, depth_m=(20.0, 60.0)), seen_twice(rng, 40, depth_m=(20.0, 60.0))
    )
    deceived, found = (
        start_of(tracks, FORWARD, mode="reject", prefilter_deg=limit) for limit in (0.0, 5.0)
    )
    assert deceived.inliers[:60].mean() > 0.9
    assert not found.inliers[:60].any()
    assert found.inliers[60:].mean() > 0.9
    assert np.linalg.norm(motion_error(found.T_curr_prev)) < 0.01


def test_the_threshold_is_widened_where_hardly_anything_agrees() -> None:
    """Noise of 4 px against a threshold of 3 px: some of those taken are farther off than that."""
    tracks = seen_twice(np.random.default_rng(10), 100, sigma_px=4.0, depth_m=(4.0, 10.0))
    config = OdometryConfig()
    found = start_of(tracks, mode="reject")
    assert are_enough(found.inliers, config)
    predicted = CAMERA.project(se3.transform(found.T_curr_prev, CAMERA.triangulate(tracks.prev_px)))
    errors_px = np.abs(tracks.curr_px - predicted)
    assert errors_px[found.inliers][:, :3].max() > config.ransac.threshold_px


def test_with_the_gyro_s_rotation_one_point_fixes_a_motion() -> None:
    C_gyro = so3.exp(np.array([0.001, 0.0, 0.0])) @ FORWARD[:3, :3]
    tracks = seen_twice(np.random.default_rng(11), 100, depth_m=(5.0, 15.0))
    gyro = RelativeRotation(C_gyro, 1e-6 * np.eye(3), curr=MOTION)
    found = start_of(tracks, gyro=gyro, mode="reject", rotation_from="gyro")
    np.testing.assert_allclose(found.T_curr_prev[:3, :3], C_gyro, atol=1e-12)
    assert np.linalg.norm(motion_error(found.T_curr_prev)[:3]) < 0.05


@pytest.mark.parametrize(
    ("count", "share", "is_enough"), [(100, 0.25, True), (100, 0.24, False), (12, 0.5, True)]
)
def test_enough_is_a_quarter_and_at_least_min_tracks(
    count: int, share: float, is_enough: bool
) -> None:
    assert MIN_INLIER_SHARE == 0.25
    inliers = np.arange(count) < round(share * count)
    assert are_enough(inliers, OdometryConfig()) is is_enough
    assert not are_enough(inliers, OdometryConfig(solver=SolverConfig(min_tracks=count)))


def test_no_tracks_are_not_enough() -> None:
    assert not are_enough(np.zeros(0, np.bool_), OdometryConfig())


def test_the_same_seed_gives_the_same_start() -> None:
    tracks = mismatched(seen_twice(np.random.default_rng(12), 80, sigma_px=0.5), 30)
    first, second = (start_of(tracks, mode="reject") for _ in range(2))
    assert first.T_curr_prev.tobytes() == second.T_curr_prev.tobytes()
