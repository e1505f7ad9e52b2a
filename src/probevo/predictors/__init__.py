"""What a feature looks like, as numbers that predict its noise; one file a predictor."""

from probevo.predictors.base import Needs, Predictor, Step
from probevo.predictors.registry import PREDICTORS, all_predictors, prediction_space, space_for
from probevo.predictors.space import PredictionSpace

__all__ = [
    "PREDICTORS",
    "Needs",
    "PredictionSpace",
    "Predictor",
    "Step",
    "all_predictors",
    "prediction_space",
    "space_for",
]
