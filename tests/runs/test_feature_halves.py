"""Two halves of the features: that they are halves, and what is said where claims are wrong."""

from collections import Counter
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import probevo as pv
from cli.rendering import write_wall
from probevo.arrays import FloatArray
from probevo.cli.covariance_check import verdict
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.runs.feature_halves import SPAN, Agreement, checkerboard, compare_halves, halves_of
from probevo.sequences.frame import Frame
from probevo.sequences.without_imu import WithoutImu
from worlds import CAMERA, drive


class Drive:
    """A recording of features with an error of so many pixels."""

    imu = None

    def __init__(self, sigma_px: float, frames: int = 60) -> None:
        self.path = Path("drive")
        self.camera = CAMERA
        self.frames = drive(np.random.default_rng(3), frames, points=300, sigma_px=sigma_px)

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> object:
        return iter(self.frames)


@cache
def agreements(sigma_px: float, estimator: str) -> list[Agreement]:
    noise = pv.noise.Fixed(0.2**2 * np.eye(4))
    found = compare_halves(Drive(sigma_px), noise, {"estimator": estimator})  # type: ignore[arg-type]
    return list(found.agreements)


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_halves_whose_noise_is_as_claimed_agree(estimator: str) -> None:
    found = agreements(0.2, estimator)
    assert [one.frames for one in found] == ([1, SPAN] if estimator == "window" else [1])
    for one in found:
        assert "too small" not in verdict(one)
        # Less than 1 by what is claimed for the rig of both; over several frames that is most.
        assert (0.2 if one.frames == 1 else 0.15) < one.mean < 1.3
        assert one.share_inside(0.99) > 0.95


def test_claims_of_a_window_that_are_too_small_by_three_are_found_out() -> None:
    """Without any truth. Over eight frames most of the claim is for the calibration of the rig,
    which both halves have in common, so that less of it shows."""
    step, span = agreements(0.6, "window")
    assert verdict(step).startswith("! Over 1 frame: σ is claimed 2.")
    assert step.share_inside(0.99) < 0.5
    assert span.mean > 4.0 * agreements(0.2, "window")[1].mean


def test_the_scatter_of_a_wrong_claim_does_not_excuse_it() -> None:
    """Errors that are three times too large over eight frames: of 27 motions, which overlap, hardly
    three are independent, and their own scatter exceeds what is tested."""
    rng = np.random.default_rng(4)
    wrong = Agreement(SPAN, 7.3 * rng.chisquare(2.0, size=27) * 3.0)
    assert wrong.mean < 1.0 + 3.0 * wrong.standard_error
    assert verdict(wrong).startswith("! Over 8 frames: σ is claimed 3.16 times too small")


def test_of_right_claims_few_motions_say_nothing_and_many_say_that_they_hold() -> None:
    rng = np.random.default_rng(5)
    said = Counter(
        verdict(Agreement(1, rng.chisquare(6.0, size=count))) for count in [11] * 500 + [100] * 500
    )
    few = [text for text in said if "too few motions to tell" in text]
    assert sum(said[text] for text in few) > 490
    assert said["Over 1 frame: the claim holds."] > 490
    # Of a claim that holds, the standard error that is expected is that of the scatter.
    right = Agreement(1, rng.chisquare(6.0, size=10_000))
    np.testing.assert_allclose(right.standard_error_if_true, right.standard_error, rtol=0.05)


def test_two_frames_enlarge_a_claim_that_their_residuals_contradict() -> None:
    (one,) = agreements(0.6, "two-frame")
    assert "too small" not in verdict(one)


def test_no_feature_is_in_both_halves() -> None:
    features = drive(np.random.default_rng(0), 1)[0]
    one, other = halves_of(features)
    assert one.features is not None
    assert other.features is not None
    assert features.features is not None
    assert sorted([*one.features.ids, *other.features.ids]) == sorted(features.features.ids)
    image = np.zeros((375, 1242), np.uint8)
    mask = np.ones(image.shape, np.bool_)
    mask[:, 600:] = False
    images = Frame(0, 0, left=image, right=image.copy())
    for frame in (images, replace(images, left_mask=mask)):
        one, other = halves_of(frame)
        assert isinstance(one.left_mask, np.ndarray)
        assert isinstance(other.left_mask, np.ndarray)
        assert not (one.left_mask & other.left_mask).any()
        usable = (one.left_mask | other.left_mask) > 0
        np.testing.assert_array_equal(usable, True if frame.left_mask is None else mask)


@pytest.mark.parametrize("factor", [1, 2, 64, -3])
def test_identities_of_any_step_are_halved(factor: int) -> None:
    """Even ones, for example, of a tracker that numbers left and right features in turn."""
    frame = drive(np.random.default_rng(0), 1)[0]
    assert frame.features is not None
    ids = factor * np.arange(len(frame.features.ids))
    one, _ = halves_of(replace(frame, features=replace(frame.features, ids=ids)))
    assert one.features is not None
    assert 0.4 < len(one.features.ids) / len(ids) < 0.6


@dataclass(frozen=True)
class OfAcceleration:
    """Noise that refuses an undefined acceleration."""

    columns: tuple[str, ...] = ("acceleration", "vibration")

    def predict(self, predictors: FloatArray) -> pv.noise.StereoNoise:
        assert np.isfinite(predictors).all()
        return pv.noise.StudentT().predict(predictors)

    def check_camera(self, camera: pv.StereoCamera) -> None:
        """Accept any."""


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_predictors_see_the_imu_and_the_solve_does_not(estimator: str, data_root: Path) -> None:
    """Without it, the noise was another one than any run's."""
    sequence = pv.open_sequence(data_root / "euroc" / "MH_01_micro")
    config = {"estimator": estimator}
    one, *_ = compare_halves(sequence, OfAcceleration(), config, max_frames=17).agreements
    other, *_ = compare_halves(sequence, pv.noise.StudentT(), config, max_frames=17).agreements
    assert len(one.squared) == len(other.squared)
    with pytest.raises(InputError, match="accelerometer"):
        compare_halves(WithoutImu.of(sequence), OfAcceleration(), config)


@pytest.mark.parametrize("shape", [(370, 1226), (480, 752), (8, 5)])
def test_a_checkerboard_is_half_white(shape: tuple[int, int]) -> None:
    assert 0.4 < (checkerboard(shape) > 0).mean() < 0.65


def test_a_recording_that_is_too_short_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="8 of its steps count and were solved by both halves"):
        compare_halves(Drive(0.2, 13), pv.noise.StudentT(), {}, max_frames=None)  # type: ignore[arg-type]
    write_wall(tmp_path / "wall", frames=4)
    assert main(["covariance-check", str(tmp_path / "wall")]) == 2


def test_the_command_prints_a_row_for_each_span(
    data_root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = data_root / "euroc" / "MH_01_micro"
    assert main(["covariance-check", str(path), "--max-frames", "30"]) == 0
    shown = capsys.readouterr().out
    assert "30 frames, 29 solved twice" in shown
    assert "\n1 frame " in shown
    assert f"\n{SPAN} frames " in shown
    assert "in common does not show" in shown
