"""Fixtures for all tests."""

import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

# Workers of xdist and subprocesses inherit this; NumPy reads it when compile_once imports it. With
# threads, OpenBLAS makes an eigendecomposition of size 40 wait for 10 ms instead of 0.1 where all
# cores are busy, as they are with the tests.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# The tests start many processes. Without bytecode, each of these compiles all sources again, and
# each worker all tests.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

from compile_once import take_turns  # noqa: E402

LONGEST = (
    # One process compiles the odometry for minutes, which all others wait for once they need it.
    # So these begin with networks, which do not.
    *("test_atomic_step.py", "paper/test_hydranet.py", "nets/test_learning.py"),
    *("nets/test_sun_training.py", "nets/test_methods.py", "nets/test_sun_methods.py"),
    *("nets/test_rotation_training.py", "test_examples.py"),
    *("training/gk/test_expectation_maximization.py", "sim/scene/test_presets.py"),
    *("noise/gk/test_generalized_kernel.py", "nets/test_correction_training.py"),
    *("test_odometry.py", "sim/scene/test_renderer.py"),
    *("test_tutorial.py", "training/test_training_at_scale.py", "training/test_api.py"),
    *("paper/test_figure_5.py", "evaluation/test_accelerometer_scale.py"),
    *("predictors/test_separation.py", "cli/test_hostile_folder.py", "test_fuzz.py"),
    *("training/probe/test_selection.py", "estimation/test_sensor_fusion.py"),
    *("output/report/test_report.py", "cli/test_run_command.py", "training/test_workers.py"),
    *("tracking/test_pair_timing.py", "estimation/window/test_inertial.py"),
    *("cli/test_demo_command.py", "training/gk/test_jitter.py"),
    *("estimation/window/test_window.py", "output/comparison/test_comparison.py"),
)
"""Files of more than ten seconds of processor time, which several processes begin with. Those that
start processes of their own come later: what is compiled by then, these need not compile again."""
MIN_PROCESSES = 3
"""Of ``--numprocesses auto``. Some tests wait: two processes would leave a core of two idle. Three
keep both busy 97 % of the time, and each more one imports all tests once more, for 11 s."""

take_turns()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int | None:
    """Return the number of processes for ``--numprocesses auto``; None if the user has set it."""
    if "PYTEST_XDIST_AUTO_NUM_WORKERS" in os.environ:
        return None
    return max(os.cpu_count() or 1, MIN_PROCESSES)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files, so that at the end no process is left with one of them."""
    tests = Path(__file__).parent
    rank = {tests / name: place for place, name in enumerate(LONGEST)}
    missing = [str(path) for path in rank if not path.exists()]
    if missing:
        raise pytest.UsageError(f"LONGEST in {__file__} names what is not there: {missing}")
    items.sort(key=lambda item: rank.get(item.path, len(rank)))


def pytest_collection_finish() -> None:
    """Spare the garbage collector what stays for good: all modules and all tests."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 20, 20)


def pytest_configure(config: pytest.Config) -> None:
    """Let JAX compile quickly, and all processes, and later calls, share what it has compiled.

    Networks consist of hundreds of operations that take JAX longer to compile than to compute.
    Without its emitters of fused operations it compiles them in two thirds of the time, without
    LLVM's optimisations in two fifths of that, and undivided in a fifteenth less.
    """
    quick = (
        "--xla_cpu_use_fusion_emitters=false",
        "--xla_backend_optimization_level=0",
        "--xla_cpu_parallel_codegen_split_count=1",
    )
    os.environ.setdefault("XLA_FLAGS", " ".join(quick))
    if hasattr(config, "cache"):  # unless started with -p no:cacheprovider
        os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(config.cache.mkdir("jax")))
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")
        os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES", "-1")


@pytest.fixture(scope="session")
def data_root() -> Path:
    """Folder of the real recordings; the test is skipped if they are absent."""
    root = Path(os.environ.get("PROBEVO_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not root.is_dir():
        pytest.skip(f"no real recordings at {root}: set PROBEVO_DATA to their folder")
    return root


@pytest.fixture
def coarsely_rendered() -> Iterator[None]:
    """Render quickly, for a test that needs images but not their finest detail."""
    from coarse_rendering import coarse_rendering

    with coarse_rendering():
        yield


@pytest.fixture
def undrawn() -> Iterator[None]:
    """Leave the figures of all pages empty, for a test that does not look at them."""
    from output.undrawn import figures_undrawn

    with figures_undrawn():
        yield
