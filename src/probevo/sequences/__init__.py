"""Recordings: the protocol ``Sequence``, which every format implements.

``open_sequence`` opens a recording of any registered format.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from probevo.sequences.registry import (
    SequenceFormat,
    format_names,
    open_sequence,
    register_format,
    sequence_formats,
)

if TYPE_CHECKING:
    from probevo.sequences.base import Sequence
    from probevo.sequences.frame import Frame, GroundTruth, ImuSamples, StereoFeatures
    from probevo.sequences.imu_calibration import ImuCalibration

_HOMES = {
    "Frame": "probevo.sequences.frame",
    "GroundTruth": "probevo.sequences.frame",
    "ImuCalibration": "probevo.sequences.imu_calibration",
    "ImuSamples": "probevo.sequences.frame",
    "Sequence": "probevo.sequences.base",
    "StereoFeatures": "probevo.sequences.frame",
}
__all__ = [
    "Frame",
    "GroundTruth",
    "ImuCalibration",
    "ImuSamples",
    "Sequence",
    "SequenceFormat",
    "StereoFeatures",
    "format_names",
    "open_sequence",
    "register_format",
    "sequence_formats",
]


def __getattr__(name: str) -> Any:
    """Import a value class on first use: the names of the formats should not wait for NumPy."""
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'probevo.sequences' has no attribute {name!r}")
