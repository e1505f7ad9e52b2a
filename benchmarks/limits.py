"""What the figures of docs/accuracy.md hang on: self-calibration, far features, speed, the truth;
and are we honest?

python benchmarks/limits.py
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
from probevo.geometry.uncertainty import compound
from probevo.output.run_result import RunRecorder, RunResult
from probevo.sequences import Sequence
from probevo.tracking import Tracks, image_tracker

OFF = pv.OdometryConfig(self_calibration=False)


def run(
    sequence: Sequence,
    config: pv.OdometryConfig | None = None,
    every: int = 1,
    slower: bool = False,
) -> tuple[RunResult, FloatArray]:
    """A run over every so many-th frame, without IMU, and the true poses of the frames.

    They come at the recording's own rate, as of a car so many times as fast, or, if slower, at
    their own times.
    """
    odometry = pv.StereoOdometry(sequence.camera, config=config)
    recorder = RunRecorder()
    for k, frame in enumerate(list(sequence)[::every]):
        stamp_ns = frame.stamp_ns if slower else int(sequence.stamps_ns[k])
        recorder.add(stamp_ns, odometry.step(replace(frame, index=k, stamp_ns=stamp_ns, imu=None)))
    if odometry.calibration:
        print(f"      b1, b2 = {np.round(odometry.calibration.disparity, 2)} px", end=" ")
        print(f"a4 = {odometry.calibration.rows[4]:.1f} px")
    return recorder.result(), sequence.truth.T_world_cam[::every]


def drift(T_world_cam: FloatArray, truth: FloatArray) -> str:
    metrics = evaluate(se3.inverse(T_world_cam[0]) @ T_world_cam, se3.inverse(truth[0]) @ truth)
    return f"{metrics.short_t_percent:6.3f} % {metrics.short_r_deg_per_m:8.4f} °/m"


def only_far(limit_px: float) -> None:
    """Keep nearer points out of the tracks from here on."""
    track = image_tracker.ImageTracker.track

    def far(self: image_tracker.ImageTracker, frame: pv.Frame, expected: FloatArray) -> Tracks:
        tracks = track(self, frame, expected)
        return tracks.kept(tracks.prev_px[:, 0] - tracks.prev_px[:, 2] < limit_px)

    image_tracker.ImageTracker.track = far


def two_steps_against_one(sequence: Sequence) -> float:
    """Median NEES of the difference of two steps of one frame and one of two: about 6 if the
    covariances are honest."""
    single = run(sequence)[0]
    double = run(sequence, every=2)[0]
    nees = []
    for k in range(min(len(double.status), len(single.status) // 2)):
        steps = slice(2 * k, 2 * k + 2)
        T, cov = compound(
            *(
                x
                for pair in zip(single.T_curr_prev[steps], single.cov[steps], strict=True)
                for x in pair
            )
        )
        error = se3.log(T @ se3.inverse(double.T_curr_prev[k]))
        nees.append(error @ np.linalg.solve(cov + double.cov[k], error))
    return float(np.median(nees))


def path_against_claim(result: RunResult, truth: FloatArray, first: int) -> str:
    """The path from a frame on against the truth, and against its own claim, along the camera's
    axes.

    Also with the direction of travel fitted: the true attitude of the first frame, and how the
    camera was said to be
    mounted, turn the whole path, of which no odometry can know.
    """
    steps = (
        x[first:]
        for x in (result.T_curr_prev, result.cov, result.common_mode, result.path_cross_cov)
    )
    three_sigma = 3.0 * np.sqrt(np.diagonal(drift_covariances(*steps)[-1]))
    estimated, true = (se3.inverse(T[first]) @ T[first:] for T in (result.T_world_cam, truth))
    end = drift_errors(estimated, true)[-1]
    positions = true[:, :3, 3]
    turn, _ = Rotation.align_vectors(positions, estimated[:, :3, 3])
    off = np.sqrt(np.mean((turn.apply(estimated[:, :3, 3]) - positions) ** 2, axis=0))
    pitch, yaw, _ = np.rad2deg(turn.as_rotvec())
    return (
        f"off at the end by {np.round(end[:3], 3)} m, {np.round(np.rad2deg(end[3:]), 3)}°,"
        f" 3σ {np.round(three_sigma[:3], 3)} m, {np.round(np.rad2deg(three_sigma[3:]), 3)}°;"
        f" with the direction fitted ({pitch:.2f}°, {yaw:.2f}°) RMS {np.round(off, 3)} m"
    )


def main() -> None:
    for name, path in available().items():
        sequence = pv.open_sequence(path)
        for label, config in (("with self-calibration", None), ("without", OFF)):
            result, truth = run(sequence, config)
            print(f"{name}, {label}: {drift(result.T_world_cam, truth)}")
            if name == "odometry 06":
                print(f"  frames 12 on: {drift(result.T_world_cam[12:], truth[12:])}")
                for first in (0, 12):
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
    only_far(12.0)
    for label, config in (("with self-calibration", None), ("without", OFF)):
        sequence = pv.open_sequence(next(iter(available().values())))
        result, truth = run(sequence, config)
        print(f"disparities below 12 px, {label}: {drift(result.T_world_cam, truth)}")


if __name__ == "__main__":
    main()
