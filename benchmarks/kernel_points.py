"""PROBE-GK in the point world: error and honesty of the motion against the best static Student-t
and the oracle.

python benchmarks/kernel_points.py [seeds] [law …]    20 seeds of every law by default

Outliers: 5 % of the landmarks, ±20 px. Training and test worlds are independent, the rig is
    flawless, and all start
from the same RANSAC. *Best-scaled* is the Student-t (ν = 5) whose scale has the least ARMSE on the
test itself, with the noise of residuals, as in PROBE-GK, and with that of observations, as probevo
ships it. *Law* is our odometry with the true covariance of every observation; the oracle knows that
and which landmarks are outliers.
"""

from __future__ import annotations

import sys
from collections import defaultdict
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from points import Law, oracle

import probevo as pv
from probevo.estimation.reprojection import solve_reprojection
from probevo.evaluation.consistency import feature_coverage
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.output.run_result import RunRecorder
from probevo.training.settings import KernelSettings, SupervisionName, TrainSettings
from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import PointWorld, write_training_and_test

LAWS = ("row", "column", "radius", "disparity", "heavy-tailed", "correlated")
SCALES_PX = (0.1, 0.2, 0.4, 0.8)
PREDICTORS = ("place", "disparity")
OFF = pv.OdometryConfig(self_calibration=False)


def config_of(law: str, seed: int) -> PointConfig:
    noise = {"law": "row", "correlation": 0.8} if law == "correlated" else {"law": law}
    return PointConfig.model_validate(
        {"seed": seed, "noise": noise, "outliers": {"fraction": 0.05, "range_px": 20.0}}
    )


def trained(
    folder: Path, kind: str, supervision: SupervisionName, kernel: KernelSettings
) -> pv.noise.NoiseModel:
    predictors = PREDICTORS if kind == "gk" else None
    settings = TrainSettings(
        kind=kind, supervision=supervision, predictors=predictors, gk=kernel, odometry=OFF
    )
    return pv.load_model(
        pv.train_model([pv.open_sequence(folder / "train.npz")], settings, folder / "m.safetensors")
    )


def run(world: PointWorld, noise: pv.noise.NoiseModel) -> Metrics:
    odometry = pv.StereoOdometry(world.camera, noise, config=OFF)
    recorder = RunRecorder()
    for frame in world.frames():
        recorder.add(frame.stamp_ns, odometry.step(frame))
    result = recorder.result()
    return evaluate(result.T_world_cam, world.T_world_cam, result.T_curr_prev, cov=result.cov)


def feature_honesty(world: PointWorld, model: pv.noise.NoiseModel) -> dict[str, float]:
    """Share of the inliers' residuals at the true motion within their predicted 50, 90, 95 and 99 %
    regions."""
    shares: dict[str, list[float]] = defaultdict(list)
    odometry = pv.StereoOdometry(world.camera, model, config=OFF)
    steps = world.steps()
    frames = world.frames()
    odometry.step(next(frames))
    for step, frame in zip(steps, frames, strict=True):
        odometry.step(frame)
        noise = model.predict(odometry.phi).of(np.flatnonzero(odometry.used))
        tracks = odometry.tracks.kept(odometry.used)
        at_truth = solve_reprojection(
            tracks.prev_px,
            tracks.curr_px,
            noise,
            guess=step.T_curr_prev,
            camera=world.camera,
            max_iterations=0,
        )
        scale = np.linalg.inv(at_truth.information)
        residual_noise = pv.noise.StereoNoise(scale, noise.dof, np.zeros((len(scale), 4)))
        for level, share in feature_coverage(residual_noise, at_truth.residuals).items():
            shares[level].append(share)
    return {level: float(np.mean(values)) for level, values in shares.items()}


def static(scale_px: float, refers_to: str) -> pv.noise.StudentT:
    return pv.noise.StudentT(5.0, scale_px**2 * np.eye(4), refers_to=refers_to)


def main() -> None:
    seeds = int(sys.argv[1]) if len(sys.argv) > 1 else 20
    estimators = {
        "fitted Student-t": ("student-t", "gt", KernelSettings()),
        "GK-GT published": (
            "gk",
            "gt",
            KernelSettings(variant="published", refers_to="residual", iterations=1),
        ),
        "GK-GT": ("gk", "gt", KernelSettings()),
        "GK-EM": ("gk", "none", KernelSettings()),
    }
    head = (
        "law",
        "estimator",
        "ARMSE, m",
        "RMS of a step, mm",
        "ANEES",
        "features within 50 / 90 / 95 / 99 %",
    )
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for law in sys.argv[2:] or LAWS:
        rows: dict[str, list[tuple[float, ...]]] = defaultdict(list)
        honesty: dict[str, list[list[float]]] = defaultdict(list)
        for seed in range(seeds):
            with TemporaryDirectory() as name:
                folder = Path(name)
                config = config_of(law, seed)
                _, test = write_training_and_test(config, folder)
                for refers_to in ("residual", "observation"):
                    tried = [run(test, static(scale, refers_to)) for scale in SCALES_PX]
                    best = min(tried, key=lambda m: m.armse_m)
                    rows[f"best-scaled static, {refers_to}"].append(
                        (best.armse_m, 1e3 * best.rpe_t_m, best.anees)
                    )
                for label, (kind, supervision, kernel) in estimators.items():
                    model = trained(folder, kind, supervision, kernel)
                    metrics = run(test, model)
                    rows[label].append((metrics.armse_m, 1e3 * metrics.rpe_t_m, metrics.anees))
                    if seed < 3:
                        honesty[label].append(list(feature_honesty(test, model).values()))
                for label, metrics in (("law", run(test, Law(config))), ("oracle", oracle(test))):
                    rows[label].append((metrics.armse_m, 1e3 * metrics.rpe_t_m, metrics.anees))
        for label, values in rows.items():
            armse, step, anees = np.mean(values, axis=0)
            shares = " / ".join(
                f"{100 * share:.1f}" for share in np.mean(honesty.get(label, [[]]), axis=0)
            )
            print(
                f"| {law} | {label} | {armse:.4f} | {step:.2f} | {anees:.2f} | {shares} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
