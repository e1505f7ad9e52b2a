"""Ways to damage a recording, and a check that it is refused."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from probevo.arrays import AnyArray
from probevo.errors import InputError
from probevo.sequences import open_sequence
from sequences.recordings import write_image

Edit = Callable[[Path], None]


def remove(name: str) -> Edit:
    def edit(path: Path) -> None:
        target = path / name
        shutil.rmtree(target) if target.is_dir() else target.unlink()

    return edit


def replace(name: str, old: str, new: str) -> Edit:
    """Replace the first occurrence in a text file."""

    def edit(path: Path) -> None:
        text = (path / name).read_text()
        assert old in text
        (path / name).write_text(text.replace(old, new, 1))

    return edit


def append(name: str, line: str) -> Edit:
    def edit(path: Path) -> None:
        with (path / name).open("a") as file:
            file.write(line + "\n")

    return edit


def write(name: str, content: bytes | AnyArray) -> Edit:
    """Put other bytes, or another image, into a file."""

    def edit(path: Path) -> None:
        if isinstance(content, bytes):
            (path / name).write_bytes(content)
        else:
            write_image(path / name, content)

    return edit


def drop_line(name: str, line: int) -> Edit:
    def edit(path: Path) -> None:
        lines = (path / name).read_text().splitlines()
        del lines[line]
        (path / name).write_text("\n".join(lines) + "\n")

    return edit


def swap_lines(name: str, first: int, second: int) -> Edit:
    def edit(path: Path) -> None:
        lines = (path / name).read_text().splitlines()
        lines[first], lines[second] = lines[second], lines[first]
        (path / name).write_text("\n".join(lines) + "\n")

    return edit


def cut(name: str, kept: float) -> Edit:
    def edit(path: Path) -> None:
        data = (path / name).read_bytes()
        (path / name).write_bytes(data[: int(kept * len(data))])

    return edit


def clear(name: str) -> Edit:
    def edit(path: Path) -> None:
        shutil.rmtree(path / name)
        (path / name).mkdir()

    return edit


def assert_refused(path: Path, fragments: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        list(open_sequence(path))
    for fragment in fragments:
        assert fragment in str(caught.value)
