"""The training: the same bytes for the same seed, stopped or not, and refusals of wrong files."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save_file

from probevo.errors import InputError

jax = pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from nets.small_networks import METHODS, PLAN, build, data  # noqa: E402
from probevo.nets import methods  # noqa: E402
from probevo.nets.learning import LearningPlan, learn  # noqa: E402
from probevo.nets.methods import Method  # noqa: E402
from probevo.nets.network_file import named_arrays, read_facts  # noqa: E402
from probevo.nets.quaternions import product  # noqa: E402
from probevo.nets.target_space import RotationTargets  # noqa: E402
from probevo.noise import StudentT  # noqa: E402
from probevo.noise.model_io import save_model  # noqa: E402

SPACE = RotationTargets()
HYDRA_SIGMA = METHODS[-1]


def train(
    method: Method, file: Path | None, plan: LearningPlan = PLAN, stop_after: int | None = None
) -> dict[str, np.ndarray]:
    """Return the arrays of the trained networks."""

    def stop(epoch: int, total: int) -> None:
        if epoch == stop_after:
            raise KeyboardInterrupt

    trained = learn(method, SPACE, build, data=data(method), plan=plan, file=file, show=stop)
    assert trained.kept_epoch == trained.epochs == plan.epochs
    return named_arrays(trained.networks)


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file of a finished training, which no test changes."""
    file = tmp_path_factory.mktemp("finished") / "done.safetensors"
    train(HYDRA_SIGMA, file)
    return file


@pytest.mark.parametrize("method", [METHODS[1], HYDRA_SIGMA], ids=lambda method: method.name)
def test_a_training_that_was_stopped_ends_with_the_same_bytes(
    method: Method, tmp_path: Path
) -> None:
    """It stops between two writings of its file, so that an epoch is repeated."""
    whole = tmp_path / "whole.safetensors"
    parts = tmp_path / "parts.safetensors"
    train(method, whole)
    for epoch in (3, 5):
        with pytest.raises(KeyboardInterrupt):
            train(method, parts, stop_after=epoch)
        assert not read_facts(parts)["is_finished"]
    train(method, parts)
    assert parts.read_bytes() == whole.read_bytes()


def test_another_seed_gives_other_networks() -> None:
    one = train(HYDRA_SIGMA, None)
    same = train(HYDRA_SIGMA, None)
    other = train(HYDRA_SIGMA, None, plan=replace(PLAN, seed=1))
    assert all(np.array_equal(one[name], same[name]) for name in one)
    assert not any(np.array_equal(one[name], other[name]) for name in one if "weight" in name)


def test_a_finished_training_is_not_repeated(tmp_path: Path) -> None:
    file = tmp_path / "done.safetensors"
    first = train(HYDRA_SIGMA, file)
    again = train(HYDRA_SIGMA, file, stop_after=1)
    assert all(np.array_equal(first[name], again[name]) for name in first)


def test_networks_of_another_plan_are_refused(finished: Path) -> None:
    for method, plan in ((HYDRA_SIGMA, replace(PLAN, epochs=7)), (METHODS[2], PLAN)):
        with pytest.raises(InputError, match="another method, plan or version"):
            train(method, finished, plan=plan)


@pytest.mark.parametrize("place", [0, 200, -1])
def test_a_damaged_file_is_refused(place: int, finished: Path, tmp_path: Path) -> None:
    content = bytearray(finished.read_bytes())
    content[place] ^= 0xFF
    file = tmp_path / finished.name
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"done\.safetensors"):
        train(HYDRA_SIGMA, file)


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "other.safetensors"
    save_file({"a": np.zeros(3)}, file)
    with pytest.raises(InputError, match="not a network of probevo"):
        train(METHODS[2], file)


@pytest.mark.parametrize("version", [{}, {"version": 2}])
def test_another_format_is_refused(version: dict[str, int], tmp_path: Path) -> None:
    file = tmp_path / "other.safetensors"
    entry = json.dumps({"checksum": "", "facts": "{}", **version})
    save_file({"a": np.zeros(3)}, file, {"probevo-network": entry})
    with pytest.raises(InputError, match=f"format {version.get('version', 0)}, ") as caught:
        read_facts(file)
    assert "Update probevo" in caught.value.cure


def test_a_noise_model_is_named_as_such(tmp_path: Path) -> None:
    file = tmp_path / "noise.safetensors"
    save_model(StudentT(), file)
    with pytest.raises(InputError, match="this is a noise model") as caught:
        read_facts(file)
    assert "--noise" in caught.value.cure


def test_it_stops_early_and_keeps_the_best(tmp_path: Path) -> None:
    """The loss on the data left out decides; after some thirty epochs it falls no longer."""
    file = tmp_path / "best.safetensors"
    plan = replace(PLAN, epochs=500, patience=4, keep_every=10)
    seen = []
    trained = learn(
        HYDRA_SIGMA,
        SPACE,
        build,
        data=data(HYDRA_SIGMA),
        plan=plan,
        file=file,
        show=lambda epoch, total: seen.append((epoch, total)),
    )
    epochs = read_facts(file)["epochs"]
    assert 4 < epochs < 500
    assert trained.epochs == epochs
    assert trained.kept_epoch == epochs - 4 == read_facts(file)["kept_epoch"]
    assert seen == [(epoch, 500) for epoch in range(1, epochs + 1)]
    # The best networks are those of a training that ends four epochs earlier, but for the rounding
    # of another compiled epoch; those of the epochs beside it differ by 0.015.
    best = learn(
        HYDRA_SIGMA,
        SPACE,
        build,
        data=data(HYDRA_SIGMA),
        plan=replace(plan, epochs=epochs - 4, patience=None),
    )
    expected = named_arrays(best.networks)
    for name, found in named_arrays(trained.networks).items():
        np.testing.assert_allclose(found, expected[name], rtol=0.0, atol=1e-3, err_msg=name)
    again = learn(HYDRA_SIGMA, SPACE, build, data=data(HYDRA_SIGMA), plan=plan, file=file)
    assert again[1:] == trained[1:]


def test_the_initial_networks_are_kept_if_no_loss_is_finite() -> None:
    given = data(HYDRA_SIGMA)
    spoiled = replace(given, held_out_targets=jax.numpy.nan * given.held_out_targets)
    plan = replace(PLAN, epochs=500, patience=2)
    trained = learn(HYDRA_SIGMA, SPACE, build, data=spoiled, plan=plan)
    assert trained.kept_epoch == 0
    assert trained.epochs == 2


def test_each_copy_of_the_data_is_another_one() -> None:
    """Targets of copies are turned about z by a random half turn or none: with as many copies, the
    network learns that either is as likely, and its loss is that of not knowing."""
    given = data(HYDRA_SIGMA)
    half_turn = jax.numpy.asarray([0.0, 0.0, 0.0, 1.0])

    def turned(inputs: Any, targets: Any, key: Any) -> Any:
        is_turned = jax.random.bernoulli(key, 0.5, (len(targets), 1, 1))
        return inputs, jax.numpy.where(is_turned, product(targets, half_turn), targets)

    plan = replace(PLAN, epochs=4, copies=3)
    as_many_steps = replace(PLAN, epochs=plan.copies * plan.epochs)
    plain = learn(HYDRA_SIGMA, SPACE, build, data=given, plan=as_many_steps)
    copied = learn(HYDRA_SIGMA, SPACE, build, data=replace(given, augment=turned), plan=plan)
    sigma = []
    for networks in (plain.networks, copied.networks):
        first = jax.tree.map(lambda array: array[0], networks)
        inputs = given.held_out_inputs[0]
        _, raw = methods.estimates(HYDRA_SIGMA, SPACE, first, inputs, jax.random.key(0))
        sigma.append(np.sqrt(np.median(SPACE.covariance(np.asarray(raw))[..., 2, 2])))
    assert sigma[1] > 3.0 * sigma[0]


def test_a_plan_that_the_data_do_not_allow_is_refused() -> None:
    with pytest.raises(InputError, match="there are 300 data"):
        train(HYDRA_SIGMA, None, plan=replace(PLAN, batch=301))
    without = data(HYDRA_SIGMA)
    nothing = replace(without, held_out_inputs=without.held_out_inputs[:, :0])
    with pytest.raises(InputError, match="no data are left out"):
        learn(HYDRA_SIGMA, SPACE, build, data=nothing, plan=replace(PLAN, patience=2))


@pytest.mark.parametrize("method", [METHODS[1], HYDRA_SIGMA], ids=lambda method: method.name)
def test_it_learns_rotations(method: Method) -> None:
    """Inputs are rotation vectors with 0.02 rad of noise; the error falls to a quarter."""
    given = data(method)

    def mean_error_deg(epochs: int) -> float:
        trained = learn(method, SPACE, build, data=given, plan=replace(PLAN, epochs=epochs))
        first = jax.tree.map(lambda array: array[0], trained.networks)
        inputs = given.held_out_inputs[0]
        found, raw = methods.estimates(method, SPACE, first, inputs, jax.random.key(0))
        mean = jax.numpy.asarray(methods.prediction(SPACE, found, raw).mean)
        errors = SPACE.difference(mean, given.held_out_targets[0])
        return float(np.degrees(np.linalg.norm(errors, axis=-1)).mean())

    assert mean_error_deg(50) < 0.25 * mean_error_deg(1)
