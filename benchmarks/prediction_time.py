"""What a learned model costs: prediction for 1,000 features and loading, by the number of training samples.

python benchmarks/prediction_time.py
"""

from __future__ import annotations

import os

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}  # before NumPy is imported: one core

import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

import probevo as pv

COLUMNS = 14
"""As many as the default prediction space has."""
RUNS = 15


def median_ms(times_s: list[float]) -> float:
    return 1e3 * float(np.median(times_s))


def world(count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Correlated places, as real ones are, and an α that depends on them."""
    places = rng.normal(size=(count, 5)) @ rng.normal(size=(5, COLUMNS)) + 0.5 * rng.normal(size=(count, COLUMNS))
    return places, np.exp(0.1 * places[:, 0] + np.tanh(places[:, 1]) + rng.normal(size=count))


def main() -> None:
    rng = np.random.default_rng(0)
    for count in (10_000, 100_000, 1_000_000):
        places, alphas = world(count, rng)
        model = pv.noise.NearestNeighbors(neighbors=200).fit(places, alphas)
        features = places[rng.choice(count, 1000)] + 0.1 * rng.normal(size=(1000, COLUMNS))
        model.predict(features)
        predictions, loads = [], []
        for _ in range(RUNS):
            start = perf_counter()
            model.predict(features)
            predictions.append(perf_counter() - start)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "model.safetensors")
            pv.save_model(model, path)
            for _ in range(RUNS):
                start = perf_counter()
                pv.load_model(path)
                loads.append(perf_counter() - start)
            size_mb = path.stat().st_size / 1e6
        print(
            f"{count:9,} samples: {median_ms(predictions):5.2f} ms for 1,000 features,"
            f" {median_ms(loads):6.1f} ms to load {size_mb:.1f} MB"
        )


if __name__ == "__main__":
    main()
