"""The house style where no linter knows it: density, the field's words, and imports without cycles.

How to mend a failure: the message names each place, and the word to use instead.
"""

from __future__ import annotations

import ast
import os
import re
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from itertools import pairwise
from pathlib import Path

import pytest

from density import Density, measure, report

ROOT = Path(__file__).parents[1]
SRC = ROOT / "src"
FILES = sorted(SRC.rglob("*.py"))

WORDS = {
    r"tied|untied": "cross-covariance, correlated",
    r"lasting": "time-correlated",
    r"carr(?:y|ies|ied|ying) on": "dead reckoning, propagate",
    r"judg(?:e|es|ed|ing|ement|ment)": "gate, test, evaluate",
    r"told|untold": "given, reported, distinguished",
    r"felt": "measured",
    r"lessons?": "sample, statistics",
    r"left over": "remaining, residual",
    r"goes home|went home": "converges",
    r"as honest as": "consistent",
    r"astray": "outlier, diverging",
    r"absurd(?:ly)?": "fails the innovation gate; out of bounds",
    r"surpris(?:e|es|ed|ing)": "innovation",
    r"doubt(?:s|ed|ful)?": "uncertainty",
    r"belie(?:f|ve|ves|ved)": "accepted, prior",
    r"what is known of": "prior",
}
"""Private words, and what the field says instead; nowhere in src/, whether as part of a name, in a
docstring, a comment or a message. A blank also stands for an underscore or a line break."""

NAME_WORDS = {
    "shared": "common_mode, or what is shared",
    "alone": "unconditioned, without_…",
}
"""The same, but only as a word of a name: in a sentence they are plain English."""

ALLOWED: dict[tuple[str, str], str] = {}
"""Uses that stay: (file below src/, the words around) → why they cannot mislead."""

PACKAGES = [
    *("geometry", "camera", "sequences", "tracking", "predictors", "noise", "measurements"),
    *("estimation", "training", "evaluation", "output", "cli", "runs", "storage", "config"),
]
OUTER = ("cli", "output", "runs", "__main__")
"""Units of probevo that are not its core: what a user sees."""


@cache
def with_split_names(path: Path) -> str:
    """The text of a file, in which words of a name in camel case are words of their own; no line
    moves."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", path.read_text("utf-8"))


@cache
def density() -> Density:
    """How densely all files are packed."""
    return measure(FILES)


@cache
def names_in(path: Path) -> list[tuple[str, int]]:
    """The names that a file binds, with their lines."""
    return list(names(parsed(path)))


def places(pattern: str) -> list[str]:
    """Where the words occur as words of their own, or as words of a name."""
    words = re.compile(
        r"(?<![a-z])(?:" + pattern.replace(" ", r"[\s_#\"']+") + r")(?![a-z])", re.IGNORECASE
    )
    found = []
    for path in FILES:
        text = with_split_names(path)
        file = path.relative_to(SRC).as_posix()
        for match in words.finditer(text):
            around = text[max(match.start() - 60, 0) : match.end() + 60]
            if not any(file == where and phrase in around for where, phrase in ALLOWED):
                found.append(f"{file}:{text.count(chr(10), 0, match.start()) + 1}: {match[0]!r}")
    return found


@cache
def parsed(path: Path) -> ast.Module:
    """The syntax tree of a file."""
    return ast.parse(path.read_text("utf-8"))


def names(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """Every name that a file uses or makes, with its line."""
    for node in ast.walk(tree):
        line = getattr(node, "lineno", 0)
        for key in ("id", "attr", "arg", "name", "asname"):
            name = getattr(node, key, None)
            if isinstance(name, str):
                yield name, line


def module_name(path: Path) -> str:
    parts = path.relative_to(SRC).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in FILES}


def unit_of(module: str) -> str:
    """The package of a module, or the module where it lies directly in probevo."""
    parts = module.split(".")
    return parts[1] if parts[0] == "probevo" and len(parts) > 1 else parts[0]


def imported(path: Path) -> Iterator[str]:
    """The modules of this repository that a file imports, those for type checking included."""
    for node in ast.walk(parsed(path)):
        targets: list[str] = []
        if isinstance(node, ast.Import):
            targets = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                targets.append(submodule if submodule in MODULES else str(node.module))
                if submodule == "probevo.__version__":
                    targets.pop()  # a constant: it needs nothing that probevo/__init__.py names
        yield from (target for target in targets if target in MODULES)


@cache
def imports_by_unit() -> dict[str, dict[str, list[str]]]:
    """Unit → the units it imports → the imports, as text."""
    graph: dict[str, dict[str, list[str]]] = defaultdict(lambda: defaultdict(list))
    for module, path in MODULES.items():
        for target in imported(path):
            if unit_of(target) != unit_of(module):
                graph[unit_of(module)][unit_of(target)].append(f"{module} imports {target}")
    return {unit: dict(others) for unit, others in graph.items()}


def test_density() -> None:
    """Packed assignments, calls with many positional arguments and long lines are within bounds."""
    measured = density()
    assert measured.is_within_bounds, report(measured)


@pytest.mark.parametrize("pattern", WORDS)
def test_no_private_word_is_left(pattern: str) -> None:
    found = places(pattern)
    assert not found, "\n".join([f"say: {WORDS[pattern]}", *found])


@pytest.mark.parametrize("word", NAME_WORDS)
def test_no_name_holds_a_private_word(word: str) -> None:
    found = [
        f"{path.relative_to(SRC)}:{line}: {name}"
        for path in FILES
        for name, line in names_in(path)
        if word in name.lower().split("_")
    ]
    assert not found, "\n".join([f"say: {NAME_WORDS[word]}", *found])


def test_no_value_is_named_by_a_preposition() -> None:
    """A variable says what it is: `pose_jacobian`, not `of_pose`. Methods may begin with `of_`."""
    found = [
        f"{path.relative_to(SRC)}:{line}: {name}"
        for path in FILES
        for name, line in bound_values(parsed(path))
        if name.startswith("of_")
    ]
    assert not found, "\n".join(["begin with the noun", *found])


def bound_values(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """The variables, parameters and attributes that a file binds, with their lines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id, node.lineno
        if isinstance(node, ast.arg):
            yield node.arg, node.lineno
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr, node.lineno


def test_what_an_attribute_is_begins_with_a_noun() -> None:
    """It reads: Velocity at the end, [3], m/s. It does not read: Of the end, [3]."""
    found = [
        f"{path.relative_to(SRC)}:{line}: {text}"
        for path in FILES
        for text, line in attribute_docstrings(parsed(path))
        if re.match(r"(Of|As|Those|That of)\b", text)
    ]
    assert not found, "\n".join(found)


def attribute_docstrings(tree: ast.Module) -> Iterator[tuple[str, int]]:
    """The texts below attributes and constants, with their lines."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.ClassDef | ast.Module):
            continue
        for before, after in pairwise(node.body):
            is_text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            if isinstance(before, ast.Assign | ast.AnnAssign) and is_text:
                yield ast.unparse(after).strip("'\""), after.lineno


def test_every_exception_is_still_needed() -> None:
    unused = [
        (file, phrase) for file, phrase in ALLOWED if phrase not in (SRC / file).read_text("utf-8")
    ]
    assert not unused


def test_there_is_no_cycle_of_packages() -> None:
    """Packages of probevo and the modules beside them depend on each other in one order only."""
    graph = imports_by_unit()
    assert set(PACKAGES) <= set(graph)
    inside = {unit for unit in graph if not unit.startswith("probevo_")} - {"probevo"}
    order = TopologicalSorter(
        {unit: [other for other in graph[unit] if other in inside] for unit in inside}
    )
    try:
        order.prepare()
    except CycleError as error:
        cycle = error.args[1][::-1]
        pairs = pairwise(cycle)
        lines = [line for importer, other in pairs for line in graph[importer][other]]
        pytest.fail("\n".join([" → ".join(cycle), *lines]))


def test_only_the_entry_points_import_the_package_itself() -> None:
    """probevo/__init__.py names what users need, and so depends on nearly all of it."""
    graph = imports_by_unit()
    allowed = {"cli", "probevo_sim", "probevo_paper"}
    found = [line for unit in set(graph) - allowed for line in graph[unit].get("probevo", [])]
    assert not found


def test_the_core_needs_neither_simulation_nor_experiments_nor_output() -> None:
    graph = imports_by_unit()
    core = {unit for unit in graph if not unit.startswith("probevo_") and unit not in OUTER}
    assert {"odometry", "training", "probevo"} <= core
    found = [
        line
        for unit in core
        for other in ("probevo_sim", "probevo_paper", "output", "runs")
        for line in graph[unit].get(other, [])
        if line != "probevo imports probevo.runs.plot"  # pv.plot, imported when it is called
    ]
    assert not found


def test_only_the_experiments_import_the_networks() -> None:
    """They need JAX, which is an extra; and they build on little of the core."""
    graph = imports_by_unit()
    assert "nets" in graph
    importers = {unit for unit in graph if "nets" in graph[unit]}
    assert importers <= {"probevo_paper"}
    allowed = {"arrays", "camera", "errors", "geometry", "measurements", "storage"}
    allowed |= {"config", "probevo", "sensor_kinds", "sequences"}
    allowed |= {"estimation", "odometry"}  # whose motions are corrected
    found = [line for unit in set(graph["nets"]) - allowed for line in graph["nets"][unit]]
    assert not found


def test_nothing_imports_the_command_line() -> None:
    """Except ``python -m probevo``, and the commands that lie beside the core."""
    found = [
        line
        for unit, others in imports_by_unit().items()
        for line in others.get("cli", [])
        if not line.startswith(
            ("probevo.__main__ ", "probevo_sim.command", "probevo_paper.command")
        )
    ]
    assert not found


def test_no_function_of_the_core_takes_more_than_seven_parameters() -> None:
    """Constructors aside: theirs are the settings of a class."""
    core = f"{SRC / 'probevo'}{os.sep}"
    found = [place for place in density().many_parameters if place.startswith(core)]
    assert not found, "\n".join(found)
