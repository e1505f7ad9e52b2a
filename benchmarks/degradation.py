"""Degrade a recording, and hold the odometry's error against what it claims: docs/degradation.md.

    python benchmarks/degradation.py [--frames 120] [--of street kitti_0039]

A rendered street, whose truth is exact, and a real recording. One thing is spoiled at a time: blur,
darkness, noise, lost and frozen frames, exposure that flickers, occlusion, and a calibration that
is wrong. Prints for each: steps that are OK; RMS error of all steps, and the RMS of the σ that
they claim; the mean NEES of the steps that are OK (6 is consistent); the end error, and the σ that
the path claims for it; what warns.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from recordings import ROOT

import probevo as pv
from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.evaluation.consistency import motion_consistency
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.geometry import se3
from probevo.output.report.report_data import drift_of
from probevo.output.run_result import RunRecorder, RunResult
from probevo.output.run_warnings import run_warnings
from probevo.sequences.frame import Frame
from probevo_sim.scene.config import SceneConfig
from probevo_sim.scene.recording import open_scene

FRAMES = 120
DISTANCE_M = 120.0
BLACK = 2
"""Grey level of a black frame, and of what covers a lens."""


@dataclass(frozen=True)
class World:
    """A recording in memory."""

    name: str
    camera: StereoCamera
    frames: list[Frame]
    T_world_cam: FloatArray
    """True poses of the frames, [N, 4, 4], m."""


Spoil = Callable[[list[Frame], np.random.Generator], list[Frame]]
"""Returns other frames, perhaps fewer; indices are those of the recording."""


def each(change: Callable[[Image, int, np.random.Generator], Image]) -> Spoil:
    """Change both images of each frame; called with the image and the number of its side."""

    def spoil(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
        return [
            replace(
                frame,
                left=np.ascontiguousarray(change(frame.left, 0, rng)),
                right=np.ascontiguousarray(change(frame.right, 1, rng)),
            )
            for frame in frames
        ]

    return spoil


def blur(sigma_px: float) -> Spoil:
    return each(lambda image, side, rng: cv2.GaussianBlur(image, (0, 0), sigma_px))


def dark(gain: float) -> Spoil:
    """Less light: shot noise of 100 electrons a grey level, read noise of one level, rounding."""

    def change(image: Image, side: int, rng: np.random.Generator) -> Image:
        signal = gain * image.astype(float)
        noisy = signal + np.sqrt(signal / 100.0 + 1.0) * rng.normal(size=image.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    return each(change)


def noise(sigma: float) -> Spoil:
    def change(image: Image, side: int, rng: np.random.Generator) -> Image:
        noisy = image + sigma * rng.normal(size=image.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    return each(change)


def occluded(share: float) -> Spoil:
    """Cover the left part of the left image, as by dirt on one lens."""

    def change(image: Image, side: int, rng: np.random.Generator) -> Image:
        covered = image.copy()
        if side == 0:
            covered[:, : round(share * image.shape[1])] = BLACK
        return covered

    return each(change)


def rolled(angle_deg: float) -> Spoil:
    """Turn the right image about its middle: a pair that is not rectified."""

    def change(image: Image, side: int, rng: np.random.Generator) -> Image:
        height, width = image.shape
        turn = cv2.getRotationMatrix2D((width / 2, height / 2), angle_deg if side else 0.0, 1.0)
        return cv2.warpAffine(image, turn, (width, height), borderMode=cv2.BORDER_REPLICATE)

    return each(change)


def lost(share: float) -> Spoil:
    """Lose frames at random, never the first nor the last."""

    def spoil(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
        kept = rng.random(len(frames)) >= share
        kept[[0, -1]] = True
        return [frame for frame, is_kept in zip(frames, kept, strict=True) if is_kept]

    return spoil


def every(step: int) -> Spoil:
    return lambda frames, rng: frames[::step]


def at_random(share: float, change: Callable[[Frame, Frame], Frame]) -> Spoil:
    """Change single frames; called with the frame and the last one that was shown."""

    def spoil(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
        shown = frames[:1]
        for frame in frames[1:]:
            shown.append(change(frame, shown[-1]) if rng.random() < share else frame)
        return shown

    return spoil


def black(frame: Frame, last: Frame) -> Frame:
    del last
    return replace(
        frame, left=np.full_like(frame.left, BLACK), right=np.full_like(frame.right, BLACK)
    )


def frozen(frame: Frame, last: Frame) -> Frame:
    """The images of a driver that hangs: those of the last frame again."""
    return replace(frame, left=last.left.copy(), right=last.right.copy())


def flickering(spread: float) -> Spoil:
    """Another exposure in each frame, the same on both sides."""

    def spoil(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
        changed = []
        for frame in frames:
            gain = float(np.exp(spread * rng.normal()))
            left, right = (
                np.clip(gain * image.astype(float), 0, 255).astype(np.uint8)
                for image in (frame.left, frame.right)
            )
            changed.append(replace(frame, left=left, right=right))
        return changed

    return spoil


def nothing(frames: list[Frame], rng: np.random.Generator) -> list[Frame]:
    del rng
    return frames


def same(camera: StereoCamera) -> StereoCamera:
    return camera


SPOILED: dict[str, tuple[Spoil, Callable[[StereoCamera], StereoCamera]]] = {
    "nothing": (nothing, same),
    "blur, σ 1 px": (blur(1.0), same),
    "blur, σ 2 px": (blur(2.0), same),
    "blur, σ 4 px": (blur(4.0), same),
    "a quarter of the light": (dark(0.25), same),
    "a tenth of the light": (dark(0.1), same),
    "a thirtieth of the light": (dark(1 / 30), same),
    "noise, σ 10 grey levels": (noise(10.0), same),
    "noise, σ 30 grey levels": (noise(30.0), same),
    "exposure ± 30 % a frame": (flickering(0.3), same),
    "every third frame": (every(3), same),
    "every fifth frame": (every(5), same),
    "10 % of the frames lost": (lost(0.1), same),
    "40 % of the frames lost": (lost(0.4), same),
    "10 % of the frames frozen": (at_random(0.1, frozen), same),
    "10 % of the frames black": (at_random(0.1, black), same),
    "30 % of one lens covered": (occluded(0.3), same),
    "60 % of one lens covered": (occluded(0.6), same),
    "right image rolled by 0.1°": (rolled(0.1), same),
    "right image rolled by 0.5°": (rolled(0.5), same),
    "focal length 1 % too long": (
        nothing,
        lambda camera: replace(camera, fu_px=1.01 * camera.fu_px, fv_px=1.01 * camera.fv_px),
    ),
    "baseline 5 % too long": (
        nothing,
        lambda camera: replace(camera, baseline_m=1.05 * camera.baseline_m),
    ),
}


def worlds(names: list[str], count: int) -> Iterator[World]:
    """Load each world into memory."""
    if "street" in names:
        config = SceneConfig(preset="city", seed=0, distance_m=DISTANCE_M)
        scene = open_scene(config)
        frames = [frame for frame, _ in zip(scene, range(count), strict=False)]
        truth = scene.truth.T_world_cam[: len(frames)]
        yield World("street", scene.camera, frames, truth)
    for name in names:
        if name != "street":
            (path,) = (ROOT / name / "sequences").iterdir()
            sequence = pv.open_sequence(path)
            frames = [frame for frame, _ in zip(sequence, range(count), strict=False)]
            yield World(name, sequence.camera, frames, sequence.truth.T_world_cam[: len(frames)])


def run(world: World, name: str) -> tuple[RunResult, FloatArray]:
    """Run the shipped defaults without any IMU on the spoiled recording; return the truth, too."""
    spoil, wrong = SPOILED[name]
    kept = spoil(world.frames, np.random.default_rng(0))
    truth = world.T_world_cam[[frame.index for frame in kept]]
    odometry = pv.StereoOdometry(wrong(world.camera))
    recorder = RunRecorder()
    for number, frame in enumerate(kept):
        motion = odometry.step(replace(frame, index=number, imu=None))
        recorder.add(frame.stamp_ns, motion, rejected=odometry.tracks.rejected)
    row_errors = odometry.rig.row_errors(odometry.camera)
    return replace(recorder.result(), row_errors=row_errors), truth


def row(world: World, name: str) -> list[str]:
    """Return the cells of a line of the table."""
    result, truth = run(world, name)
    true = relative_motions(truth)
    error = se3.log(true @ se3.inverse(result.T_curr_prev))[:, :3]
    claimed = np.trace(result.cov[:, :3, :3], axis1=1, axis2=2)
    is_ok = result.status == pv.Status.OK
    consistency = None
    if is_ok.any():
        consistency = motion_consistency(result.T_curr_prev[is_ok], result.cov[is_ok], true[is_ok])
    drift = drift_of(result, truth)
    end_m = float(np.linalg.norm((drift.T_world_cam - drift.T_world_cam_true)[-1, :3, 3]))
    warnings = [heading.lower() for heading in run_warnings(result, truth)]
    return [
        name,
        f"{100.0 * is_ok.mean():.0f}",
        f"{1e3 * np.sqrt(np.mean(np.sum(error**2, axis=1))):.1f}",
        f"{1e3 * np.sqrt(np.mean(claimed)):.1f}",
        "–" if consistency is None else f"{consistency.anees:.0f}",
        f"{end_m:.2f}",
        f"{drift.position_sigma_m[-1]:.2f}",
        ", ".join(warnings) or "–",
    ]


def main() -> None:
    """Parse the command line, and print a table for each world."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=FRAMES, help="at most, of each recording")
    parser.add_argument("--of", nargs="+", default=["street", "kitti_0039"])
    given = parser.parse_args()
    cv2.setNumThreads(1)
    for world in worlds(given.of, given.frames):
        length_m = float(np.linalg.norm(np.diff(world.T_world_cam[:, :3, 3], axis=0), axis=1).sum())
        print(f"\n{world.name}, {len(world.frames)} frames, {length_m:.0f} m\n")
        head = ["spoiled", "OK, %", "step, mm", "its σ, mm", "ANEES", "end, m", "its σ, m", "warns"]
        print("| " + " | ".join(head) + " |")
        print("|" + "---|" * len(head))
        for name in SPOILED:
            print("| " + " | ".join(row(world, name)) + " |", flush=True)


if __name__ == "__main__":
    main()
