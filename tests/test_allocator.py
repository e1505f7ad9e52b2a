"""Freed memory is kept: images that are allocated again and again cost no new pages."""

import subprocess
import sys

import pytest

SCRIPT = """
import resource
import threading
import numpy as np
from probevo.allocator import keep_freed_memory
is_kept = keep_freed_memory()
def images():
    for _ in range(20):
        list(map(np.ones, [500_000] * 5))  # 4 MB each, and all freed together
def images_of_a_thread():
    thread = threading.Thread(target=images)
    thread.start()
    thread.join()
def num_faults(allocate):
    faults_before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    allocate()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - faults_before
images()
print(is_kept, num_faults(images), num_faults(images_of_a_thread))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a setting of glibc")
def test_freed_memory_is_kept_for_all_threads() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    is_kept, of_this_thread, of_another_thread = done.stdout.split()
    if is_kept == "False":
        pytest.skip("not glibc")
    # Fresh pages would cost 1,000 faults for each image, 100,000 in all.
    assert int(of_this_thread) < 100
    # A heap of the thread's own would cost these 1,000 of the first five images, 5,000 in all.
    assert int(of_another_thread) < 500


HOLES = """
import numpy as np
from pathlib import Path
from probevo.allocator import keep_freed_memory, release_freed_memory
def resident_mb():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6
keep_freed_memory()
images = list(map(np.ones, [500_000] * 20))  # 4 MB each
kept = np.ones(10_000)  # behind them: they are not at the end of the heap
del images
before_mb = resident_mb()
print(release_freed_memory(), before_mb - resident_mb())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="a setting of glibc")
def test_freed_memory_is_given_back_on_request() -> None:
    done = subprocess.run([sys.executable, "-c", HOLES], capture_output=True, text=True, check=True)
    is_given_back, released_mb = done.stdout.split()
    if is_given_back == "False":
        pytest.skip("not glibc")
    assert float(released_mb) > 70.0  # of the 80 MB of the images
