"""What an IMU adds to the window, what it costs where it is wrong, and black images.

    python benchmarks/window_imu.py [NAME…]    # all, or those whose names hold NAME

For each recording: the error at the end and on average, without and with the IMU. Black images, for
a while in the middle: the error that the blackout adds at its end, as a share of the way meanwhile,
the largest error in units of its σ, and σ of the motion over four frames before, at the end, and
ten frames after. Faults of the IMU: the errors at the end as multiples of those without it, whether
the IMU was left out, and what the odometry said.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from recordings import ROOT

import probevo as pv
from probevo.arrays import FloatArray
from probevo.estimation.window.inertial import Inertial
from probevo.geometry import se3, so3
from probevo.measurements.imu_reason import ImuFault
from probevo.sequences.base import Sequence
from probevo.sequences.frame import Frame, ImuSamples
from probevo.sequences.imu_calibration import ImuCalibration
from probevo_sim.scene.config import Effects, SceneConfig
from probevo_sim.scene.writer import write_scene

EFFECTS = Effects(noise=0.5, traffic=0.5, shadows=0.5, blur=0.3, rectification=0.5)
SCENES = {
    "city, clean": SceneConfig(preset="city", seed=21, distance_m=120.0),
    "residential, effects": SceneConfig(
        preset="residential", seed=22, distance_m=120.0, effects=EFFECTS
    ),
    "rover's loop, clean": SceneConfig(preset="rover", seed=23, distance_m=30.0),
}
"""Seeds of which no setting was chosen."""
SPAN = 4
"""Frames that a motion spans whose σ is shown."""
AFTER = 10
"""Frames after a blackout."""

Change = Callable[[list[Frame], ImuCalibration], tuple[list[Frame], ImuCalibration]]


@dataclass
class Run:
    """The path of a run, and what was said of the IMU."""

    T_world_cam: FloatArray
    """[K, 4, 4]."""
    sigma: FloatArray
    """Standard deviations of the left perturbation of T_cam_world, [K, 6]."""
    step_sigma_m: FloatArray
    """Of the motion over ``SPAN`` frames, [K]; NaN before there are so many."""
    num_ok: int
    uses_imu: bool
    said: list[str]
    """What was said of the IMU, each sentence once."""

    def errors(self, truth: FloatArray) -> FloatArray:
        """Return Log of the error of each T_cam_world, [K, 6]."""
        return np.asarray(se3.log(se3.inverse(self.T_world_cam) @ truth))


def run(
    sequence: Sequence,
    frames: list[Frame],
    imu: ImuCalibration | None,
    dark: range = range(0),
) -> Run:
    """Run the window over frames, some of them with black images."""
    odometry = pv.StereoOdometry(sequence.camera, "student-t", imu, config={"estimator": "window"})
    poses = []
    sigma = []
    step_sigma_m = []
    said: dict[str, None] = {}
    num_ok = 0
    for k, frame in enumerate(frames):
        if k in dark:
            black = np.zeros_like(frame.left)
            frame = replace(frame, left=black, right=black)
        estimate = odometry.step(frame if imu is not None else replace(frame, imu=None))
        num_ok += estimate.status is pv.Status.OK
        said |= dict.fromkeys(text for text in map(str, estimate.missing) if "IMU" in text)
        reason = estimate.imu_reason
        if reason is not None and reason.fault is not ImuFault.TESTING:
            said[f"the IMU {reason.text}"] = None
        poses.append(estimate.T_world_cam)
        sigma.append(np.sqrt(np.diag(estimate.cov_cam_world)))
        window = odometry.window
        step = np.nan
        if window is not None and len(window) > SPAN:
            _, cov = window.relative(len(window) - 1, len(window) - 1 - SPAN)
            step = float(np.sqrt(np.trace(cov[:3, :3])))
        step_sigma_m.append(step)
    return Run(
        T_world_cam=np.array(poses),
        sigma=np.array(sigma),
        step_sigma_m=np.array(step_sigma_m),
        num_ok=num_ok,
        uses_imu=Inertial.of(odometry.window).is_used,
        said=list(said),
    )


def sequences(folder: Path, wanted: list[str]) -> Iterator[tuple[str, Sequence]]:
    """Yield the recordings and rendered drives whose names hold one of the words wanted."""
    for name in ("MH_01_micro", "V1_01_micro"):
        path = ROOT / "euroc" / name
        if path.is_dir() and _is_wanted(name, wanted):
            yield name, pv.open_sequence(path)
    for number, (name, config) in enumerate(SCENES.items()):
        if _is_wanted(name, wanted):
            out = folder / str(number)
            write_scene(config, out, jobs=2)
            yield name, pv.open_sequence(out)


def _is_wanted(name: str, wanted: list[str]) -> bool:
    return not wanted or any(word in name for word in wanted)


def show_gain(name: str, without: Run, with_imu: Run, truth: FloatArray) -> None:
    """Print the errors without and with the IMU."""
    for label, each in (("images", without), ("and IMU", with_imu)):
        errors = each.errors(truth)
        position = np.linalg.norm(errors[:, :3], axis=1)
        turn = np.degrees(np.linalg.norm(errors[:, 3:], axis=1))
        print(
            f"{name:22} {label:8} end {position[-1]:8.4f} m {turn[-1]:6.3f}°, mean"
            f" {position.mean():8.4f} m {turn.mean():6.3f}°, {each.num_ok} OK",
            flush=True,
        )


def show_blackout(name: str, dark: range, each: Run, without: Run, truth: FloatArray) -> None:
    """Print what a blackout adds to the error, and what the images add there without one."""
    last = dark[-1]
    before = dark[0] - 1
    way_m = np.linalg.norm(np.diff(truth[before : last + 1, :3, 3], axis=0), axis=1).sum()
    error_m, images_m = (
        _added(path.T_world_cam, truth, before, last=last) for path in (each, without)
    )
    whole = np.abs(each.errors(truth)[last]) / each.sigma[last]
    sigma_m = each.step_sigma_m[[before, last, min(last + AFTER, len(truth) - 1)]]
    print(
        f"{name:22} {len(dark)} black frames: {error_m:.4f} m of {way_m:.2f} m,"
        f" {100.0 * error_m / way_m:.2f} %, images {images_m:.4f} m;"
        f" {whole[:3].max():.1f} σ, turn {whole[3:].max():.1f} σ;"
        f" σ over {SPAN} frames {sigma_m.round(4)} m; end"
        f" {np.linalg.norm(each.errors(truth)[-1, :3]):.4f} m",
        flush=True,
    )


def _added(T_world_cam: FloatArray, truth: FloatArray, before: int, last: int) -> float:
    """Return the error of the way from one frame to another, m."""
    seen = se3.inverse(T_world_cam[last]) @ T_world_cam[before]
    true_motion = se3.inverse(truth[last]) @ truth[before]
    return float(np.linalg.norm((seen @ se3.inverse(true_motion))[:3, 3]))


def main() -> None:
    """Print all tables."""
    cv2.setNumThreads(1)
    with tempfile.TemporaryDirectory() as folder:
        for name, sequence in sequences(Path(folder), sys.argv[1:]):
            truth = sequence.truth.T_world_cam
            truth = se3.inverse(truth[0]) @ truth
            frames = list(sequence)
            imu = sequence.imu
            without = run(sequence, frames, None)
            show_gain(name, without, run(sequence, frames, imu), truth)
            rate_hz = 1e9 / np.median(np.diff([frame.stamp_ns for frame in frames]))
            for seconds in (0.5, 2.0, 5.0):
                count = round(seconds * rate_hz)
                first = min(3 * len(frames) // 5, len(frames) - count - AFTER - 1)
                if first < 15:
                    continue
                dark = range(first, first + count)
                each = run(sequence, frames, imu, dark)
                show_blackout(name, dark, each, without=without, truth=truth)
            for fault, change in FAULTS.items():
                wrong_frames, wrong_imu = change(frames, imu)
                each = run(sequence, wrong_frames, wrong_imu)
                show_fault(f"{name}: {fault}", each, without, truth)


def show_fault(name: str, each: Run, without: Run, truth: FloatArray) -> None:
    """Print the errors with a fault as multiples of those without an IMU."""
    errors = np.abs(each.errors(truth))
    without_errors = np.abs(without.errors(truth))
    ratios = [
        np.linalg.norm(errors[-1, part]) / np.linalg.norm(without_errors[-1, part])
        for part in (slice(0, 3), slice(3, 6))
    ]
    mean = np.linalg.norm(errors[:, :3], axis=1).mean()
    mean /= np.linalg.norm(without_errors[:, :3], axis=1).mean()
    print(
        f"{name:44} end × {ratios[0]:.2f}, turn × {ratios[1]:.2f}, mean × {mean:.2f};"
        f" {'used' if each.uses_imu else 'left out'}; {each.said[-1:]}",
        flush=True,
    )


def mounted_off(frames: list[Frame], imu: ImuCalibration) -> tuple[list[Frame], ImuCalibration]:
    """Turn the mounting by 10° about an axis between all three."""
    T = imu.T_cam_imu.copy()
    T[:3, :3] = so3.exp(np.radians(10.0) * np.array([0.6, 0.48, 0.64])) @ T[:3, :3]
    return frames, replace(imu, T_cam_imu=T)


def preintegrate_samples(change: Callable[[ImuSamples], ImuSamples]) -> Change:
    """Return a fault of all samples of the recording, which are cut into frames again."""

    def changed(frames: list[Frame], imu: ImuCalibration) -> tuple[list[Frame], ImuCalibration]:
        whole = [frame.imu for frame in frames if frame.imu is not None]
        joined = whole[0]
        for each in whole[1:]:
            joined = joined.followed_by(each)
        joined = change(joined)
        found = frames[:1]
        for prev, frame in pairwise(frames):
            first = np.searchsorted(joined.stamps_ns, prev.stamp_ns, side="right") - 1
            last = np.searchsorted(joined.stamps_ns, frame.stamp_ns, side="left")
            rows = slice(max(int(first), 0), int(last) + 1)
            samples = ImuSamples(
                joined.stamps_ns[rows], joined.gyro_rad_s[rows], joined.accel_m_s2[rows]
            )
            found.append(replace(frame, imu=samples))
        return found, imu

    return changed


def late(samples: ImuSamples) -> ImuSamples:
    """Shift the stamps by 50 ms."""
    return replace(samples, stamps_ns=samples.stamps_ns + 50_000_000)


def in_degrees(samples: ImuSamples) -> ImuSamples:
    """Give rates in °/s."""
    return replace(samples, gyro_rad_s=np.degrees(samples.gyro_rad_s))


def spike_of(size_rad_s: float) -> Callable[[ImuSamples], ImuSamples]:
    """Return a spike in the sample in the middle."""

    def spiked(samples: ImuSamples) -> ImuSamples:
        rates = samples.gyro_rad_s.copy()
        rates[len(rates) // 2] += size_rad_s * np.array([0.6, 0.48, 0.64])
        return replace(samples, gyro_rad_s=rates)

    return spiked


def every_97th(value: float) -> Callable[[ImuSamples], ImuSamples]:
    """Return samples of which every 97th is no number, or an impossible one."""

    def damaged(samples: ImuSamples) -> ImuSamples:
        rates = samples.gyro_rad_s.copy()
        rates[50::97] = value
        forces = samples.accel_m_s2.copy()
        forces[80::97] = value
        return replace(samples, gyro_rad_s=rates, accel_m_s2=forces)

    return damaged


FAULTS: dict[str, Change] = {
    "mounting off by 10°": mounted_off,
    "stamps off by 50 ms": preintegrate_samples(late),
    "gyro in °/s": preintegrate_samples(in_degrees),
    "spike of 1 rad/s": preintegrate_samples(spike_of(1.0)),
    "spike of 5 rad/s": preintegrate_samples(spike_of(5.0)),
    "spike of 1,000 rad/s": preintegrate_samples(spike_of(1000.0)),
    "NaN": preintegrate_samples(every_97th(np.nan)),
    "1e308": preintegrate_samples(every_97th(1e308)),
}


if __name__ == "__main__":
    main()
