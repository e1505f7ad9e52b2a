"""K and γ: their values where the answer is known, and that they improve a second drive."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from probevo.arrays import FloatArray, IntArray
from probevo.config import SolverConfig
from probevo.config.training import TrainSettings
from probevo.noise import Fixed, StudentT
from probevo.noise.metric import Metric
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.training.checkpoint import Iteration
from probevo.training.drive import Drive
from probevo.training.probe import selection
from probevo.training.probe.samples import folds_of_steps, gather_samples
from probevo.training.probe.selection import (
    EXPONENTS,
    MIN_ERRORS,
    NEIGHBORS,
    Search,
    choose_exponent,
    choose_neighbors,
    out_of_fold,
    weighted_motions,
)
from probevo.training.probe.subsets import SubsetErrors, SubsetSampler
from probevo.training.supervision import from_step_to_step
from probevo_sim.point_world import PointWorld
from training.supervised_drives import (
    drive_of,
    known,
    point_world,
    rmse_m,
    sampler_of,
    true_motions,
)

BASES = {"fixed": Fixed(), "student-t": StudentT()}


@pytest.fixture(autouse=True)
def fewer_queries(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare values of K on a fifth of the samples, and save most of the time."""
    monkeypatch.setattr(selection, "MAX_QUERIES", 4000)


def blocks(count: int) -> IntArray:
    return np.arange(count) * 10 // count % 5


def test_pure_noise_wants_as_many_neighbours_as_there_are() -> None:
    """Nothing to be learned from a place: the mean of all is best."""
    rng = np.random.default_rng(0)
    search = choose_neighbors(rng.normal(size=(3000, 2)), rng.normal(size=3000), blocks(3000))
    assert search.chosen == max(search.candidates) == NEIGHBORS[-1]
    assert search.errors[0] > search.errors[-1]


def test_a_fine_structure_without_noise_wants_few() -> None:
    rng = np.random.default_rng(1)
    places = rng.uniform(size=(3000, 1))
    assert (
        choose_neighbors(places, np.sin(100.0 * places[:, 0]), blocks(3000)).chosen == NEIGHBORS[0]
    )


def test_between_them_it_is_a_balance() -> None:
    """One period and as much noise as signal: neither 10 nor 800; the error that is left is that of
    the noise."""
    rng = np.random.default_rng(2)
    places = rng.uniform(size=(4000, 1))
    search = choose_neighbors(
        places, np.sin(6.0 * places[:, 0]) + rng.normal(size=4000), blocks(4000)
    )
    assert NEIGHBORS[0] < search.chosen < NEIGHBORS[-1]
    assert min(search.errors) == pytest.approx(1.0, rel=0.08)
    assert search.as_dict() == {
        "candidates": [float(k) for k in NEIGHBORS],
        "errors": list(search.errors),
        "chosen": search.chosen,
    }


@pytest.mark.parametrize("count", [10, 30, 100])
def test_no_k_is_larger_than_what_other_folds_hold(count: int) -> None:
    rng = np.random.default_rng(3)
    search = choose_neighbors(rng.normal(size=(count, 2)), rng.normal(size=count), blocks(count))
    assert max(search.candidates) <= 0.8 * count
    assert 1 <= search.chosen <= 0.8 * count


def test_samples_of_one_fold_alone_still_give_some_k() -> None:
    search = choose_neighbors(np.zeros((6, 1)), np.ones(6), np.zeros(6, np.int64))
    assert 1 <= search.chosen <= 6


def test_neighbours_come_from_other_folds() -> None:
    """α says which fold it is from; no query gets a value of its own fold."""
    rng = np.random.default_rng(4)
    coordinates = rng.normal(size=(500, 2))
    fold = blocks(500)
    for k in range(5):
        means = out_of_fold(
            coordinates,
            (fold == k).astype(float),
            fold,
            neighbors=10,
            queries=coordinates[fold == k][:40],
            fold_of_query=np.full(40, k),
        )
        np.testing.assert_array_equal(means, 0.0)
    everywhere = out_of_fold(
        coordinates,
        fold.astype(float),
        fold,
        neighbors=10,
        queries=coordinates,
        fold_of_query=fold,
    )
    assert np.isfinite(everywhere).all()


def test_k_is_no_larger_than_what_other_folds_hold() -> None:
    means = out_of_fold(
        np.zeros((4, 1)),
        np.arange(4.0),
        np.array([0, 0, 0, 1]),
        neighbors=10,
        queries=np.zeros((2, 1)),
        fold_of_query=np.array([1, 0]),
    )
    np.testing.assert_allclose(means, [1.0, 3.0])


def test_one_alpha_for_a_whole_drive_is_no_structure_of_its_features() -> None:
    """Each iteration has one α, by chance, for all of its features: folds by time find it in the
    features nearby, which are of the same iteration too, and folds by iteration do not."""
    world = point_world(seed=0)
    drive = drive_of(world)
    sampler = sampler_of(drive, known(world, "loop"), world.camera)
    rng = np.random.default_rng(6)
    iterations: list[Iteration] = []
    for _ in range(60):
        near = np.argsort(np.abs(sampler.coordinates[:, 1] - rng.normal()))[:500]
        alphas = np.full(500, np.exp(rng.normal()))
        iterations.append([SubsetErrors(np.sort(near), alphas)])
    samples = gather_samples(iterations, [sampler], TrainSettings(relative=False))
    coordinates = sampler.coordinates[samples.features, 1:]
    values = np.log(samples.alphas)
    assert choose_neighbors(coordinates, values, samples.fold_by_error).chosen == NEIGHBORS[-1]
    assert choose_neighbors(coordinates, values, samples.fold_by_time).chosen < NEIGHBORS[-1]


@dataclass(frozen=True, eq=False)
class SampledDrive:
    """A drive, the world that it goes through, and its sampler."""

    world: PointWorld
    drive: Drive
    sampler: SubsetSampler


@cache
def sampled_drive(
    kind: str = "gt", *, seed: int = 0, every: int = 1, base_name: str = "fixed"
) -> SampledDrive:
    """σ from 0.05 px to 1 px from the left to the right of the image."""
    base = BASES[base_name]
    world = point_world("column", seed=seed)
    drive = drive_of(world, base=base, seed=seed)
    supervision = known(world, kind, every).completed(drive.T_curr_prev)
    return SampledDrive(
        world, drive, sampler_of(drive, supervision, world.camera, base=base, relative=True)
    )


@pytest.fixture
def sampled() -> SampledDrive:
    return sampled_drive()


@cache
def static_rmse_m(drive: SampledDrive) -> float:
    """RMSE of the motions of equal weights, m."""
    return rmse_of(drive, np.ones(len(drive.drive.used)))


def rmse_of(drive: SampledDrive, beta: FloatArray) -> float:
    motions = weighted_motions(drive.sampler, beta, drive.drive.used)
    return rmse_m(motions, true_motions(drive.world))


def test_where_phi_says_nothing_gamma_is_0(sampled: SampledDrive) -> None:
    """ln of the mean α of K random neighbours is a random number, of whatever size."""
    for scale in (0.0, 0.05, 0.5):
        noise = scale * np.random.default_rng(5).normal(size=len(sampled.drive.used))
        search = choose_exponent([sampled.sampler], [noise])
        assert search.chosen == 0.0
        assert search.candidates == EXPONENTS


def test_where_phi_is_the_noise_gamma_is_that_of_variances(sampled: SampledDrive) -> None:
    """With ln(σ/σ̄) in place of ln(α/ᾱ), the weight that minimises the variance is β = (σ/σ̄)²."""
    log_sigma = sampled.drive.phi[:, 0] - sampled.drive.phi[:, 0].mean()
    search = choose_exponent([sampled.sampler], [log_sigma])
    assert search.chosen in (2.0, 3.0)
    errors = dict(zip(search.candidates, search.errors, strict=True))
    assert errors[search.chosen] < 0.8 * errors[0.0]
    assert errors[32.0] > errors[0.0]


def test_where_phi_says_the_contrary_gamma_is_0(sampled: SampledDrive) -> None:
    log_sigma = sampled.drive.phi[:, 0] - sampled.drive.phi[:, 0].mean()
    assert choose_exponent([sampled.sampler], [-log_sigma]).chosen == 0.0


def test_equal_weights_give_the_motions_back(sampled: SampledDrive) -> None:
    """Noise of another size all over does not move the optimum; a step with too few features keeps
    its motion."""
    ones = np.ones(len(sampled.drive.used))
    used = sampled.drive.used.copy()
    for factor in (1.0, 4.0):
        motions = weighted_motions(sampled.sampler, factor * ones, used)
        np.testing.assert_allclose(motions, sampled.drive.T_curr_prev, atol=3e-4)
    used[sampled.drive.rows(5)] = False
    motions = weighted_motions(sampled.sampler, 4.0 * ones, used)
    np.testing.assert_array_equal(motions[5], sampled.drive.T_curr_prev[5])


def test_a_solve_that_does_not_converge_counts_as_it_is(sampled: SampledDrive) -> None:
    """Weights that spoil a step must not be judged by the motion of equal ones: after one iteration
    no solve has converged, and each step is off by more than with equal weights."""
    sampler = replace(sampled.sampler, solver=SolverConfig(max_iterations=1))
    truth = true_motions(sampled.world)
    log_sigma = sampled.drive.phi[:, 0] - sampled.drive.phi[:, 0].mean()
    motions = weighted_motions(sampler, np.exp(-8.0 * log_sigma), sampled.drive.used)
    assert (np.abs(motions - sampled.drive.T_curr_prev).max(axis=(1, 2)) > 0.0).all()
    assert rmse_m(motions, truth) > 1.5 * rmse_m(sampled.drive.T_curr_prev, truth)


def test_steps_that_no_half_can_solve_have_no_say() -> None:
    """Both halves keep the motion of all features there and agree: γ and errors are those of the
    drive without them."""
    whole = sampled_drive("none")
    end = 40
    first = whole.drive.first_of_step[end]
    lost = replace(whole.drive, used=np.arange(len(whole.drive.used)) < first)
    short = replace(
        whole.drive,
        T_curr_prev=whole.drive.T_curr_prev[:end],
        first_of_step=whole.drive.first_of_step[: end + 1],
        **{
            name: getattr(whole.drive, name)[:first]
            for name in ("prev_px", "curr_px", "ids", "phi", "used")
        },
    )
    log_sigma = whole.drive.phi[:, 0] - whole.drive.phi[:, 0].mean()
    searches = []
    for drive in (lost, short):
        sampler = sampler_of(
            drive, from_step_to_step(drive.T_curr_prev), whole.world.camera, base=Fixed()
        )
        searches.append(choose_exponent([sampler], [log_sigma[: len(drive.used)]]))
    np.testing.assert_allclose(searches[0].errors, searches[1].errors, rtol=1e-9)
    assert searches[0].chosen == searches[1].chosen > 0.0
    blind = [
        sampler_of(
            replace(lost, used=lost.used & False), whole.sampler.supervision, whole.world.camera
        )
    ]
    assert choose_exponent(blind, [log_sigma]).chosen == 0.0  # no step at all


@cache
def without_truth() -> Search:
    """γ of the drive without any truth, of which φ is the noise."""
    none = sampled_drive("none")
    return choose_exponent([none.sampler], [none.drive.phi[:, 0] - none.drive.phi[:, 0].mean()])


@pytest.mark.parametrize("every", [60, 20])
def test_a_few_known_errors_do_not_decide_on_gamma(every: int) -> None:
    """One loop, or a few stretches: γ is that of the drive without any truth."""
    few = sampled_drive("sparse", every=every)
    assert len(few.sampler.supervision.stretches) < MIN_ERRORS
    log_sigma = few.drive.phi[:, 0] - few.drive.phi[:, 0].mean()
    search = choose_exponent([few.sampler], [log_sigma])
    assert search == without_truth()
    assert search.chosen > 0.0


@pytest.mark.parametrize("steps", [1, MIN_ERRORS - 1])
def test_of_a_few_steps_gamma_is_0(sampled: SampledDrive, steps: int) -> None:
    """Their standard error means nothing, and that of one step is 0: chance alone would decide."""
    whole = sampled.drive
    used = np.arange(len(whole.used)) < whole.first_of_step[steps]
    drive = replace(whole, used=whole.used & used)
    sampler = sampler_of(drive, from_step_to_step(drive.T_curr_prev), sampled.world.camera)
    rng = np.random.default_rng(7)
    for _ in range(10):
        search = choose_exponent([sampler], [0.3 * rng.normal(size=len(whole.used))])
        assert np.ptp(search.errors) > 0.0
        assert search.chosen == 0.0


def learned(sampled: SampledDrive, settings: TrainSettings) -> NearestNeighbors:
    """A model of one drive, with K and γ chosen, as ``probevo train`` does it."""
    sampler = sampled.sampler
    drive = sampled.drive
    samples = gather_samples(
        [[sampler.iterate(k)] for k in range(settings.iterations)], [sampler], settings
    )
    values = np.log(samples.alphas)
    coordinates = sampler.coordinates[samples.features]
    neighbors = int(choose_neighbors(coordinates, values, samples.fold_by_error).chosen)
    own = folds_of_steps(sampler, 0)[drive.step_of_feature]
    means = out_of_fold(
        coordinates,
        values,
        samples.fold_by_time,
        neighbors=neighbors,
        queries=sampler.coordinates,
        fold_of_query=own,
    )
    exponent = choose_exponent([sampler], [means - values.mean()]).chosen
    metric = Metric.fitted(drive.phi, ("log_sigma", "chance"))
    return NearestNeighbors(neighbors, exponent).fit(
        drive.phi[samples.features], samples.alphas, metric=metric
    )


@pytest.mark.parametrize(
    ("kind", "every", "base", "better"),
    [
        ("gt", 1, "fixed", 0.85),
        ("gt", 1, "student-t", 0.97),
        ("sparse", 5, "fixed", 0.85),
        ("none", 1, "fixed", 0.85),
        ("loop", 1, "fixed", 1.0),
    ],
)
def test_a_model_learned_on_one_drive_makes_another_one_better(
    kind: str, every: int, base: str, better: float
) -> None:
    """RMSE against that of the static base: with truth at every frame, at every fifth, or none; one
    closed loop at least makes it no worse. Student-t, which forgives bad features as it goes,
    leaves less to learn. An iteration learns less from a loop, which is one error for all features.

    β follows the noise, and not the column of chance.
    """
    train = sampled_drive(kind, every=every, base_name=base)
    test = sampled_drive(seed=1, base_name=base)
    model = learned(train, TrainSettings(iterations=20 if kind == "loop" else 10))
    beta = model.weights(test.drive.phi)
    assert rmse_of(test, beta) < better * static_rmse_m(test)
    of_noise, of_chance = (
        abs(np.corrcoef(np.log(beta), column)[0, 1]) for column in test.drive.phi.T
    )
    assert of_noise > 0.85
    assert of_chance < 0.3
