"""Stereo calibration files of other tools: the available readers, and the choice among them.

A calibration is recognised by its content, not by its name. A new kind is one more entry here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from probevo.camera.image_scale import SizePx
from probevo.errors import InputError
from probevo.sequences.calibrations.calibration_content import CalibrationContent, load_calibration
from probevo.sequences.calibrations.kalibr_calibration import is_kalibr, read_kalibr
from probevo.sequences.calibrations.opencv_calibration import is_opencv, read_opencv
from probevo.sequences.calibrations.ros_calibration import is_ros, read_ros
from probevo.sequences.calibrations.slam_settings import (
    is_orb_slam,
    is_vins_camera,
    is_vins_fusion,
    read_orb_slam,
    read_vins_fusion,
)
from probevo.sequences.calibrations.stereo_calibration import StereoCalibration


@dataclass(frozen=True)
class CalibrationReader:
    """A kind of calibration file."""

    name: str
    recognises: Callable[[CalibrationContent], bool]
    """Tells by the keys of the file."""
    read: Callable[[CalibrationContent, SizePx | None], StereoCalibration]
    """Called with the content, and with the size of the images for files that have none."""


READERS = (
    CalibrationReader("Kalibr's camchain", is_kalibr, read_kalibr),
    CalibrationReader("settings of VINS-Fusion", is_vins_fusion, read_vins_fusion),
    CalibrationReader("settings of ORB-SLAM3", is_orb_slam, read_orb_slam),
    CalibrationReader("left.yaml and right.yaml of ROS", is_ros, read_ros),
    CalibrationReader("OpenCV's stereo calibration", is_opencv, read_opencv),
)


def is_stereo_calibration(path: Path) -> bool:
    """Return whether an existing file is a calibration of one of the known kinds."""
    try:
        content = load_calibration(path)
    except InputError:  # whoever reads it as another kind of file says what is wrong
        return False
    return any(known.recognises(content) for known in READERS)


def read_stereo_calibration(
    path: Path, size_px: SizePx | None = None, *, resized: bool = False
) -> StereoCalibration:
    """Read a calibration file of any known kind.

    Args:
        path: the file.
        size_px: (width, height) of the images that it is for; None to accept any.
        resized: whether these images may have been scaled since they were calibrated.

    Raises:
        InputError: the file is missing, of no known kind, of a camera model that is not supported,
            of images of another size, or a value is impossible.
    """
    content = load_calibration(path)
    reader = next((known for known in READERS if known.recognises(content)), None)
    if reader is None and is_vins_camera(content):
        what = "this is one camera of VINS-Fusion, not a stereo pair."
        raise InputError(path, what, "Give the settings file that names it in cam0_calib.")
    if reader is None:
        what = f"this is not the calibration of a stereo pair; its keys are {content.keys_text}."
        raise InputError(path, what, f"Known are {', '.join(known.name for known in READERS)}.")
    # A file that does not give the size is taken for the images as they are, but not as they were.
    calibration = reader.read(content, None if resized else size_px)
    if size_px is not None and calibration.left.size_px != size_px:
        width, height = calibration.left.size_px
        if resized:
            return calibration.resized(size_px)
        what = f"it is for images of {width}×{height} px; these have {size_px[0]}×{size_px[1]} px."
        cure = (
            "Calibrate at the size of the images, or give --resized if they were scaled since they"
            " were calibrated."
        )
        raise InputError(path, what, cure)
    return calibration
