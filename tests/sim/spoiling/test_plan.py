"""What is done to each frame: shares, lengths, and the same for the same seed."""

from collections import Counter
from itertools import groupby, pairwise

import numpy as np
import pytest

from probevo_sim.spoiling.config import PRESETS, PresetName, SpoilConfig
from probevo_sim.spoiling.plan import plan_frames

COUNT = 20_000


def test_the_share_of_clean_frames_and_the_length_of_bursts_are_those_of_the_settings() -> None:
    plans = plan_frames(SpoilConfig(clean=0.3, burst_frames=5.0), COUNT)
    clean = sum(plan.effect is None for plan in plans)
    assert clean / COUNT == pytest.approx(0.3, abs=0.03)
    lengths = [len(list(burst)) for number, burst in groupby(p.burst for p in plans) if number >= 0]
    assert np.mean(lengths) == pytest.approx(5.0, rel=0.05)


@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_each_preset_has_its_effects_and_no_others(preset: PresetName) -> None:
    found = Counter(plan.effect for plan in plan_frames(SpoilConfig(preset=preset), COUNT))
    assert set(found) - {None} == set(PRESETS[preset])


def test_amounts_grow_with_the_severity() -> None:
    for severity in (0.1, 1.0):
        plans = plan_frames(SpoilConfig(severity=severity), COUNT)
        amounts = [plan.amount for plan in plans if plan.effect is not None]
        assert min(amounts) >= 0.5 * severity
        assert max(amounts) <= severity


@pytest.mark.parametrize(("severity", "share"), [(1.0, 0.2), (0.5, 0.6), (0.25, 0.8), (1e-17, 1.0)])
def test_more_severe_is_more_frames_lost(severity: float, share: float) -> None:
    plans = plan_frames(SpoilConfig(preset="frames", clean=0.2, severity=severity), COUNT)
    clean = sum(plan.effect is None for plan in plans)
    assert clean / COUNT == pytest.approx(share, abs=0.03)


def test_the_first_frame_is_clean_and_places_in_a_burst_are_counted() -> None:
    plans = plan_frames(SpoilConfig(clean=0.0), 100)
    assert plans[0].effect is None
    for before, plan in pairwise(plans[1:]):
        expected = before.position + 1 if plan.burst == before.burst else 0
        assert plan.position == expected


def test_the_start_is_as_long_as_asked_for() -> None:
    plans = plan_frames(SpoilConfig(clean=0.0, clean_start_frames=7), 100)
    assert all(plan.effect is None for plan in plans[:7])
    assert plans[7].effect is not None
    assert plans[7:] == plan_frames(SpoilConfig(clean=0.0), 100)[1:-6]


def test_another_seed_is_another_plan() -> None:
    first = plan_frames(SpoilConfig(seed=1), 100)
    assert first == plan_frames(SpoilConfig(seed=1), 100)
    assert first != plan_frames(SpoilConfig(seed=2), 100)


def test_without_bursts_all_frames_are_clean() -> None:
    for config in (SpoilConfig(preset="delay"), SpoilConfig(clean=1.0)):
        assert all(plan.effect is None for plan in plan_frames(config, 50))


def test_only_the_preset_delay_has_one_by_itself() -> None:
    assert SpoilConfig().delay_frames == 0
    assert SpoilConfig(preset="delay").delay_frames == 1
    assert SpoilConfig(preset="blur", right_late_frames=3).delay_frames == 3
