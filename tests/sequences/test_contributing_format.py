"""The example of "Add a recording format" in CONTRIBUTING.md runs as it is written there."""

from pathlib import Path
from typing import Any

import pytest

from contributing import example as example_of
from contributing import section
from probevo.errors import InputError
from probevo.sequences import format_names, open_sequence, registry
from sequences.recordings import HEIGHT_PX, WIDTH_PX, image, stamps_ns, write_image, write_lines

TITLE = "Add a recording format"


def write_rover(root: Path) -> Path:
    for index in range(3):
        write_image(root / "port" / f"{index}.png", image(index))
        write_image(root / "starboard" / f"{index}.png", image(index, right=True))
    write_lines(root / "seconds.txt", [str(stamp) for stamp in stamps_ns(3)])
    return root


@pytest.fixture
def example(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> tuple[dict[str, Any], str]:
    """What the example defines, and what it prints; its format is registered for this test."""
    monkeypatch.setattr(registry, "_registered", dict(registry._registered))
    code = example_of(TITLE)
    defined: dict[str, Any] = {"__name__": "example"}
    path = write_rover(tmp_path)
    exec(
        compile(code.replace("path/to/recording", path.as_posix()), "CONTRIBUTING.md", "exec"),
        defined,
    )
    return defined, capsys.readouterr().out


def test_the_example_opens_a_recording(example: tuple[dict[str, Any], str]) -> None:
    defined, printed = example
    assert defined["sequence"].format == "rover"
    assert defined["sequence"].camera.fu_px == 60.0
    shape = (HEIGHT_PX, WIDTH_PX)
    assert printed.splitlines() == [
        f"{index} {stamp} {shape}" for index, stamp in enumerate(stamps_ns(3))
    ]


def test_the_format_of_the_example_is_registered(
    example: tuple[dict[str, Any], str], tmp_path: Path
) -> None:
    assert "rover" in format_names()
    assert open_sequence(tmp_path, "rover").camera.fu_px == 50.0
    with pytest.raises(InputError, match=r"focal_px \(--focal-px\), for the format rover: is -1"):
        open_sequence(tmp_path, focal_px=-1)


def test_the_entry_point_names_the_format() -> None:
    assert f'[project.entry-points."{registry.ENTRY_POINTS}"]\nrover = ' in section(TITLE)
