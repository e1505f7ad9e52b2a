"""Samples of all iterations: the feature of each α, what α is relative to, and the folds."""

import numpy as np
import pytest

from probevo.arrays import IntArray
from probevo.config.training import TrainSettings
from probevo.errors import InputError
from probevo.noise.probe.nearest_neighbors import Average
from probevo.training.checkpoint import Iteration
from probevo.training.probe.samples import (
    BLOCKS_A_DRIVE,
    FOLDS,
    fold_of_step,
    folds_of_steps,
    gather_samples,
)
from probevo.training.probe.subsets import SubsetErrors, SubsetSampler
from probevo.training.supervision import Supervision
from training.supervised_drives import drive_of, known, point_world, sampler_of

WORLDS = [point_world(seed=seed, frames=21) for seed in (0, 1)]
SAMPLERS = [
    sampler_of(drive_of(world), known(world, every=4), world.camera, seed=(0, k))
    for k, world in enumerate(WORLDS)
]
ITERATIONS: list[Iteration] = [[sampler.iterate(k) for sampler in SAMPLERS] for k in range(6)]


def owners(sampler: SubsetSampler) -> IntArray:
    """Return the stretch of each feature of a drive."""
    drive = sampler.drive
    return sampler.supervision.stretch_of_step(len(drive.T_curr_prev))[drive.step_of_feature]


def test_every_alpha_stays_with_its_feature() -> None:
    """Features of the second drive are counted on from those of the first."""
    samples = gather_samples(ITERATIONS, SAMPLERS, TrainSettings(relative=False))
    before = len(SAMPLERS[0].drive.used)
    expected = [
        (before * number + feature, alpha)
        for number in range(2)
        for iteration in ITERATIONS
        for feature, alpha in zip(*iteration[number], strict=True)
    ]
    np.testing.assert_array_equal(samples.features, [feature for feature, _ in expected])
    np.testing.assert_array_equal(samples.alphas, [alpha for _, alpha in expected])


@pytest.mark.parametrize("average", ["geometric", "arithmetic"])
def test_relative_alphas_have_a_mean_of_one_over_each_stretch(average: Average) -> None:
    """In the sense of the average that the model takes: a hard stretch does not count as one of bad
    features."""
    samples = gather_samples(ITERATIONS, SAMPLERS, TrainSettings(average=average))
    stretch = np.concatenate([owners(SAMPLERS[0]), owners(SAMPLERS[1]) + 100])[samples.features]
    assert len(np.unique(stretch)) == 10
    values = np.log(samples.alphas) if average == "geometric" else samples.alphas - 1.0
    for each in np.unique(stretch):
        assert abs(values[stretch == each].mean()) < 1e-12
        assert values[stretch == each].std() > 0.0


def test_within_a_stretch_relative_alphas_keep_their_ratios() -> None:
    plain, relative = (
        gather_samples(ITERATIONS, SAMPLERS, TrainSettings(relative=flag)) for flag in (False, True)
    )
    stretch = owners(SAMPLERS[0])[plain.features[plain.features < len(SAMPLERS[0].drive.used)]]
    ratio = (relative.alphas / plain.alphas)[: len(stretch)]
    for each in np.unique(stretch):
        np.testing.assert_allclose(ratio[stretch == each], ratio[stretch == each][0])


@pytest.mark.parametrize("num_steps", [10, 11, 47, 100, 1100])
@pytest.mark.parametrize("drive", [0, 3])
def test_folds_never_split_a_block_of_time(num_steps: int, drive: int) -> None:
    """Ten blocks of nearly equal length alternate: each fold has two, far from each other."""
    folds = fold_of_step(np.arange(num_steps), num_steps, drive)
    starts = np.flatnonzero(np.diff(folds)) + 1
    lengths = np.diff([0, *starts, num_steps])
    assert len(lengths) == BLOCKS_A_DRIVE
    assert lengths.max() - lengths.min() <= 1
    np.testing.assert_array_equal(folds[[0, *starts]], (np.arange(BLOCKS_A_DRIVE) + drive) % FOLDS)


def test_a_step_is_in_the_same_fold_in_every_iteration() -> None:
    samples = gather_samples(ITERATIONS, SAMPLERS, TrainSettings())
    drives = [sampler.drive for sampler in SAMPLERS]
    step = np.concatenate([drives[0].step_of_feature, drives[1].step_of_feature + 1000])[
        samples.features
    ]
    for each in np.unique(step):
        assert len(np.unique(samples.fold_by_time[step == each])) == 1
    assert set(samples.fold_by_time.tolist()) == set(range(FOLDS))


@pytest.mark.parametrize("every", [2, 3, 4, 7])
def test_folds_divide_no_stretch(every: int) -> None:
    """Otherwise one and the same α would be on both sides."""
    world = WORLDS[0]
    sampler = sampler_of(drive_of(world), known(world, every=every), world.camera)
    folds = folds_of_steps(sampler, 0)
    owner = sampler.supervision.stretch_of_step(20)
    for each in np.unique(owner[owner >= 0]):
        assert len(np.unique(folds[owner == each])) == 1
    assert len(np.unique(folds)) > 1


@pytest.mark.parametrize("frames", [[0, 10, 20], [0, 12, 20], [2, 5, 9, 12, 16, 18]])
def test_of_a_few_stretches_each_has_a_fold_of_its_own(frames: list[int]) -> None:
    """Two equal ones would otherwise share one, since ten blocks alternate over five folds."""
    world = WORLDS[0]
    known_at = np.array(frames)
    supervision = Supervision("sparse", known_at, world.T_world_cam[known_at])
    sampler = sampler_of(drive_of(world), supervision, world.camera)
    folds = folds_of_steps(sampler, 3)
    count = len(frames) - 1
    np.testing.assert_array_equal(folds[known_at[:-1]], (np.arange(count) + 3) % FOLDS)
    owner = supervision.stretch_of_step(20)
    for each in range(count):
        assert len(np.unique(folds[owner == each])) == 1
    # Steps outside of all stretches are with the nearest one.
    assert folds[0] == folds[frames[0]]
    assert folds[-1] == folds[frames[-1] - 1]


@pytest.mark.parametrize("num_steps", [2, 4, 5, 9])
def test_of_a_few_steps_neighbours_have_folds_of_their_own(num_steps: int) -> None:
    folds = fold_of_step(np.arange(num_steps), num_steps, 1)
    np.testing.assert_array_equal(folds, (np.arange(num_steps) + 1) % FOLDS)


@pytest.mark.parametrize("kind", ["gt", "loop"])
@pytest.mark.parametrize("every", [1, 4])
def test_no_alpha_is_on_both_sides_when_samples_are_left_out(kind: str, every: int) -> None:
    """With one α for a whole drive, the folds are those of the iterations; else those of time."""
    world = WORLDS[0]
    sampler = sampler_of(drive_of(world), known(world, kind, every), world.camera)
    samples = gather_samples(
        [[sampler.iterate(k)] for k in range(6)], [sampler], TrainSettings(relative=False)
    )
    for alpha in np.unique(samples.alphas):
        assert len(np.unique(samples.fold_by_error[samples.alphas == alpha])) == 1
    assert set(samples.fold_by_error.tolist()) == set(range(FOLDS))
    assert np.array_equal(samples.fold_by_error, samples.fold_by_time) == (kind == "gt")


def test_the_features_of_a_short_drive_are_in_some_fold() -> None:
    for num_steps in range(1, 10):
        folds = fold_of_step(np.arange(num_steps), num_steps, 0)
        assert ((folds >= 0) & (folds < FOLDS)).all()


def test_a_drive_without_samples_is_allowed() -> None:
    nothing = SubsetErrors(np.zeros(0, np.int64), np.zeros(0))
    samples = gather_samples(
        [[nothing, iteration[1]] for iteration in ITERATIONS], SAMPLERS, TrainSettings()
    )
    assert samples.features.min() >= len(SAMPLERS[0].drive.used)


def test_no_sample_at_all_is_refused() -> None:
    nothing = SubsetErrors(np.zeros(0, np.int64), np.zeros(0))
    with pytest.raises(InputError) as caught:
        gather_samples([[nothing, nothing]] * 3, SAMPLERS, TrainSettings(subset=9))
    assert "training data: no step has 9 features to learn from and a true motion." in str(
        caught.value
    )
    assert "--subset" in caught.value.cure
