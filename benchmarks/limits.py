"""Measure what limits accuracy on the real recordings, and how consistent covariances are.

    python benchmarks/limits.py

Prints drift with and without self-calibration, with frames left out, and with far features alone;
the end error of odometry 06 against its claim; and two steps of one frame against one of two. All
runs are without the IMU.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from recordings import available
from scipy.spatial.transform import Rotation

import probevo as pv
from probevo.arrays import FloatArray
from probevo.evaluation.consistency import drift_covariances, drift_errors
from probevo.evaluation.metrics import evaluate
from probevo.geometry import se3
from probevo.geometry.uncertainty import compound_pair
from probevo.output.run_result import RunRecorder, RunResult
from probevo.sequences import Sequence
from probevo.tracking import image_tracker
from probevo.tracking.tracker import Tracked

CONFIGS = {
    "with self-calibration": pv.OdometryConfig(estimator="two-frame"),
    "without": pv.OdometryConfig(estimator="two-frame", self_calibration=False),
}
FILLED_IN = 12
"""Frames at the start of odometry 06 whose true rotations were filled in (docs/accuracy.md)."""
FAR_PX = 12.0
"""Features of a smaller disparity are far."""


def run(
    sequence: Sequence,
    config: pv.OdometryConfig = CONFIGS["with self-calibration"],
    every: int = 1,
    slower: bool = False,
) -> tuple[RunResult, FloatArray]:
    """Run over every so many-th frame, without IMU; return the result and the true poses.

    The frames have the stamps of consecutive frames, as those of a car so many times as fast; with
    ``slower`` they keep their own.
    """
    odometry = pv.StereoOdometry(sequence.camera, config=config)
    recorder = RunRecorder()
    for k, frame in enumerate(list(sequence)[::every]):
        stamp_ns = frame.stamp_ns if slower else int(sequence.stamps_ns[k])
        recorder.add(stamp_ns, odometry.step(replace(frame, index=k, stamp_ns=stamp_ns, imu=None)))
    if odometry.rig:
        print(f"      b1, b2 = {np.round(odometry.rig.disparity, 2)} px", end=" ")
        print(f"a4 = {odometry.rig.rows[4]:.1f} px")
    return recorder.result(), sequence.truth.T_world_cam[::every]


def drift(T_world_cam: FloatArray, truth: FloatArray) -> str:
    """Return the drift over pieces of 10 to 50 m, both paths taken from their first pose."""
    metrics = evaluate(se3.inverse(T_world_cam[0]) @ T_world_cam, se3.inverse(truth[0]) @ truth)
    return f"{metrics.short_t_percent:6.3f} % {metrics.short_r_deg_per_m:8.4f} °/m"


def track_only_far_features() -> None:
    """Remove near features from the tracks of all odometries from here on."""
    complete = image_tracker.ImageTracker.with_new_features

    def far(self: image_tracker.ImageTracker, followed: image_tracker.Followed) -> Tracked:
        tracked = complete(self, followed)
        disparity_px = tracked.tracks.prev_px[:, 0] - tracked.tracks.prev_px[:, 2]
        return replace(tracked, tracks=tracked.tracks.subset(disparity_px < FAR_PX))

    image_tracker.ImageTracker.with_new_features = far


def two_steps_against_one(sequence: Sequence) -> float:
    """Return the median NEES of two steps of one frame against one of two.

    It is about 5.3, the median of χ²(6), if covariances are consistent and steps independent.
    """
    single, _ = run(sequence)
    double, _ = run(sequence, every=2)
    nees = []
    for k in range(min(len(double.status), len(single.status) // 2)):
        first = 2 * k
        second = first + 1
        T, cov = compound_pair(
            single.T_curr_prev[first],
            single.cov[first],
            single.T_curr_prev[second],
            single.cov[second],
        )
        error = se3.log(T @ se3.inverse(double.T_curr_prev[k]))
        nees.append(error @ np.linalg.solve(cov + double.cov[k], error))
    return float(np.median(nees))


def path_against_claim(result: RunResult, truth: FloatArray, first: int) -> str:
    """Compare the path from a frame on with the truth, and its end error with the claimed 3σ.

    The path is compared with its direction of travel fitted, too: the true attitude of the first
    frame and the mounting of the camera turn the whole path, and no odometry can know them.
    """
    cov = drift_covariances(
        result.T_curr_prev[first:],
        result.cov[first:],
        result.common_mode[first:],
        result.path_cross_cov[first:],
    )
    three_sigma = 3.0 * np.sqrt(np.diagonal(cov[-1]))
    estimated = se3.inverse(result.T_world_cam[first]) @ result.T_world_cam[first:]
    true = se3.inverse(truth[first]) @ truth[first:]
    end = drift_errors(estimated, true)[-1]
    positions = true[:, :3, 3]
    turn, _ = Rotation.align_vectors(positions, estimated[:, :3, 3])
    rms_m = np.sqrt(np.mean((turn.apply(estimated[:, :3, 3]) - positions) ** 2, axis=0))
    pitch, yaw, _ = np.rad2deg(turn.as_rotvec())
    return (
        f"off at the end by {np.round(end[:3], 3)} m, {np.round(np.rad2deg(end[3:]), 3)}°,"
        f" 3σ {np.round(three_sigma[:3], 3)} m, {np.round(np.rad2deg(three_sigma[3:]), 3)}°;"
        f" with the direction fitted ({pitch:.2f}°, {yaw:.2f}°) RMS {np.round(rms_m, 3)} m"
    )


def print_recording(name: str, sequence: Sequence) -> None:
    """Print what is measured on one recording."""
    for label, config in CONFIGS.items():
        result, truth = run(sequence, config)
        print(f"{name}, {label}: {drift(result.T_world_cam, truth)}")
        if name == "odometry 06":
            later = drift(result.T_world_cam[FILLED_IN:], truth[FILLED_IN:])
            print(f"  frames {FILLED_IN} on: {later}")
            for first in (0, FILLED_IN):
                print(f"  from frame {first} on, {path_against_claim(result, truth, first)}")
        result, truth = run(sequence, config, every=3)
        print(f"  every third frame: {drift(result.T_world_cam, truth)}")
    for every in (2, 3, 4, 5):
        result, truth = run(sequence, every=every, slower=True)
        unsolved = int((result.status[1:] != pv.Status.OK).sum())
        print(
            f"  one frame of {every}, at its own time: {drift(result.T_world_cam, truth)},"
            f" {unsolved} not solved"
        )
    print(f"  two steps against one, median NEES {two_steps_against_one(sequence):.1f}")


def main() -> None:
    """Print the measurements on each recording, and those with far features on the first."""
    recordings = available()
    for name, path in recordings.items():
        print_recording(name, pv.open_sequence(path))
    track_only_far_features()
    for label, config in CONFIGS.items():
        result, truth = run(pv.open_sequence(next(iter(recordings.values()))), config)
        print(f"disparities below {FAR_PX:g} px, {label}: {drift(result.T_world_cam, truth)}")


if __name__ == "__main__":
    main()
