"""Freed memory is kept: images that are allocated again and again cost no new pages."""

import subprocess
import sys

import pytest

SCRIPT = """
import resource
import numpy as np
from probevo.allocator import keep_freed_memory
is_kept = keep_freed_memory()
def images():
    for _ in range(20):
        list(map(np.ones, [500_000] * 5))  # 4 MB each, and all freed together
images()
faults_before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
images()
print(is_kept, resource.getrusage(resource.RUSAGE_SELF).ru_minflt - faults_before)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a setting of glibc")
def test_freed_memory_is_kept() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    is_kept, num_faults = done.stdout.split()
    if is_kept == "False":
        pytest.skip("not glibc")
    # Fresh pages would cost 1,000 faults for each image, 100,000 in all.
    assert int(num_faults) < 100
