"""Learned models to and from files; what is particular to the files of nearest neighbours."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load, save

from probevo.arrays import AnyArray, FloatArray
from probevo.errors import InputError
from probevo.noise import Fixed, GeneralizedKernel, StudentT
from probevo.noise.base import LearnedNoiseModel
from probevo.noise.metric import Metric
from probevo.noise.model_file import FORMAT, ModelFile, write_model_file
from probevo.noise.model_io import load_model, save_model
from probevo.noise.named import noise_model
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from worlds import CAMERA

COUNT = 300
TRAINING = {
    "settings": {"seed": 0},
    "recordings": [{"name": "06", "frames": 1101, "sha256": "0" * 64}],
}


def places(count: int = COUNT, seed: int = 0) -> FloatArray:
    """Of three columns; the second is undefined for every tenth."""
    phi = np.random.default_rng(seed).normal(size=(count, 3))
    phi[::10, 1] = np.nan
    return phi


def trained(**options: Any) -> NearestNeighbors:
    phi = places()
    alphas = np.exp(np.random.default_rng(1).normal(size=COUNT))
    metric = Metric.fitted(phi, ("place", "blur", "age"), (False, True, False))
    given: dict[str, Any] = {
        "neighbors": 20,
        "exponent": 4.0,
        "camera": CAMERA,
        "training": TRAINING,
    }
    return NearestNeighbors(**given | options).fit(phi, alphas, metric=metric)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "model.safetensors"


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"base": Fixed()},
        {"base": Fixed(4.0 * np.eye(4))},
        {"base": StudentT(dof=7.0)},
        {"base": StudentT(np.inf, np.diag([1.0, 2.0, 3.0, 4.0]), "residual")},
        {"base": StudentT(np.float32(3.0), time_correlation_ratio=1.5, camera=CAMERA)},
        {"base": StudentT(jitter_cov=1e-6 * np.eye(3))},
        {"neighbors": np.int64(20), "exponent": np.float32(4.0)},
        {"camera": None},
        {"average": "arithmetic"},
        {"exponent": 0.0},
        {"training": None},
    ],
)
def test_a_model_comes_back_as_it_was(path: Path, options: dict[str, Any]) -> None:
    """It predicts the same bytes, and gives the same file again."""
    model = trained(**options)
    save_model(model, path)
    back = load_model(path)
    queries = places(50, seed=2)
    one = model.predict(queries)
    other = back.predict(queries)
    for name in ("scale", "dof", "bias", "time_correlated", "jitter_cov"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.refers_to == other.refers_to
    for name in (
        "neighbors",
        "exponent",
        "average",
        "camera",
        "training",
        "columns",
        "log_mean_alpha_",
    ):
        assert getattr(back, name) == getattr(model, name)
    assert isinstance(back, NearestNeighbors)
    assert type(back.base) is type(model.base)
    again = path.with_name("again.safetensors")
    save_model(back, again)
    assert again.read_bytes() == path.read_bytes()


def test_it_is_found_by_its_path(path: Path) -> None:
    save_model(trained(), path)
    model = noise_model(str(path))
    assert isinstance(model, NearestNeighbors)
    assert model.columns == ("place", "blur", "age")


def test_a_camera_without_a_size_comes_back(path: Path) -> None:
    camera = replace(CAMERA, size_px=None)
    save_model(trained(camera=camera), path)
    assert load_model(path).camera == camera


def test_an_unknown_kind_is_refused(path: Path) -> None:
    write_model_file(path, ModelFile("oracle", {}, {}))
    with pytest.raises(InputError, match=r"kind 'oracle'.\n.*Known are gk, knn, student-t"):
        load_model(path)


def refuse(path: Path, model: ModelFile) -> None:
    """Its checksum is right, its content is not."""
    write_model_file(path, model)
    with pytest.raises(InputError) as caught:
        load_model(path)
    assert caught.value.where == str(path)
    assert "not a complete knn model" in str(caught.value)
    assert "Train it again." in str(caught.value)


ARRAYS = ("centers", "first_of_cell", "samples", "values", "mean", "spread", "weight")
Change = Callable[[AnyArray], AnyArray]


def with_value(value: float) -> Change:
    def change(array: AnyArray) -> AnyArray:
        changed = array.copy()
        changed.reshape(-1)[changed.size // 2] = value
        return changed

    return change


def test_an_alpha_that_is_not_positive_is_refused(path: Path) -> None:
    """Where α itself is stored, and not its logarithm."""
    file = trained(average="arithmetic").to_file()
    refuse(
        path,
        ModelFile(
            file.kind,
            {**file.arrays, "values": with_value(-1.0)(file.arrays["values"])},
            file.facts,
        ),
    )


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_a_spread_that_is_not_positive_is_refused(path: Path, value: float) -> None:
    file = trained().to_file()
    changed = with_value(value)(np.asarray(file.arrays["spread"]))
    refuse(path, ModelFile(file.kind, {**file.arrays, "spread": changed}, file.facts))


@pytest.mark.parametrize(
    "index",
    [
        {5: -1},
        {5: COUNT + 1},
        {5: 2**62},
        {0: 1},
        {0: -1},
        {-1: COUNT + 1},
        {-1: 0},
        {5: 2**63 - 1, 6: -2},
    ],
)
def test_cells_that_reach_beyond_the_samples_are_refused(path: Path, index: dict[int, int]) -> None:
    """The last differs from its neighbours by more than 64 bits hold, so that their difference
    wraps around."""
    file = trained().to_file()
    first = np.asarray(file.arrays["first_of_cell"]).copy()
    for at, value in index.items():
        first[at] = value
    refuse(path, ModelFile(file.kind, {**file.arrays, "first_of_cell": first}, file.facts))


def test_cells_out_of_order_are_refused(path: Path) -> None:
    file = trained().to_file()
    first = np.asarray(file.arrays["first_of_cell"]).copy()
    first[3], first[9] = first[9], first[3]
    refuse(path, ModelFile(file.kind, {**file.arrays, "first_of_cell": first}, file.facts))


@pytest.mark.parametrize("text", ["NaN", "Infinity", "1e999"])
def test_an_exponent_that_is_no_number_is_refused(path: Path, text: str) -> None:
    """JSON has no such number, so this can be no file of ours."""
    save_model(trained(), path)
    content = path.read_bytes()
    header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
    entry = header["__metadata__"][FORMAT]
    assert '"exponent":4.0' in entry
    path.write_bytes(
        save(load(content), {FORMAT: entry.replace('"exponent":4.0', f'"exponent":{text}')})
    )
    with pytest.raises(InputError, match="damaged"):
        load_model(path)


def changed_after_fit(**values: object) -> NearestNeighbors:
    model = trained()
    for name, value in values.items():
        setattr(model, name, value)
    return model


@pytest.mark.parametrize(
    "make",
    [
        lambda: changed_after_fit(average="harmonic"),
        lambda: changed_after_fit(exponent=-3.0),
        lambda: changed_after_fit(exponent=np.nan),
        NearestNeighbors,
        GeneralizedKernel,
    ],
    ids=["average", "negative", "NaN", "unfitted knn", "unfitted gk"],
)
def test_a_model_that_could_not_be_read_back_is_not_written(
    make: Callable[[], LearnedNoiseModel], path: Path
) -> None:
    with pytest.raises(InputError, match=r"^model: (it is not a complete|is a .* not fitted)"):
        save_model(make(), path)
    assert not path.exists()


@pytest.mark.parametrize("options", [{"average": "harmonic"}, {"exponent": -3.0}])
def test_what_no_model_can_have_is_not_fitted(options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="known averages are"):
        trained(**options)
