"""What a feature looks like, as numbers from which its noise can be predicted; one file a
predictor."""

from probevo.predictors.base import Needs, PredictionSpace, Predictor, Step
from probevo.predictors.table import PREDICTORS, prediction_space, space_for

__all__ = [
    "PREDICTORS",
    "Needs",
    "PredictionSpace",
    "Predictor",
    "Step",
    "prediction_space",
    "space_for",
]
