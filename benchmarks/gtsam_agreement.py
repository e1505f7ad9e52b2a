"""How far GTSAM's motions are from probevo's on the same tracks and noise, and what each part does.

pip install '.[gtsam]'; python benchmarks/gtsam_agreement.py

About fifteen minutes. The first row of a table is examples/05_noise_for_gtsam.py; each further row
leaves out one part more of what it hands over, and the last takes GTSAM's own stereo factor.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import numpy as np
from recordings import available

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.track_factors import TrackFactors
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.noise import StereoNoise
from probevo.sequences import Sequence
from probevo.tracking import Tracks
from probevo_sim.point_config import PointConfig, PointNoise, PointOutliers
from probevo_sim.point_world import simulate_points

EXAMPLE = Path(__file__).parents[1] / "examples" / "05_noise_for_gtsam.py"
GTSAM_TOLERANCE = 1e-5
"""Default of GTSAM's Levenberg–Marquardt."""
MIN_DISPARITY_PX = 1.0
"""GTSAM's points have three finite coordinates."""
POINT_DOF = 5.0
POINT_SIGMA_PX = 0.2


def load_example() -> ModuleType:
    spec = importlib.util.spec_from_file_location("noise_for_gtsam", EXAMPLE)
    if spec is None or spec.loader is None:
        raise ImportError(f"{EXAMPLE} is missing")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Step:
    """What a step of probevo knew, and what it found."""

    tracks: Tracks
    noise: StereoNoise
    camera: StereoCamera
    disparities: DisparityFilter
    T_curr_prev: FloatArray
    cov: FloatArray
    """Without the uncertainty of the rig's calibration."""

    def factors(self) -> TrackFactors:
        return TrackFactors.of(self.tracks, self.noise, self.camera, self.disparities)

    def without_common_mode(self) -> TrackFactors:
        factors = self.factors()
        return replace(factors, common=np.zeros_like(factors.common))

    def without_history(self) -> TrackFactors:
        return TrackFactors.of(self.tracks, self.noise, self.camera)

    def without_time_correlated(self) -> TrackFactors:
        noise = replace(self.noise, time_correlated=None)
        return TrackFactors.of(self.tracks, noise, self.camera)

    def off(self, T_curr_prev: FloatArray) -> FloatArray:
        """Return how far another motion is from its own, [6], in its σ."""
        apart = se3.log(T_curr_prev @ se3.inverse(self.T_curr_prev))
        return np.asarray(apart / np.sqrt(np.diagonal(self.cov)))


def steps(sequence: Sequence, model: pv.noise.StudentT | pv.noise.Fixed) -> Iterator[Step]:
    odometry = pv.StereoOdometry(
        sequence.camera, model, sequence.imu, config={"estimator": "two-frame"}
    )
    for frame in sequence:
        before = odometry.state
        motion = odometry.step(frame)
        if motion.status is pv.Status.OK and before is not None:
            used = odometry.used
            noise = odometry.noise.predict(odometry.phi[used])
            yield Step(
                tracks=odometry.tracks.subset(used),
                noise=replace(
                    noise.scaled(before.noise_scale.factor),
                    jitter_cov=None if before.rig is None else before.rig.jitter.cov,
                ),
                camera=odometry.camera,
                disparities=before.disparities,
                T_curr_prev=motion.T_curr_prev,
                cov=motion.cov - motion.common_mode @ motion.common_mode.T,
            )


def merge_rows(pixels: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Merge v_l and v_r of observations [N, 4], px, of scale [N, 4, 4], px².

    Returns (u_l, u_r, v) [N, 3], their scale [N, 3, 3], and the squared Mahalanobis length [N] of
    what the two rows disagree in.
    """
    H = np.eye(3)[[0, 2, 1, 2]]
    weight = np.linalg.inv(scale)
    merged_scale = np.linalg.inv(H.T @ weight @ H)
    merged = (merged_scale @ H.T @ weight @ pixels[..., None])[..., 0]
    off = pixels - merged @ H.T
    return merged, merged_scale, np.einsum("ni,nij,nj->n", off, weight, off)


def solve_by_stereo_factors(step: Step) -> FloatArray:
    """Solve with GTSAM's GenericStereoFactor3D, a robust loss on each observation by itself."""
    import gtsam

    prev_px = step.tracks.prev_px
    curr_px = step.tracks.curr_px
    disparity = np.minimum(prev_px[:, 0] - prev_px[:, 2], curr_px[:, 0] - curr_px[:, 2])
    keep = np.flatnonzero(disparity > MIN_DISPARITY_PX)
    noise = step.noise.subset(keep)
    c = step.camera
    calibration = gtsam.Cal3_S2Stereo(c.fu_px, c.fv_px, 0.0, c.cu_px, c.cv_px, c.baseline_m)
    graph = gtsam.NonlinearFactorGraph()
    graph.addPriorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6))
    values = gtsam.Values()
    values.insert(0, gtsam.Pose3())
    values.insert(1, gtsam.Pose3(se3.inverse(step.T_curr_prev)))
    for pose, pixels in enumerate((prev_px[keep], curr_px[keep] - noise.bias)):
        merged, scale, off = merge_rows(pixels, noise.scale)
        view = gtsam.StereoCamera(values.atPose3(pose), calibration)
        for row, nu in enumerate(np.minimum(noise.dof, 1e9)):
            seen = gtsam.StereoPoint2(*merged[row])
            cauchy = gtsam.noiseModel.mEstimator.Cauchy(np.sqrt(nu + 4.0))
            cov = (nu + off[row]) / (nu + 4.0) * scale[row]
            gaussian = gtsam.noiseModel.Gaussian.Covariance(cov)
            student_t = gtsam.noiseModel.Robust.Create(cauchy, gaussian)
            point = 2 + row
            graph.add(gtsam.GenericStereoFactor3D(seen, student_t, pose, point, calibration))
            values.insert_or_assign(point, view.backproject(seen))
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(1e-9)
    best = gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
    return np.asarray(best.atPose3(1).inverse().matrix())


def print_row(name: str, off: FloatArray, above: FloatArray | None) -> None:
    rms = np.sqrt(np.mean(off**2, axis=0))
    line = f"{name:28} {np.sqrt(np.mean(off**2)):6.3f} {np.abs(off).max():6.2f}   "
    line += " ".join(f"{value:6.3f}" for value in rms)
    if above is not None:
        line += f"   {np.sqrt(np.mean((off - above) ** 2)):6.3f} {np.abs(off - above).max():6.2f}"
    print(line, flush=True)


def agreement(name: str, sequence: Sequence, model: pv.noise.StudentT | pv.noise.Fixed) -> None:
    example = load_example()
    rows: dict[str, list[FloatArray]] = {}
    ratios = []
    for step in steps(sequence, model):
        start = step.T_curr_prev
        T, cov = example.solve(step.factors(), np.eye(4))
        ratios.append(np.sqrt(np.diagonal(cov) / np.diagonal(step.cov)))
        motions = {
            "the example, from identity": T,
            "GTSAM's own tolerance": example.solve(step.factors(), start, GTSAM_TOLERANCE)[0],
            "no common mode": example.solve(step.without_common_mode(), start)[0],
            "and no history": example.solve(step.without_history(), start)[0],
            "and no time correlation": example.solve(step.without_time_correlated(), start)[0],
            "GenericStereoFactor3D": solve_by_stereo_factors(step),
        }
        for row, motion in motions.items():
            rows.setdefault(row, []).append(step.off(motion))
    print(f"\n{name}, {type(model).__name__}, {len(ratios)} steps: off probevo's motion, in its σ")
    print(f"{'':28} {'rms':>6} {'max':>6}   rms of x y z, about x y z{'':21}   off the row above")
    above = None
    for row, off in rows.items():
        print_row(row, np.array(off), above)
        above = np.array(off)
    print("σ of GTSAM over that of probevo, median:", np.median(ratios, axis=0).round(2))


def nees(outliers: float) -> None:
    """Print the mean NEES of both covariances in the point world, where the noise is known."""
    import gtsam

    example = load_example()
    variance = POINT_SIGMA_PX**2 * POINT_DOF / (POINT_DOF - 2.0)
    sigma = float(np.sqrt(variance))
    law = PointNoise(law="constant", sigma_low_px=sigma, sigma_high_px=sigma, dof=POINT_DOF)
    config = PointConfig(noise=law, outliers=PointOutliers(fraction=outliers))
    world = simulate_points(config, 12.0, np.random.default_rng(0))
    model = pv.noise.StudentT(POINT_DOF, POINT_SIGMA_PX**2 * np.eye(4))
    odometry = pv.StereoOdometry(world.camera, model, config={"estimator": "two-frame"})
    of_weights = []
    of_fisher = []
    own = []
    truth = [step.T_curr_prev for step in world.steps()]
    for frame in world.frames():
        before = odometry.state
        motion = odometry.step(frame)
        if motion.status is not pv.Status.OK:
            continue
        T_true = truth[frame.index - 1]
        robust, fisher, values = example.graphs(
            example.factors_of(odometry, before), motion.T_curr_prev
        )
        best = gtsam.LevenbergMarquardtOptimizer(robust, values).optimize()
        T = best.atPose3(example.CURR).inverse().matrix()
        for graph, found in ((robust, of_weights), (fisher, of_fisher)):
            cov = np.roll(gtsam.Marginals(graph, best).marginalCovariance(example.CURR), 3, (0, 1))
            found.append(normalized_error_squared(T_true, T, cov))
        own_cov = motion.cov - motion.common_mode @ motion.common_mode.T
        own.append(normalized_error_squared(T_true, motion.T_curr_prev, own_cov))
    print(f"point world, ν = {POINT_DOF:g}, {outliers:.0%} outliers, {len(own)} steps; mean NEES:")
    print(f"  Marginals of the robust graph     {np.mean(of_weights):5.2f}")
    print(f"  Marginals of the Fisher graph     {np.mean(of_fisher):5.2f}")
    print(f"  probevo                           {np.mean(own):5.2f}", flush=True)


def main() -> None:
    for outliers in (0.0, 0.1):
        nees(outliers)
    for name, path in available().items():
        for model in (pv.noise.StudentT(), pv.noise.Fixed()):
            agreement(name, pv.open_sequence(path), model)


if __name__ == "__main__":
    main()
