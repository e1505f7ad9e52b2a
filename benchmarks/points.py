"""Compare the classical noise models with knowing every covariance, in the point world.

python benchmarks/points.py [number of worlds, 3 by default]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator

import numpy as np

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.estimation.reprojection import solve_reprojection
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.geometry import se3
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise.base import StereoNoise
from probevo.predictors import prediction_space
from probevo_sim.noise_laws import NoiseLaw
from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import PointWorld, stereo_camera, training_and_test_world

TWO_FRAMES = pv.OdometryConfig(estimator="two-frame")
NO_CALIBRATION = pv.OdometryConfig(estimator="two-frame", self_calibration=False)
OUTLIER_DOF = 20.0
"""Degrees of freedom for Gaussian errors, which leave room for outliers that RANSAC misses."""


def run(world: PointWorld, noise: pv.noise.NoiseModel, config: pv.OdometryConfig) -> Metrics:
    """Run the odometry over a world."""
    odometry = pv.StereoOdometry(world.camera, noise, config=config)
    motions = [odometry.step(frame) for frame in world.frames()][1:]
    T_curr_prev = np.array([motion.T_curr_prev for motion in motions])
    cov = np.array([motion.cov for motion in motions])
    return evaluate(se3.chain_motions(T_curr_prev), world.T_world_cam, T_curr_prev, cov=cov)


def oracle(world: PointWorld) -> Metrics:
    """Solve each step from its true motion, without outliers, with the true covariances."""
    solutions = []
    for step in world.steps():
        inlier = step.inlier
        count = int(inlier.sum())
        # One covariance for both observations of a feature, which are near to each other.
        scale = 0.5 * (step.prev_covariance + step.curr_covariance)[inlier]
        noise = StereoNoise(
            scale, np.full(count, np.inf), np.zeros((count, 4)), refers_to="observation"
        )
        tracks = step.tracks.subset(inlier)
        solutions.append(
            solve_reprojection(
                StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=world.camera),
                guess=step.T_curr_prev,
            )
        )
    T_curr_prev = np.array([solution.T_curr_prev for solution in solutions])
    cov = np.array([solution.cov for solution in solutions])
    return evaluate(se3.chain_motions(T_curr_prev), world.T_world_cam, T_curr_prev, cov=cov)


class KnownCovariances:
    """The noise model that knows the true covariance of each observation, but not the outliers.

    Outliers are left to RANSAC, and to the tails of a Student-t with ν = 20 where errors are
    Gaussian.
    """

    columns = prediction_space(("place", "disparity")).columns

    def __init__(self, config: PointConfig) -> None:
        """Take the noise law of a world."""
        self.law = NoiseLaw.of(config)
        self.camera = stereo_camera(config)

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """Return the noise of N features from x, y and ln d, [N, 3]."""
        camera = self.camera
        count = len(predictors)
        u = camera.fu_px * predictors[:, 0] + camera.cu_px
        v = camera.fv_px * predictors[:, 1] + camera.cv_px
        disparity = np.exp(predictors[:, 2])
        covariance = self.law.covariance(np.column_stack([u, v, u - disparity, v]))
        dof = self.law.dof
        if np.isinf(dof):
            dof = OUTLIER_DOF
            scale = covariance
        else:
            scale = (dof - 2.0) / dof * covariance
        return StereoNoise(
            scale, np.full(count, dof), np.zeros((count, 4)), refers_to="observation"
        )

    def check_camera(self, camera: StereoCamera) -> None:
        """Accept any camera: a world has only one."""


def results(world: PointWorld) -> Iterator[tuple[str, Metrics]]:
    """Yield the name and the metrics of each estimator."""
    yield "`fixed`", run(world, pv.noise.Fixed(), TWO_FRAMES)
    yield "`student-t`", run(world, pv.noise.StudentT(), TWO_FRAMES)
    yield "`student-t`, no self-calibration", run(world, pv.noise.StudentT(), NO_CALIBRATION)
    yield "true covariances, no outliers", oracle(world)


def main() -> None:
    """Print the table of docs/simulation.md."""
    num_worlds = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    rows: dict[str, list[Metrics]] = {}
    for seed in range(num_worlds):
        _, test = training_and_test_world(PointConfig(seed=seed))
        for name, metrics in results(test):
            rows.setdefault(name, []).append(metrics)
    print("| | ARMSE, m | drift, % | ANEES |\n|---|---|---|---|")
    for name, runs in rows.items():
        cells = [
            " / ".join(f"{metrics.armse_m:.3g}" for metrics in runs),
            " / ".join(f"{metrics.short_t_percent:.3g}" for metrics in runs),
            " / ".join(f"{metrics.anees:.3g}" for metrics in runs),
        ]
        print(f"| {name} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
