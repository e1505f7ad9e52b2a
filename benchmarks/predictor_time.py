"""Time of the image predictors, each and all together, for 1,000 features of one image on one core.

python benchmarks/predictor_time.py
"""

from __future__ import annotations

import os

for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"  # read once, when NumPy is imported

from collections.abc import Callable  # noqa: E402
from time import perf_counter  # noqa: E402

import cv2  # noqa: E402
import numpy as np  # noqa: E402
from recordings import RECORDINGS  # noqa: E402

import probevo as pv  # noqa: E402
from probevo.arrays import Image  # noqa: E402
from probevo.predictors.blur import blur  # noqa: E402
from probevo.predictors.entropy import entropy  # noqa: E402
from probevo.predictors.frequency import frequency  # noqa: E402
from probevo.predictors.structure import structure  # noqa: E402

PREDICTORS = (blur, entropy, frequency, structure)
COUNT = 1000
MARGIN_PX = 12
SIZE_PX = (1242, 375)


def median_ms(job: Callable[[], object], repeats: int = 300) -> float:
    times = []
    for _ in range(20 + repeats):
        start = perf_counter()
        job()
        times.append(1e3 * (perf_counter() - start))
    return float(np.median(times[20:]))


def image() -> tuple[str, Image]:
    """A street, or noise where there is none, and which of the two."""
    if RECORDINGS["raw 0005"].is_dir():
        left = next(iter(pv.open_sequence(RECORDINGS["raw 0005"]))).left
        if left is not None:
            return "KITTI raw 0005", left
    return "noise", np.random.default_rng(0).integers(0, 256, SIZE_PX[::-1], np.uint8)


def main() -> None:
    cv2.setNumThreads(1)
    name, left = image()
    last = np.array(left.shape[::-1]) - 1 - MARGIN_PX
    uv = np.random.default_rng(1).uniform(MARGIN_PX, last, (COUNT, 2))
    print(f"{COUNT} features, {left.shape[1]}×{left.shape[0]}, {name}")
    times = {
        predictor.__name__: median_ms(lambda compute=predictor: compute(left, uv))
        for predictor in PREDICTORS
    }
    for predictor, time_ms in times.items():
        print(f"  {predictor:10} {time_ms:6.3f} ms")
    print(f"  {'sum':10} {sum(times.values()):6.3f} ms")
    print(
        f"  {'together':10}"
        f" {median_ms(lambda: [compute(left, uv) for compute in PREDICTORS]):6.3f} ms"
    )


if __name__ == "__main__":
    main()
