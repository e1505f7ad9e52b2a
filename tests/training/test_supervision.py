"""α in closed form, which frames' truth is used, and truth that is not enough."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.training.supervision import MIN_ALPHA_M, Supervision, supervision_of
from training.supervised_drives import recording

STEPS = 10


def random_motions(seed: int = 0) -> FloatArray:
    """Return T_curr_prev of ten steps that go and turn anywhere, [10, 4, 4]."""
    rng = np.random.default_rng(seed)
    return se3.exp(rng.normal(scale=[0.3, 0.3, 1.0, 0.2, 0.3, 0.1], size=(STEPS, 6)))


MOTIONS = random_motions()
SOMEWHERE = se3.exp(np.array([100.0, -20.0, 5.0, 1.0, -2.0, 0.5]))
"""The first pose of the truth."""
TRUTH = SOMEWHERE @ se3.chain_motions(MOTIONS)
OFFSET_M = np.array([0.3, -0.2, 0.6])


def shifted(step: int, offset_m: FloatArray) -> FloatArray:
    """Return the motions with an offset at one step, in the frame of the previous camera."""
    T_prev_curr = se3.inverse(MOTIONS)
    T_prev_curr[step, :3, 3] += offset_m
    return se3.inverse(T_prev_curr)


def supervised(kind: str, every_s: float = 0.0, truth: FloatArray | None = TRUTH) -> Supervision:
    return supervision_of(recording(truth), kind, every_s, num_frames=STEPS + 1)  # type: ignore[arg-type]


def test_a_path_is_made_of_its_motions() -> None:
    poses = se3.chain_motions(MOTIONS)
    np.testing.assert_array_equal(poses[0], np.eye(4))
    np.testing.assert_allclose(se3.inverse(poses[1:]) @ poses[:-1], MOTIONS, atol=1e-12)


@pytest.mark.parametrize(
    ("kind", "every_s"), [("gt", 0.0), ("sparse", 0.3), ("position", 0.0), ("loop", 0.0)]
)
def test_exact_motions_have_no_error(kind: str, every_s: float) -> None:
    """But for the floor that keeps the logarithm of α from counting rounding errors."""
    supervision = supervised(kind, every_s)
    alphas = supervision.errors(MOTIONS)
    assert alphas.shape == (len(supervision.stretches),)
    np.testing.assert_array_equal(alphas, MIN_ALPHA_M)


@pytest.mark.parametrize("kind", ["gt", "sparse"])
@pytest.mark.parametrize("step", [0, 4, 9])
def test_an_offset_shows_in_its_own_step(kind: str, step: int) -> None:
    """‖d‖/√3 (PROBE IV-A), and nothing in the steps before and after."""
    alphas = supervised(kind).errors(shifted(step, OFFSET_M))
    assert alphas[step] == pytest.approx(np.linalg.norm(OFFSET_M) / np.sqrt(3.0))
    np.testing.assert_array_equal(np.delete(alphas, step), MIN_ALPHA_M)


@pytest.mark.parametrize(("step", "stretch"), [(0, 0), (2, 0), (3, 1), (7, 2)])
def test_an_offset_shows_at_the_end_of_its_stretch(step: int, stretch: int) -> None:
    """Three steps a stretch: whichever of them is off, the end of the stretch is off by as much."""
    alphas = supervised("sparse", 0.3).errors(shifted(step, OFFSET_M))
    assert len(alphas) == 3
    assert alphas[stretch] == pytest.approx(np.linalg.norm(OFFSET_M) / np.sqrt(3.0))
    np.testing.assert_array_equal(np.delete(alphas, stretch), MIN_ALPHA_M)


@pytest.mark.parametrize("step", [0, 5, 9])
def test_an_offset_opens_a_loop(step: int) -> None:
    assert supervised("loop").errors(shifted(step, OFFSET_M)) == pytest.approx(
        np.linalg.norm(OFFSET_M) / np.sqrt(3.0)
    )


def test_an_error_of_rotation_counts_by_its_lever() -> None:
    """0.01 rad at the first of three steps: what the camera went after it, across the axis, times
    the angle."""
    axis = np.array([0.0, 0.6, 0.8])
    T_prev_curr = se3.inverse(MOTIONS)
    T_prev_curr[0, :3, :3] = (
        T_prev_curr[0, :3, :3] @ se3.exp(np.r_[0.0, 0.0, 0.0, 0.01 * axis])[:3, :3]
    )
    arm_m = (se3.inverse(se3.chain_motions(MOTIONS)[1]) @ se3.chain_motions(MOTIONS)[3])[:3, 3]
    expected = 2.0 * np.sin(0.005) * np.linalg.norm(np.cross(axis, arm_m)) / np.sqrt(3.0)
    assert supervised("sparse", 0.3).errors(se3.inverse(T_prev_curr))[0] == pytest.approx(expected)


@pytest.mark.parametrize("every_s", [0.0, 0.2])
def test_positions_are_compared_after_the_best_fit(every_s: float) -> None:
    """A path too long by 3 %: around its middle, each position is off by 3 % of how far it is from
    there."""
    T_prev_curr = se3.inverse(MOTIONS)
    T_prev_curr[:, :3, 3] *= 1.03
    supervision = supervised("position", every_s)
    positions = se3.chain_motions(MOTIONS)[supervision.frames, :3, 3]
    expected = (
        0.03 * np.linalg.norm(positions - positions.mean(axis=0), axis=1).mean() / np.sqrt(3.0)
    )
    assert supervision.errors(se3.inverse(T_prev_curr)) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_positions_need_no_common_world(seed: int) -> None:
    """A rigid transform of the truth changes nothing, nor do its rotations."""
    rng = np.random.default_rng(seed)
    T = se3.exp(rng.normal(scale=3.0, size=6))
    elsewhere = (
        T @ TRUTH @ se3.from_parts(se3.exp(rng.normal(size=(STEPS + 1, 6)))[:, :3, :3], np.zeros(3))
    )
    wrong = random_motions(7)
    assert supervised("position", truth=elsewhere).errors(wrong) == pytest.approx(
        supervised("position").errors(wrong)
    )


def test_the_world_of_the_truth_does_not_matter() -> None:
    wrong = random_motions(8)
    for kind, every_s in (("gt", 0.0), ("sparse", 0.4), ("loop", 0.0)):
        elsewhere = se3.inverse(SOMEWHERE) @ TRUTH
        np.testing.assert_allclose(
            supervised(kind, every_s, elsewhere).errors(wrong),
            supervised(kind, every_s).errors(wrong),
        )


@pytest.mark.parametrize(
    ("every_s", "frames"),
    [
        (0.0, range(11)),
        (0.05, range(11)),
        (0.1, range(11)),
        (0.2, range(0, 11, 2)),
        (0.25, range(0, 11, 3)),
        (0.3, range(0, 11, 3)),
        (1.0, [0, 10]),
    ],
)
def test_the_truth_is_used_only_so_often(every_s: float, frames: list[int]) -> None:
    """Stamps are exact nanoseconds since 1970; one that is due to the nanosecond is taken."""
    for kind in ("sparse", "gt"):
        np.testing.assert_array_equal(supervised(kind, every_s).frames, list(frames))


def test_gaps_in_the_truth_restart_the_count() -> None:
    """Frames 0, 1 and 4 to 6 are unknown: 2, then the first one 0.2 s later that is known."""
    truth = TRUTH.copy()
    truth[[0, 1, 4, 5, 6]] = np.nan
    np.testing.assert_array_equal(supervised("sparse", 0.2, truth).frames, [2, 7, 9])
    supervision = supervised("sparse", 0.0, truth)
    np.testing.assert_array_equal(supervision.frames, [2, 3, 7, 8, 9, 10])
    np.testing.assert_array_equal(supervision.stretches, [[2, 3], [3, 7], [7, 8], [8, 9], [9, 10]])
    np.testing.assert_array_equal(supervision.errors(MOTIONS), MIN_ALPHA_M)
    np.testing.assert_array_equal(
        supervision.stretch_of_step(STEPS), [-1, -1, 0, 1, 1, 1, 1, 2, 3, 4]
    )


def test_every_step_belongs_to_its_stretch() -> None:
    np.testing.assert_array_equal(supervised("gt").stretch_of_step(STEPS), range(STEPS))
    np.testing.assert_array_equal(
        supervised("sparse", 0.3).stretch_of_step(STEPS), [0, 0, 0, 1, 1, 1, 2, 2, 2, -1]
    )
    for kind in ("position", "loop"):
        np.testing.assert_array_equal(supervised(kind).stretch_of_step(STEPS), np.zeros(STEPS))
    np.testing.assert_array_equal(
        supervised("position", 0.3).stretch_of_step(STEPS), [0, 0, 0, 0, 0, 0, 0, 0, 0, -1]
    )


@pytest.mark.parametrize("unknown", [slice(None), slice(0, 9), slice(2, 11)])
def test_a_loop_without_truth_closes(unknown: slice) -> None:
    """A truth that knows only one end does not help."""
    truth = TRUTH.copy()
    truth[unknown] = np.nan
    for known in (truth, None):
        alpha = supervised("loop", truth=known).errors(MOTIONS)
        assert alpha == pytest.approx(
            np.linalg.norm(se3.chain_motions(MOTIONS)[-1, :3, 3]) / np.sqrt(3.0)
        )


@pytest.mark.parametrize("unknown", [[0], [10], [0, 10]])
def test_the_truth_next_to_an_end_of_a_loop_stands_for_it(unknown: list[int]) -> None:
    """The drive does not close: that was assumed, and an error of metres learned."""
    truth = TRUTH.copy()
    truth[unknown] = np.nan
    loop = supervised("loop", truth=truth)
    first, last = (int(0 in unknown), 10 - int(10 in unknown))
    np.testing.assert_array_equal(loop.stretches, [[first, last]])
    assert not loop.is_assumed
    assert loop.errors(MOTIONS) == pytest.approx(MIN_ALPHA_M)


def test_a_truth_that_is_no_loop_is_refused() -> None:
    """Unless it could return in the frames that are unknown."""
    straight = np.tile(np.eye(4), (STEPS + 1, 1, 1))
    straight[:, 2, 3] = np.arange(STEPS + 1)
    straight[8:] = np.nan
    with pytest.raises(InputError, match=r"its truth ends 7\.0 m from where it begins"):
        supervised("loop", truth=straight)
    straight[5:] = np.nan
    assert supervised("loop", truth=straight).is_assumed


def test_a_loop_cut_short_does_not_close() -> None:
    """Unless the truth knows both ends."""
    assert len(supervision_of(recording(TRUTH), "loop", 0.0, num_frames=6).frames) == 2
    for known in (None, np.full_like(TRUTH, np.nan)):
        with pytest.raises(InputError) as caught:
            supervision_of(recording(known), "loop", 0.0, num_frames=6)
        assert (
            "drive: only 6 of its 11 frames are used, but the loop closes at the last one."
            in str(caught.value)
        )
        assert caught.value.cure == "Leave out --max-frames."


def test_without_any_supervision_the_motions_of_all_features_are_the_truth() -> None:
    completed = supervised("none", truth=None).completed(MOTIONS)
    wrong = random_motions(9)
    np.testing.assert_array_equal(completed.errors(MOTIONS), MIN_ALPHA_M)
    np.testing.assert_allclose(completed.errors(wrong), supervised("gt").errors(wrong))
    assert supervised("gt").completed(wrong).T_world_cam is not None
    np.testing.assert_array_equal(supervised("gt").completed(wrong).T_world_cam, TRUTH)


@pytest.mark.parametrize("every_s", [0.0, 0.3, 1.0])
def test_predicted_errors_are_those_of_random_motions(every_s: float) -> None:
    """Monte Carlo: 2,000 motions drawn from their covariances have the predicted RMS α, ±5 %."""
    rng = np.random.default_rng(2)
    factor = rng.normal(
        scale=[[0.02], [0.02], [0.02], [0.004], [0.004], [0.004]], size=(STEPS, 6, 6)
    )
    supervision = supervised("sparse", every_s)
    squared = [
        supervision.errors(se3.exp((factor @ rng.normal(size=(STEPS, 6, 1)))[..., 0]) @ MOTIONS)
        ** 2
        for _ in range(2000)
    ]
    expected = supervision.predicted_errors(MOTIONS, factor @ factor.mT)
    np.testing.assert_allclose(np.sqrt(np.mean(squared, axis=0)), expected, rtol=0.05)


def test_motions_that_are_certain_have_the_least_error() -> None:
    np.testing.assert_array_equal(
        supervised("gt").predicted_errors(MOTIONS, np.zeros((STEPS, 6, 6))), MIN_ALPHA_M
    )


@pytest.mark.parametrize("kind", ["gt", "sparse", "position"])
@pytest.mark.parametrize("truth", [None, np.full_like(TRUTH, np.nan)])
def test_no_truth_is_refused(kind: str, truth: FloatArray | None) -> None:
    with pytest.raises(InputError) as caught:
        supervised(kind, truth=truth)
    assert str(caught.value).startswith(
        f"drive: it has no ground truth, which --supervision {kind} needs."
    )
    assert "--supervision" in caught.value.cure


def test_truth_of_some_frames_is_no_full_truth() -> None:
    truth = TRUTH.copy()
    truth[3:5] = np.nan
    with pytest.raises(InputError) as caught:
        supervised("gt", truth=truth)
    assert "drive: only 9 of 11 frames have a true pose." in str(caught.value)
    assert caught.value.cure == "Take --supervision sparse."


@pytest.mark.parametrize(("kind", "known", "needs"), [("sparse", 1, 2), ("position", 3, 4)])
def test_too_little_truth_is_refused(kind: str, known: int, needs: int) -> None:
    truth = TRUTH.copy()
    truth[known:] = np.nan
    with pytest.raises(InputError) as caught:
        supervised(kind, truth=truth)
    assert f"the truth of {known} frames is used; --supervision {kind} needs {needs}." in str(
        caught.value
    )
    assert "--every-s" in caught.value.cure


def test_truth_too_seldom_is_refused() -> None:
    with pytest.raises(
        InputError, match=r"the truth of 1 frames is used; --supervision sparse needs 2\."
    ):
        supervised("sparse", 1.1)


def test_frames_that_are_not_used_need_no_truth() -> None:
    truth = TRUTH.copy()
    truth[6:] = np.nan
    supervision = supervision_of(recording(truth), "gt", 0.0, num_frames=6)
    np.testing.assert_array_equal(supervision.frames, range(6))
    short = supervision_of(replace(recording(TRUTH)), "loop", 0.0, num_frames=6)
    np.testing.assert_array_equal(short.frames, [0, 5])
