"""Recordings: one protocol, ``Sequence``, behind which every format hides; ``open_sequence`` opens
any of them."""

from probevo.sequences.base import Sequence
from probevo.sequences.detect import FORMAT_NAMES, open_sequence
from probevo.sequences.frame import Frame, GroundTruth, ImuCalibration, ImuSamples, StereoFeatures

__all__ = [
    "FORMAT_NAMES",
    "Frame",
    "GroundTruth",
    "ImuCalibration",
    "ImuSamples",
    "Sequence",
    "StereoFeatures",
    "open_sequence",
]
