"""``benchmarks/heap.py``: the memory in use is what arrays take, while they are there."""

import gc
import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]


def load_heap() -> ModuleType:
    spec = importlib.util.spec_from_file_location("heap", ROOT / "benchmarks" / "heap.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


heap = load_heap()


@pytest.mark.parametrize("size_mb", [50.0, 1.0, 0.01])
def test_arrays_come_and_go(size_mb: float) -> None:
    """One from the system and many from the heap: 50 MiB of either."""
    before_mb = heap.heap_mb()
    if before_mb is None:
        pytest.skip("the C library does not say")
    arrays = [np.ones(int(size_mb * 2**17)) for _ in range(round(50.0 / size_mb))]
    with_mb = heap.heap_mb()
    del arrays
    after_mb = heap.heap_mb()
    assert with_mb - before_mb == pytest.approx(50.0, abs=2.0)
    assert after_mb - before_mb == pytest.approx(0.0, abs=2.0)


def test_another_c_library_tells_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(heap.ctypes, "CDLL", lambda name: object())
    heap._mallinfo2.cache_clear()
    assert heap.heap_mb() is None
    heap._mallinfo2.cache_clear()


def test_a_sample_leaves_no_cycle_behind() -> None:
    heap.heap_mb()
    gc.collect()
    for _ in range(100):
        heap.heap_mb()
    assert gc.collect() < 10
