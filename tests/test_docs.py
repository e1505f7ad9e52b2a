"""The documents: what they link to and name exists, they begin with a summary, and use the field's
words.

Links lead to pages and sections; names are those of files, of the package, of commands and flags.
"""

import io
import re
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import fields
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from probevo.cli.main import COMMANDS, HELP, main
from probevo.noise import registry as noise_models
from probevo.odometry import StereoOdometry
from probevo.predictors import registry as predictors
from probevo.sequences import registry as formats
from probevo.state import OdometryState
from test_style import WORDS

ROOT = Path(__file__).parents[1]
DOCS = sorted((ROOT / "docs").glob("*.md"))
PAGES = [
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")),
    ROOT / "benchmarks" / "README.md",
    *DOCS,
]
SOURCES = [
    path
    for folder in ("src", "tests", "benchmarks", "examples", "tools", "docs")
    for path in (ROOT / folder).rglob("*.py")
]
ENTRY_POINTS = {kind.ENTRY_POINTS for kind in (formats, noise_models, predictors)}
"""Groups of entry points, whose dotted names are no modules."""
BLOCK = re.compile(r"^ *(```|~~~).*?\n(.*?)^ *\1 *$", re.DOTALL | re.MULTILINE)
SPAN = re.compile(r"(`+)(.+?)\1", re.DOTALL)
HAVE_PARTS = ("simulate", "paper")
"""Commands whose second word has flags of its own."""

every_page = pytest.mark.parametrize(
    "path", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix()
)


def prose(text: str) -> str:
    """The text without any code."""
    return SPAN.sub("", BLOCK.sub("", text))


def code(text: str) -> list[str]:
    """Code blocks, and spans of code."""
    return [match[2] for match in BLOCK.finditer(text)] + [
        match[2] for match in SPAN.finditer(BLOCK.sub("", text))
    ]


def anchors(text: str) -> set[str]:
    """The anchors of its headings, as GitHub makes them."""
    found: set[str] = set()
    for heading in re.findall(r"^#+ +(.+?)[ #]*$", BLOCK.sub("", text), re.MULTILINE):
        words = re.sub(r"\[(.*?)\]\(.*?\)", r"\1", heading)
        first = name = re.sub(r"[^\w\- ]", "", words.lower()).strip().replace(" ", "-")
        number = 0
        while name in found:
            number += 1
            name = f"{first}-{number}"
        found.add(name)
    return found


def broken_links(text: str, page: Path) -> list[str]:
    """Relative links that lead to no file, or to no section of it."""
    broken = []
    for link in re.findall(r"\]\(([^)\s]+)[^)]*\)|(?:src|href)=\"([^\"]+)\"", prose(text)):
        target, _, section = "".join(link).partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        file = page.parent / target if target else page
        if not file.exists():
            broken.append("".join(link))
        elif section and file.suffix == ".md":
            there = text if file == page else file.read_text("utf-8")
            if section not in anchors(there):
                broken.append("".join(link))
    return broken


def missing_files(text: str) -> list[str]:
    """Python files that the repository does not have, by name or by the end of a path."""
    known = ["/" + path.relative_to(ROOT).as_posix() for path in SOURCES]
    named = {
        name
        for piece in code(text)
        for name in re.findall(r"(?<![\w/.*<>-])[\w-][\w./-]*\.py\b", piece)
    }
    return sorted(name for name in named if not any(path.endswith("/" + name) for path in known))


def is_there(dotted: str) -> bool:
    """Whether it can be imported, or is an attribute or a field of what can be."""
    first, *names = dotted.split(".")
    module = "probevo"
    found: object = import_module(module)
    assert first in ("probevo", "pv")
    for name in names:
        if not hasattr(found, name):
            module = f"{module}.{name}"
            try:
                found = import_module(module)
            except ModuleNotFoundError:
                return name == names[-1] and any(
                    name in kind.__annotations__ for kind in getattr(found, "__mro__", ())[:-1]
                )
        else:
            found = getattr(found, name)
            module = f"{module}.{name}"
    return True


def unknown_names(text: str) -> list[str]:
    """Dotted names of this package that lead nowhere."""
    pattern = r"(?<![\w./-])(?:probevo|pv)(?:\.[A-Za-z_]\w*)+(?![\w/])"
    return sorted(
        name
        for name in {name for piece in code(text) for name in re.findall(pattern, piece)}
        if name not in ENTRY_POINTS and not is_there(name)
    )


def commands(text: str) -> Iterator[list[str]]:
    """The words after each ``probevo`` that starts a command."""
    for piece in code(text):
        for line in piece.replace("\\\n", " ").splitlines():
            for part in re.split(r"&&|[|;]|(?<!\S)#", line):
                if match := re.match(r"\s*(?:\$ +)?probevo +(.*\S)", part):
                    yield match[1].split()


@cache
def flags(*command: str) -> frozenset[str]:
    """The flags that its help lists."""
    with redirect_stdout(io.StringIO()) as shown, pytest.raises(SystemExit) as caught:
        main([*command, "--help"])
    assert caught.value.code == 0
    lines = re.findall(r"^[│ ]*(-.*)", shown.getvalue(), re.MULTILINE)
    return frozenset(
        flag for line in lines for flag in re.findall(r"(?<![\w-])--[a-z][\w.-]*", line)
    )


def unknown_flags(text: str) -> list[str]:
    """Commands that do not exist, and flags that their commands do not have."""
    unknown = []
    for first, *rest in commands(text):
        if first.startswith("-"):
            unknown += [first] if first not in HELP and first != "-h" else []
        elif first.islower() and first not in COMMANDS:
            unknown.append(first)
        elif first in COMMANDS:
            part = (
                [rest[0]]
                if first in HAVE_PARTS and rest and re.fullmatch(r"[a-z][a-z0-9.-]*", rest[0])
                else []
            )
            given = {word for each in rest for word in re.findall(r"^[\[(]*(--[a-z][\w.-]*)", each)}
            unknown += [f"{first} {flag}" for flag in sorted(given - flags(first, *part))]
    return unknown


@every_page
def test_each_link_leads_somewhere(path: Path) -> None:
    assert broken_links(path.read_text("utf-8"), path) == []


@every_page
def test_each_file_that_is_named_is_there(path: Path) -> None:
    assert missing_files(path.read_text("utf-8")) == []


@every_page
def test_each_name_of_the_package_can_be_imported(path: Path) -> None:
    assert unknown_names(path.read_text("utf-8")) == []


@every_page
def test_each_command_has_the_flags_that_are_given(path: Path) -> None:
    assert unknown_flags(path.read_text("utf-8")) == []


def private_words(text: str) -> list[str]:
    """Words that only this project uses, with the field's word for each."""
    words = prose(text)
    return [
        f"{match[0]!r}: say {field}"
        for pattern, field in WORDS.items()
        for match in re.finditer(rf"(?<![a-z])(?:{pattern})(?![a-z])", words, re.IGNORECASE)
    ]


@pytest.mark.parametrize(
    "path", [path for path in PAGES if path.name != "CHANGELOG.md"], ids=lambda path: path.name
)
def test_each_page_uses_the_words_of_the_field(path: Path) -> None:
    """The changelog has the table from the old words to the new ones."""
    assert private_words(path.read_text("utf-8")) == []


@pytest.mark.parametrize("path", DOCS, ids=lambda path: path.name)
def test_each_page_begins_with_a_summary_of_three_lines(path: Path) -> None:
    title, blank, *summary, after = path.read_text("utf-8").splitlines()[:6]
    assert title.startswith("# ")
    assert blank == after == ""
    assert all(re.match(r"[^\W_]|`", line) for line in summary), summary
    assert summary[-1].endswith(".")


WRONG = """\
# A title, with `code`

[Here](#a-title-with-code), [there](#elsewhere), [a page](docs/none.md),
[a section](docs/probe.md#none).
`odometry.py`, `motion/odometry.py`, `benchmarks/none.py`,
`pv.OdometryConfig.seed`, `pv.StereoOdometry.leap`, `probevo.noise`,
`probevo.geometry.se3.exp`, `probevo.geometry.none`,
`probevo simulate point --preset city`, `probevo fly`.

```sh
probevo run DRIVE --noise fixed \\
    --noises all  # --not-this
probevo simulate scene --preset city --effects.blur 0.5 --out out && probevo train A --kinds gk
```
"""


def test_what_is_wrong_is_found() -> None:
    """Each fault is found, and nothing else."""
    assert broken_links(WRONG, ROOT / "README.md") == [
        "#elsewhere",
        "docs/none.md",
        "docs/probe.md#none",
    ]
    assert missing_files(WRONG) == ["benchmarks/none.py", "motion/odometry.py"]
    assert unknown_names(WRONG) == ["probevo.geometry.none", "pv.StereoOdometry.leap"]
    assert private_words("It was carried on, as `shared` is. A surprise.") == [
        "'carried on': say dead reckoning, propagate",
        "'surprise': say innovation",
    ]
    assert unknown_flags(WRONG) == ["run --noises", "train --kinds", "simulate --preset", "fly"]


@every_page
def test_each_test_that_is_named_exists(path: Path) -> None:
    named = re.findall(r"`(tests/[\w/]+\.py)(?:::(\w+))?`", path.read_text("utf-8"))
    missing = [
        f"{file}::{test}"
        for file, test in named
        if not (ROOT / file).exists() or f"def {test}" not in (ROOT / file).read_text("utf-8")
    ]
    assert missing == []


def test_every_part_of_the_package_is_in_the_list_of_folders() -> None:
    """Who reads an import in odometry.py finds its concept in docs/data-flow.md."""
    page = (ROOT / "docs" / "data-flow.md").read_text("utf-8")
    table = page[page.index("## Folder → concept") : page.index("## A step")]
    package = ROOT / "src" / "probevo"
    parts = {f"{path.name}/" for path in package.iterdir() if (path / "__init__.py").exists()}
    parts |= {path.name for path in package.glob("*.py") if not path.name.startswith("__")}
    assert not {part for part in parts if f"`{part}`" not in table}


def test_data_flow_names_the_methods_of_a_step_and_the_fields_of_the_state() -> None:
    page = (ROOT / "docs" / "data-flow.md").read_text(encoding="utf-8")
    a_step = page[page.index("## A step") : page.index("## State")]
    methods = re.findall(r"`(_[a-z_]+)`", a_step)
    assert methods
    assert [name for name in methods if not hasattr(StereoOdometry, name)] == []
    state = page[page.index("## State") : page.index("## Measurements and the estimator")]
    fields_in_page = re.findall(r"^\| `(\w+)` \|", state, flags=re.MULTILINE)
    assert sorted(fields_in_page) == sorted(field.name for field in fields(OdometryState))
