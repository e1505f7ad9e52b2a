"""What the file of a trained network says of itself: read, put into words, or refused."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from safetensors.numpy import save

from probevo.errors import InputError
from probevo.nets.methods import Method
from probevo.nets.network_file import FORMAT, VERSION, _checksum, write_network_file
from probevo.nets.trained_network import (
    empty_domain,
    facts_of_kind,
    first_facts,
    kept_lines,
    kept_text,
    read_arrays,
)
from probevo.sensor_kinds import kind_of_file, recordings_of_file

KIND = "sun"


def read_back(folder: Path, further: dict[str, Any]) -> dict[str, Any]:
    """Write facts to a file, and return what is read of it."""
    file = folder / "network.safetensors"
    facts = {**first_facts(KIND, Method("sigma", learns_covariance=True)), "scale": 1.0, **further}
    write_network_file(file, {"weight": np.zeros(1)}, facts)
    return facts_of_kind(file, KIND)


@pytest.mark.parametrize(
    ("kept", "epochs", "text"),
    [
        (
            12,
            22,
            "the network after 12 epochs; 10 more did not lower the loss on what was left out",
        ),
        (1, 2, "the network after 1 epoch; 1 more did not lower the loss on what was left out"),
        (40, 40, "the network after 40 epochs, the last"),
        (0, 10, "the initial network; no epoch had a finite loss on what was left out"),
    ],
)
def test_the_kept_epoch_is_read_and_said(tmp_path: Path, kept: int, epochs: int, text: str) -> None:
    facts = read_back(tmp_path, {"kept_epoch": kept, "epochs": epochs})
    assert kept_text(facts) == text
    assert kept_lines(facts) == [f"kept:         {text}"]


@pytest.mark.parametrize(("kept", "epochs", "is_limit"), [(38, 40, True), (30, 40, False)])
def test_a_training_that_ended_by_its_limit_says_so(
    tmp_path: Path, kept: int, epochs: int, is_limit: bool
) -> None:
    """Or by its patience of ten epochs, in the last of which the limit was reached, too."""
    settings = {"epochs": 40, "patience": 10}
    facts = read_back(tmp_path, {"kept_epoch": kept, "epochs": epochs, "settings": settings})
    assert ("it ended at --nets.epochs" in kept_text(facts)) == is_limit
    before = read_back(tmp_path, {"kept_epoch": 20, "epochs": 30, "settings": settings})
    assert "--nets.epochs" not in kept_text(before)


@pytest.mark.parametrize("settings", [None, [], {"epochs": 40}, {"epochs": 40, "patience": "10"}])
def test_settings_of_another_form_say_nothing_of_a_limit(tmp_path: Path, settings: object) -> None:
    facts = read_back(tmp_path, {"kept_epoch": 40, "epochs": 40, "settings": settings})
    assert kept_text(facts) == "the network after 40 epochs, the last"


def test_a_file_without_it_stays_readable(tmp_path: Path) -> None:
    facts = read_back(tmp_path, {})
    assert kept_text(facts) == ""
    assert kept_lines(facts) == []


@pytest.mark.parametrize(
    "further",
    [
        {"kept_epoch": 3},
        {"epochs": 3},
        {"kept_epoch": 4, "epochs": 3},
        {"kept_epoch": -1, "epochs": 3},
        {"kept_epoch": 1.5, "epochs": 3},
        {"kept_epoch": True, "epochs": 3},
        {"kept_epoch": None, "epochs": 3},
        {"kept_epoch": "2", "epochs": 3},
        {"kept_epoch": 2, "epochs": [3]},
    ],
)
def test_numbers_of_epochs_that_cannot_be_are_refused(
    tmp_path: Path, further: dict[str, Any]
) -> None:
    with pytest.raises(InputError, match="epoch"):
        read_back(tmp_path, further)


@pytest.mark.parametrize("scale", [0.0, -1.0, "2", None, True, [1.0], 10**400])
def test_a_factor_that_is_no_positive_number_is_refused(tmp_path: Path, scale: object) -> None:
    with pytest.raises(InputError, match="not a complete network of kind sun"):
        read_back(tmp_path, {"scale": scale})


@pytest.mark.parametrize("scale", ["Infinity", "NaN"])
def test_a_factor_that_is_not_finite_is_refused(tmp_path: Path, scale: str) -> None:
    """Python's JSON has these, and the checksum holds."""
    method = json.dumps(asdict(Method("sigma", learns_covariance=True)))
    text = f'{{"kind": "sun", "method": {method}, "scale": {scale}}}'
    entry = {"checksum": _checksum(text, {}), "facts": text, "version": VERSION}
    file = tmp_path / "network.safetensors"
    file.write_bytes(save({}, {FORMAT: json.dumps(entry)}))
    with pytest.raises(InputError, match=r"not a complete network of kind sun .*scale is"):
        facts_of_kind(file, "sun")


@pytest.mark.parametrize("kind", [["sun"], {}, None, 3, "moon"])
def test_a_kind_that_is_none_is_refused(tmp_path: Path, kind: object) -> None:
    file = tmp_path / "network.safetensors"
    write_network_file(file, {}, {"kind": kind})
    with pytest.raises(InputError, match="no sensor of a known kind"):
        kind_of_file(file)


@pytest.mark.parametrize("names", [5, "drive", [5], {"drive": 1}, None])
@pytest.mark.parametrize("key", ["learned_from", "left_out"])
def test_recordings_that_are_no_names_are_refused(tmp_path: Path, key: str, names: object) -> None:
    file = tmp_path / "network.safetensors"
    write_network_file(file, {}, {"kind": "sun", "learned_from": ["one"], key: names})
    with pytest.raises(InputError, match=f"{key}: it is no list of names"):
        recordings_of_file(file)


def test_weights_that_are_not_finite_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "network.safetensors"
    domain = empty_domain(2)
    for bad in (np.nan, np.inf):
        write_network_file(file, ({"weight": np.array([1.0, bad])}, domain), {})
        with pytest.raises(InputError, match=r"weight'.*not finite"):
            read_arrays(file, {"weight": np.zeros(2)}, 2)
