"""A recording seen through bursts of blur, darkness, occluders, and what else spoils images."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.output.recording_folder import write_recording_folder
from probevo.sequences import Frame, Sequence
from probevo.sequences.frame import GroundTruth, ImuSamples
from probevo.sequences.recording import ImageRecording
from probevo.storage.files import write_atomically
from probevo_sim.spoiling import effects
from probevo_sim.spoiling.config import SpoilConfig
from probevo_sim.spoiling.plan import (
    BEST_JPEG,
    DARKEST,
    FULL_EXPOSURE,
    FULL_NOISE_GREY,
    FULL_SHAKE_PX,
    WORST_JPEG,
    FramePlan,
    plan_frames,
)

RECORD = "spoiled.json"
"""File beside the images that says what was done to each frame."""
MIN_FRAMES = 2
_BURST_KEY = 2
_FRAME_KEY = 3


@dataclass(frozen=True)
class _Pair:
    """Left and right image, and their masks."""

    left: Image
    right: Image
    left_mask: Image | BoolArray | None = None
    right_mask: Image | BoolArray | None = None

    def each(self, change: Callable[[Image, int], Image]) -> _Pair:
        """Change both images; ``change`` takes one and its side, 0 for the left."""
        return replace(self, left=change(self.left, 0), right=change(self.right, 1))

    def distorted(self, source_px: FloatArray) -> _Pair:
        """Return the images, and their masks, whose pixels come from these places, [2, height,
        width], px."""
        masks = [
            None if mask is None else effects.distorted_mask(mask, source_px)
            for mask in (self.left_mask, self.right_mask)
        ]
        images = self.each(lambda image, _: effects.distorted(image, source_px))
        return replace(images, left_mask=masks[0], right_mask=masks[1])


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class SpoiledRecording(ImageRecording):
    """A ``Sequence`` with the frames of another one, spoiled while it is read."""

    original: Sequence
    config: SpoilConfig
    plans: tuple[FramePlan, ...]
    """What is done to each frame of the original."""

    @staticmethod
    def of(original: Sequence, config: SpoilConfig) -> SpoiledRecording:
        """Plan how to spoil a recording; nothing is read yet.

        Raises:
            InputError: it has no images, hardly any frame is left, or a distortion leaves the
                corners of its images without anything to show.
        """
        if original.camera.size_px is None:
            what = f"the format {original.format} has no images."
            raise InputError(original.path, what, "Only recordings of images can be spoiled.")
        _, k1 = config.wrong_calibration
        strongest = effects.strongest_barrel(original.camera)
        if -k1 > strongest:
            what = f"with {k1:g}, nothing is seen in the corners of the images of this camera."
            cure = (
                f"The strongest that shows something there is -{np.floor(1e4 * strongest) / 1e4:g}."
            )
            raise InputError("radial_distortion", what, cure)
        plans = plan_frames(config, len(original))
        kept = np.array([plan.effect != "dropped" for plan in plans])
        if kept.sum() < MIN_FRAMES:
            what = f"of its {len(original)} frames, {int(kept.sum())} would be left."
            raise InputError(original.path, what, "Take a longer recording, or another --seed.")
        truth = original.truth
        if truth is not None:
            truth = GroundTruth(truth.stamps_ns[kept], truth.T_world_cam[kept])
        return SpoiledRecording(
            path=original.path,
            format=original.format,
            camera=_miscalibrated(original.camera, config),
            stamps_ns=original.stamps_ns[kept],
            imu=original.imu,
            imu_stream=original.imu_stream if isinstance(original, ImageRecording) else None,
            truth=truth,
            original=original,
            config=config,
            plans=tuple(plans),
        )

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames from the first; raise InputError at a faulty image."""
        late: deque[tuple[Image, Image | BoolArray | None]] = deque(
            maxlen=self.config.delay_frames + 1
        )
        before: _Pair | None = None
        shown: _Pair | None = None
        imu: ImuSamples | None = None
        count = 0
        _, k1 = self.config.wrong_calibration
        source_px = effects.distortion_map(self.original.camera, k1) if k1 else None
        for frame, plan in zip(self.original, self.plans, strict=True):
            if frame.left is None or frame.right is None:
                what = f"frame {frame.index} has no images."
                raise InputError(self.path, what, "Only recordings of images can be spoiled.")
            # The right image comes from an earlier frame, and so does its mask.
            late.append((frame.right, frame.right_mask))
            right, right_mask = late[0]
            pair = _Pair(frame.left, right, frame.left_mask, right_mask)
            if source_px is not None:
                pair = pair.distorted(source_px)
            imu = frame.imu if imu is None or frame.imu is None else imu.followed_by(frame.imu)
            if plan.effect != "dropped":
                is_frozen = plan.effect == "frozen" and shown is not None
                if shown is None or not is_frozen:
                    shown = self._spoiled(pair, plan, index=frame.index, before=before)
                yield replace(
                    frame,
                    index=count,
                    left=shown.left.copy(),
                    right=shown.right.copy(),
                    left_mask=shown.left_mask,
                    right_mask=shown.right_mask,
                    imu=imu if count else None,
                    prepared=None,
                )
                count += 1
                imu = None
            before = pair

    def record(self) -> dict[str, Any]:
        """Return what is done to each frame of the original, and where it is written."""
        frames = []
        written = 0
        for index, plan in enumerate(self.plans):
            is_written = plan.effect != "dropped"
            frames.append(
                {"frame": index, "written": written if is_written else None} | plan.record
            )
            written += is_written
        return {"settings": self.config.effective().model_dump(), "frames": frames}

    def _spoiled(self, pair: _Pair, plan: FramePlan, *, index: int, before: _Pair | None) -> _Pair:
        """Return the images of a frame with the effect of its plan."""
        amount = plan.amount
        rng = np.random.default_rng([self.config.seed, _FRAME_KEY, index])
        burst_rng = np.random.default_rng([self.config.seed, _BURST_KEY, max(plan.burst, 0)])
        if plan.effect == "shake":
            angle = burst_rng.uniform(0.0, np.pi)
            length_px = FULL_SHAKE_PX * amount * rng.uniform(0.5, 1.0)
            way_px = length_px * np.array([np.cos(angle), np.sin(angle)])
            return pair.each(lambda image, _: effects.shaken(image, way_px))
        if plan.effect == "flow_blur" and before is not None:
            # The flow of the pixels of this frame, back to the one before: the way is the same.
            return replace(
                pair,
                left=effects.blurred_along(
                    pair.left, effects.optical_flow(pair.left, before.left), amount
                ),
                right=effects.blurred_along(
                    pair.right, effects.optical_flow(pair.right, before.right), amount
                ),
            )
        if plan.effect == "darkness":
            gain = DARKEST**amount
            noise_grey = FULL_NOISE_GREY * amount
            return pair.each(lambda image, _: effects.exposed(image, gain, noise_grey, rng))
        if plan.effect == "exposure":
            gain = FULL_EXPOSURE ** (amount * rng.uniform(-1.0, 1.0))
            return pair.each(lambda image, _: effects.exposed(image, gain, 0.0, rng))
        if plan.effect == "occluder":
            return _occluded(pair, plan, burst_rng)
        if plan.effect == "dirt":
            masks: list[FloatArray] = [
                effects.dirt_mask(pair.left.shape, amount, burst_rng) for _ in range(2)
            ]
            return pair.each(lambda image, side: effects.soiled(image, masks[side]))
        if plan.effect == "jpeg":
            quality = round(BEST_JPEG + amount * (WORST_JPEG - BEST_JPEG))
            return pair.each(lambda image, _: effects.compressed(image, quality))
        return pair


def _miscalibrated(camera: StereoCamera, config: SpoilConfig) -> StereoCamera:
    """Return a camera with the focal length that the calibration wrongly gives."""
    factor = 1.0 + config.wrong_calibration[0]
    return replace(camera, fu_px=factor * camera.fu_px, fv_px=factor * camera.fv_px)


def _occluded(pair: _Pair, plan: FramePlan, burst_rng: np.random.Generator) -> _Pair:
    """Let something textured pass before both cameras, with a disparity of its own."""
    height, width = pair.left.shape
    size = (0.3 + 0.5 * plan.amount) * height
    patch = effects.texture((round(size), round(size * burst_rng.uniform(0.5, 1.5))), burst_rng)
    disparity_px = burst_rng.uniform(0.02, 0.08) * width
    u = burst_rng.uniform(0.0, 0.7) * width
    v = burst_rng.uniform(0.0, 0.6) * height
    step_px = burst_rng.uniform(-0.05, 0.05) * width
    # Half of it or more stays within the width of both images. Where it would leave, it comes in
    # again on the other side.
    leftmost = disparity_px - 0.5 * patch.shape[1]
    rightmost = width - 0.5 * patch.shape[1]
    u = leftmost + (u + plan.position * step_px - leftmost) % (rightmost - leftmost)
    return replace(
        pair,
        left=effects.pasted(pair.left, patch, (u, v)),
        right=effects.pasted(pair.right, patch, (u - disparity_px, v)),
    )


def write_spoiled(
    out: Path, recording: SpoiledRecording, on_frame: Callable[[int], None] = lambda index: None
) -> int:
    """Write a spoiled recording as a folder, with ``spoiled.json`` beside its images.

    Returns:
        The number of IMU samples that were left out, as ``write_recording_folder`` does.

    Raises:
        InputError: the folder holds something, a file of the original is damaged, or one cannot be
            written.
    """
    num_left_out = write_recording_folder(
        out, recording, num_frames=len(recording), on_frame=on_frame
    )
    write_atomically(out / RECORD, json.dumps(recording.record(), indent=1) + "\n")
    return num_left_out
