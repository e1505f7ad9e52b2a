"""The file of a learned noise model: what is written is read, and damage is always detected."""

import json
import os
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import save

from probevo.arrays import AnyArray
from probevo.errors import InputError
from probevo.noise.model_file import DTYPES, FORMAT, ModelFile, read_model_file, write_model_file

FACTS: dict[str, Any] = {
    "k": 7,
    "columns": ["blur", "speed °/s"],
    "camera": {"fu_px": 718.856, "cx": None},
    "x": 0.1,
}


def small_model() -> ModelFile:
    rng = np.random.default_rng(0)
    arrays: dict[str, AnyArray] = {
        "targets": rng.normal(size=3),
        "phi": rng.normal(size=(3, 2)).astype(np.float32),
    }
    return ModelFile("knn", arrays, FACTS)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "model.safetensors"


def assert_same(a: ModelFile, b: ModelFile) -> None:
    assert (a.kind, a.facts, sorted(a.arrays)) == (b.kind, b.facts, sorted(b.arrays))
    assert json.dumps(a.facts, sort_keys=True) == json.dumps(b.facts, sort_keys=True)
    for name, array in a.arrays.items():
        assert array.dtype == b.arrays[name].dtype
        np.testing.assert_array_equal(array, b.arrays[name], strict=True)


def write_by_hand(path: Path, envelope: object, arrays: dict[str, AnyArray] | None = None) -> None:
    path.write_bytes(save(arrays or {"phi": np.zeros(2)}, {FORMAT: json.dumps(envelope)}))


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("shape", [(), (0,), (0, 3), (5,), (2, 3, 4)])
def test_arrays_of_each_type_and_shape_come_back(
    path: Path, dtype: str, shape: tuple[int, ...]
) -> None:
    array = np.random.default_rng(1).integers(0, 2, size=shape).astype(dtype)
    model = ModelFile("gk", {"a": array, "b": np.array([np.nan, np.inf, -0.0])}, FACTS)
    write_model_file(path, model)
    back = read_model_file(path)
    assert_same(back, model)
    assert np.signbit(back.arrays["b"][2])
    assert all(array.flags.writeable and array.flags.c_contiguous for array in back.arrays.values())


def test_a_model_without_arrays_comes_back(path: Path) -> None:
    write_model_file(path, ModelFile("student-t", {}, {}))
    assert_same(read_model_file(path), ModelFile("student-t", {}, {}))


def test_the_layout_in_memory_does_not_matter(path: Path) -> None:
    array = np.arange(12.0).reshape(3, 4)
    for same in (
        np.asfortranarray(array),
        array.astype(">f8"),
        np.repeat(array, 2, axis=1)[:, ::2],
    ):
        write_model_file(path, ModelFile("knn", {"a": same}, {}))
        assert_same(read_model_file(path), ModelFile("knn", {"a": array}, {}))


def test_the_same_model_gives_the_same_bytes_in_whatever_order_it_is_given(tmp_path: Path) -> None:
    model = small_model()
    reverse = ModelFile(
        "knn", dict(reversed(list(model.arrays.items()))), dict(reversed(FACTS.items()))
    )
    contents = set()
    for i, same in enumerate([model, reverse] * 5):
        write_model_file(tmp_path / f"{i}", same)
        contents.add((tmp_path / f"{i}").read_bytes())
    assert len(contents) == 1


def test_a_change_of_any_byte_is_refused_or_harmless(path: Path) -> None:
    model = small_model()
    write_model_file(path, model)
    content = path.read_bytes()
    refused = 0
    for position, byte in enumerate(content):
        for changed in (byte ^ 0xFF, (byte + 1) % 256):
            path.write_bytes(content[:position] + bytes([changed]) + content[position + 1 :])
            try:
                assert_same(read_model_file(path), model)
            except InputError:
                refused += 1
    assert refused > 1.9 * len(content)


def test_any_bit_of_the_arrays_counts(path: Path) -> None:
    write_model_file(path, small_model())
    content = path.read_bytes()
    for position in range(8 + int.from_bytes(content[:8], "little"), len(content)):
        for bit in range(8):
            path.write_bytes(
                content[:position] + bytes([content[position] ^ 1 << bit]) + content[position + 1 :]
            )
            with pytest.raises(InputError, match=r"damaged.*\n.*train it again"):
                read_model_file(path)


def test_arrays_cannot_swap_their_names(path: Path) -> None:
    write_model_file(path, ModelFile("knn", {"aaa": np.zeros(2), "bbb": np.ones(2)}, {}))
    content = path.read_bytes()
    path.write_bytes(
        content.replace(b"aaa", b"ccc").replace(b"bbb", b"aaa").replace(b"ccc", b"bbb")
    )
    with pytest.raises(InputError, match="checksum"):
        read_model_file(path)


def test_a_file_cut_short_anywhere_or_with_a_tail_is_refused(path: Path) -> None:
    write_model_file(path, small_model())
    content = path.read_bytes()
    for part in (*(content[:length] for length in range(len(content))), content + b"\0"):
        path.write_bytes(part)
        with pytest.raises(InputError, match="damaged or cut short"):
            read_model_file(path)


class Bomb:
    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return os.mkdir, ("bomb",)


def test_a_pickle_is_refused_and_never_run(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(path.parent)
    path.write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(InputError, match="not a safetensors file"):
        read_model_file(path)
    assert not Path("bomb").exists()


@pytest.mark.parametrize("metadata", [None, {"format": "pt"}])
def test_a_foreign_safetensors_file_is_refused(path: Path, metadata: dict[str, str] | None) -> None:
    path.write_bytes(save({"weight": np.zeros((3, 3), np.float16)}, metadata))
    with pytest.raises(InputError, match="not a noise model of probevo"):
        read_model_file(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 2}, "newer probevo.*\n.*Update"),
        ({"version": 2, "kind": None, "units": "px"}, "newer probevo"),
        ({"version": 0}, "no format 0"),
        ({"version": True}, "no version"),
        ({"version": "1"}, "no version"),
        ({"extra": 1}, "the keys checksum, extra, facts"),
        ({"kind": 3}, "kind: damaged: '3' is not text"),
        ({"facts": [1]}, "facts: damaged"),
        ({"facts": {"x": float("nan")}}, "damaged"),
        ({"checksum": None}, "checksum: damaged"),
        ({"kind": "gk"}, "does not match its checksum"),
    ],
)
def test_metadata_that_are_not_ours_are_refused(
    path: Path, change: dict[str, object], message: str
) -> None:
    write_by_hand(path, {"checksum": "0" * 64, "facts": {}, "kind": "knn", "version": 1} | change)
    with pytest.raises(InputError, match=message):
        read_model_file(path)


@pytest.mark.parametrize("key", ["checksum", "facts", "kind", "version"])
def test_a_missing_key_is_refused(path: Path, key: str) -> None:
    envelope = {"checksum": "0" * 64, "facts": {}, "kind": "knn", "version": 1}
    del envelope[key]
    write_by_hand(path, envelope)
    with pytest.raises(InputError, match=key):
        read_model_file(path)


@pytest.mark.parametrize(
    "text", ["", "knn", "3", '{"version": 1, "facts": {"x": 1e}}', "[" * 100_000]
)
def test_metadata_that_are_not_json_objects_are_refused(path: Path, text: str) -> None:
    path.write_bytes(save({"phi": np.zeros(2)}, {FORMAT: text}))
    with pytest.raises(InputError, match="damaged"):
        read_model_file(path)


def test_a_number_of_the_facts_that_grew_infinite_is_refused(path: Path) -> None:
    write_model_file(path, ModelFile("knn", {}, {"x": 1.5e308}))
    path.write_bytes(path.read_bytes().replace(b"1.5e+308", b"9.5e+308"))
    with pytest.raises(InputError, match="damaged"):
        read_model_file(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"this file is missing\.\n *Name a model file"):
        read_model_file(tmp_path / "missing.safetensors")
    with pytest.raises(InputError, match="a folder"):
        read_model_file(tmp_path)


@pytest.mark.parametrize(
    "dtype", ["float16", "uint64", "int8", "complex64", "O", "U3", "datetime64[ns]"]
)
def test_arrays_of_other_types_are_not_written(path: Path, dtype: str) -> None:
    with pytest.raises(ValueError, match="array a: type"):
        write_model_file(path, ModelFile("knn", {"a": np.zeros(2, dtype)}, {}))
    assert not path.exists()


@pytest.mark.parametrize(
    "facts",
    [
        {"x": float("nan")},
        {"x": np.zeros(2)},
        {"x": (1, 2)},
        {"x": {1: 2}},
        {"x": Path("a")},
        {1: 2, "a": 3},
    ],
)
def test_facts_that_json_would_change_are_not_written(path: Path, facts: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="JSON"):
        write_model_file(path, ModelFile("knn", {}, facts))
    assert not path.exists()


def test_an_array_cannot_take_the_name_of_the_metadata(path: Path) -> None:
    with pytest.raises(ValueError, match="__metadata__"):
        write_model_file(path, ModelFile("knn", {"__metadata__": np.zeros(2)}, {}))
