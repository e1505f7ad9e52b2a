"""A recording in probevo's own layout, the format ``folder``."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from probevo.arrays import Image
from probevo.errors import InputError
from probevo.output.recording_parts import imu_samples, stereo_pairs
from probevo.sequences import ImuSamples, Sequence
from probevo.sequences.formats.folder import IMU_HEADER
from probevo.sequences.imu_calibration import DENSITIES
from probevo.sequences.masked import mask_of_array
from probevo.sequences.pose_files import write_kitti_poses
from probevo.storage.files import write_atomically


def check_new_folder(folder: Path) -> None:
    """Refuse a folder that holds something.

    Raises:
        InputError: it does, or it is a file.
    """
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(folder, "this folder is not empty.", "Name a new folder.")


def write_recording_folder(
    folder: Path,
    sequence: Sequence,
    *,
    num_frames: int,
    on_frame: Callable[[int], None] = lambda index: None,
) -> int:
    """Write the rectified images of a recording as PNG files, with masks, calibration, times, IMU
    and truth.

    What is read back is the same to the last bit, except that true poses are rounded by the change
    of their origin. IMU samples without a finite angular rate are left out, and a specific force
    that is not finite is written as unknown: that is how the odometry takes them.

    Args:
        folder: the folder; it must be missing or empty.
        sequence: the recording.
        num_frames: how many frames to write, from the first.
        on_frame: called with the index of each frame that was written.

    Returns:
        The number of IMU samples that were left out.

    Raises:
        InputError: the folder holds something, the recording has no images, one of its files is
            damaged, or a file cannot be written.
    """
    check_new_folder(folder)
    recorded = imu_samples(sequence)
    samples = None if recorded is None else _readable(recorded)
    frames = islice(sequence, num_frames)
    stamps = []
    for pair in stereo_pairs(frames, sequence):
        name = f"{pair.index:06d}.png"
        write_atomically(folder / "left" / name, _png(pair.left))
        write_atomically(folder / "right" / name, _png(pair.right))
        for side, mask in (("left", pair.left_mask), ("right", pair.right_mask)):
            if mask is not None:
                image = mask_of_array(mask, sequence.camera.size_px, f"frame {pair.index}")
                write_atomically(folder / f"mask_{side}" / name, _png(image))
        stamps.append(f"{pair.stamp_ns}\n")
        on_frame(pair.index)
    write_atomically(folder / "times.txt", "".join(stamps))
    if samples is not None:
        write_atomically(folder / "imu.csv", _csv(samples))
    if sequence.truth is not None and sequence.truth.known[:num_frames].any():
        write_kitti_poses(folder / "poses.txt", sequence.truth.T_world_cam[:num_frames])
    # Last, because it makes the folder a recording.
    content = _calibration(sequence, has_imu=samples is not None)
    write_atomically(folder / "calib.yaml", yaml.safe_dump(content, sort_keys=False))
    num_written = 0 if samples is None else len(samples.stamps_ns)
    return 0 if recorded is None else len(recorded.stamps_ns) - num_written


def left_out_text(num_samples: int) -> str:
    """Return what to tell of IMU samples that were left out."""
    if num_samples == 1:
        return "1 IMU sample is left out: it has no finite angular rate."
    return f"{num_samples:,} IMU samples are left out: they have no finite angular rate."


def _readable(samples: ImuSamples) -> ImuSamples | None:
    """Return the samples that can be read back; None if they are fewer than two."""
    has_rate = np.isfinite(samples.gyro_rad_s).all(axis=1)
    if has_rate.sum() < 2:
        return None
    accel_m_s2 = samples.accel_m_s2[has_rate]
    has_force = np.isfinite(accel_m_s2).all(axis=1, keepdims=True)
    return ImuSamples(
        stamps_ns=samples.stamps_ns[has_rate],
        gyro_rad_s=samples.gyro_rad_s[has_rate],
        accel_m_s2=np.where(has_force, accel_m_s2, np.nan),
    )


def _png(pixels: Image) -> bytes:
    return bytes(cv2.imencode(".png", pixels)[1].tobytes())


def _csv(samples: ImuSamples) -> str:
    values = np.concatenate([samples.gyro_rad_s, samples.accel_m_s2], axis=1).tolist()
    stamps_ns = samples.stamps_ns.tolist()
    rows = [
        ",".join([str(stamp_ns), *map(repr, row)])
        for stamp_ns, row in zip(stamps_ns, values, strict=True)
    ]
    return "\n".join([IMU_HEADER, *rows]) + "\n"


def _calibration(sequence: Sequence, *, has_imu: bool) -> dict[str, Any]:
    """Return the content of ``calib.yaml``; the samples are on the clock of the images already."""
    camera = sequence.camera
    width_px, height_px = camera.size_px or (0, 0)
    content: dict[str, Any] = {
        "fu_px": float(camera.fu_px),
        "fv_px": float(camera.fv_px),
        "cu_px": float(camera.cu_px),
        "cv_px": float(camera.cv_px),
        "baseline_m": float(camera.baseline_m),
        "width_px": int(width_px),
        "height_px": int(height_px),
    }
    if camera.readout_s:
        content["readout_s"] = float(camera.readout_s)
    imu = sequence.imu
    if imu is not None and has_imu:
        content["imu"] = {"T_cam_imu": np.asarray(imu.T_cam_imu, float).tolist()}
        content["imu"] |= {name: float(getattr(imu, name)) for name in DENSITIES}
    return content
