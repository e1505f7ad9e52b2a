"""Measure the time of the image predictors for 1,000 features of one image on one core.

python benchmarks/predictor_time.py
"""

from __future__ import annotations

import os

# Libraries read these once, when NumPy is imported: one core.
for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

from collections.abc import Callable  # noqa: E402
from functools import partial  # noqa: E402
from time import perf_counter  # noqa: E402

import cv2  # noqa: E402
import numpy as np  # noqa: E402
from recordings import RECORDINGS  # noqa: E402

import probevo as pv  # noqa: E402
from probevo.arrays import FloatArray, Image  # noqa: E402
from probevo.predictors.blur import blur  # noqa: E402
from probevo.predictors.entropy import entropy  # noqa: E402
from probevo.predictors.frequency import frequency  # noqa: E402
from probevo.predictors.structure import structure  # noqa: E402

PREDICTORS = (blur, entropy, frequency, structure)
COUNT = 1000
MARGIN_PX = 12
SIZE_PX = (1242, 375)
WARM_UP = 20


def median_ms(job: Callable[[], object], repeats: int = 300) -> float:
    """Return the median time of a call, after some that do not count."""
    times = []
    for _ in range(WARM_UP + repeats):
        start = perf_counter()
        job()
        times.append(1e3 * (perf_counter() - start))
    return float(np.median(times[WARM_UP:]))


def image() -> tuple[str, Image]:
    """Return the name and the pixels of a street image, or of noise where there is no recording."""
    if RECORDINGS["raw 0005"].is_dir():
        left = next(iter(pv.open_sequence(RECORDINGS["raw 0005"]))).left
        if left is not None:
            return "KITTI raw 0005", left
    return "noise", np.random.default_rng(0).integers(0, 256, SIZE_PX[::-1], np.uint8)


def compute_all(left: Image, uv: FloatArray) -> None:
    """Compute all predictors."""
    for predictor in PREDICTORS:
        predictor(left, uv)


def main() -> None:
    """Print the time of each predictor, their sum, and that of all together."""
    cv2.setNumThreads(1)
    name, left = image()
    last = np.array(left.shape[::-1]) - 1 - MARGIN_PX
    uv = np.random.default_rng(1).uniform(MARGIN_PX, last, (COUNT, 2))
    print(f"{COUNT} features, {left.shape[1]}×{left.shape[0]}, {name}")
    total_ms = 0.0
    for predictor in PREDICTORS:
        time_ms = median_ms(partial(predictor, left, uv))
        total_ms += time_ms
        print(f"  {predictor.__name__:10} {time_ms:6.3f} ms")
    print(f"  {'sum':10} {total_ms:6.3f} ms")
    print(f"  {'together':10} {median_ms(partial(compute_all, left, uv)):6.3f} ms")


if __name__ == "__main__":
    main()
