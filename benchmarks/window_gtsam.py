"""Compare a window as long as the drive with batch adjustment by GTSAM, on 30 simulated frames.

    python benchmarks/window_gtsam.py

Prints the largest difference of a pose, and of its covariance in units of the standard deviations.
Noise is Gaussian; both v of an observation have the same, so that GTSAM's one v is their mean.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.estimation.window.estimator import WindowEstimator
from probevo.estimation.window.window import Window
from probevo.geometry import se3
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.variables import pose_of
from probevo.noise import StudentT
from probevo.tracking.tracks import Tracks

CAMERA = StereoCamera.centered(707.0, 0.537, (1226, 370))
NUM_FRAMES = 30
NUM_POINTS = 2000
SIGMA_PX = 0.3
STEP = se3.exp(np.array([0.02, 0.01, -0.8, 0.003, 0.01, -0.002]))
ADJUSTMENTS = 10
"""How often the whole window is adjusted, so that it has converged to rounding."""


def drive(rng: np.random.Generator) -> list[dict[int, np.ndarray]]:
    """Return the observations (u_l, v_l, u_r, v_r), px, of each frame, by landmark."""
    points = rng.uniform([-20.0, -3.0, 2.0], [20.0, 2.0, 60.0], (NUM_POINTS, 3))
    T_cam_world = np.eye(4)
    frames = []
    for _ in range(NUM_FRAMES):
        in_camera = se3.transform(T_cam_world, points)
        pixels = CAMERA.project(in_camera)
        seen = (in_camera[:, 2] > 3.0) & (in_camera[:, 2] < 40.0)
        seen &= np.all((pixels[:, :2] > 0.0) & (pixels[:, :2] < [1226.0, 370.0]), axis=1)
        noisy = pixels + SIGMA_PX * rng.normal(size=pixels.shape)
        frames.append({int(row): noisy[row] for row in np.flatnonzero(seen)})
        T_cam_world = STEP @ T_cam_world
    # Landmarks that both solve for: seen in a row of frames, twice at least.
    return frames


def by_window(frames: list[dict[int, np.ndarray]]) -> Window:
    """Return the adjusted window of all frames."""
    config = OdometryConfig.model_validate(
        {"self_calibration": False, "window": {"frames": NUM_FRAMES, "correlation": 0.0}}
    )
    estimator = WindowEstimator(CAMERA, config)
    model = StudentT(dof=np.inf, scale=SIGMA_PX**2 * np.eye(4))
    window = Window.at_first_frame(0)
    for index in range(1, len(frames)):
        prev = frames[index - 1]
        curr = frames[index]
        ids = np.array(sorted(prev.keys() & curr.keys()))
        tracks = Tracks(
            prev_px=np.array([prev[i] for i in ids]),
            curr_px=np.array([curr[i] for i in ids]),
            ids=ids,
            age=np.full(len(ids), 2),
        )
        noise = model.predict(np.zeros((len(ids), 0)))
        two_frames = RelativePose(STEP, 0.01 * np.eye(6), pose_of(index), pose_of(index - 1))
        window = estimator.add_observed_frame(window, tracks, noise, motion=two_frames)
    for _ in range(ADJUSTMENTS):
        window = estimator.adjustment.adjusted(window)
    return window


def by_gtsam(window: Window) -> tuple[np.ndarray, np.ndarray]:
    """Return poses T_cam_world, [K, 4, 4], and covariances of their left perturbations, [K, 6, 6],
    from the same observations."""
    import gtsam
    from gtsam.symbol_shorthand import L, X

    calibration = gtsam.Cal3_S2Stereo(
        CAMERA.fu_px, CAMERA.fv_px, 0.0, CAMERA.cu_px, CAMERA.cv_px, CAMERA.baseline_m
    )
    noise = gtsam.noiseModel.Diagonal.Sigmas(SIGMA_PX * np.array([1.0, 1.0, np.sqrt(0.5)]))
    graph: Any = gtsam.NonlinearFactorGraph()
    initial: Any = gtsam.Values()
    for slot, T_cam_world in enumerate(window.T_cam_world):
        initial.insert(X(slot), gtsam.Pose3(se3.inverse(T_cam_world)))
    graph.add(gtsam.NonlinearEqualityPose3(X(0), gtsam.Pose3(np.eye(4))))
    observations = window.observations
    for row, start in enumerate(observations.start[:-1]):
        u_l, v_l, u_r, v_r = observations.pixels[start]
        anchor = window.T_cam_world[observations.slot[start]]
        point = CAMERA.triangulate(np.array([u_l, v_l, u_r, v_r]))
        initial.insert(L(row), se3.transform(se3.inverse(anchor), point[None])[0])
    for row, slot, pixels in zip(
        window.landmark_rows, observations.slot, observations.pixels, strict=True
    ):
        measured = gtsam.StereoPoint2(pixels[0], pixels[2], 0.5 * (pixels[1] + pixels[3]))
        graph.add(
            gtsam.GenericStereoFactor3D(measured, noise, X(int(slot)), L(int(row)), calibration)
        )
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-15)
    parameters.setAbsoluteErrorTol(1e-15)
    result = gtsam.LevenbergMarquardtOptimizer(graph, initial, parameters).optimize()
    marginals = gtsam.Marginals(graph, result)
    # ξ of T_cam_world from the left is −ξ of T_world_cam from the right; GTSAM's angles come first.
    order = [3, 4, 5, 0, 1, 2]
    poses = []
    covs = []
    for slot in range(len(window)):
        poses.append(se3.inverse(result.atPose3(X(slot)).matrix()))
        covs.append(marginals.marginalCovariance(X(slot))[np.ix_(order, order)])
    return np.array(poses), np.array(covs)


def main() -> None:
    """Print the differences."""
    window = by_window(drive(np.random.default_rng(0)))
    poses, covs = by_gtsam(window)
    difference = np.abs(se3.log(poses @ se3.inverse(window.T_cam_world)))
    ratios = []
    for slot in range(1, len(window)):
        at = window.pose_slice(slot)
        sigma = np.sqrt(np.diag(covs[slot]))
        ratios.append(np.abs(window.cov[at, at] - covs[slot]) / np.outer(sigma, sigma))
    print(f"{len(window)} frames, {len(window.ids)} landmarks")
    print(f"poses differ by {difference[:, :3].max():.1e} m, {difference[:, 3:].max():.1e} rad")
    print(f"covariances differ by {np.max(ratios):.1e} of their standard deviations")


if __name__ == "__main__":
    main()
