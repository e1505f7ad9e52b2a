"""Freed memory is kept: an image's worth of it, written again and again, costs no new pages."""

import subprocess
import sys

import pytest

SCRIPT = """
import resource
import numpy as np
from probevo.allocator import keep_freed_memory
taken = keep_freed_memory()
def images():
    for _ in range(20):
        list(map(np.ones, [500_000] * 5))  # 4 MB each, and all freed together
images()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
images()
print(taken, resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a setting of glibc")
def test_freed_memory_is_kept() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    taken, faults = done.stdout.split()
    if taken == "False":
        pytest.skip("not glibc")
    assert int(faults) < 100  # fresh pages would be 1,000 faults for every image, 100,000 in all
