"""Bad input to every learned kind of noise model is refused in clear words.

The compiled loops read the arrays of a file, so none that does not fit may be accepted.
"""

import copy
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from probevo.arrays import AnyArray, FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.noise import GeneralizedKernel, NearestNeighbors, StudentT
from probevo.noise.base import LearnedNoiseModel
from probevo.noise.metric import Metric
from probevo.noise.model_file import ModelFile, write_model_file
from probevo.noise.model_io import load_model
from probevo.noise.registry import noise_kinds, untrained_model, untrained_names
from worlds import CAMERA

COUNT = 200
TRAINING = {
    "settings": {"seed": 0},
    "recordings": [{"name": "06", "frames": 1101, "sha256": "0" * 64}],
}
COLUMNS = ("place", "blur", "age")
ERRORS = np.random.default_rng(2).normal(size=(COUNT, 4))
ALPHAS = np.exp(np.random.default_rng(1).normal(size=COUNT))


def places() -> FloatArray:
    """Three columns, of which the second is undefined for every tenth sample."""
    phi = np.random.default_rng(0).normal(size=(COUNT, 3))
    phi[::10, 1] = np.nan
    return phi


def fit_knn(
    phi: FloatArray, metric: Metric | None = None, camera: StereoCamera | None = None
) -> NearestNeighbors:
    model = NearestNeighbors(neighbors=20, exponent=4.0, camera=camera, training=TRAINING)
    return model.fit(phi, ALPHAS, metric=metric)


def fit_gk(
    phi: FloatArray,
    metric: Metric | None = None,
    camera: StereoCamera | None = None,
    errors: FloatArray = ERRORS,
    error_cov: FloatArray | None = None,
) -> GeneralizedKernel:
    model = GeneralizedKernel(
        neighbors=60,
        prior_counts=8.0,
        dof_counts=30.0,
        bias_counts=np.inf,
        weights=np.ones(3),
        centers=30,
        camera=camera,
        training=TRAINING,
    )
    return model.fit(phi, errors, metric=metric, error_cov=error_cov)


def fit_student_t(
    phi: FloatArray,
    metric: Metric | None = None,
    camera: StereoCamera | None = None,
    errors: FloatArray = ERRORS,
    error_cov: FloatArray | None = None,
) -> StudentT:
    model = StudentT(refers_to="residual", camera=camera, training=TRAINING)
    return model.fit(phi, errors, error_cov=error_cov)


COLUMN_FACTS: dict[str, list[Any]] = {
    "columns": [
        None,
        "abc",
        ["place"],
        ["place", "blur"],
        [1, 2, 3],
        ["a", "a", "b"],
        {"a": 1, "b": 2, "c": 3},
    ],
    "may_be_undefined": [None, "abc", [True], ["a", "b", "c"], [[], [], []], 7],
}


@dataclass(frozen=True)
class Kind:
    """How a kind is fitted, and wrong values for each of its facts."""

    fit: Callable[..., LearnedNoiseModel]
    facts: dict[str, list[Any]] = field(repr=False)


KINDS = {
    "knn": Kind(
        fit_knn,
        COLUMN_FACTS
        | {
            "neighbors": ["20", 2.5, None, True, 0, -1, COUNT + 1, 10**30, [20], {}],
            "exponent": ["4", None, [4.0], True, -1.0, {}],
            "average": ["median", None, 3, ""],
            "log_mean_alpha": ["0", None, [0.0], True],
            "base": [
                None,
                "fixed",
                {},
                {"name": "cauchy"},
                {"name": None},
                {"name": []},
                [],
                {"name": "fixed", "student_t": {}},
                {"name": "fixed", "student_t": []},
                {"name": "student-t", "student_t": {"dof": -1.0}},
            ],
        },
    ),
    "gk": Kind(
        fit_gk,
        COLUMN_FACTS
        | {
            "variant": [None, "", "optimal", 3],
            "neighbors": ["20", 2.5, None, True, 0, -1, [20]],
            "reach": ["4", None, [4.0], True, 0.0, -1.0],
            "domain_radius": ["4", None, [4.0], True, 0.0, -1.0],
            "prior_counts": ["4", None, [4.0], True, 0.0, -1.0],
            "refers_to": [None, "", "motion", 3],
            "samples": ["20", 2.5, None, True, 0, -1],
        },
    ),
    "student-t": Kind(
        fit_student_t,
        {
            "dof": [None, "5", "-inf", 0.0, -1.0, True, [5.0]],
            "refers_to": [None, "", "motion", 3],
        },
    ),
}
ORIGIN_FACTS: dict[str, list[Any]] = {
    "camera": ["KITTI", [], {}, 7],
    "training": [None, "06", 3, []],
}
CAMERA_CHANGES: list[dict[str, Any]] = [
    {"fu_px": "700"},
    {"fu_px": None},
    {"fu_px": -700.0},
    {"fu_px": [700.0]},
    {"baseline_m": 0.0},
    {"size_px": [1226]},
    {"size_px": ["a", "b"]},
    {"size_px": [1226, 370, 3]},
    {"size_px": 5},
    {"name": "left"},
]
WITH_COLUMNS = ("knn", "gk")
"""Kinds with a prediction space."""
OF_ERRORS = ("gk", "student-t")
"""Kinds that learn from the errors of features."""


@cache
def trained(kind: str) -> LearnedNoiseModel:
    metric = Metric.fitted(places(), COLUMNS, (False, True, False))
    return KINDS[kind].fit(places(), metric=metric, camera=CAMERA)


def file_of(kind: str) -> ModelFile:
    return trained(kind).to_file()


def arrays_of(*types: type) -> list[Any]:
    """Each kind with the name of each of its arrays of these types."""
    return [
        (kind, name)
        for kind in KINDS
        for name, array in file_of(kind).arrays.items()
        if isinstance(array.dtype.type(), types)
    ]


def facts_of(kind: str) -> dict[str, list[Any]]:
    return KINDS[kind].facts | ORIGIN_FACTS


@pytest.fixture
def no_numpy_warning() -> Iterator[None]:
    """Before bad input is refused, nothing is divided by zero, and nothing overflows."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "model.safetensors"


def refuse(path: Path, file: ModelFile) -> None:
    """Write content that is wrong under a checksum that is right; reading it is refused."""
    write_model_file(path, file)
    with pytest.raises(InputError) as caught:
        load_model(path)
    assert caught.value.where == str(path)
    assert f"not a complete {file.kind} model" in str(caught.value)
    assert "Train it again." in str(caught.value)


def refuse_array(path: Path, kind: str, name: str, array: AnyArray) -> None:
    file = file_of(kind)
    refuse(path, ModelFile(kind, {**file.arrays, name: array}, file.facts))


def test_every_kind_that_can_be_read_is_tested_here() -> None:
    assert set(KINDS) == {name for name, kind in noise_kinds().items() if kind.from_file}


SHAPES: dict[str, Callable[[AnyArray], AnyArray]] = {
    "the last is missing": lambda array: array[..., :-1],
    "the first row is missing": lambda array: array[1:],
    "one more": lambda array: np.concatenate([array, array[..., -1:]], axis=-1),
    "twice as many rows": lambda array: np.concatenate([array, array]),
    "one more axis": lambda array: array[..., None],
    "one more axis in front": lambda array: array[None],
    "transposed and longer": lambda array: np.concatenate([array.T, array.T]),
    "a single number": lambda array: np.asarray(array.reshape(-1)[0]),
    "nothing": lambda array: array[:0],
    "nothing in two dimensions": lambda array: np.zeros((0, 0), array.dtype),
    "nothing in as many dimensions": lambda array: np.zeros([0] * array.ndim, array.dtype),
}


@pytest.mark.parametrize(("kind", "name"), arrays_of(np.generic))
@pytest.mark.parametrize("change", SHAPES.values(), ids=SHAPES.keys())
def test_an_array_of_another_shape_is_refused(
    path: Path, kind: str, name: str, change: Callable[[AnyArray], AnyArray]
) -> None:
    refuse_array(path, kind, name, change(np.asarray(file_of(kind).arrays[name])))


@pytest.mark.parametrize(("kind", "name"), arrays_of(np.generic))
@pytest.mark.parametrize("dtype", ["float32", "float64", "int64", "int32", "uint8", "bool"])
def test_an_array_of_another_type_is_refused(path: Path, kind: str, name: str, dtype: str) -> None:
    """Compiled loops take each array in one precision."""
    array = np.asarray(file_of(kind).arrays[name])
    if array.dtype != dtype:
        refuse_array(path, kind, name, array.astype(dtype))


@pytest.mark.parametrize(("kind", "name"), arrays_of(np.floating))
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_an_array_that_is_not_finite_is_refused(
    path: Path, kind: str, name: str, value: float
) -> None:
    array = np.asarray(file_of(kind).arrays[name]).copy()
    array.reshape(-1)[array.size // 2] = value
    refuse_array(path, kind, name, array)


@pytest.mark.parametrize(("kind", "name"), arrays_of(np.generic))
def test_a_missing_array_is_refused(path: Path, kind: str, name: str) -> None:
    file = file_of(kind)
    others = {other: array for other, array in file.arrays.items() if other != name}
    refuse(path, ModelFile(kind, others, file.facts))


@pytest.mark.parametrize(
    ("kind", "key", "value"),
    [(kind, key, value) for kind in KINDS for key, vs in facts_of(kind).items() for value in vs],
)
def test_a_fact_of_another_type_is_refused(path: Path, kind: str, key: str, value: Any) -> None:
    file = file_of(kind)
    refuse(path, ModelFile(kind, file.arrays, copy.deepcopy(dict(file.facts)) | {key: value}))


@pytest.mark.parametrize(("kind", "key"), [(kind, key) for kind in KINDS for key in facts_of(kind)])
def test_a_missing_fact_is_refused(path: Path, kind: str, key: str) -> None:
    file = file_of(kind)
    others = {other: value for other, value in file.facts.items() if other != key}
    refuse(path, ModelFile(kind, file.arrays, others))


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_without_any_fact_or_array_is_refused(path: Path, kind: str) -> None:
    refuse(path, ModelFile(kind, file_of(kind).arrays, {}))
    refuse(path, ModelFile(kind, {}, file_of(kind).facts))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("change", CAMERA_CHANGES)
def test_a_camera_that_cannot_be_is_refused(path: Path, kind: str, change: dict[str, Any]) -> None:
    file = file_of(kind)
    camera = file.facts["camera"] | change
    refuse(path, ModelFile(kind, file.arrays, {**file.facts, "camera": camera}))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", ["fu_px", "fv_px", "cu_px", "cv_px", "baseline_m"])
def test_a_property_of_the_camera_may_not_be_missing(path: Path, kind: str, name: str) -> None:
    file = file_of(kind)
    camera = {key: value for key, value in file.facts["camera"].items() if key != name}
    refuse(path, ModelFile(kind, file.arrays, {**file.facts, "camera": camera}))


@pytest.mark.parametrize("kind", KINDS)
def test_the_camera_of_the_training_is_accepted(kind: str) -> None:
    """Also without its size, and within the tolerance of a calibration."""
    for camera in (
        CAMERA,
        replace(CAMERA, size_px=None),
        replace(CAMERA, fu_px=1.05 * CAMERA.fu_px),
    ):
        trained(kind).check_camera(camera)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (replace(CAMERA, fu_px=2.0 * CAMERA.fu_px), "1414 px.*707 px"),
        (replace(CAMERA, baseline_m=2.0 * CAMERA.baseline_m), "this one's baseline is"),
        (type(CAMERA).centered(400.0, 0.5, (640, 480)), "this one's focal length is 400 px"),
    ],
)
def test_another_camera_is_refused(kind: str, camera: StereoCamera, message: str) -> None:
    with pytest.raises(InputError, match=f"trained with another camera: .*{message}") as caught:
        trained(kind).check_camera(camera)
    assert caught.value.cure == "Train one with this camera."


@pytest.mark.parametrize("kind", KINDS)
def test_a_model_of_an_unknown_camera_accepts_any(kind: str) -> None:
    metric = Metric.fitted(places(), COLUMNS, (False, True, False))
    model = KINDS[kind].fit(places(), metric=metric)
    model.check_camera(replace(CAMERA, fu_px=1.0))
    model.check_camera(replace(CAMERA, baseline_m=2.0))


def test_untrained_models_accept_any_camera() -> None:
    for name in untrained_names():
        untrained_model(name).check_camera(type(CAMERA).centered(400.0, 0.5, (640, 480)))


UNFIT: list[tuple[str, str, float]] = [
    ("knn", "weight", 1e300),
    ("knn", "weight", -1.0),
    ("knn", "samples", 1e30),
    ("knn", "centers", 1e30),
    ("gk", "weight", 1e300),
    ("gk", "prior_scale", 1e300),
    ("student-t", "scale", np.nan),
    ("student-t", "scale", 1e300),
]
"""Values that lead to a prediction that is not finite; of a matrix, in its upper triangle alone."""


@pytest.mark.parametrize("kind", OF_ERRORS)
@pytest.mark.parametrize("value", [-1.0, 1e300, "1"])
def test_a_time_correlation_that_no_model_has_is_refused(
    path: Path, kind: str, value: float | str
) -> None:
    file = file_of(kind)
    refuse(path, ModelFile(kind, file.arrays, {**file.facts, "time_correlation_ratio": value}))


@pytest.mark.parametrize(("kind", "name", "value"), UNFIT)
def test_an_array_with_a_value_that_no_model_has_is_refused(
    path: Path, kind: str, name: str, value: float
) -> None:
    array = np.array(file_of(kind).arrays[name])
    array.reshape(-1)[1] = value
    refuse_array(path, kind, name, array)


@pytest.mark.usefixtures("no_numpy_warning")
@pytest.mark.parametrize("kind", WITH_COLUMNS)
@pytest.mark.parametrize("shape", [(7,), (7, 1), (7, 2), (7, 4), (7, 3, 1), ()])
def test_predictors_of_other_columns_are_refused(kind: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match=r"predictors: their shape is .*\[N, 3\]: place, blur"):
        trained(kind).predict(np.zeros(shape))


@pytest.mark.usefixtures("no_numpy_warning")
@pytest.mark.parametrize("kind", WITH_COLUMNS)
@pytest.mark.parametrize(
    ("column", "value"),
    [(0, np.nan), (0, np.inf), (1, np.inf), (1, -np.inf), (2, np.nan), (2, -np.inf)],
)
def test_a_predictor_that_is_not_finite_is_named(kind: str, column: int, value: float) -> None:
    """Only the second column may be NaN; none may be infinite."""
    queries = np.zeros((5, 3))
    queries[2, column] = value
    message = rf"predictor {COLUMNS[column]}: feature 2 \(from 0\) has the value {value}"
    with pytest.raises(InputError, match=message):
        trained(kind).predict(queries)


@pytest.mark.usefixtures("no_numpy_warning")
@pytest.mark.parametrize("kind", WITH_COLUMNS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_a_predictor_in_training_that_is_not_finite_is_named(kind: str, value: float) -> None:
    phi = np.nan_to_num(places())
    phi[17, 1] = value
    with pytest.raises(InputError, match=rf"predictor column 1: feature 17 .* {value}"):
        KINDS[kind].fit(phi)


@pytest.mark.usefixtures("no_numpy_warning")
@pytest.mark.parametrize("kind", WITH_COLUMNS)
@pytest.mark.parametrize("shape", [(COUNT,), (COUNT, 3, 1)])
def test_predictors_in_training_of_another_shape_are_refused(
    kind: str, shape: tuple[int, ...]
) -> None:
    with pytest.raises(InputError, match="predictors: their shape is"):
        KINDS[kind].fit(np.zeros(shape))


@pytest.mark.usefixtures("no_numpy_warning")
@pytest.mark.parametrize("kind", OF_ERRORS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e200])
def test_an_error_that_is_no_number_is_named(kind: str, value: float) -> None:
    errors = ERRORS.copy()
    errors[17, 2] = value
    message = r"residuals: the residual of feature 17 \(from 0\)"
    with pytest.raises(InputError, match=message) as caught:
        KINDS[kind].fit(np.nan_to_num(places()), errors=errors)
    assert caught.value.cure


@pytest.mark.usefixtures("no_numpy_warning")
@pytest.mark.parametrize("kind", OF_ERRORS)
@pytest.mark.parametrize("shape", [(COUNT,), (COUNT, 2), (COUNT, 3), (COUNT, 4, 1)])
def test_errors_of_another_shape_are_refused(kind: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match=r"residuals: their shape is .* \[N, 4\]"):
        KINDS[kind].fit(np.nan_to_num(places()), errors=np.zeros(shape))


@pytest.mark.usefixtures("no_numpy_warning")
@pytest.mark.parametrize("kind", OF_ERRORS)
def test_no_errors_are_refused(kind: str) -> None:
    with pytest.raises(InputError, match="residuals: there is none"):
        KINDS[kind].fit(np.zeros((0, 3)), errors=np.zeros((0, 4)))


@pytest.mark.usefixtures("no_numpy_warning")
@pytest.mark.parametrize("kind", OF_ERRORS)
@pytest.mark.parametrize(
    "error_cov",
    [
        np.zeros((COUNT - 1, 4, 4)),
        np.zeros((COUNT, 4)),
        np.full((COUNT, 4, 4), np.nan),
        np.full((COUNT, 4, 4), np.inf),
    ],
)
def test_an_error_cov_that_is_none_is_refused(kind: str, error_cov: FloatArray) -> None:
    """The compiled loop would read beyond its end."""
    with pytest.raises(InputError, match="error_cov"):
        KINDS[kind].fit(np.nan_to_num(places()), error_cov=error_cov)


ACCOUNT: dict[str, Any] = {
    "recordings": [{"name": "06", "frames": 1101, "sha256": "0" * 64}],
    "settings": {"seed": 0, "supervision": "gt"},
    "iterations": [{"log_likelihood": 1.0, "loop_error_m": 2.0}],
}
"""What a training says of itself, as far as it is shown."""
SEARCHES: dict[str, dict[str, Any]] = {
    "knn": {"neighbors": {"candidates": [1.0, 2.0], "errors": [1.0, 2.0], "chosen": 1.0}},
    "gk": {
        "weights": {
            "candidates": ["place", "gone"],
            "gains": [0.1, 0.2],
            "chosen": {"place": 1.0, "gone": 0.0},
        },
        "neighbors": {"candidates": [10, 20], "gains": [1.0, 2.0], "chosen": 10},
    },
    "student-t": {},
}
NONSENSE: list[tuple[tuple[str | int, ...], Any]] = [
    *((("recordings",), value) for value in (7, "06", [None], [[]], [{}], {"a": 1})),
    *((("recordings", 0, "frames"), value) for value in ("x", None, -1, 10**400, [])),
    *((("recordings", 0, key), None) for key in ("name", "sha256")),
    *((("iterations",), value) for value in (7, [[]], [None], [{}], [{"a": 1}])),
    *((("iterations", 0, "log_likelihood"), value) for value in (None, "x", [], 10**400)),
    *((("iterations", 0, "loop_error_m"), value) for value in ("x", [[]])),
    *((("kept_iteration",), value) for value in ("x", -1, 1.5, [])),
    *((("time_correlation_gain",), value) for value in ("x", [])),
    *((("settings",), value) for value in (None, "x", [])),
    *((("searches",), value) for value in (None, "x", {"neighbors": 0}, {"neighbors": {}})),
]
SEARCH_NONSENSE: list[tuple[str, Any]] = [
    ("candidates", None),
    ("candidates", [1.0]),
    ("candidates", [None, 2.0]),
    ("chosen", 3.0),
    ("chosen", {"a": 1.0}),
    ("chosen", None),
]


def with_training(kind: str, place: tuple[str | int, ...], value: Any) -> ModelFile:
    """Return a model file with a value at a place of the account of its training."""
    training = copy.deepcopy(ACCOUNT | {"searches": SEARCHES[kind]})
    part: Any = training
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    file = file_of(kind)
    return replace(file, facts={**file.facts, "training": training})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("place", "value"), NONSENSE, ids=lambda value: str(value)[:30])
def test_nonsense_about_the_training_is_refused(
    kind: str, place: tuple[str | int, ...], value: Any, path: Path
) -> None:
    """The pages would stumble over it."""
    refuse(path, with_training(kind, place, value))


@pytest.mark.parametrize("kind", ["knn", "gk"])
@pytest.mark.parametrize(("key", "value"), SEARCH_NONSENSE)
def test_nonsense_about_a_search_is_refused(kind: str, key: str, value: Any, path: Path) -> None:
    refuse(path, with_training(kind, ("searches", "neighbors", key), value))


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("kind", KINDS)
def test_a_page_shows_what_is_accepted(kind: str, path: Path, tmp_path: Path) -> None:
    write_model_file(path, with_training(kind, ("settings", "seed"), 1))
    assert main(["inspect", "--model", str(path), "--out", str(tmp_path / "page")]) == 0


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("depth", [190, 900, 20_000])
def test_metadata_without_end_are_refused(kind: str, depth: int, path: Path) -> None:
    """Written by hand: they are too deep for the writer, too."""
    write_model_file(path, file_of(kind))
    deep = "[" * depth + "]" * depth
    data = path.read_bytes()
    size = int.from_bytes(data[:8], "little")
    header = data[8 : 8 + size].rstrip().replace(b'\\"seed\\":0', f'\\"seed\\":{deep}'.encode())
    assert deep.encode() in header
    path.write_bytes(len(header).to_bytes(8, "little") + header + data[8 + size :])
    with pytest.raises(InputError):
        load_model(path)


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [("knn", "log_mean_alpha", -1e308), ("gk", "domain_radius", 1e308), ("gk", "reach", 1e308)],
)
def test_facts_that_would_overflow_are_refused(
    kind: str, name: str, value: float, path: Path
) -> None:
    file = file_of(kind)
    refuse(path, replace(file, facts={**file.facts, name: value}))
