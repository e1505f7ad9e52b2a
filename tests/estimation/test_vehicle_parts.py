"""Features that are fixed to the vehicle are told from a scene at rest, whatever their number."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import probevo as pv
from probevo.arrays import FloatArray, IntArray
from probevo.config import OdometryConfig
from probevo.estimation.motion_estimate import Status
from probevo.estimation.vehicle_parts import FRAMES_BACK, fixed_to_vehicle, many_stay
from probevo.geometry import se3
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.tracking.observations import FrameObservations, ObservationStore
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, HEIGHT_PX, WIDTH_PX, drive, random_pixels

CONFIG = OdometryConfig()
FIRST_FIXED = 10_000
"""Identity of the first feature that is fixed to the vehicle."""
SLOW = se3.exp(np.array([0.0, 0.0, -0.05, 0.0, 0.0005, 0.0]))
"""T_curr_prev of half a metre a second: most features move by less than 2 px."""
AT_REST = np.eye(4)


def bonnet(rng: np.random.Generator, count: int) -> FloatArray:
    """Return noise-free observations of a part of the vehicle at the lower border, [N, 4], px: at a
    depth of two to three metres."""
    pixels = random_pixels(rng, count, (2.0, 3.0))
    pixels[:, 1] = pixels[:, 3] = rng.uniform(0.7 * HEIGHT_PX, HEIGHT_PX, count)
    return pixels


def van(rng: np.random.Generator, count: int) -> FloatArray:
    """Return noise-free observations of points of a van, [N, 4], px."""
    points = rng.uniform([-2.0, -1.0, 9.0], [2.0, 1.0, 10.5], (count, 3))
    return CAMERA.project(points)


def with_fixed(frames: list[Frame], fixed_px: FloatArray) -> list[Frame]:
    """Add features that stay where they are but for noise, [M, 4], px, to each frame."""
    rng = np.random.default_rng(17)
    added = []
    for frame in frames:
        assert frame.features is not None
        noisy_px = fixed_px + 0.1 * rng.normal(size=fixed_px.shape)
        features = StereoFeatures(
            np.r_[frame.features.ids, FIRST_FIXED + np.arange(len(fixed_px))],
            np.vstack([frame.features.pixels, noisy_px]),
        )
        added.append(replace(frame, features=features))
    return added


def found_among(frames: list[Frame]) -> IntArray:
    """Return what is found to be fixed in the last frame."""
    store = ObservationStore()
    for frame in frames[:-1]:
        assert frame.features is not None
        store = store.with_frame(
            FrameObservations(
                frame.index,
                frame.stamp_ns,
                landmarks=frame.features.ids,
                pixels=frame.features.pixels,
            )
        )
    last = frames[-1].features
    before = frames[-2].features
    assert last is not None
    assert before is not None
    ids, rows, prev_rows = np.intersect1d(last.ids, before.ids, return_indices=True)
    tracks = Tracks(
        prev_px=before.pixels[prev_rows],
        curr_px=last.pixels[rows],
        ids=ids,
        age=np.full(len(ids), 2),
    )
    return fixed_to_vehicle(tracks, store, CAMERA, config=CONFIG, rng=np.random.default_rng(0))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("count", [40, 300])
def test_a_bonnet_is_found_while_the_scene_moves(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    fixed = found_among(with_fixed(drive(rng, 2, points=60), bonnet(rng, count)))
    assert (fixed >= FIRST_FIXED).all()
    assert len(fixed) >= 0.95 * count


def test_a_slow_scene_tells_after_some_frames() -> None:
    rng = np.random.default_rng(4)
    fixed_px = bonnet(rng, 300)
    frames = with_fixed(drive(rng, 1 + max(FRAMES_BACK), SLOW, points=100), fixed_px)
    assert len(found_among(frames[:2])) == 0
    fixed = found_among(frames)
    assert (fixed >= FIRST_FIXED).all()
    assert len(fixed) >= 0.9 * len(fixed_px)


def test_before_a_camera_at_rest_nothing_is_fixed_to_it() -> None:
    """Neither in a scene of which nothing moves, nor behind a van that passes, though that has more
    features."""
    rng = np.random.default_rng(5)
    frames = drive(rng, 10, AT_REST, points=60)
    assert len(found_among(frames)) == 0
    passing_px = van(rng, 150)
    past = []
    for k, frame in enumerate(frames):
        assert frame.features is not None
        moved_px = CAMERA.project(CAMERA.triangulate(passing_px) + np.array([0.2 * k, 0.0, 0.0]))
        inside = (moved_px[:, 0] >= 0.0) & (moved_px[:, 0] < WIDTH_PX)
        features = StereoFeatures(
            np.r_[frame.features.ids, FIRST_FIXED + np.flatnonzero(inside)],
            np.vstack([frame.features.pixels, moved_px[inside]]),
        )
        past.append(replace(frame, features=features))
    assert len(found_among(past)) == 0


def test_a_quarter_that_stays_may_hold_the_motion() -> None:
    rng = np.random.default_rng(6)
    [before, now] = with_fixed(drive(rng, 2, points=60), bonnet(rng, 25))
    assert before.features is not None
    assert now.features is not None
    tracks = Tracks(
        prev_px=before.features.pixels[-60:],
        curr_px=now.features.pixels[-60:],
        ids=now.features.ids[-60:],
        age=np.full(60, 2),
    )
    assert many_stay(tracks)
    assert not many_stay(tracks.subset(np.arange(40)))
    assert not many_stay(Tracks.none())


@pytest.mark.parametrize("estimator", ["window", "two-frame"])
@pytest.mark.parametrize("T_curr_prev", [FORWARD, SLOW], ids=["fast", "slow"])
def test_the_path_is_that_of_the_scene(estimator: str, T_curr_prev: FloatArray) -> None:
    """From rest on, beside a bonnet with five times as many features as the scene."""
    rng = np.random.default_rng(7)
    num_frames = 25
    motions = np.repeat(T_curr_prev[None], num_frames, axis=0)
    motions[:5] = AT_REST
    # Up to its speed within so many frames.
    for k in range(8):
        motions[5 + k] = se3.exp(k / 8.0 * se3.log(T_curr_prev))
    frames = with_fixed(drive(rng, num_frames, motions, points=60), bonnet(rng, 300))
    odometry = pv.StereoOdometry(CAMERA, config={"estimator": estimator})
    estimates = [odometry.step(frame) for frame in frames]
    for estimate, true in list(zip(estimates, motions, strict=True))[-8:]:
        assert estimate.status is Status.OK
        error_m = np.linalg.norm(estimate.T_curr_prev[:3, 3] - true[:3, 3])
        assert error_m < 0.05 * np.linalg.norm(true[:3, 3])
    ids = odometry.tracks_of_vehicle.ids
    assert (ids >= FIRST_FIXED).all()
    assert len(ids) >= 290
    assert not np.isin(ids, odometry.tracks.ids).any()


def test_a_truck_that_drives_off_is_not_fixed_any_more() -> None:
    """One that was ahead at the speed of the camera; its features are tracks like others then."""
    rng = np.random.default_rng(8)
    ahead_px = van(rng, 200)
    frames = with_fixed(drive(rng, 12, points=60), ahead_px)
    odometry = pv.StereoOdometry(CAMERA, config={"estimator": "two-frame"})
    for frame in frames[:-1]:
        odometry.step(frame)
    assert odometry.state is not None
    fixed_ids = FIRST_FIXED + np.arange(200)
    tracking = replace(odometry.state.tracking, fixed_ids=fixed_ids)
    odometry._state = replace(odometry.state, tracking=tracking)
    last = frames[-1]
    assert last.features is not None
    away_px = CAMERA.project(CAMERA.triangulate(ahead_px) + np.array([0.0, 0.0, 1.0]))
    pixels = np.vstack([last.features.pixels[:-200], away_px])
    odometry.step(replace(last, features=StereoFeatures(last.features.ids, pixels)))
    assert len(odometry.tracks_of_vehicle) < 20
    assert np.isin(fixed_ids, odometry.tracks.ids).mean() > 0.9
