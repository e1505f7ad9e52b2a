"""What a track's past says of its disparity: it is the joint Gaussian, and motions are as sure as
they say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from probevo.arrays import FloatArray, IntArray
from probevo.estimation.disparity_filter import WANDERING, DisparityMemory, carried_on, remember
from probevo.estimation.reprojection import ReprojectionSolution, solve_reprojection
from probevo.evaluation.consistency import drift_covariances
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.point_priors import KnownDisparities
from probevo.noise import StudentT
from probevo.tracking.tracks import Tracks
from worlds import CAMERA

STEP = se3.exp(np.array([0.02, 0.01, -0.8, 0.002, 0.008, -0.001]))
SCALE = np.diag([0.04, 0.04, 0.05, 0.05])
NOISE = StudentT(np.inf, SCALE, time_correlation_ratio=3.0)
SLIP_PX = 0.07


def points_m(rng: np.random.Generator, count: int) -> FloatArray:
    """From 6 to 40 m ahead, all over the image."""
    z = rng.uniform(6.0, 40.0, count)
    return np.column_stack(
        [rng.uniform(-0.6, 0.6, count) * z, rng.uniform(-0.2, 0.2, count) * z, z]
    )


def views(points: FloatArray, steps: int) -> list[FloatArray]:
    """True observations of the points from the start and after each step, [N, 4] each, px."""
    places = [points]
    for _ in range(steps):
        places.append(se3.transform(STEP, places[-1]))
    return [CAMERA.project(place) for place in places]


def tracks_of(prev_px: FloatArray, curr_px: FloatArray, ids: IntArray | None = None) -> Tracks:
    own = np.arange(len(prev_px)) if ids is None else ids
    return Tracks(prev_px, curr_px, own, age=np.full(len(own), 2))


def solve_at(tracks: Tracks, model: StudentT, memory: DisparityMemory) -> ReprojectionSolution:
    """What there is to say at the true motion."""
    noise = model.predict(np.zeros((len(tracks), 0)))
    known = memory.of(tracks).known
    return solve_reprojection(
        tracks.prev_px,
        tracks.curr_px,
        noise,
        guess=STEP,
        camera=CAMERA,
        max_iterations=0,
        known=known,
    )


def carried(
    tracks: Tracks, model: StudentT, solution: ReprojectionSolution, before: DisparityMemory
) -> DisparityMemory:
    """The memory after a step whose motion is known."""
    noise = model.predict(np.zeros((len(tracks), 0)))
    trusted = np.ones(len(tracks), np.bool_)
    return carried_on(
        tracks, noise, solution, camera=CAMERA, trusted=trusted, before=before.of(tracks)
    )


def test_true_disparities_are_carried_along_with_the_motion() -> None:
    seen = views(points_m(np.random.default_rng(0), 50), 3)
    memory = DisparityMemory.none()
    for before, now in pairwise(seen):
        tracks = tracks_of(before, now)
        memory = carried(tracks, NOISE, solve_at(tracks, NOISE, memory), memory)
        np.testing.assert_allclose(memory.known.disparity, now[:, 0] - now[:, 2], rtol=1e-9)
        np.testing.assert_allclose(memory.known.error, 0.0, atol=1e-9)


def test_knowing_what_the_observation_says_anyway_changes_nothing() -> None:
    """Where u and v are independent of the disparity, as they are for what is known beside it."""
    scale = np.diag([1e-9, 0.04, 0.05, 0.05])
    model = StudentT(5.0, scale, time_correlation_ratio=2.0)
    rng = np.random.default_rng(1)
    before, now = (px + rng.normal(scale=0.2, size=px.shape) for px in views(points_m(rng, 40), 1))
    noise = model.predict(np.zeros((40, 0)))
    alone = solve_reprojection(before, now, noise, guess=STEP, camera=CAMERA)
    variance = scale[0, 0] + scale[2, 2]
    tau = noise.time_correlated
    assert tau is not None
    cov = np.array([[variance, 0.0], [0.0, 0.0]]) + tau[:, None, None] * np.array(
        [[1.0, -1.0], [-1.0, 1.0]]
    )
    known = KnownDisparities(np.arange(40), before[:, 0] - before[:, 2], np.zeros(40), cov=cov)
    told = solve_reprojection(before, now, noise, guess=STEP, camera=CAMERA, known=known)
    np.testing.assert_allclose(told.T_curr_prev, alone.T_curr_prev, atol=1e-7)
    np.testing.assert_allclose(told.cov, alone.cov, rtol=1e-3)


def test_it_is_the_posterior_of_the_joint_gaussian() -> None:
    """Three frames of one point, at known motions, against the least squares of all its
    observations at once.

    The disparity in each frame follows from that in the first; the left image is exact, so that
    only u_r contributes.
    """
    scale = np.diag([1e-8, 1e-8, 0.05, 1e-8])
    model = StudentT(np.inf, scale, time_correlation_ratio=3.0)
    tau = 9.0 * (scale[0, 0] + scale[2, 2])
    rng = np.random.default_rng(2)
    point = np.array([[1.5, -0.5, 9.0]])
    straight = se3.exp(np.array([0.0, 0.0, -0.8, 0.0, 0.0, 0.0]))
    true = [CAMERA.project(point), CAMERA.project(se3.transform(straight, point))]
    true.append(CAMERA.project(se3.transform(straight @ straight, point)))
    seen = [px + np.array([0.0, 0.0, rng.normal(scale=0.5), 0.0]) for px in true]
    noise = model.predict(np.zeros((1, 0)))
    memory = DisparityMemory.none()
    for before, now in pairwise(seen):
        tracks = tracks_of(before, now)
        solution = solve_reprojection(
            before,
            now,
            noise,
            guess=straight,
            camera=CAMERA,
            max_iterations=0,
            known=memory.of(tracks).known,
        )
        memory = carried(tracks, model, solution, memory)
    # The left image, exact, fixes the disparity by parallax; the three errors tell of δ: one and
    # the same within a step, it wanders between two.
    errors = np.array(
        [(px[0, 0] - px[0, 2]) - (at[0, 0] - at[0, 2]) for px, at in zip(seen, true, strict=True)]
    )
    prior = tau * (np.ones((3, 3)) + np.diag([0.0, 0.0, WANDERING]))
    gain = prior[2] @ np.linalg.inv(prior + scale[2, 2] * np.eye(3))
    assert memory.known.disparity[0] == pytest.approx(true[2][0, 0] - true[2][0, 2], abs=1e-2)
    assert memory.known.error[0] == pytest.approx(gain @ errors, abs=0.02)
    assert memory.known.cov[0, 1, 1] == pytest.approx(
        prior[2, 2] - gain @ prior[2] + WANDERING * tau, rel=0.05
    )


TAU_PX = 1.0
SLIPPING = StudentT(
    np.inf,
    0.5 * SLIP_PX**2 * np.tile(np.eye(2), (2, 2)) + np.diag([1e-6, 1e-6, 0.02, 0.01]),
    time_correlation_ratio=TAU_PX / np.sqrt(0.02),
)


def drive(rng: np.random.Generator, steps: int, life: int) -> list[Tracks]:
    """Steps among 300 patches that slip by 0.07 px from frame to frame, and are new ones after
    ``life`` frames.

    New in each frame, their disparities are off by 0.14 px; by 1 px for long, which wanders from
    the second frame on: the first two sights share the error, as those of a track of two frames are
    taken to.
    """
    count = 300
    ids = np.arange(count)
    age = rng.integers(0, life, count)
    next_id = count
    points = points_m(rng, count) + np.array([0.0, 0.0, 8.0])
    time_correlated = rng.normal(scale=TAU_PX, size=count)
    age[age == 0] = 1
    first = np.ones(count, np.bool_)
    frames = []
    for _ in range(steps + 1):
        error = np.zeros((count, 4))
        error[:, 2:] = rng.normal(scale=[0.1 * np.sqrt(2.0), 0.1], size=(count, 2))
        error[:, 2] -= lasting
        frames.append((ids.copy(), CAMERA.project(points) + error))
        lasting += np.where(first, 0.0, np.sqrt(WANDERING) * TAU_PX) * rng.normal(size=count)
        points[:, :2] += rng.normal(scale=SLIP_PX, size=(count, 2)) * points[:, 2:] / CAMERA.fu_px
        points = se3.transform(STEP, points)
        age = age + 1
        first = np.zeros(count, np.bool_)
        new = age >= life
        fresh = int(new.sum())
        ids[new] = np.arange(next_id, next_id + fresh)
        next_id = next_id + fresh
        points[new] = points_m(rng, fresh) + np.array([0.0, 0.0, 8.0])
        time_correlated[new] = rng.normal(scale=TAU_PX, size=fresh)
        age[new] = 0
        first[new] = True
    found = []
    for (ids_before, before), (ids_now, now) in pairwise(frames):
        _, rows, columns = np.intersect1d(ids_before, ids_now, return_indices=True)
        found.append(tracks_of(before[rows], now[columns], ids_now[columns]))
    return found


@dataclass(frozen=True)
class Driven:
    """The steps of a drive as they were solved."""

    T: FloatArray
    cov: FloatArray
    path_cross_cov: FloatArray

    @staticmethod
    def along(steps: list[Tracks], *, remembers: bool) -> Driven:
        memory = DisparityMemory.none()
        solved = []
        tied = []
        for tracks in steps:
            noise = SLIPPING.predict(np.zeros((len(tracks), 0)))
            before = memory.of(tracks)
            solution = solve_reprojection(
                tracks.prev_px, tracks.curr_px, noise, guess=STEP, camera=CAMERA, known=before.known
            )
            if remembers:
                trusted = np.ones(len(tracks), np.bool_)
                solution, memory = remember(
                    tracks, noise, solution, camera=CAMERA, trusted=trusted, before=before
                )
            solved.append(solution)
            tied.append(memory.path_cross_cov)
        T = np.array([s.T_curr_prev for s in solved])
        cov = np.array([s.cov for s in solved])
        return Driven(T, cov, np.array(tied))

    def end_error_squared(self, path_cross_cov: FloatArray) -> float:
        """NEES of the pose at the end."""
        shared = np.zeros((len(self.T), 6, 1))
        cov = drift_covariances(self.T, self.cov, shared, path_cross_cov=tied)[-1]
        end = np.eye(4)
        true = np.eye(4)
        for T in self.T:
            end = T @ end
            true = STEP @ true
        return float(normalized_error_squared(true[None], end[None], cov[None])[0])


@pytest.fixture(scope="module")
def drives() -> dict[bool, list[Driven]]:
    """30 of 25 steps, with memory and without."""
    seen = [drive(np.random.default_rng(seed), 25, 10) for seed in range(30)]
    return {
        remembers: [Driven.along(steps, remembers=remembers) for steps in seen]
        for remembers in (False, True)
    }


def test_it_makes_better_motions_that_are_as_sure_as_they_say(
    drives: dict[bool, list[Driven]],
) -> None:
    errors = {}
    nees = {}
    for remembers, driven in drives.items():
        T, cov = (
            np.concatenate([getattr(each, name)[8:] for each in driven]) for name in ("T", "cov")
        )
        true = np.broadcast_to(STEP, T.shape)
        nees[remembers] = float(np.mean(normalized_error_squared(true, T, cov)))
        errors[remembers] = float(np.sqrt(np.mean(np.sum((T - true)[:, :3, 3] ** 2, axis=1))))
    assert errors[True] < 0.9 * errors[False]
    assert 5.3 < nees[True] < 7.2


def test_a_path_is_as_sure_as_its_ties_say(drives: dict[bool, list[Driven]]) -> None:
    tied = np.mean([each.end_error_squared(each.path_cross_cov) for each in drives[True]])
    untied = np.mean(
        [each.end_error_squared(np.zeros_like(each.path_cross_cov)) for each in drives[True]]
    )
    assert 4.5 < tied < 8.0
    assert untied > 1.5 * tied


def test_only_what_is_trusted_and_in_front_is_remembered() -> None:
    seen = views(points_m(np.random.default_rng(4), 6), 1)
    tracks = tracks_of(seen[0], seen[1], np.array([9, 4, 7, 1, 3, 8]))
    noise = NOISE.predict(np.zeros((6, 0)))
    solution = solve_at(tracks, NOISE, DisparityMemory.none())
    solution.information[3] = 0.0
    trusted = np.array([True, False, True, True, True, True])
    memory = carried_on(
        tracks, noise, solution, camera=CAMERA, trusted=trusted, before=DisparityMemory.none()
    )
    assert memory.ids.tolist() == [3, 7, 8, 9]
    ids = np.array([8, 2, 9, 100, 0])
    known = memory.of(replace(tracks.kept(np.arange(5)), ids=ids)).known
    assert known.rows.tolist() == [0, 2]
    np.testing.assert_array_equal(known.disparity, memory.known.disparity[[2, 3]])


def test_what_is_measured_otherwise_afterwards_was_an_error() -> None:
    """The self-calibration corrects the last frame by 0.3 px more than before: d stays what it was,
    δ takes it up."""
    seen = views(points_m(np.random.default_rng(8), 20), 2)
    tracks = tracks_of(*seen[:2])
    memory = carried(
        tracks, NOISE, solve_at(tracks, NOISE, DisparityMemory.none()), DisparityMemory.none()
    )
    same = tracks_of(*seen[1:])
    other = tracks_of(*(px - np.array([0.0, 0.0, 0.3, 0.0]) for px in seen[1:]))
    now = memory.of(other)
    then = memory.of(same)
    np.testing.assert_allclose(now.known.error, then.known.error + 0.3, atol=1e-9)
    np.testing.assert_array_equal(now.known.disparity, then.known.disparity)
    np.testing.assert_allclose(
        solve_at(other, NOISE, memory).residuals, solve_at(same, NOISE, memory).residuals, atol=1e-9
    )


def test_where_nothing_is_trusted_nothing_is_left() -> None:
    seen = views(points_m(np.random.default_rng(6), 40), 2)
    memory = DisparityMemory.none()
    noise = NOISE.predict(np.zeros((40, 0)))
    for trusted in (True, False):
        tracks = tracks_of(*seen[:2]) if trusted else tracks_of(*seen[1:])
        before = memory.of(tracks)
        solution = solve_reprojection(
            tracks.prev_px, tracks.curr_px, noise, guess=STEP, camera=CAMERA, known=before.known
        )
        solution, memory = remember(
            tracks, noise, solution, camera=CAMERA, trusted=np.full(40, trusted), before=before
        )
        np.testing.assert_allclose(solution.T_curr_prev, STEP, atol=1e-6)
        assert len(memory.ids) == (40 if trusted else 0)


def test_a_step_that_fixes_no_motion_is_left_as_it_is_and_forgets() -> None:
    far = tracks_of(
        np.tile([300.0, 150.0, 300.0, 150.0], (9, 1)), np.tile([301.0, 150.0, 301.0, 150.0], (9, 1))
    )
    noise = NOISE.predict(np.zeros((9, 0)))
    before = DisparityMemory.none()
    solution = solve_reprojection(far.prev_px, far.curr_px, noise, guess=np.eye(4), camera=CAMERA)
    same, memory = remember(
        far, noise, solution, camera=CAMERA, trusted=np.ones(9, np.bool_), before=before
    )
    assert same is solution
    assert not len(memory.ids)


def test_nothing_is_remembered_where_no_error_lasts() -> None:
    seen = views(points_m(np.random.default_rng(5), 6), 1)
    tracks = tracks_of(seen[0], seen[1])
    model = StudentT(5.0, SCALE)
    nothing = DisparityMemory.none()
    assert not len(carried(tracks, model, solve_at(tracks, model, nothing), nothing).ids)
    assert not len(nothing.of(tracks).ids)
