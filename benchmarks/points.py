"""The point world of docs/simulation.md: the shipped noise models, and what knowing every
covariance is worth.

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
from probevo.noise.base import StereoNoise
from probevo.predictors import prediction_space
from probevo_sim.noise_laws import NoiseLaw
from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import PointWorld, stereo_camera, training_and_test_world

OFF = pv.OdometryConfig(self_calibration=False)


def shipped(
    world: PointWorld, noise: pv.noise.NoiseModel, config: pv.OdometryConfig | None
) -> Metrics:
    odometry = pv.StereoOdometry(world.camera, noise, config=config)
    motions = [odometry.step(frame) for frame in world.frames()][1:]
    T_curr_prev = np.array([m.T_curr_prev for m in motions])
    cov = np.array([m.cov for m in motions])
    return evaluate(se3.chain_motions(T_curr_prev), world.T_world_cam, T_curr_prev, cov=cov)


def oracle(world: PointWorld) -> Metrics:
    """With the outliers taken out and the true covariance of each observation, from the true motion
    on."""
    solutions = []
    for step in world.steps():
        inlier, count = step.inlier, int(step.inlier.sum())
        scale = (
            0.5 * (step.prev_covariance + step.curr_covariance)[inlier]
        )  # one for both observations: they are near
        noise = StereoNoise(
            scale, np.full(count, np.inf), np.zeros((count, 4)), refers_to="observation"
        )
        tracks = step.tracks.kept(inlier)
        solutions.append(
            solve_reprojection(
                tracks.prev_px, tracks.curr_px, noise, guess=step.T_curr_prev, camera=world.camera
            )
        )
    T_curr_prev = np.array([s.T_curr_prev for s in solutions])
    cov = np.array([s.cov for s in solutions])
    return evaluate(se3.chain_motions(T_curr_prev), world.T_world_cam, T_curr_prev, cov=cov)


class Law:
    """The law of a world as a noise model: the true covariance where each landmark is seen, but not
    which are outliers.

    Those are left to the odometry's consensus, and to tails of ν = 20 for errors that are Gaussian.
    """

    columns = prediction_space(("place", "disparity")).columns

    def __init__(self, config: PointConfig) -> None:
        self.law = NoiseLaw.of(config)
        self.camera = stereo_camera(config)

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """Noise of N features from x, y and ln d, [N, 3]."""
        c = self.camera
        count = len(predictors)
        u = c.fu_px * predictors[:, 0] + c.cu_px
        v = c.fv_px * predictors[:, 1] + c.cv_px
        pixels = np.column_stack([u, v, u - np.exp(predictors[:, 2]), v])
        covariance = self.law.covariance(pixels)
        dof = self.law.dof
        if np.isinf(dof):
            return StereoNoise(
                covariance, np.full(count, 20.0), np.zeros((count, 4)), refers_to="observation"
            )
        scale = (dof - 2.0) / dof * covariance
        return StereoNoise(
            scale, np.full(count, dof), np.zeros((count, 4)), refers_to="observation"
        )

    def check_camera(self, camera: StereoCamera) -> None:
        """It is of one world, whose camera is the only one."""


def estimators(world: PointWorld) -> Iterator[tuple[str, Metrics]]:
    yield "`fixed`", shipped(world, pv.noise.Fixed(), None)
    yield "`student-t`", shipped(world, pv.noise.StudentT(), None)
    yield "`student-t`, no self-calibration", shipped(world, pv.noise.StudentT(), OFF)
    yield "true covariances, no outliers", oracle(world)


def main() -> None:
    rows: dict[str, list[Metrics]] = {}
    for seed in range(int(sys.argv[1]) if len(sys.argv) > 1 else 3):
        for name, metrics in estimators(training_and_test_world(PointConfig(seed=seed))[1]):
            rows.setdefault(name, []).append(metrics)
    print("| | ARMSE, m | drift, % | ANEES |\n|---|---|---|---|")
    for name, runs in rows.items():
        texts = [
            " / ".join(f"{value:.3g}" for value in values)
            for values in zip(*((m.armse_m, m.short_t_percent, m.anees) for m in runs), strict=True)
        ]
        print(f"| {name} | " + " | ".join(texts) + " |")


if __name__ == "__main__":
    main()
