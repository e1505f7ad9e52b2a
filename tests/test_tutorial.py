"""The tutorial runs as it stands: its blocks, one after the other, in an empty folder."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs" / "tutorial.md"
BLOCK = re.compile(r"^```(bash|python)\n(.*?)^```$", re.DOTALL | re.MULTILINE)


def script() -> str:
    """All blocks as one script of Bash; the Python ones share a process, as in a notebook."""
    blocks = BLOCK.findall(PAGE.read_text("utf-8"))
    shell = [text for kind, text in blocks if kind == "bash"]
    python = [text for kind, text in blocks if kind == "python"]
    return "".join([*shell, "cat > loop.py <<'END'\n", *python, "END\npython loop.py\n"])


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.skipif(sys.platform == "win32", reason="the tutorial is for Bash")
def test_every_block_runs_in_an_empty_folder(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra bag is not installed")
    folders = [str(Path(sys.executable).parent), os.environ["PATH"]]
    environment = os.environ | {"PATH": os.pathsep.join(folders)}
    if "PYTHONPATH" in environment:
        paths = environment["PYTHONPATH"].split(os.pathsep)
        environment["PYTHONPATH"] = os.pathsep.join(str(Path(path).resolve()) for path in paths)
    words = ["bash", "-euo", "pipefail", "-c", script()]
    done = subprocess.run(words, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    for name in ("first", "learned", "bag"):
        assert (tmp_path / "out" / name / "report.html").exists()
    for name in ("compared", "seen"):
        assert list((tmp_path / "out" / name).glob("*.html"))
    assert (tmp_path / "odometry.mcap").exists() or (tmp_path / "out/bag/odometry.mcap").exists()
    assert "OK" in done.stdout.splitlines()[-1]
