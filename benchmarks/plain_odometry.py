"""Compare probevo with an odometry of thirty lines, which remembers nothing, on real recordings.

    python benchmarks/plain_odometry.py

The plain odometry takes new FAST corners in each step, follows them around the circle of four
images by Lucas–Kanade with windows of 11×11, finds a consensus by PnP in RANSAC, and solves for the
motion with Student-t noise of u_l, v_l and u_r. It has no anchor patches, no gate on grey levels,
no self-calibration and no memory of disparities. Where it drifts less than probevo, one of these
does harm.

Prints drift and rotation over pieces of 10 to 50 m, the end error and the yaw error at the end; for
the plain odometry, for probevo, and for probevo with each of these taken away.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import cv2
import numpy as np
from opencv_odometry import strongest_corners
from recordings import ROOT

import probevo as pv
from probevo.arrays import BoolArray, FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.evaluation.metrics import evaluate
from probevo.geometry import se3
from probevo.noise import StudentT
from probevo.sequences import Sequence
from probevo.sequences.frame import Frame
from probevo.tracking import TrackingState, tracker_for

RECORDINGS = {
    "odometry 06 from frame 12": (
        ROOT / "kitti_odometry" / "sequences" / "06",
        12,
    ),
    "raw 0005": (
        ROOT / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0005_sync",
        0,
    ),
    "kitti_0039": (ROOT / "kitti_0039" / "sequences" / "39", 0),
    "MH_01_micro": (ROOT / "euroc" / "MH_01_micro", 0),
}
"""Path, and the first frame that counts: the truth of 06 is filled in before frame 12."""
WINDOW = {"winSize": (11, 11), "maxLevel": 4}
SIGMA_PX = 0.25
"""Scale of u_l, v_l and u_r."""
IGNORED_PX = 100.0
"""Scale of v_r, which is so left out: rows of the right image carry errors of rectification."""
DOF = 5.0
MAX_CIRCLE_ERROR_PX = 1.0
MAX_ROW_OFFSET_PX = 2.5


class PlainOdometry:
    """Motion of a stereo camera from frame to frame, from fresh corners in each step."""

    def __init__(self, camera: StereoCamera) -> None:
        """Start without a previous frame."""
        self.camera = camera
        self.matrix = np.array(
            [[camera.fu_px, 0, camera.cu_px], [0, camera.fv_px, camera.cv_px], [0, 0, 1.0]]
        )
        sigma_px = np.array([SIGMA_PX, SIGMA_PX, SIGMA_PX, IGNORED_PX])
        self.noise = StudentT(dof=DOF, scale=np.diag(sigma_px**2))
        self.previous: tuple[Image, Image] | None = None

    def step(self, frame: Frame) -> FloatArray:
        """Return T_curr_prev, [4, 4]; the identity for the first frame."""
        if frame.left is None or frame.right is None:
            raise ValueError("a frame without images")
        motion = np.eye(4)
        if self.previous is not None:
            prev_px, curr_px = self._circle(*self.previous, frame.left, frame.right)
            guess, inliers = self._consensus(prev_px, curr_px)
            estimate = pv.estimate_motion(
                prev_px[inliers], curr_px[inliers], self.noise, self.camera, guess=guess
            )
            motion = estimate.T_curr_prev
        self.previous = (frame.left, frame.right)
        return motion

    def _circle(
        self, left0: Image, right0: Image, left1: Image, right1: Image
    ) -> tuple[FloatArray, FloatArray]:
        """Return (u_l, v_l, u_r, v_r) in the previous frame, 0, and in the current one, 1."""
        start = strongest_corners(left0)
        in_right0, ok1 = _follow(left0, right0, start)
        in_right1, ok2 = _follow(right0, right1, in_right0)
        in_left1, ok3 = _follow(right1, left1, in_right1)
        back, ok4 = _follow(left1, left0, in_left1)
        good = ok1 & ok2 & ok3 & ok4
        good &= np.abs(back - start).max(axis=1) < MAX_CIRCLE_ERROR_PX
        for left, right in ((start, in_right0), (in_left1, in_right1)):
            good &= np.abs(left[:, 1] - right[:, 1]) < MAX_ROW_OFFSET_PX
            good &= left[:, 0] > right[:, 0]
        prev_px = np.hstack([start[good], in_right0[good]]).astype(np.float64)
        curr_px = np.hstack([in_left1[good], in_right1[good]]).astype(np.float64)
        return prev_px, curr_px

    def _consensus(self, prev_px: FloatArray, curr_px: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Return a motion, [4, 4], and which of the N matches agree on it, by PnP in RANSAC."""
        _, rotation, translation, indices = cv2.solvePnPRansac(
            self.camera.triangulate(prev_px),
            curr_px[:, :2].copy(),
            self.matrix,
            None,
            iterationsCount=200,
            reprojectionError=2.0,
            confidence=0.999,
        )
        guess = np.eye(4)
        guess[:3, :3] = cv2.Rodrigues(rotation)[0]
        guess[:3, 3] = translation[:, 0]
        inliers = np.zeros(len(prev_px), np.bool_)
        inliers[np.asarray(indices).ravel()] = True
        return guess, inliers


def _follow(a: Image, b: Image, points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Track points, [N, 2], px, from image a to b; return them and which were found, [N]."""
    found, status, _ = cv2.calcOpticalFlowPyrLK(a, b, points, None, **WINDOW)
    return found, status[:, 0] > 0


def plain(sequence: Sequence) -> Callable[[Frame], FloatArray]:
    """Return the step of the plain odometry."""
    return PlainOdometry(sequence.camera).step


def with_settings(
    *, fresh_corners: bool = False, **settings: object
) -> Callable[[Sequence], Callable[[Frame], FloatArray]]:
    """Return what makes the step of probevo with ``student-t``.

    Args:
        fresh_corners: forget all tracks after each step, and detect new corners instead.
        settings: of the odometry, where they differ from its defaults.
    """

    def odometry_of(sequence: Sequence) -> Callable[[Frame], FloatArray]:
        config = pv.OdometryConfig.model_validate({"estimator": "two-frame"} | settings)
        odometry = pv.StereoOdometry(sequence.camera, imu=sequence.imu, config=config)

        def step(frame: Frame) -> FloatArray:
            if fresh_corners:
                forget_tracks(odometry)
            return odometry.step(frame).T_curr_prev

        return step

    return odometry_of


def forget_tracks(odometry: pv.StereoOdometry) -> None:
    """Replace the features of the last frame by new corners, which have no past.

    No setting does this: it reaches into the state, for this experiment alone.
    """
    state = odometry.state
    if state is None:
        return
    tracker = tracker_for(state.frame, odometry.camera, odometry.config.tracking_of_estimator)
    nothing = TrackingState.none(state.tracking.next_id)
    fresh = tracker.track(nothing, state.frame, np.eye(4)).state
    odometry._state = replace(state, tracking=fresh)


NO_GATE: dict[str, object] = {"max_difference": 255.0}
SYSTEMS = {
    "plain": plain,
    "probevo": with_settings(),
    "no self-calibration": with_settings(self_calibration=False),
    "no gate": with_settings(tracking=NO_GATE),
    "new corners": with_settings(fresh_corners=True),
    "new corners, no gate": with_settings(fresh_corners=True, tracking=NO_GATE),
    "these, no high pass": with_settings(
        fresh_corners=True, tracking={**NO_GATE, "high_pass_px": 0}
    ),
    "these, no self-calibration": with_settings(
        fresh_corners=True, self_calibration=False, tracking={**NO_GATE, "high_pass_px": 0}
    ),
}


def path_of(step: Callable[[Frame], FloatArray], frames: Iterable[Frame]) -> FloatArray:
    """Return T_world_cam of all frames, [K, 4, 4]."""
    poses: list[FloatArray] = []
    for frame in frames:
        motion = step(frame)
        last = poses[-1] if poses else np.eye(4)
        poses.append(last @ se3.inverse(motion))
    return np.array(poses)


def yaw_error_deg(estimate: FloatArray, truth: FloatArray) -> float:
    """Return the error of the turn about the camera's vertical, first to last frame, degrees."""
    turned = np.linalg.inv(estimate[0]) @ estimate[-1]
    truly_turned = np.linalg.inv(truth[0]) @ truth[-1]
    error = truly_turned[:3, :3].T @ turned[:3, :3]
    return float(np.degrees(np.arctan2(error[0, 2], error[2, 2])))


def main() -> None:
    """Print a row for each recording and system."""
    cv2.setNumThreads(1)
    print(
        f"{'recording':26} {'odometry':27} {'short t, %':>10} {'short r, °/m':>13}"
        f" {'end error, m':>13} {'yaw, °':>7}"
    )
    for name, (path, first) in RECORDINGS.items():
        if not path.is_dir():
            print(f"{name:26} not there")
            continue
        sequence = pv.open_sequence(path)
        truth = sequence.truth.T_world_cam[first:]
        for system, odometry_of in SYSTEMS.items():
            # All frames are seen, so that what is learned on the way is there at the first.
            estimate = path_of(odometry_of(sequence), sequence)[first:]
            metrics = evaluate(estimate, truth)
            known = np.flatnonzero(np.isfinite(truth).all(axis=(1, 2)))
            drift = "    –" if metrics.short_t_percent is None else f"{metrics.short_t_percent:.3f}"
            rotation = (
                "    –" if metrics.short_r_deg_per_m is None else f"{metrics.short_r_deg_per_m:.4f}"
            )
            yaw_deg = yaw_error_deg(estimate[known], truth[known])
            print(
                f"{name:26} {system:27} {drift:>10} {rotation:>13}"
                f" {metrics.final_error_m:13.4f} {yaw_deg:7.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
