"""Of processes that run tests at the same time, one compiles a loop and the others read it."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

LOOP = """
from numba import njit

@njit(cache=True)
def total(values):
    found = 0.0
    for value in values:
        found += value
    return found
"""
CALL = """
import sys
import numpy as np
from compile_once import take_turns

take_turns()
import loop

print("ready", flush=True)
sys.stdin.readline()
assert loop.total(np.ones(3)) == 3.0
print(sum(loop.total.stats.cache_misses.values()), sum(loop.total.stats.cache_hits.values()))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="each process compiles for itself there")
def test_of_three_processes_one_compiles(tmp_path: Path) -> None:
    (tmp_path / "loop.py").write_text(LOOP)
    path = os.pathsep.join([str(Path(__file__).parent), str(tmp_path)])
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", CALL],
            env=os.environ | {"PYTHONPATH": path},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for _ in range(3)
    ]
    for process in processes:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    found = sorted(process.communicate()[0].split() for process in processes)
    assert found == [["0", "1"], ["0", "1"], ["1", "0"]]
