"""Drive through frames that show nothing, or only what is far away: docs/window.md.

    python benchmarks/gaps.py [--seeds 10] [--presets mixed darkness blur]
        [--estimators two-frame window]

First, real recordings are spoiled as by ``probevo simulate spoil``, and compared with the clean run
of the same estimator. Prints, medians over the seeds: the error at the end, the claim for it (the
root of the summed variances), both for the attitude; then the mean of the end errors, NEES over 6
at the end, both runs' covariances added, the largest of these, and how the steps were solved.

Then, simulated points, all of which are 400 to 1,500 m away for some frames, or 5 to 50 km, while
the vehicle accelerates by one standard deviation of the motion model. Prints, over forty drives:
how these steps were solved; RMS error and claim of the position and of the attitude at the end;
NEES over 6 of these steps, and of the pose at the end.
"""

from __future__ import annotations

import argparse
from collections import Counter

import cv2
import numpy as np
from recordings import ROOT

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import MotionModelConfig
from probevo.estimation.motion_estimate import MotionEstimate
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.sequences import Sequence
from probevo.sequences.frame import Frame, StereoFeatures
from probevo_sim.spoiling.config import SpoilConfig
from probevo_sim.spoiling.recording import SpoiledRecording

RECORDINGS = {
    "06": ROOT / "kitti_odometry" / "sequences" / "06",
    "kitti_0039": ROOT / "kitti_0039" / "sequences" / "39",
}
SEVERITY = {"mixed": 0.5, "darkness": 1.0, "blur": 1.0}
CLEAN_START_FRAMES = 5

CAMERA = StereoCamera(
    fu_px=707.0, fv_px=709.0, cu_px=601.0, cv_px=183.0, baseline_m=0.537, size_px=(1226, 370)
)
AHEAD = np.array([0.02, 0.01, -1.2, 0.003, 0.01, -0.002])
"""Log(T_curr_prev) of a car at 12 m/s and ten frames a second."""
STEP_S = 0.1
FRAMES = 16
FIRST_FAR = 7
"""Index of the first frame without near points."""
NEAR_M = (5.0, 60.0)
FAR_M = ((400.0, 1500.0), (5000.0, 50_000.0))
NUM_NEAR = 100
NUM_FAR = 25
SIGMA_PX = 0.2
DRIVES = 40


def poses_of(sequence: Sequence, estimator: str) -> dict[int, MotionEstimate]:
    """Return the estimate of each frame, by its stamp."""
    odometry = pv.StereoOdometry(sequence.camera, config={"estimator": estimator})
    return {frame.stamp_ns: odometry.step(frame) for frame in sequence}


def report_spoiled(name: str, preset: str, estimator: str, seeds: int) -> None:
    """Print a line for a recording, spoiled in one way by so many seeds."""
    clean = poses_of(pv.open_sequence(RECORDINGS[name]), estimator)
    statuses: Counter[str] = Counter()
    rows = []
    for seed in range(seeds):
        config = SpoilConfig(
            preset=preset,
            seed=seed,
            severity=SEVERITY[preset],
            clean_start_frames=CLEAN_START_FRAMES,
        )
        spoiled = poses_of(
            SpoiledRecording.of(pv.open_sequence(RECORDINGS[name]), config), estimator
        )
        statuses.update(one.status.name for one in list(spoiled.values())[1:])
        last = max(spoiled)
        found = se3.inverse(spoiled[last].T_world_cam)
        expected = se3.inverse(clean[last].T_world_cam)
        error = se3.log(expected @ se3.inverse(found))
        cov = spoiled[last].cov_cam_world
        nees = normalized_error_squared(expected, found, cov + clean[last].cov_cam_world) / 6
        rows.append([*norms(error), *claims(cov), float(nees)])
    position, attitude, position_claim, attitude_claim, nees_6 = np.array(rows).T
    print(
        f"{name:10}  {preset:8}  {estimator:9}"
        f"  {np.median(position):.2f} ({np.median(position_claim):.2f}) m"
        f"  {np.median(attitude):.2f} ({np.median(attitude_claim):.2f})°"
        f"  mean {position.mean():.2f} m  NEES {np.median(nees_6):.2f}, {nees_6.max():.1f}"
        f"  {dict(statuses)}",
        flush=True,
    )


def norms(error: FloatArray) -> tuple[float, float]:
    """Return the lengths of a perturbation's translation, m, and rotation, °."""
    return float(np.linalg.norm(error[:3])), float(np.degrees(np.linalg.norm(error[3:])))


def claims(cov: FloatArray) -> tuple[float, float]:
    """Return the roots of the summed variances of translation, m, and rotation, °."""
    position = np.sqrt(np.trace(cov[:3, :3]))
    return float(position), float(np.degrees(np.sqrt(np.trace(cov[3:, 3:]))))


class Points:
    """Points that a camera follows until they leave its image; new ones take their place."""

    def __init__(self, count: int, depth_m: tuple[float, float], first_id: int) -> None:
        """Start without a point."""
        self.count = count
        self.depth_m = depth_m
        self.ids = np.zeros(0, np.int64)
        self.pixels = np.zeros((0, 4))
        self.next_id = first_id

    def move(self, T_curr_prev: FloatArray, rng: np.random.Generator) -> None:
        """Move the camera, and see the points again."""
        points_m = se3.transform(T_curr_prev, CAMERA.triangulate(self.pixels))
        ahead = points_m[:, 2] > 0.6 * self.depth_m[0]
        pixels = CAMERA.project(points_m[ahead])
        ids = self.ids[ahead]
        inside = np.all((pixels[:, :2] >= 0.0) & (pixels[:, :2] < CAMERA.size_px), axis=1)
        missing = self.count - int(inside.sum())
        self.pixels = np.vstack([pixels[inside], self._new(missing, rng)])
        self.ids = np.concatenate([ids[inside], self.next_id + np.arange(missing)])
        self.next_id += missing

    def _new(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Return points anywhere in the image, uniform in inverse depth, [count, 4], px."""
        rho = rng.uniform(1.0 / self.depth_m[1], 1.0 / self.depth_m[0], count)
        uv = rng.uniform(0.0, CAMERA.size_px, (count, 2))
        disparity_px = CAMERA.fu_px * CAMERA.baseline_m * rho
        return np.column_stack([uv, uv[:, 0] - disparity_px, uv[:, 1]])


def far_drive(
    num_far: int, far_m: tuple[float, float], rng: np.random.Generator
) -> tuple[list[Frame], FloatArray]:
    """Return a drive with so many frames that see far points only, and its motions, [K, 4, 4].

    From the first of these on, the vehicle accelerates. The near points behind them are new.
    """
    config = MotionModelConfig()
    sigma = np.repeat([config.acceleration_m_s2, config.angular_acceleration_rad_s2], 3)
    acceleration = rng.normal(size=6) * sigma * STEP_S**2
    steps = np.clip(np.arange(FRAMES) - FIRST_FAR + 1, 0, num_far)
    motions = se3.exp(AHEAD + steps[:, None] * acceleration)
    near = Points(NUM_NEAR, NEAR_M, first_id=10**6)
    far = Points(NUM_FAR, far_m, first_id=0)
    frames = []
    for index, motion in enumerate(motions):
        near.move(motion, rng)
        far.move(motion, rng)
        if index == FIRST_FAR:
            near = Points(NUM_NEAR, NEAR_M, first_id=2 * 10**6)
        is_far = FIRST_FAR <= index < FIRST_FAR + num_far
        if is_far:
            near.ids = near.ids[:0]
            near.pixels = near.pixels[:0]
        pixels = np.vstack([near.pixels, far.pixels])
        features = StereoFeatures(
            np.concatenate([near.ids, far.ids]), pixels + SIGMA_PX * rng.normal(size=pixels.shape)
        )
        frames.append(Frame(index, round(1e9 * STEP_S) * index, features=features))
    return frames, motions


def report_far(num_far: int, far_m: tuple[float, float], estimator: str) -> None:
    """Print a line for drives with so many frames that see far points only."""
    statuses: Counter[str] = Counter()
    rows = []
    nees_of_steps = []
    for seed in range(DRIVES):
        frames, motions = far_drive(num_far, far_m, np.random.default_rng(seed))
        odometry = pv.StereoOdometry(CAMERA, config={"estimator": estimator})
        T_world_cam = np.eye(4)
        for frame in frames:
            estimate = odometry.step(frame)
            motion = motions[frame.index]
            if frame.index:
                T_world_cam = T_world_cam @ se3.inverse(motion)
            if FIRST_FAR <= frame.index < FIRST_FAR + num_far:
                statuses[estimate.status.name] += 1
                nees = normalized_error_squared(motion, estimate.T_curr_prev, estimate.cov) / 6
                nees_of_steps.append(float(nees))
        expected = se3.inverse(T_world_cam)
        found = estimate.T_cam_world
        error = se3.log(expected @ estimate.T_world_cam)
        nees = normalized_error_squared(expected, found, estimate.cov_cam_world) / 6
        rows.append([*norms(error), *claims(estimate.cov_cam_world), float(nees)])
    position, attitude, position_claim, attitude_claim, nees_6 = np.array(rows).T
    rms = np.sqrt(np.mean(np.square([position, attitude]), axis=1))
    print(
        f"{num_far} frames, {far_m[0]:g} m or more  {estimator:9}"
        f"  {rms[0]:.2f} ({np.median(position_claim):.2f}) m"
        f"  {rms[1]:.3f} ({np.median(attitude_claim):.3f})°"
        f"  NEES: steps {np.mean(nees_of_steps):.2f}, end {nees_6.mean():.2f}  {dict(statuses)}",
        flush=True,
    )


def main() -> None:
    """Parse the command line, and print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--presets", nargs="*", choices=list(SEVERITY), default=list(SEVERITY))
    parser.add_argument("--estimators", nargs="*", default=["two-frame", "window"])
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    for preset in arguments.presets:
        for name in RECORDINGS:
            for estimator in arguments.estimators:
                report_spoiled(name, preset, estimator, arguments.seeds)
    for far_m in FAR_M:
        for num_far in (1, 3, 6):
            for estimator in arguments.estimators:
                report_far(num_far, far_m, estimator)


if __name__ == "__main__":
    main()
