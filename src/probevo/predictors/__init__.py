"""Predictors: numbers that describe a feature and predict its noise; one file per predictor."""

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
