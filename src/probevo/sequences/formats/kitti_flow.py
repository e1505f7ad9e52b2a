"""KITTI 2012 and 2015, stereo and flow: scenes of a few frames with true disparity and flow.

Images are in ``image_0`` and ``image_1`` (2012, grey) or ``image_2`` and ``image_3`` (colour),
called ``<scene>_<frame>.png``. The truth belongs to frame 10, and to the motion from 10 to 11. It
comes from the LiDAR, for about a third of the pixels.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from probevo.arrays import AnyArray, FloatArray, IntArray
from probevo.errors import InputError
from probevo.sequences.calibrations.kitti_calibration import KittiCalibration
from probevo.sequences.format_options import KITTI_FLOW_RATE_HZ
from probevo.sequences.images import MAX_FILE_BYTES, list_images, pair_size_px
from probevo.sequences.recording import StereoRecording
from probevo.storage.files import check_regular

TRUTH_FRAME = 10
"""Frame to which the true disparity belongs, and from which the true flow leads to the next."""
MAX_SCENES = 6
"""Scenes that a message names."""
_NAME = re.compile(r"(\d{6})_(\d{2})\.png")
_CAMERAS = (("image_0", "image_1"), ("image_2", "image_3"))
_CURE = "Expected the layout of KITTI 2012 or 2015, stereo or flow, such as its folder training."


class FlowTruth(NamedTuple):
    """The truth of a scene at frame 10, NaN where it is unknown."""

    disparity_px: FloatArray
    """u_l − u_r, [height, width]."""
    flow_px: FloatArray
    """Way (u, v) from frame 10 to 11 in the left image, [height, width, 2]."""


def open_kitti_flow(
    path: Path, *, scene: int | None = None, rate_hz: float | None = None
) -> StereoRecording:
    """Open a scene.

    Args:
        path: the folder with ``image_0`` or ``image_2``, and with ``calib`` or
            ``calib_cam_to_cam``.
        scene: its number; may be left out if there is only one.
        rate_hz: frames a second, since the benchmark has no times; 10 by default.

    Raises:
        InputError: a file or field is missing, there is no such scene, or it is not said which.
    """
    left_name, right_name = _cameras_of(path)
    scenes = _scenes(path / left_name)
    number = _chosen(path, sorted(scenes), scene)
    frames = sorted(scenes[number])
    left_files = [path / left_name / f"{number:06d}_{frame:02d}.png" for frame in frames]
    right_files = [path / right_name / file.name for file in left_files]
    missing = [file for file in right_files if not file.exists()]
    if missing:
        raise InputError(missing[0], "this image is missing.", "Left and right come in pairs.")
    size_px = pair_size_px(left_files[0], right_files[0])
    folder = "calib" if (path / "calib").is_dir() else "calib_cam_to_cam"
    calibration = KittiCalibration(path / folder / f"{number:06d}.txt", _CURE)
    prefix = "P" if folder == "calib" else "P_rect_0"
    camera = calibration.stereo_camera(
        f"{prefix}{left_name[-1]}", f"{prefix}{right_name[-1]}", size_px
    )
    step_ns = 1e9 / (rate_hz or KITTI_FLOW_RATE_HZ)
    stamps_ns: IntArray = np.rint(np.array(frames) * step_ns).astype(np.int64)
    return StereoRecording(
        path=path,
        format="kitti-flow",
        camera=camera,
        stamps_ns=stamps_ns,
        left_files=left_files,
        right_files=right_files,
        notes=(("scene", f"{number:06d}, frames {frames[0]} to {frames[-1]}"),),
    )


def scene_numbers(path: Path) -> list[int]:
    """Return the numbers of all scenes in a folder, ascending.

    Raises:
        InputError: it is no folder of the benchmark.
    """
    return sorted(_scenes(path / _cameras_of(path)[0]))


def read_flow_truth(path: Path, scene: int, *, with_occluded: bool = True) -> FlowTruth:
    """Read the true disparity and flow of a scene.

    Args:
        path: the folder of the benchmark.
        scene: number of the scene.
        with_occluded: whether to take pixels that the other image does not show.

    Raises:
        InputError: a file is missing or damaged.
    """
    which = "occ" if with_occluded else "noc"
    name = f"{scene:06d}_{TRUTH_FRAME}.png"
    folder = path / f"disp_{which}"
    if not folder.is_dir():  # the folder of 2015, which has the disparity at frame 11, too
        folder = path / f"disp_{which}_0"
    disparity = _read_16_bits(folder / name, channels=1)
    flow = _read_16_bits(path / f"flow_{which}" / name, channels=3)
    if flow.shape[:2] != disparity.shape:
        what = f"has shape {flow.shape[:2]}, the disparity {disparity.shape}."
        raise InputError(path / f"flow_{which}" / name, what, "Both are of one image.")
    # OpenCV has the channels from the last to the first: whether it is valid, v, u.
    is_known = flow[..., 0] > 0
    flow_px = (flow[..., :0:-1].astype(float) - 2.0**15) / 64.0
    return FlowTruth(
        disparity_px=np.where(disparity > 0, disparity / 256.0, np.nan),
        flow_px=np.where(is_known[..., None], flow_px, np.nan),
    )


def _cameras_of(path: Path) -> tuple[str, str]:
    """Return the names of the folders of left and right images.

    Raises:
        InputError: neither pair is there.
    """
    for left, right in _CAMERAS:
        if (path / left).is_dir() and (path / right).is_dir():
            return left, right
    wanted = " nor ".join(f"{left} and {right}" for left, right in _CAMERAS)
    raise InputError(path, f"it has neither {wanted}.", _CURE)


def _scenes(folder: Path) -> dict[int, list[int]]:
    """Return the numbers of the frames of each scene.

    Raises:
        InputError: no image has a name of the benchmark.
    """
    scenes: dict[int, list[int]] = {}
    for file in list_images(folder):
        match = _NAME.fullmatch(file.name)
        if match is not None:
            scenes.setdefault(int(match[1]), []).append(int(match[2]))
    if not scenes:
        raise InputError(folder, "no image is called such as 000027_10.png.", _CURE)
    return scenes


def _chosen(path: Path, scenes: list[int], scene: int | None) -> int:
    """Return the number of the scene to open.

    Raises:
        InputError: it is not there, or there are several and none is named.
    """
    if scene in scenes:
        return int(scene)
    if scene is None and len(scenes) == 1:
        return scenes[0]
    some = ", ".join(map(str, scenes[:MAX_SCENES])) + (" …" if len(scenes) > MAX_SCENES else "")
    cure = f"Give one of {some} with --scene, in Python as scene=…"
    if scene is None:
        raise InputError(path, f"holds {len(scenes)} scenes, and none is named.", cure)
    raise InputError(path, f"has no scene {scene}.", cure)


def _read_16_bits(path: Path, channels: int) -> AnyArray:
    """Decode a PNG file of 16 bits, [height, width] or [height, width, channels].

    Raises:
        InputError: it is missing, damaged, or of another kind.
    """
    check_regular(path, MAX_FILE_BYTES)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror}.", _CURE) from None
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if image is None or image.dtype != np.uint16 or np.atleast_3d(image).shape[2] != channels:
        what = f"this is not a PNG of 16 bits with {channels} channels."
        raise InputError(path, what, "Copy the file anew.")
    return np.asarray(image)
