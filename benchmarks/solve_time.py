"""Time of one reprojection solve: 1,000 features, ten iterations, and of RANSAC on the same
features.

python benchmarks/solve_time.py
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np
from probevo.estimation import reprojection

from probevo.camera.stereo import StereoCamera
from probevo.estimation.ransac import find_consensus
from probevo.geometry import se3
from probevo.noise import StudentT

CAMERA = StereoCamera(707.0, 707.0, 601.0, cv_px=183.0, baseline_m=0.537)
T_CURR_PREV = se3.exp(np.array([0.02, 0.01, -1.2, 0.003, 0.01, -0.002]))


def median_ms(job: Callable[[], object], repeats: int = 200) -> float:
    times = []
    for _ in range(repeats):
        start = perf_counter()
        job()
        times.append(1e3 * (perf_counter() - start))
    return float(np.median(times))


def main() -> None:
    rng = np.random.default_rng(0)
    count = 1000
    rho = rng.uniform(1 / 60, 1 / 5, count)
    u = rng.uniform(0, 1226, count)
    v = rng.uniform(0, 370, count)
    prev = np.column_stack([u, v, u - CAMERA.fu_px * CAMERA.baseline_m * rho, v])
    curr = CAMERA.project(se3.transform(T_CURR_PREV, CAMERA.triangulate(prev)))
    prev = prev + rng.normal(0, 0.2, prev.shape)
    curr = curr + rng.normal(0, 0.2, curr.shape)
    noise = StudentT().predict(np.zeros((count, 0)))

    reprojection.CONVERGED_BELOW = 0.0  # never satisfied: all ten iterations are taken
    iterate = reprojection.minimize
    spent = []

    def timed(*arguments: object) -> object:
        start = perf_counter()
        result = iterate(*arguments)
        spent.append(1e3 * (perf_counter() - start))
        return result

    reprojection.minimize = timed
    guess = find_consensus(prev, curr, CAMERA, rng=rng, guess=np.eye(4)).T_curr_prev
    whole = median_ms(
        lambda: reprojection.solve_reprojection(
            prev, curr, noise, guess, CAMERA, max_iterations=10
        ),
        repeats=200,
    )
    print(f"ten iterations over {count} features: {np.median(spent):.2f} ms")
    print(f"  with set-up, weights and covariance: {whole:.2f} ms")
    ransac = median_ms(
        lambda: find_consensus(prev, curr, CAMERA, rng=np.random.default_rng(0), guess=guess)
    )
    print(f"RANSAC, 35 samples of three points, {count} features: {ransac:.2f} ms")


if __name__ == "__main__":
    main()
