"""The point world: exact geometry, errors as stated, and files that the odometry reads."""

from pathlib import Path
from typing import get_args

import numpy as np
import pytest
from pydantic import ValidationError

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.sequences import open_sequence
from probevo_sim.point_config import LawName, PointCamera, PointConfig, PointNoise, PointOutliers
from probevo_sim.point_world import (
    PointWorld,
    circle,
    simulate_points,
    training_and_test_world,
    write_points,
    write_training_and_test,
)

NO_NOISE = PointNoise(sigma_low_px=0.0, sigma_high_px=0.0)
NO_OUTLIERS = PointOutliers(fraction=0.0)
SHORT = PointConfig(train_s=1.0, test_s=2.0)


def world_of(config: PointConfig, duration_s: float = 2.0, seed: int = 0) -> PointWorld:
    return simulate_points(config, duration_s, np.random.default_rng(seed))


def whitened(world: PointWorld) -> FloatArray:
    """Return the errors whitened by the Cholesky factor of the covariance of each, [n, 4]."""
    lower = np.linalg.cholesky(world.covariance)
    white: FloatArray = np.linalg.solve(lower, (world.pixels - world.true_px)[..., None])[..., 0]
    return white


@pytest.mark.parametrize("law", get_args(LawName))
def test_sample_covariance_of_the_errors_is_the_stated_one(law: LawName) -> None:
    """Whitened by the stated covariances, M errors have the sample covariance 1.

    An entry is the mean of M products; their variance is 2 on the diagonal and 1 off it for
    Gaussian errors, and at ν = 10, with κ = (ν − 2)/(ν − 4) = 4/3, it is 3κ − 1 = 3 and κ = 4/3.
    Five standard deviations are allowed.
    """
    noise = PointNoise(law=law, correlation=0.5, dof=10.0 if law == "heavy-tailed" else None)
    white = whitened(world_of(PointConfig(noise=noise, outliers=NO_OUTLIERS), duration_s=10.0))
    diagonal, beside = (3.0, 4.0 / 3.0) if law == "heavy-tailed" else (2.0, 1.0)
    bound = 5.0 * np.sqrt(np.where(np.eye(4) > 0, diagonal, beside) / len(white))
    assert np.all(np.abs(white.T @ white / len(white) - np.eye(4)) < bound)


def test_outliers_are_uniform_on_top_of_the_noise() -> None:
    """Without noise their errors fill ±range evenly: covariance range²/3, each entry within five
    standard deviations.

    Of M uniform errors, e² has the variance range⁴ 4/45, and e_i e_j has range⁴/9.
    """
    world = world_of(
        PointConfig(noise=NO_NOISE, outliers=PointOutliers(fraction=0.2, range_px=10.0)),
        duration_s=10.0,
    )
    errors = (world.pixels - world.true_px)[~world.inlier]
    bound = 5.0 * 10.0**2 * np.sqrt(np.where(np.eye(4) > 0, 4.0 / 45.0, 1.0 / 9.0) / len(errors))
    stated = 10.0**2 / 3.0 * np.eye(4)
    assert np.all(np.abs(errors.T @ errors / len(errors) - stated) < bound)
    np.testing.assert_allclose(
        world.covariance[~world.inlier], np.broadcast_to(stated, (len(errors), 4, 4))
    )
    assert 9.9 < np.abs(errors).max() <= 10.0
    np.testing.assert_array_equal(world.pixels[world.inlier], world.true_px[world.inlier])


@pytest.mark.parametrize(("fraction", "count"), [(0.0, 0), (0.1, 200), (0.3337, 667), (1.0, 2000)])
def test_the_number_of_outliers_is_exact(fraction: float, count: int) -> None:
    config = PointConfig(outliers=PointOutliers(fraction=fraction))
    assert world_of(config, duration_s=0.1).outlier.sum() == count


def test_without_noise_the_true_motion_leaves_no_residual() -> None:
    """e = y' − f(T g(y)) is zero to rounding in every step."""
    world = world_of(PointConfig(noise=NO_NOISE, outliers=NO_OUTLIERS))
    for step in world.steps():
        points = se3.transform(step.T_curr_prev, world.camera.triangulate(step.tracks.prev_px))
        np.testing.assert_allclose(
            step.tracks.curr_px, world.camera.project(points), rtol=0.0, atol=1e-9
        )


def test_the_truth_of_a_step_belongs_to_its_tracks() -> None:
    config = PointConfig(noise=PointNoise(law="column"))
    world = world_of(config, duration_s=1.0)
    steps = 0
    for k, step in enumerate(world.steps()):
        for frame, pixels, covariance in (
            (k, step.tracks.prev_px, step.prev_covariance),
            (k + 1, step.tracks.curr_px, step.curr_covariance),
        ):
            rows = slice(world.first_of_frame[frame], world.first_of_frame[frame + 1])
            where = {tuple(pixel): n for n, pixel in enumerate(world.pixels[rows].tolist())}
            found = [where[tuple(pixel)] for pixel in pixels.tolist()]
            np.testing.assert_array_equal(world.ids[rows][found], step.tracks.ids)
            np.testing.assert_array_equal(world.covariance[rows][found], covariance)
        np.testing.assert_array_equal(step.inlier, ~world.outlier[step.tracks.ids])
        steps += 1
    assert steps == len(world) - 1


def test_the_camera_drives_the_circle_looking_ahead() -> None:
    """Positions lie on the circle, the velocity is the given speed along z, y points down, and C is
    a rotation."""
    config = PointConfig(radius_m=7.0, speed_m_s=2.0)
    t_s = np.linspace(0.0, 30.0, 50)
    h_s = 1e-5
    T_world_cam = circle(config, t_s)
    velocity = (circle(config, t_s + h_s) - circle(config, t_s - h_s))[:, :3, 3] / (2.0 * h_s)
    np.testing.assert_allclose(np.linalg.norm(T_world_cam[:, :3, 3], axis=1), 7.0)
    np.testing.assert_allclose(velocity, 2.0 * T_world_cam[:, :3, 2], atol=1e-8)
    np.testing.assert_allclose(T_world_cam[:, :3, 1], np.tile([0.0, 0.0, -1.0], (50, 1)))
    C = T_world_cam[:, :3, :3]
    np.testing.assert_allclose(so3.exp(so3.log(C)), C, atol=1e-12)


def test_the_default_drives_are_those_of_the_paper() -> None:
    """90 m in 30 s and 180 m in 60 s: the angle from frame to frame times radius, summed up."""
    for world, duration_s, path_m in zip(
        training_and_test_world(PointConfig()), (30.0, 60.0), (90.0, 180.0), strict=True
    ):
        rotations = so3.log(world.T_world_cam[:-1, :3, :3].mT @ world.T_world_cam[1:, :3, :3])
        assert 14.3 * np.linalg.norm(rotations, axis=1).sum() == pytest.approx(path_m)
        assert world.stamps_ns[-1] == duration_s * 1e9
        assert len(world.landmarks_m) == 2000


def test_landmarks_are_seen_in_both_images_and_within_range() -> None:
    config = PointConfig(camera=PointCamera(nearest_m=3.0, farthest_m=20.0))
    world = world_of(config)
    depth_m = world.camera.triangulate(world.true_px)[:, 2]
    assert depth_m.min() >= 3.0 - 1e-9
    assert depth_m.max() <= 20.0 + 1e-9
    assert world.true_px.min() >= 0.0
    assert np.all(world.true_px.max(axis=0) <= [639.0, 479.0, 639.0, 479.0])


def test_a_frame_sees_a_hundred_to_three_hundred_landmarks() -> None:
    seen = np.diff(training_and_test_world(PointConfig())[1].first_of_frame)
    assert seen.min() >= 100
    assert seen.max() <= 300


def test_an_id_is_the_index_of_a_landmark() -> None:
    """Every observation triangulates to the landmark of its id."""
    world = world_of(PointConfig())
    frame = np.repeat(np.arange(len(world)), np.diff(world.first_of_frame))
    points = se3.transform(world.T_world_cam[frame], world.camera.triangulate(world.true_px))
    np.testing.assert_allclose(points, world.landmarks_m[world.ids], atol=1e-9)


def test_another_law_comes_with_the_same_landmarks_and_outliers() -> None:
    row = world_of(PointConfig(noise=PointNoise(law="row")))
    column = world_of(PointConfig(noise=PointNoise(law="column")))
    np.testing.assert_array_equal(row.true_px, column.true_px)
    np.testing.assert_array_equal(row.outlier, column.outlier)


def test_training_and_test_worlds_are_independent() -> None:
    """Other landmarks, other outliers, and errors without correlation: |r| < 5/√M."""
    train, test = training_and_test_world(SHORT)
    assert not np.isin(train.landmarks_m, test.landmarks_m).any()
    assert (train.outlier != test.outlier).any()
    count = len(train.ids)
    first, second = ((world.pixels - world.true_px)[:count, 0] for world in (train, test))
    assert abs(np.corrcoef(first, second)[0, 1]) < 5.0 / np.sqrt(count)


def test_the_same_seed_gives_the_same_bytes_and_another_does_not(tmp_path: Path) -> None:
    for name, seed in (("once", 3), ("again", 3), ("other", 4)):
        write_training_and_test(SHORT.model_copy(update={"seed": seed}), tmp_path / name)
    for name in ("train.npz", "test.npz", "config.yaml"):
        once = (tmp_path / "once" / name).read_bytes()
        assert once == (tmp_path / "again" / name).read_bytes()
        assert once != (tmp_path / "other" / name).read_bytes()


def test_the_file_is_a_tracks_sequence_with_truth(tmp_path: Path) -> None:
    world = world_of(SHORT)
    write_points(world, tmp_path / "points.npz")
    sequence = open_sequence(tmp_path / "points.npz")
    assert sequence.format == "tracks"
    np.testing.assert_array_equal(sequence.stamps_ns, world.stamps_ns)
    for frame, written in zip(sequence, world.frames(), strict=True):
        assert frame.features is not None
        assert written.features is not None
        np.testing.assert_array_equal(frame.features.ids, written.features.ids)
        np.testing.assert_array_equal(frame.features.pixels, written.features.pixels)
    assert sequence.truth is not None
    T_first_cam = se3.inverse(world.T_world_cam[0]) @ world.T_world_cam
    np.testing.assert_allclose(sequence.truth.T_world_cam, T_first_cam, atol=1e-12)
    with np.load(tmp_path / "points.npz", allow_pickle=False) as archive:
        np.testing.assert_array_equal(archive["covariance"], world.covariance)
        np.testing.assert_array_equal(archive["inlier"], world.inlier)
        np.testing.assert_array_equal(archive["true_uv"], world.true_px)


def test_a_world_in_which_nothing_is_seen() -> None:
    """One landmark, seldom in view."""
    world = world_of(PointConfig(landmarks=1), duration_s=0.5)
    assert len(world.ids) == 0
    assert [len(step.tracks) for step in world.steps()] == [0] * 5


def test_too_large_a_world_is_refused() -> None:
    with pytest.raises(InputError, match=r"36001 frames × 2000 landmarks are 72,002,000"):
        world_of(PointConfig(), duration_s=3600.0)


@pytest.mark.parametrize(
    "values",
    [
        {"noise": {"law": "diagonal"}},
        {"noise": {"dof": 2.0}},
        {"noise": {"correlation": 1.1}},
        {"outliers": {"fraction": 1.1}},
        {"landmarks": 0},
        {"radius_m": float("inf")},
        {"laws": 1},
    ],
)
def test_settings_out_of_bounds_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        PointConfig.model_validate(values)
