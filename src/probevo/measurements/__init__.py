"""Everything that constrains the state: residuals with Jacobians, covariance and robust loss."""

from probevo.measurements.base import Linearization, Measurement, Outcome
from probevo.measurements.direction import Direction
from probevo.measurements.heading import Heading
from probevo.measurements.north import NORTH
from probevo.measurements.pose_prior import PosePrior
from probevo.measurements.position import Position
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.sensor import NoMeasurement
from probevo.measurements.stereo_observations import StereoObservations
from probevo.measurements.sun import sun_in_enu
from probevo.measurements.travelled_distance import TravelledDistance
from probevo.measurements.variables import Values, Variable, pose_of
from probevo.measurements.vector_measurement import VectorMeasurement

__all__ = [
    "NORTH",
    "Direction",
    "Heading",
    "Linearization",
    "Measurement",
    "NoMeasurement",
    "Outcome",
    "PosePrior",
    "Position",
    "RelativeRotation",
    "StereoObservations",
    "TravelledDistance",
    "Values",
    "Variable",
    "VectorMeasurement",
    "pose_of",
    "sun_in_enu",
]
