"""The tutorial runs as it stands: its blocks, one after the other, in an empty folder."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from probevo.cli.main import main

PAGE = Path(__file__).parents[1] / "docs" / "tutorial.md"
BLOCK = re.compile(r"^```(bash|python)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
COMMAND = re.compile(r"^(probevo [\w ./:-]+)\n", re.MULTILINE)
"""A call of probevo that a shell hands over word by word: without quotes, variables and pipes."""
SMALLER_IMAGES = ["--rig.width-px=414", "--rig.height-px=126", "--rig.focal-px=240"]
"""For drives that the tutorial renders."""


def blocks(language: str) -> str:
    """Return all blocks of a language as one script."""
    found = BLOCK.findall(PAGE.read_text("utf-8"))
    return "".join(text for kind, text in found if kind == language)


def run_in_bash(script: str) -> None:
    """Run a script of Bash in the working directory, where it finds this Python and its probevo."""
    folders = [str(Path(sys.executable).parent), os.environ["PATH"]]
    environment = os.environ | {"PATH": os.pathsep.join(folders)}
    words = ["bash", "-euo", "pipefail", "-c", script]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.usefixtures("undrawn", "coarsely_rendered")
@pytest.mark.skipif(sys.platform == "win32", reason="the tutorial is for Bash")
def test_every_block_runs_in_an_empty_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Calls of probevo share this process, which spares each of them its imports; what else the
    shell blocks hold, Bash runs."""
    pytest.importorskip("rosbags", reason="the extra bag is not installed")
    monkeypatch.chdir(tmp_path)
    run_in_bash("probevo --version\n")
    for number, text in enumerate(COMMAND.split(blocks("bash"))):
        if number % 2 == 1:
            words = shlex.split(text)[1:]
            if words[:2] == ["simulate", "scene"]:
                words += SMALLER_IMAGES
            assert main(words) == 0, f"{text}\n{capsys.readouterr().err}"
        elif text:
            run_in_bash(text)
    names: dict[str, Any] = {"__name__": "__main__"}
    capsys.readouterr()
    exec(compile(blocks("python"), PAGE.name, "exec"), names)
    assert "OK" in capsys.readouterr().out.splitlines()[-1]
    for name in ("first", "learned", "bag"):
        assert (tmp_path / "out" / name / "report.html").exists()
    for name in ("compared", "seen"):
        assert list((tmp_path / "out" / name).glob("*.html"))
    assert (tmp_path / "odometry.mcap").exists() or (tmp_path / "out/bag/odometry.mcap").exists()
