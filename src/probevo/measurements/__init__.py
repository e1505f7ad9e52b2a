"""Whatever constrains the state, each with a residual, Jacobians, a covariance and a loss."""

from probevo.measurements.base import (
    Linearization,
    Measurement,
    Outcome,
    Values,
    Variable,
    VectorMeasurement,
    pose_of,
)
from probevo.measurements.pose_prior import PosePrior
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.stereo_observations import StereoObservations

__all__ = [
    "Linearization",
    "Measurement",
    "Outcome",
    "PosePrior",
    "RelativeRotation",
    "StereoObservations",
    "Values",
    "Variable",
    "VectorMeasurement",
    "pose_of",
]
