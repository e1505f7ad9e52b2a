"""Stereo odometry that learns how far to trust each feature, and says how sure it is of its own motion."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from probevo import noise as noise
    from probevo.camera.stereo import StereoCamera as StereoCamera
    from probevo.config import OdometryConfig as OdometryConfig
    from probevo.motion.estimate import MotionEstimate as MotionEstimate
    from probevo.motion.estimate import Status as Status
    from probevo.odometry import StereoOdometry as StereoOdometry
    from probevo.sequences import open_sequence as open_sequence
    from probevo.sequences.frame import Frame as Frame
    from probevo.sequences.frame import ImuCalibration as ImuCalibration
    from probevo.sequences.frame import ImuSamples as ImuSamples

__version__ = "0.1.0"

_HOMES = {
    "Frame": "probevo.sequences.frame",
    "ImuCalibration": "probevo.sequences.frame",
    "ImuSamples": "probevo.sequences.frame",
    "MotionEstimate": "probevo.motion.estimate",
    "OdometryConfig": "probevo.config",
    "Status": "probevo.motion.estimate",
    "StereoCamera": "probevo.camera.stereo",
    "StereoOdometry": "probevo.odometry",
    "open_sequence": "probevo.sequences",
}
__all__ = [*_HOMES, "noise"]


def __getattr__(name: str) -> Any:
    """Import the public names on first use: ``probevo --help`` should not wait for SciPy."""
    if name == "noise":
        return importlib.import_module("probevo.noise")
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'probevo' has no attribute {name!r}")
