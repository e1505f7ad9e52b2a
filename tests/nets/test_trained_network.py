"""What the file of a trained network says of itself: read, put into words, or refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("jax", reason="jax is missing: pip install 'probevo[nets]'")
pytest.importorskip("equinox")

from probevo.errors import InputError
from probevo.nets.methods import Method
from probevo.nets.network_file import write_network_file
from probevo.nets.trained_network import (
    facts_of_kind,
    first_facts,
    kept_lines,
    kept_text,
)

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
