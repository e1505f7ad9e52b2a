"""YAML files: what is refused before it costs time or memory."""

import re
import time
from pathlib import Path

import pytest

from probevo.errors import InputError
from probevo.run_config import read_config
from probevo.sequences import open_sequence
from probevo.sequences.yaml_file import load_yaml
from sequences.recordings import write_folder_sequence

ALIASES = "a0: &a0 [1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"a{k}: &a{k} [{','.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 9)
)
"""330 bytes that stand for 9⁹ values."""


def assert_refused_at_once(path: Path, text: str, what: str) -> None:
    path.write_text(text)
    start = time.process_time()
    with pytest.raises(InputError, match=what) as raised:
        read_config(path)
    assert time.process_time() - start < 5.0
    assert len(str(raised.value)) < 2_000


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (ALIASES, "more than 100,000 values"),
        ("a: &a [*a]", "more than 100,000 values"),
        ("seed: 1\n" * 100_000, "800,000 bytes; expected at most 64,000"),
        ("seed: 1\n" * 8_000, "the key seed is given twice"),
        ("".join(f"a{k}: 1\n" for k in range(5_000)), "and 4992 more"),
        (f"seed: {list(range(5_000))}", "seed is .0, 1, 2"),
        (f"seed: {'x' * 50_000}", "seed is 'xxx"),
        ("? " + "x" * 50_000 + "\n: 1", "the key xxx"),
        ("[" * 10_000, "not YAML"),
        ("seed: " + "9" * 5_000, "not YAML"),
    ],
    ids=lambda value: value[:12],
)
def test_a_hostile_config_is_refused_at_once(text: str, what: str, tmp_path: Path) -> None:
    assert_refused_at_once(tmp_path / "config.yaml", text, what)


def test_aliases_are_allowed(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("a: &a {x: 1}\nb: {<<: *a, y: 2}\nc: [*a, *a]")
    content = load_yaml(tmp_path / "a.yaml")
    assert content["b"] == {"x": 1, "y": 2}
    assert content["c"] == [{"x": 1}, {"x": 1}]


@pytest.mark.parametrize("word", ["on", "yes", "true", "True"])
def test_a_switch_is_no_number(word: str, tmp_path: Path) -> None:
    """Pydantic would take it for 1."""
    path = write_folder_sequence(tmp_path)
    text = (path / "calib.yaml").read_text()
    (path / "calib.yaml").write_text(text.replace("baseline_m: 0.5", f"baseline_m: {word}"))
    with pytest.raises(InputError, match=r"calib\.yaml: baseline_m.*number"):
        open_sequence(path)


@pytest.mark.parametrize(("word", "expected"), [("off", False), ("on", True), ("false", False)])
def test_a_setting_may_be_switched_on_and_off(word: str, expected: bool, tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(f"imu: {word}\n")
    assert read_config(tmp_path / "config.yaml").imu is expected


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("baseline_m: 0,54", "baseline_m is '0,54'; write a plain number, with a decimal point"),
        ("baseline_m: 0.54 m", "baseline_m is '0.54 m'; write a plain number"),
        ("baseline: 0.54", r"baseline is not known \(did you mean baseline_m\?\)"),
        ("", "baseline_m is missing"),
    ],
)
def test_faults_of_a_calibration_are_named_in_plain_words(
    line: str, what: str, tmp_path: Path
) -> None:
    path = write_folder_sequence(tmp_path)
    text = (path / "calib.yaml").read_text()
    (path / "calib.yaml").write_text(re.sub(r"(?m)^baseline_m:.*$", line, text))
    with pytest.raises(InputError, match=what):
        open_sequence(path)


def test_an_empty_calibration_is_named_as_such(tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path)
    (path / "calib.yaml").write_text("")
    with pytest.raises(InputError, match="this file is empty"):
        open_sequence(path)
