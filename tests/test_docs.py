"""The documents: what they link to and name is there — pages, sections, files, names to import,
commands, flags."""

import io
import re
from collections.abc import Iterator
from contextlib import redirect_stdout
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest

from probevo.cli.main import COMMANDS, HELP, main

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]
SOURCES = [
    path
    for folder in ("src", "tests", "benchmarks", "examples")
    for path in (ROOT / folder).rglob("*.py")
]
BLOCK = re.compile(r"^ *(```|~~~).*?\n(.*?)^ *\1 *$", re.DOTALL | re.MULTILINE)
SPAN = re.compile(r"(`+)(.+?)\1", re.DOTALL)
HAVE_PARTS = ("simulate", "paper")
"""Commands whose second word has flags of its own."""

every_page = pytest.mark.parametrize("path", PAGES, ids=lambda path: path.name)


def prose(text: str) -> str:
    """Without any code."""
    return SPAN.sub("", BLOCK.sub("", text))


def code(text: str) -> list[str]:
    """Code blocks, and what stands in backticks."""
    return [match[2] for match in BLOCK.finditer(text)] + [
        match[2] for match in SPAN.finditer(BLOCK.sub("", text))
    ]


def anchors(text: str) -> set[str]:
    """Of its headings, as GitHub makes them."""
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
    """Relative ones that lead to no file, or to no section of it."""
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
    """Python files that the repository has none of, by name or by the end of a path."""
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
        if not is_there(name)
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
    """Those that its help lists."""
    with redirect_stdout(io.StringIO()) as shown, pytest.raises(SystemExit) as caught:
        main([*command, "--help"])
    assert caught.value.code == 0
    lines = re.findall(r"^[│ ]*(-.*)", shown.getvalue(), re.MULTILINE)
    return frozenset(
        flag for line in lines for flag in re.findall(r"(?<![\w-])--[a-z][\w.-]*", line)
    )


def unknown_flags(text: str) -> list[str]:
    """Commands that there are not, and flags that their commands do not have."""
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


WRONG = """\
# A title, with `code`

[Here](#a-title-with-code), [there](#elsewhere), [a page](docs/none.md), [a section](docs/probe.md#none).
`odometry.py`, `motion/odometry.py`, `benchmarks/none.py`, `pv.OdometryConfig.seed`, `pv.StereoOdometry.leap`.
`probevo.geometry.se3.exp`, `probevo.geometry.none`, `probevo simulate point --preset city`, `probevo fly`.

```sh
probevo run DRIVE --noise fixed \\
    --noises all  # --not-this
probevo simulate scene --preset city --effects.blur 0.5 --out out && probevo train A --kinds gk
```
"""


def test_what_is_wrong_is_found() -> None:
    """And nothing else."""
    assert broken_links(WRONG, ROOT / "README.md") == [
        "#elsewhere",
        "docs/none.md",
        "docs/probe.md#none",
    ]
    assert missing_files(WRONG) == ["benchmarks/none.py", "motion/odometry.py"]
    assert unknown_names(WRONG) == ["probevo.geometry.none", "pv.StereoOdometry.leap"]
    assert unknown_flags(WRONG) == ["run --noises", "train --kinds", "simulate --preset", "fly"]
