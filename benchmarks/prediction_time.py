"""Measure prediction and loading of a learned model, by the number of training samples.

python benchmarks/prediction_time.py [samples …]    10,000 to 1,000,000 by default
"""

from __future__ import annotations

import os

# Libraries read these once, when NumPy is imported: one core.
os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}

import sys
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

import probevo as pv
from probevo.arrays import FloatArray

COLUMNS = 17
"""Between those of the default prediction spaces of a knn, 14, and of a kernel, 21."""
FEW_COLUMNS = 5
"""About as many as a kernel that was trained on tracks uses."""
FEATURES = 1000
RUNS = 15


class Samples(NamedTuple):
    """Training samples."""

    phi: FloatArray
    """Places in the prediction space, [N, 17], correlated as real ones are."""
    log_scale: FloatArray
    """Logarithm of the scale of the errors there, [N]."""


def draw_samples(count: int, rng: np.random.Generator) -> Samples:
    """Draw training samples."""
    phi = rng.normal(size=(count, 5)) @ rng.normal(size=(5, COLUMNS))
    phi = phi + 0.5 * rng.normal(size=(count, COLUMNS))
    return Samples(phi, 0.1 * phi[:, 0] + np.tanh(phi[:, 1]))


def nearest_neighbors(samples: Samples, rng: np.random.Generator) -> pv.noise.NearestNeighbors:
    """Fit PROBE, whose model holds all samples."""
    alphas = np.exp(samples.log_scale + rng.normal(size=len(samples.log_scale)))
    return pv.noise.NearestNeighbors(neighbors=200).fit(samples.phi, alphas)


def kernel(columns: int, samples: Samples, rng: np.random.Generator) -> pv.noise.GeneralizedKernel:
    """Fit PROBE-GK, distilled into 2,000 centers, that uses so many columns.

    Its hyperparameters are given, to save the time of their search.
    """
    model = pv.noise.GeneralizedKernel(
        neighbors=400,
        prior_counts=16.0,
        dof_counts=100.0,
        bias_counts=np.inf,
        weights=(np.arange(COLUMNS) < columns).astype(float),
    )
    scale = 0.3 * np.exp(samples.log_scale)[:, None]
    return model.fit(samples.phi, scale * rng.normal(size=(len(samples.phi), 4)))


def times_ms(call: Callable[[], object]) -> list[float]:
    """Return the times of RUNS calls after a first one, which does not count."""
    call()
    times = []
    for _ in range(RUNS):
        start = perf_counter()
        call()
        times.append(1e3 * (perf_counter() - start))
    return times


def print_times(
    name: str,
    count: int,
    model: pv.noise.NearestNeighbors | pv.noise.GeneralizedKernel,
    features: FloatArray,
) -> None:
    """Print the times of prediction and loading, and the size of the file."""
    predictions_ms = times_ms(partial(model.predict, features))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "model.safetensors")
        pv.save_model(model, path)
        loads_ms = times_ms(partial(pv.load_model, path))
        size_mb = path.stat().st_size / 1e6
    print(
        f"{name:14} {count:10,} samples: {np.median(predictions_ms):5.2f} ms for 1,000"
        f" features (least {min(predictions_ms):.2f}), {np.median(loads_ms):6.1f} ms to load"
        f" {size_mb:.1f} MB",
        flush=True,
    )


def main() -> None:
    """Print the times of each kind of model for each number of samples."""
    for count in [int(float(word)) for word in sys.argv[1:]] or (10_000, 100_000, 1_000_000):
        rng = np.random.default_rng(0)
        samples = draw_samples(count, rng)
        chosen = samples.phi[rng.choice(count, FEATURES)]
        features = chosen + 0.1 * rng.normal(size=(FEATURES, COLUMNS))
        print_times("knn", count, nearest_neighbors(samples, rng), features)
        for columns in (FEW_COLUMNS, COLUMNS):
            model = kernel(columns, samples, rng)
            print_times(f"gk, {columns} columns", count, model, features)


if __name__ == "__main__":
    main()
