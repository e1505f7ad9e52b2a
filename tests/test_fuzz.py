"""More than a hundred mutants of the fuzzer; ``make fuzz`` tries 10,000."""

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("resource", reason="the fuzzer bounds its processes as POSIX does")

from fuzz.mutations import DTYPES, mutated_array
from fuzz.pool import Mutant, Outcome, try_mutant
from fuzz.targets import Seed, Target, Use, all_targets, step_all, write_files

NAMES = (
    *("text", "imu", "yaml", "npz", "npz bytes", "model", "model bytes", "config", "png"),
    *("png bytes", "jpeg", "calibration", "poses", "flags", "bag", "mcap", "bag fields"),
)
NUMBER = 10
"""Mutants of each class."""
SEED = 26


@pytest.fixture(scope="module")
def targets() -> dict[str, Target]:
    return all_targets()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", NAMES)
def test_mutants_end_in_a_value_or_a_refusal(
    name: str, targets: dict[str, Target], tmp_path: Path
) -> None:
    if name not in targets:
        pytest.skip("the extra bag is not installed")
    outcomes = [
        try_mutant(targets[name], Mutant(name, SEED, number), tmp_path / "mutant")
        for number in range(NUMBER)
    ]
    findings = [outcome for outcome in outcomes if outcome.is_finding]
    assert not findings, "\n".join(f"{found.mutant}: {found.text}" for found in findings)
    assert any(outcome.kind in ("refused", "value") for outcome in outcomes)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("name", NAMES)
def test_what_is_not_mutated_is_accepted(name: str, targets: dict[str, Target]) -> None:
    """Otherwise each mutant would be refused for another reason than its damage."""
    for start in targets[name].seeds if name in targets else ():
        if name != "flags":
            targets[name].use_seed(start)


def test_the_same_three_values_are_the_same_mutant(targets: dict[str, Target]) -> None:
    for target in targets.values():
        assert target.mutant(1, 2)[1] == target.mutant(1, 2)[1]


def raising(path: Path, rng: np.random.Generator) -> None:
    raise IndexError("out of range")


def attempt(use: Use, *, is_protected: bool = False) -> Outcome:
    seed = Seed({"a": b"1"}, "a", ("a",))
    target = Target(
        "test",
        (seed,),
        lambda files, name, rng: {"a": b"2"},
        use,
        is_protected=is_protected,
    )
    return try_mutant(target, Mutant("test", 0, 0), Path("unused"))


def test_tracebacks_and_changes_in_silence_are_findings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert attempt(raising).kind == "traceback"
    assert attempt(lambda path, rng: path.read_bytes(), is_protected=True).kind == "silent"
    assert attempt(lambda path, rng: path.read_bytes()).kind == "value"
    assert attempt(step_all).kind == "refused"


def test_a_mutant_replaces_the_one_before(tmp_path: Path) -> None:
    write_files(tmp_path / "x", {"a/b": b"1"})
    write_files(tmp_path / "x", {"c": b"2"})
    assert [path.name for path in (tmp_path / "x").iterdir()] == ["c"]


@pytest.mark.filterwarnings("ignore::numpy.exceptions.ComplexWarning")
@pytest.mark.parametrize("dtype", DTYPES)
def test_arrays_of_every_type_have_mutants(dtype: str) -> None:
    """Also those that a mutation has made: another one follows."""
    array = np.zeros(4).astype(dtype)
    for seed in range(300):
        assert isinstance(mutated_array(array, np.random.default_rng(seed)), np.ndarray)
