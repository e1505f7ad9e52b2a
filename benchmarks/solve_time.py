"""Measure ten iterations of the reprojection solve, and RANSAC, for 1,000 features.

python benchmarks/solve_time.py
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import RansacConfig
from probevo.estimation import levenberg_marquardt
from probevo.estimation.ransac import InlierThreshold, find_consensus
from probevo.estimation.reprojection import solve_reprojection
from probevo.geometry import se3
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise import StudentT
from probevo.tracking.tracks import Tracks

CAMERA = StereoCamera(fu_px=707.0, fv_px=707.0, cu_px=601.0, cv_px=183.0, baseline_m=0.537)
T_CURR_PREV = se3.exp(np.array([0.02, 0.01, -1.2, 0.003, 0.01, -0.002]))
COUNT = 1000
SIGMA_PX = 0.2


def median_ms(job: Callable[[], object], repeats: int = 200) -> float:
    """Return the median time of a call."""
    times = []
    for _ in range(repeats):
        start = perf_counter()
        job()
        times.append(1e3 * (perf_counter() - start))
    return float(np.median(times))


def noisy_features(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw features 5 to 60 m away; return their observations in both frames, [N, 4] each, px."""
    inverse_depth = rng.uniform(1 / 60, 1 / 5, COUNT)
    u = rng.uniform(0, 1226, COUNT)
    v = rng.uniform(0, 370, COUNT)
    disparity = CAMERA.fu_px * CAMERA.baseline_m * inverse_depth
    prev = np.column_stack([u, v, u - disparity, v])
    curr = CAMERA.project(se3.transform(T_CURR_PREV, CAMERA.triangulate(prev)))
    noisy_prev = prev + rng.normal(0, SIGMA_PX, prev.shape)
    noisy_curr = curr + rng.normal(0, SIGMA_PX, curr.shape)
    return noisy_prev, noisy_curr


def main() -> None:
    """Print the times of the iterations alone, of the whole solve, and of RANSAC."""
    rng = np.random.default_rng(0)
    prev, curr = noisy_features(rng)
    tracks = Tracks(prev, curr, np.arange(COUNT), age=np.full(COUNT, 2))
    noise = StudentT().predict(np.zeros((COUNT, 0)))

    # This tolerance is never reached, so that all ten iterations are taken.
    levenberg_marquardt.CONVERGED_BELOW = 0.0

    # Measure the iterations inside of the solve.
    minimize = levenberg_marquardt.minimize
    iterations_ms = []

    def timed(*arguments: object, **keywords: object) -> object:
        start = perf_counter()
        result = minimize(*arguments, **keywords)
        iterations_ms.append(1e3 * (perf_counter() - start))
        return result

    levenberg_marquardt.minimize = timed
    threshold = InlierThreshold(RansacConfig().threshold_px)
    found = find_consensus(tracks, CAMERA, rng=rng, guess=np.eye(4), threshold=threshold)
    guess = found.T_curr_prev
    whole_ms = median_ms(
        lambda: solve_reprojection(
            StereoObservations.of(prev, curr, noise, camera=CAMERA), guess=guess, max_iterations=10
        )
    )
    print(f"ten iterations over {COUNT} features: {np.median(iterations_ms):.2f} ms")
    print(f"  with set-up, weights and covariance: {whole_ms:.2f} ms")
    ransac_ms = median_ms(
        lambda: find_consensus(
            tracks, CAMERA, rng=np.random.default_rng(0), guess=guess, threshold=threshold
        )
    )
    print(f"RANSAC, 35 samples of three points, {COUNT} features: {ransac_ms:.2f} ms")


if __name__ == "__main__":
    main()
