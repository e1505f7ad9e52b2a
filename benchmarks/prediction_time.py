"""What a learned model costs: prediction for 1,000 features and loading, by the number of training
samples.

python benchmarks/prediction_time.py [samples …]    10,000 to 1,000,000 by default
"""

from __future__ import annotations

import os

os.environ |= {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
}  # before NumPy is imported: one core

import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np

import probevo as pv

COLUMNS = 17
"""As many as the default prediction space has; a kernel that was trained on images weighs all of
them."""
FEW_COLUMNS = 5
"""A kernel trained on tracks weighs about as many."""
RUNS = 15


def world(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Correlated places, as real ones are, and the logarithm of how wrong motions and features are
    there."""
    places = rng.normal(size=(count, 5)) @ rng.normal(size=(5, COLUMNS)) + 0.5 * rng.normal(
        size=(count, COLUMNS)
    )
    return places, 0.1 * places[:, 0] + np.tanh(places[:, 1])


def neighbors_of(
    places: np.ndarray, wrong: np.ndarray, rng: np.random.Generator
) -> pv.noise.NearestNeighbors:
    """PROBE, whose model holds all samples."""
    return pv.noise.NearestNeighbors(neighbors=200).fit(
        places, np.exp(wrong + rng.normal(size=len(wrong)))
    )


def kernel_of(
    columns: int, places: np.ndarray, wrong: np.ndarray, rng: np.random.Generator
) -> pv.noise.GeneralizedKernel:
    """PROBE-GK, distilled into 2,000 centers; its shape is given, to save the time to choose it."""
    shape = {"neighbors": 400, "prior_counts": 16.0, "dof_counts": 100.0, "bias_counts": np.inf}
    weights = (np.arange(COLUMNS) < columns).astype(float)
    model = pv.noise.GeneralizedKernel(**shape, weights=weights)
    return model.fit(places, 0.3 * np.exp(wrong)[:, None] * rng.normal(size=(len(wrong), 4)))


def times_ms(call: Callable[[], object]) -> list[float]:
    """Of RUNS calls, the first apart."""
    call()
    times = []
    for _ in range(RUNS):
        start = perf_counter()
        call()
        times.append(1e3 * (perf_counter() - start))
    return times


def main() -> None:
    for count in [int(float(word)) for word in sys.argv[1:]] or (10_000, 100_000, 1_000_000):
        rng = np.random.default_rng(0)
        places, wrong = world(count, rng)
        features = places[rng.choice(count, 1000)] + 0.1 * rng.normal(size=(1000, COLUMNS))
        makers = {"knn": neighbors_of} | {
            f"gk, {m} columns": partial(kernel_of, m) for m in (FEW_COLUMNS, COLUMNS)
        }
        for name, make in makers.items():
            model = make(places, wrong, rng)
            predictions = times_ms(partial(model.predict, features))
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder, "model.safetensors")
                pv.save_model(model, path)
                loads = times_ms(partial(pv.load_model, path))
                size_mb = path.stat().st_size / 1e6
            print(
                f"{name:14} {count:10,} samples: {np.median(predictions):5.2f} ms for 1,000"
                f" features (least {min(predictions):.2f}), {np.median(loads):6.1f} ms to load"
                f" {size_mb:.1f} MB",
                flush=True,
            )


if __name__ == "__main__":
    main()
