"""The E-step over all drives: how drives are cut into blocks that are left out together."""

import numpy as np
import pytest

from probevo.config.training import TrainSettings
from probevo.noise import StudentT
from probevo.noise.metric import Metric
from probevo.training.gk.error_samples import (
    BLOCKS_A_DRIVE,
    STEPS_A_BLOCK,
    FeatureLikelihoods,
    blocks_of,
    gather_error_samples,
)
from probevo.training.trainer import TrainingContext
from training.supervised_drives import drive_of, in_memory, point_world

N = STEPS_A_BLOCK


@pytest.mark.parametrize(
    ("steps", "blocks"),
    [
        ([100 * N], [BLOCKS_A_DRIVE]),
        ([5 * N - 1], [4]),
        ([3, 2 * N, N - 1], [1, 2, 1]),
        ([N, 1], [1, 1]),
        ([N + 1], [2]),
        ([1], [2]),
        ([0, 5], [1, 1]),
    ],
)
def test_no_block_is_short_but_where_a_single_drive_is(steps: list[int], blocks: list[int]) -> None:
    assert blocks_of(steps) == blocks


def context_of(*frames: int) -> TrainingContext:
    """Return what a training has of drives with so many frames."""
    worlds = [point_world(frames=count, landmarks=200) for count in frames]
    drives = [in_memory(drive_of(world), world, "gt") for world in worlds]
    settings = TrainSettings(kind="gk", supervision="gt", predictors=("place",))
    metric = Metric.fitted(drives[0].drive.phi)
    return TrainingContext(drives=drives, metric=metric, settings=settings)


def groups_of(*frames: int) -> list[int]:
    """Return how many blocks there are of each drive with so many frames."""
    groups = gather_error_samples(context_of(*frames), StudentT(), lambda share: None).groups
    assert (np.diff(groups) >= 0).all()
    counts: list[int] = np.bincount(np.unique(groups) // BLOCKS_A_DRIVE).tolist()
    return counts


def test_short_drives_are_left_out_as_a_whole() -> None:
    """Otherwise the tracks of a block that is left out would go on in the next."""
    assert groups_of(10, N, 2 * N + 1) == [1, 1, 2]


def test_a_single_short_drive_is_cut_in_two() -> None:
    assert groups_of(10) == [2]


def test_features_are_counted_over_all_drives() -> None:
    samples = gather_error_samples(context_of(4, 5), StudentT(), lambda share: None)
    first, second = (
        gather_error_samples(context_of(n), StudentT(), lambda share: None) for n in (4, 5)
    )
    num_first = context_of(4).drives[0].facts.features
    expected = np.concatenate([first.features, num_first + second.features])
    np.testing.assert_array_equal(samples.features, expected)


def test_likelihoods_are_compared_feature_by_feature() -> None:
    """Features that one of both lacks, however unlikely, have no say."""
    before = FeatureLikelihoods(np.array([1, 4, 6, 9]), np.array([-3.0, -90.0, -5.0, -4.0]))
    after = FeatureLikelihoods(np.array([1, 6, 8, 9]), np.array([-2.0, -5.5, 7.0, -3.9]))
    assert after.gain_over(before) == pytest.approx((1.0 - 0.5 + 0.1) / 3.0)
    assert before.gain_over(after) == pytest.approx(-(1.0 - 0.5 + 0.1) / 3.0)
    nothing = FeatureLikelihoods(np.zeros(0, np.int64), np.zeros(0))
    assert after.gain_over(nothing) == 0.0
