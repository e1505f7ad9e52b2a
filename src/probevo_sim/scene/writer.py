"""Write a drive through a scene as a folder of files that ``open_sequence`` reads."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import cv2
import joblib
import numpy as np
import yaml

from probevo.errors import InputError
from probevo.sequences.formats.folder import IMU_HEADER, SUN_FILE
from probevo.sequences.pose_files import write_kitti_poses
from probevo.sequences.read_ahead import read_ahead
from probevo.storage.files import check_folder, remove_stale, write_atomically
from probevo.storage.lock import LOCK
from probevo.storage.npz import write_npz
from probevo_sim.scene.config import SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene
from probevo_sim.scene.renderer import PixelTruth

RENDERER_VERSION = 1
"""Version of the images that the same settings give; it distinguishes old folders from new ones.

Increase it with every change that alters an image."""
SETTINGS_FILE = "scene.yaml"
LAST_FILE = "times.txt"
"""The file that is written last: where it is, the recording is complete."""
SIDES = ("left", "right")


def write_scene(
    config: SceneConfig,
    out: Path,
    *,
    pixel_truth: bool = False,
    jobs: int = 0,
    on_frame: Callable[[int, int], None] | None = None,
) -> Path:
    """Render a drive into a folder that ``open_sequence`` reads.

    Frames that an earlier, interrupted call wrote are kept. Beside the files of the folder layout
    the folder holds the settings, ``scene.yaml``, and on request ``pixel_truth/<frame>.npz`` with
    the arrays of ``PixelTruth`` in single precision.

    Args:
        config: all settings. ``truth`` may change from call to call: only ``poses.txt`` depends on
            it.
        out: the folder; made if it is missing.
        pixel_truth: also write the truth about each pixel.
        jobs: threads that render; 0 is one for each core.
        on_frame: called with the number of frames that exist, and of all frames.

    Returns:
        ``out``.

    Raises:
        InputError: the folder holds something else, or cannot be written to.
    """
    settings = settings_text(config)
    _check_out(settings, out)
    recording = open_scene(config)
    write_atomically(out / SETTINGS_FILE, settings)

    def write(index: int) -> None:
        """Render one frame, or what is missing of it."""
        if not _has_images(out, index):
            for side, image in zip(SIDES, recording.images(index), strict=True):
                write_atomically(
                    _image_file(out, side, index), cv2.imencode(".png", image)[1].tobytes()
                )
        if pixel_truth and not _truth_file(out, index).exists():
            _write_pixel_truth(_truth_file(out, index), recording.pixel_truth(index))

    def is_missing(index: int) -> bool:
        """Return whether a file of the frame is not there yet."""
        return not _has_images(out, index) or (pixel_truth and not _truth_file(out, index).exists())

    # Render the missing frames in threads; compiled loops release the interpreter's lock.
    missing = [index for index in range(len(recording)) if is_missing(index)]
    threads = min(jobs or joblib.cpu_count(), len(recording))
    written = read_ahead(write, missing, ahead=2 * threads, threads=threads)
    for done, _ in enumerate(written, start=len(recording) - len(missing) + 1):
        if on_frame is not None:
            on_frame(done, len(recording))
    _write_rest(recording, out)
    return out


def settings_text(config: SceneConfig) -> str:
    """Return all settings that the images depend on, as YAML.

    Two scenes with the same text have the same images.
    """
    settings = config.model_dump(exclude={"truth"})
    return yaml.safe_dump({"renderer": RENDERER_VERSION, **settings}, sort_keys=False)


def scene_folder(name: str, config: SceneConfig) -> str:
    """Return a folder's name for a scene; it changes with the settings and with the renderer."""
    return f"{name}-{hashlib.sha256(settings_text(config).encode()).hexdigest()[:8]}"


def _check_out(settings: str, out: Path) -> None:
    """Check that a folder is empty or holds a part of this very scene.

    Raises:
        InputError: it holds something else.
    """
    check_folder(out, "--out")
    try:
        entries = out.iterdir() if out.is_dir() else ()
        if all(path.suffix == ".part" or path.name == LOCK for path in entries):
            return
        there = (out / SETTINGS_FILE).read_text()
    except (OSError, UnicodeDecodeError):
        what = f"the folder {out} is not empty, and holds no simulated scene."
        raise InputError("--out", what, "Choose another folder.") from None
    if there != settings:
        what = f"the folder {out} holds a scene with other settings, see {SETTINGS_FILE} there."
        raise InputError("--out", what, f"Choose another folder, or delete {out}.")


def _image_file(out: Path, side: str, index: int) -> Path:
    return out / side / f"{index:06d}.png"


def _truth_file(out: Path, index: int) -> Path:
    return out / "pixel_truth" / f"{index:06d}.npz"


def _has_images(out: Path, index: int) -> bool:
    """Return whether the images of a frame are there; files appear whole or not at all."""
    return all(_image_file(out, side, index).exists() for side in SIDES)


def _write_pixel_truth(path: Path, truth: PixelTruth) -> None:
    """Write the truth about each pixel in single precision."""
    arrays = {
        "depth_m": truth.depth_m.astype(np.float32),
        "disparity_px": truth.disparity_px.astype(np.float32),
        "flow_px": truth.flow_px.astype(np.float32),
        "moving": truth.moving,
    }
    write_npz(path, arrays, is_compressed=True)


def _write_rest(recording: SceneRecording, out: Path) -> None:
    """Write calibration, IMU, poses and, last, the times."""
    # The calibration of cameras and IMU.
    camera = recording.camera
    imu = recording.imu
    calibration = {
        "fu_px": camera.fu_px,
        "fv_px": camera.fv_px,
        "cu_px": camera.cu_px,
        "cv_px": camera.cv_px,
        "baseline_m": camera.baseline_m,
        "width_px": recording.config.rig.width_px,
        "height_px": recording.config.rig.height_px,
        "imu": {
            "T_cam_imu": imu.T_cam_imu.tolist(),
            "gyro_noise_rad_s_sqrt_hz": imu.gyro_noise_rad_s_sqrt_hz,
            "gyro_bias_sigma_rad_s": imu.gyro_bias_sigma_rad_s,
            "gyro_bias_walk_rad_s2_sqrt_hz": imu.gyro_bias_walk_rad_s2_sqrt_hz,
            "accel_noise_m_s2_sqrt_hz": imu.accel_noise_m_s2_sqrt_hz,
            "accel_bias_sigma_m_s2": imu.accel_bias_sigma_m_s2,
            "accel_bias_walk_m_s3_sqrt_hz": imu.accel_bias_walk_m_s3_sqrt_hz,
        },
    }
    write_atomically(out / "calib.yaml", yaml.safe_dump(calibration, sort_keys=False))

    # The IMU's samples, one a line, at full precision.
    samples = recording.imu_samples
    values = np.hstack([samples.gyro_rad_s, samples.accel_m_s2])
    lines = [
        ",".join([str(stamp), *map(repr, row)])
        for stamp, row in zip(samples.stamps_ns.tolist(), values.tolist(), strict=True)
    ]
    write_atomically(out / "imu.csv", "\n".join([IMU_HEADER, *lines, ""]))

    # The poses that are given away, the sun in their world, and the times.
    if recording.truth is not None:
        write_kitti_poses(out / "poses.txt", recording.truth.T_world_cam)
        write_atomically(out / SUN_FILE, " ".join(map(repr, recording.to_sun.tolist())) + "\n")
    else:
        remove_stale(out / "poses.txt")
        remove_stale(out / SUN_FILE)
    write_atomically(
        out / LAST_FILE, "".join(f"{stamp}\n" for stamp in recording.stamps_ns.tolist())
    )
