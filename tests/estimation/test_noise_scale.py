"""The running scale of the noise follows what residuals show, within bounds."""

import math

import pytest

from probevo.estimation.noise_scale import MAX_FACTOR, MEMORY_STEPS, PRIOR_STEPS, NoiseScale


def after(shown: list[float | None], scale: NoiseScale | None = None) -> NoiseScale:
    scale = scale or NoiseScale()
    for factor in shown:
        scale = scale.after(factor)
    return scale


def test_at_the_start_the_noise_is_that_of_the_model() -> None:
    assert NoiseScale().factor == 1.0


def test_the_model_counts_for_its_steps() -> None:
    """After as many steps as the model counts for, the factor is halfway, in its logarithm."""
    scale = after([0.25] * round(PRIOR_STEPS))
    assert scale.factor == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize("factor", [0.2, 1.0, 6.0])
def test_it_converges_to_what_every_step_shows(factor: float) -> None:
    assert after([factor] * 1000).factor == pytest.approx(factor, rel=1e-3)


def test_what_was_long_ago_is_forgotten() -> None:
    changed = after([4.0] * round(MEMORY_STEPS), after([0.25] * 1000))
    log_share = math.log(changed.factor / 0.25) / math.log(4.0 / 0.25)
    assert log_share == pytest.approx(1.0 - math.exp(-1.0), abs=0.01)


@pytest.mark.parametrize("nothing", [None, math.nan])
def test_a_step_that_shows_nothing_changes_nothing(nothing: float | None) -> None:
    scale = after([0.25, 0.5])
    assert scale.after(nothing) == scale


@pytest.mark.parametrize("shown", [0.0, 1e-300, 1e300, math.inf])
def test_nothing_leads_beyond_the_bounds(shown: float) -> None:
    factor = after([shown] * 1000).factor
    assert factor * (1.0 + 1e-9) >= 1.0 / MAX_FACTOR
    assert factor <= MAX_FACTOR * (1.0 + 1e-9)


def test_one_noisy_frame_counts_as_one() -> None:
    """A frame a thousand times as noisy, once the scale has settled, changes it by 7 %."""
    settled = after([0.25] * 1000)
    assert settled.after(1e3).factor < 0.25 * 1.07
