"""PROBE-GK from drives through point worlds whose noise is known: with truth, with some of it, and
with none."""

import json
import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import probevo as pv
from probevo.arrays import FloatArray
from probevo.config import SolverConfig
from probevo.config.training import KernelSettings, TrainSettings
from probevo.errors import InputError
from probevo.noise import GeneralizedKernel, NoiseModel, StudentT
from probevo.noise.base import LearnedNoiseModel
from probevo.noise.metric import Metric
from probevo.sequences.base import Sequence
from probevo.training.checkpoint import NoCheckpoint
from probevo.training.drive import Drive
from probevo.training.gk import expectation_maximization
from probevo.training.gk.error_samples import ErrorSamples, gather_error_samples
from probevo.training.gk.expectation import solve_drive
from probevo.training.gk.expectation_maximization import (
    STATIC_ITERATIONS,
    TIME_CORRELATION_GAIN,
    learn_kernel,
    learn_student_t,
)
from probevo.training.progress import TrainingProgress
from probevo.training.supervised_drive import DriveInMemory
from probevo.training.trainer import TrainingContext, trainer_of
from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import PointWorld, simulate_points, write_points
from training.supervised_drives import drive_of, in_memory, known, point_world, rmse_m, true_motions

FRAMES = 64
RECORDINGS = [{"name": "circle", "frames": FRAMES}]
GIVEN: dict[str, Any] = {"neighbors": 150, "prior_counts": 8.0, "iterations": 2, "centers": 300}
"""Weights and the dof are searched for."""
ONCE: dict[str, Any] = {"iterations": 1, "time_correlation": False}
"""Where time correlation does not matter, which is rejected here anyway."""
EXACT: dict[str, Any] = {"truth_sigma_m": 0.0, "truth_sigma_deg": 0.0, "time_correlation": False}


@pytest.fixture(scope="module", autouse=True)
def fewer_held_out() -> Iterator[None]:
    """Compare hyperparameters by a quarter of the features, and save most of the time of it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("probevo.noise.gk.folds.MAX_HELD_OUT", 150)
        yield


@dataclass(frozen=True)
class Learned:
    """A learned model, and the settings of its training."""

    model: GeneralizedKernel
    settings: TrainSettings

    @property
    def likelihoods(self) -> list[float]:
        return [iteration["log_likelihood"] for iteration in self.model.training["iterations"]]


@cache
def world(seed: int = 0, frames: int = FRAMES) -> PointWorld:
    """σ grows from 0.05 px at the bottom of the image to 1 px at its top."""
    return point_world(seed=seed, frames=frames)


@cache
def drive(seed: int = 0, frames: int = FRAMES) -> Drive:
    """Its columns are ln σ, and a random number."""
    return drive_of(world(seed, frames), seed=seed)


def supervised_drive(kind: str = "none", seed: int = 0, frames: int = FRAMES) -> DriveInMemory:
    every = 10 if kind == "sparse" else 1
    return in_memory(drive(seed, frames), world(seed, frames), kind, every)


def settings_of(**gk: Any) -> TrainSettings:
    return TrainSettings(kind="gk", gk=KernelSettings(**GIVEN | gk))


def metric() -> Metric:
    return Metric.fitted(drive().phi, ("ln_sigma", "random"))


class Kept(NoCheckpoint):
    """Keeps the iterations of a training, for another one that begins with the same."""

    def __init__(self) -> None:
        self.models: dict[int, LearnedNoiseModel] = {}

    def em_model(self, number: int) -> LearnedNoiseModel | None:
        return deepcopy(self.models.get(number))

    def keep_em_model(self, number: int, model: LearnedNoiseModel) -> None:
        self.models[number] = deepcopy(model)


BEGUN: dict[str, Kept] = defaultdict(Kept)
"""Trainings of the drive that several tests begin with, by their names."""


def context_of(
    drives: list[DriveInMemory],
    settings: TrainSettings,
    progress: TrainingProgress | None = None,
    checkpoint: NoCheckpoint | None = None,
) -> TrainingContext:
    return TrainingContext(
        drives=drives,
        metric=metric(),
        settings=settings,
        recordings=RECORDINGS,
        progress=progress or TrainingProgress(),
        checkpoint=checkpoint or NoCheckpoint(),
    )


def learn(drives: list[DriveInMemory], begun: str | None = None, **gk: Any) -> Learned:
    settings = settings_of(**gk)
    checkpoint = None if begun is None else BEGUN[begun]
    return Learned(learn_kernel(context_of(drives, settings, checkpoint=checkpoint)), settings)


@cache
def learned(kind: str = "none") -> Learned:
    """Where all is known or nothing, time correlation is learned, too, and rejected."""
    return learn([supervised_drive(kind)], kind, time_correlation=kind in ("gt", "none"))


@cache
def static() -> StudentT:
    """Return what the training without truth begins with."""
    return learn_student_t(
        context_of([supervised_drive()], settings_of(), checkpoint=BEGUN["none"])
    )


def error_m(model: NoiseModel) -> float:
    """Return the RMS error of the steps of another drive, through a world of its own, m."""
    other = in_memory(drive(1), world(1))
    motions = solve_drive(other, model.predict, SolverConfig()).T_curr_prev
    return rmse_m(motions, true_motions(world(1)))


def log_ratio(model: GeneralizedKernel) -> FloatArray:
    """Return ln(predicted σ / true σ) of the features of another drive."""
    scale = model.predict(drive(1).phi).scale
    found: FloatArray = 0.5 * np.log(np.trace(scale, axis1=1, axis2=2) / 4.0) - drive(1).phi[:, 0]
    return found


@pytest.mark.parametrize("kind", ["none", "gt"])
def test_each_iteration_makes_the_residuals_likelier(kind: str) -> None:
    """Until it no longer matters: within 0.002 nats a feature of the best before; and the first by
    more than 0.1."""
    likelihoods = learned(kind).likelihoods
    assert len(likelihoods) == GIVEN["iterations"] + 1
    assert likelihoods[1] > likelihoods[0] + 0.1
    assert (np.diff(likelihoods) > -2e-3).all()


def test_the_static_fit_gets_likelier_too() -> None:
    likelihoods = [iteration["log_likelihood"] for iteration in static().training["iterations"]]
    # One more than the iterations without time correlation, which is rejected here.
    assert len(likelihoods) == STATIC_ITERATIONS + 1
    assert (np.diff(likelihoods) > -2e-3).all()
    assert likelihoods[-1] > likelihoods[0] + 0.1


def test_a_model_says_after_which_iteration_it_was_taken() -> None:
    """Time correlation is rejected here, and with it the iterations that learn it."""
    assert static().training["kept_iteration"] == STATIC_ITERATIONS
    assert static().training["time_correlation_gain"] < TIME_CORRELATION_GAIN
    assert learned().model.training["kept_iteration"] == GIVEN["iterations"]


def test_features_that_drop_out_do_not_decide_on_time_correlation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """As where the motion of the hardest steps is no longer found: the features that are left seem
    likelier by far more than the margin, but each of them is not."""
    likelihoods = []

    def without_unlikely(
        context: TrainingContext,
        model: NoiseModel,
        on_part: Callable[[float], None],
        *,
        factors: FloatArray | None = None,
    ) -> ErrorSamples:
        """Leave out the unlikeliest twentieth where the model may have time correlation."""
        samples = gather_error_samples(context, model, on_part, factors=factors)
        if len(likelihoods) > STATIC_ITERATIONS:
            likely = samples.log_likelihood > np.quantile(samples.log_likelihood, 0.05)
            arrays = (
                "features",
                "phi",
                "errors",
                "error_cov",
                "groups",
                "log_likelihood",
                "profile",
            )
            samples = replace(samples, **{name: getattr(samples, name)[likely] for name in arrays})
        likelihoods.append(samples.progress["log_likelihood"])
        return samples

    monkeypatch.setattr(expectation_maximization, "gather_error_samples", without_unlikely)
    model = learn_student_t(context_of([supervised_drive(frames=20)], settings_of()))
    assert len(likelihoods) == 2 * STATIC_ITERATIONS
    assert likelihoods[-1] > likelihoods[STATIC_ITERATIONS] + 2.0 * TIME_CORRELATION_GAIN
    assert model.training["time_correlation_gain"] < TIME_CORRELATION_GAIN
    assert model.training["kept_iteration"] == STATIC_ITERATIONS


def test_without_any_truth_the_motions_of_another_drive_get_better() -> None:
    """GK-EM against one Student-t for all features, fitted to the same drive; by more than 5 %."""
    assert error_m(learned("none").model) < 0.95 * error_m(static())


@pytest.mark.parametrize("kind", ["gt", "sparse", "loop", "none"])
def test_whatever_is_known_the_noise_comes_out_as_it_is(kind: str) -> None:
    """σ, which ranges over a factor of 20, within 15 % for nine of ten features, and 5 % on
    average."""
    left = log_ratio(learned(kind).model)
    assert np.quantile(np.abs(left), 0.9) < 0.15
    assert abs(np.mean(left)) < 0.05


@pytest.mark.parametrize("kind", ["gt", "sparse", "loop"])
def test_with_truth_the_motions_get_better_too(kind: str) -> None:
    assert error_m(learned(kind).model) < 0.95 * error_m(static())


def test_the_random_column_gets_no_weight() -> None:
    np.testing.assert_array_equal(learned("none").model.weights_ > 0.0, [True, False])


def test_truth_that_is_exact_is_found_to_be_so() -> None:
    """With its σ estimated, all is as if the motions were known (PROBE-GK Alg. 1): σ of each
    feature within 1 %."""
    exact = learn([supervised_drive("gt")], "exact", **EXACT)
    np.testing.assert_allclose(log_ratio(learned("gt").model), log_ratio(exact.model), atol=0.01)


def test_with_exact_truth_one_iteration_suffices() -> None:
    """More hardly change it: σ of a feature by 2 % in the mean."""
    once = learn([supervised_drive("gt")], "exact", **EXACT | {"iterations": 1})
    assert np.mean(np.abs(log_ratio(once.model) - log_ratio(learned("gt").model))) < 0.02


def test_truth_that_is_far_off_does_no_harm() -> None:
    """By 5 cm and 0.5° from frame to frame, ten times what the features are: it hardly
    counts."""
    right = supervised_drive("gt", frames=20)
    off = (
        np.random.default_rng(4).normal(size=(20, 6))
        * np.r_[np.full(3, 0.05), np.full(3, np.deg2rad(0.5))]
    )
    poses = right.supervision.T_world_cam @ pv.geometry.se3.exp(off)
    wrong = replace(right, supervision=replace(right.supervision, T_world_cam=poses))
    left = log_ratio(learn([wrong], **ONCE).model)
    assert abs(np.mean(left)) < 0.1
    taken_as_exact = log_ratio(learn([wrong], truth_sigma_m=0.0, truth_sigma_deg=0.0, **ONCE).model)
    assert np.mean(taken_as_exact) > 0.5


def test_by_least_squares_it_works_too() -> None:
    """As PROBE-GK derives it. Of fewer frames, to save time."""
    model = learn([supervised_drive(frames=30)], quadratic=True, **ONCE).model
    assert error_m(model) < 0.97 * error_m(static())


def test_the_published_variant_tells_good_features_from_bad() -> None:
    """By how much, it tells less well."""
    model = learn(
        [supervised_drive("gt")],
        variant="published",
        neighbors=None,
        reach=1.0,
        centers=2000,
        **ONCE,
    ).model
    home = ~np.asarray(model.predict(drive(1).phi).out_of_domain)
    assert home.mean() > 0.99
    true = drive(1).phi[:, 0]
    assert np.corrcoef((log_ratio(model) + true)[home], true[home])[0, 1] > 0.9


def test_of_residuals_it_learns_more_noise_than_of_observations() -> None:
    """They hold that of the point, too; and each says what it refers to."""
    residual = learn([supervised_drive(frames=30)], refers_to="residual", **ONCE).model
    assert (residual.refers_to, learned().model.refers_to) == ("residual", "observation")
    assert np.mean(log_ratio(residual)) > np.mean(log_ratio(learned().model)) + 0.1


def test_a_bias_is_left_out_unless_it_is_asked_for() -> None:
    """Of 0.4 px to the right in both images, with exact truth, without which it would pass for a
    motion."""
    right = supervised_drive("gt", frames=20)
    shifted = right.drive.curr_px + np.array([0.4, 0.0, 0.4, 0.0])
    off = replace(right, drive=replace(right.drive, curr_px=shifted))
    without, with_bias = (
        learn([off], bias=bias, truth_sigma_m=0.0, truth_sigma_deg=0.0, **ONCE | {"iterations": 2})
        .model.predict(drive(1).phi)
        .bias
        for bias in (False, True)
    )
    np.testing.assert_array_equal(without, np.zeros_like(without))
    np.testing.assert_allclose(with_bias.mean(axis=0), [0.4, 0.0, 0.4, 0.0], atol=0.12)


def simulated(rho: float, sigma_px: float) -> PointWorld:
    """Errors in the left and the right image of that correlation and σ, and of 4 dof."""
    noise = {
        "law": "constant",
        "sigma_low_px": sigma_px,
        "sigma_high_px": sigma_px,
        "correlation": rho,
        "dof": 4.0,
    }
    config = PointConfig.model_validate(
        {
            "radius_m": 3.0,
            "height_m": 5.0,
            "landmarks": 800,
            "noise": noise,
            "outliers": {"fraction": 0.0},
        }
    )
    return simulate_points(config, 4.0, np.random.default_rng(0))


def correlated(rho: float) -> DriveInMemory:
    there = simulated(rho, sigma_px=0.4)
    return DriveInMemory(drive_of(there), there.camera, known(there))


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_the_static_fit_finds_how_left_and_right_go_together(rho: float) -> None:
    """Only the static Student-t knows of correlations among the four numbers; within 0.08, and its
    σ within 10 %."""
    settings = TrainSettings(kind="student-t", gk=KernelSettings(time_correlation=False))
    model = learn_student_t(context_of([correlated(rho)], settings))
    sigma = np.sqrt(np.diag(model.scale_))
    correlation = model.scale_ / np.outer(sigma, sigma)
    np.testing.assert_allclose([correlation[0, 2], correlation[1, 3]], [rho, rho], atol=0.08)
    np.testing.assert_allclose(sigma * np.sqrt(model.dof_ / (model.dof_ - 2.0)), 0.4, rtol=0.1)


@pytest.mark.parametrize("kind", ["none", "gt"])
def test_recordings_of_different_noise_are_not_taken_for_heavy_tails(kind: str) -> None:
    """σ of 0.1 and 0.4 px: the size of each is found to 10 %, and the tails are those of each."""
    worlds = [simulated(rho=0.0, sigma_px=sigma_px) for sigma_px in (0.1, 0.4)]
    drives = [DriveInMemory(drive_of(world), world.camera, known(world, kind)) for world in worlds]
    settings = TrainSettings(kind="student-t", gk=KernelSettings(time_correlation=False))
    model = learn_student_t(context_of(drives, settings))
    assert model.scale_is_relative
    factors = np.array(model.training["recording_factors"])
    variances = factors * np.diagonal(model.scale_).mean() * model.dof_ / (model.dof_ - 2.0)
    np.testing.assert_allclose(np.sqrt(variances), [0.1, 0.4], rtol=0.1)
    assert 3.0 < model.dof_ < 5.5


def test_of_two_drives_both_are_learned_from() -> None:
    """One with truth, one without; their blocks of time are told apart."""
    drives = [supervised_drive("gt", 0, 20), supervised_drive("none", 2, 20)]
    model = learn(drives, **ONCE).model
    assert model.num_samples_ == sum(len(each.drive.phi) for each in drives)
    # What the predictor says of the sizes is all that there is to say.
    np.testing.assert_allclose(model.training["recording_factors"], [1.0, 1.0], rtol=0.1)
    assert np.mean(np.abs(log_ratio(model))) < 0.1


def test_the_hyperparameters_are_chosen_in_the_first_iteration_and_kept() -> None:
    model = learned().model
    searches = model.training["searches"]
    assert set(searches) == {"weights", "dof", "dof_counts"}
    assert list(searches["weights"]["chosen"].values()) == model.weights_.tolist()
    assert model.search_.keys() == {"dof"}  # of the errors, which change with the motions
    assert model.shape_.neighbors == GIVEN["neighbors"]


def test_what_the_model_tells_of_its_training_is_json() -> None:
    """No infinity, and nothing of NumPy's."""
    for model in (learned("none").model, learned("loop").model, static()):
        assert json.loads(json.dumps(model.training, allow_nan=False)) == model.training
    assert (
        pv.TrainSettings.model_validate(learned().model.training["settings"]) == learned().settings
    )


def test_how_far_a_loop_is_from_closing_is_told_where_it_is_known() -> None:
    assert all(
        "loop_error_m" in iteration for iteration in learned("gt").model.training["iterations"]
    )
    assert not any(
        "loop_error_m" in iteration for iteration in learned("none").model.training["iterations"]
    )


@dataclass(frozen=True)
class Reported:
    """A model of a short drive, and what its training told of its progress."""

    model: GeneralizedKernel
    progress: TrainingProgress
    done: list[int]


@pytest.fixture(scope="module")
def reported() -> Reported:
    settings = settings_of(iterations=2)
    done: list[int] = []
    progress = TrainingProgress(
        12,
        trainer_of("gk").num_iterations(settings),
        lambda frames, total: done.append(frames),
    )
    model = learn_kernel(context_of([supervised_drive(frames=12)], settings, progress))
    return Reported(model, progress, done)


def test_every_iteration_is_reported(reported: Reported) -> None:
    num_iterations = trainer_of("gk").num_iterations(settings_of(iterations=2))
    done = reported.done
    assert reported.progress.iterations_done == num_iterations == 2 * STATIC_ITERATIONS + 2
    assert done == sorted(done)
    assert done[-1] == reported.progress.total
    assert len(set(done)) > num_iterations


def test_the_same_drives_give_the_same_model(reported: Reported) -> None:
    one = reported.model.to_file()
    other = learn([supervised_drive(frames=12)], iterations=2).model.to_file()
    assert one.facts == other.facts
    for name, array in one.arrays.items():
        assert np.asarray(array).tobytes() == np.asarray(other.arrays[name]).tobytes()


def test_a_drive_that_shows_too_little_is_refused() -> None:
    blind = replace(supervised_drive(), drive=replace(drive(), used=np.zeros_like(drive().used)))
    with pytest.raises(InputError, match="no step has"):
        learn_kernel(context_of([blind], settings_of()))


def test_a_drive_of_a_single_step_will_do() -> None:
    there = world(0, 2)
    single = DriveInMemory(drive(0, 2), there.camera, known(there))
    noise = learn([single], iterations=1).model.predict(drive(1).phi)
    assert (np.linalg.eigvalsh(noise.scale) > 0.0).all()


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Sequence]:
    """One short drive, of some 75 landmarks a frame."""
    path = tmp_path_factory.mktemp("tracks") / "0.npz"
    write_points(point_world("column", frames=7, landmarks=400), path)
    return [pv.open_sequence(path)]


SMALL = {"neighbors": 50, "prior_counts": 8.0, "iterations": 2, "centers": 100}


@pytest.mark.parametrize("kind", ["gk", "student-t"])
@pytest.mark.parametrize("supervision", ["gt", "sparse", "loop", "none"])
def test_a_recording_gives_the_same_bytes_whenever(
    recordings: list[Sequence], tmp_path: Path, kind: Any, supervision: Any
) -> None:
    """Train by ``train_model``, as ``probevo train`` does, and run the odometry with the model."""
    without = SMALL | {"time_correlation": False}  # of which the static fit has it
    settings = TrainSettings(
        kind=kind,
        supervision=supervision,
        every_s=0.5 if supervision == "sparse" else 0.0,
        predictors=("place",) if kind == "gk" else None,
        gk=KernelSettings(**without) if kind == "gk" else KernelSettings(),
    )
    contents = set()
    for name in "ab":
        contents.add(
            pv.train_model(recordings, settings, tmp_path / f"{name}.safetensors").read_bytes()
        )
    assert len(contents) == 1
    model = pv.load_model(tmp_path / "a.safetensors")
    assert model.camera == recordings[0].camera
    noise = model.predict(np.zeros((3, len(model.columns))))
    assert (np.linalg.eigvalsh(noise.scale) > 0.0).all()
    odometry = pv.StereoOdometry(recordings[0].camera, model)
    assert all(np.isfinite(odometry.step(frame).T_curr_prev).all() for frame in recordings[0])


@pytest.mark.parametrize("kind", ["gk", "student-t"])
def test_stopped_after_any_iteration_and_resumed_it_gives_the_same_bytes(
    recordings: list[Sequence], tmp_path: Path, kind: Any
) -> None:
    """Stop once in the second iteration; or in each but the first, one after another."""
    gk = KernelSettings(**SMALL) if kind == "gk" else KernelSettings()
    settings = TrainSettings(
        kind=kind, supervision="none", predictors=("place",) if kind == "gk" else None, gk=gk
    )
    whole = tmp_path / "whole.safetensors"
    num_iterations = trainer_of(kind).num_iterations(settings)
    pv.train_model(recordings, settings, whole)
    out = tmp_path / "again.safetensors"
    work = tmp_path / "again.safetensors.work"
    for stop in range(1, num_iterations):

        def show(done: int, total: int, after: int = stop) -> None:
            if done > total * (1 + after) / (1 + num_iterations):
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            pv.train_model(recordings, settings, out, show)
        assert {path.name for path in work.glob("em-iteration-*")} == {
            f"em-iteration-{number}.safetensors" for number in range(stop)
        }
        if stop == 1:
            shutil.copytree(work, tmp_path / "once.safetensors.work")
    for stopped in (tmp_path / "once.safetensors", out):
        assert pv.train_model(recordings, settings, stopped).read_bytes() == whole.read_bytes()
