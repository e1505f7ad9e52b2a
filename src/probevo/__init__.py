"""Stereo visual odometry that learns the noise of each feature, with a covariance for each step."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from probevo import noise as noise
    from probevo import predictors as predictors
    from probevo.camera.stereo import StereoCamera as StereoCamera
    from probevo.config import OdometryConfig as OdometryConfig
    from probevo.config.training import TrainSettings as TrainSettings
    from probevo.errors import InputError as InputError
    from probevo.estimation.matches import estimate_motion as estimate_motion
    from probevo.estimation.motion_estimate import MotionEstimate as MotionEstimate
    from probevo.estimation.motion_estimate import Status as Status
    from probevo.live import LiveEstimate as LiveEstimate
    from probevo.live import LiveOdometry as LiveOdometry
    from probevo.noise.model_io import load_model as load_model
    from probevo.noise.model_io import save_model as save_model
    from probevo.odometry import StereoOdometry as StereoOdometry
    from probevo.path import compound as compound
    from probevo.runs.plot import plot as plot
    from probevo.sequences import open_sequence as open_sequence
    from probevo.sequences.frame import Frame as Frame
    from probevo.sequences.frame import ImuSamples as ImuSamples
    from probevo.sequences.imu_calibration import ImuCalibration as ImuCalibration
    from probevo.sequences.pose_files import write_kitti_poses as write_kitti_poses
    from probevo.sequences.pose_files import write_tum as write_tum
    from probevo.training.api import train_model as train_model

__version__ = "0.2.0"

_MODULE_OF = {
    "Frame": "probevo.sequences.frame",
    "ImuCalibration": "probevo.sequences.imu_calibration",
    "ImuSamples": "probevo.sequences.frame",
    "InputError": "probevo.errors",
    "LiveEstimate": "probevo.live",
    "LiveOdometry": "probevo.live",
    "MotionEstimate": "probevo.estimation.motion_estimate",
    "OdometryConfig": "probevo.config",
    "Status": "probevo.estimation.motion_estimate",
    "StereoCamera": "probevo.camera.stereo",
    "StereoOdometry": "probevo.odometry",
    "TrainSettings": "probevo.config.training",
    "compound": "probevo.path",
    "estimate_motion": "probevo.estimation.matches",
    "load_model": "probevo.noise.model_io",
    "open_sequence": "probevo.sequences",
    "plot": "probevo.runs.plot",
    "save_model": "probevo.noise.model_io",
    "train_model": "probevo.training.api",
    "write_kitti_poses": "probevo.sequences.pose_files",
    "write_tum": "probevo.sequences.pose_files",
}
"""The module that defines each public name."""
_MODULES = ("noise", "predictors")
"""Subpackages that are used as ``probevo.noise.StudentT``."""
__all__ = [*_MODULE_OF, *_MODULES]


def __dir__() -> list[str]:
    """Return the public names, too, those that are not imported yet."""
    return sorted({*globals(), *__all__})


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that ``probevo --help`` does not wait for SciPy."""
    if name in _MODULES:
        return importlib.import_module(f"probevo.{name}")
    if name in _MODULE_OF:
        return getattr(importlib.import_module(_MODULE_OF[name]), name)
    raise AttributeError(f"module 'probevo' has no attribute {name!r}")
