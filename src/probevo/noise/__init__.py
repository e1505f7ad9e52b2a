"""Noise models: they map the predictors φ of a stereo feature to the distribution of its error."""

from probevo.noise.base import NoiseModel, StereoNoise
from probevo.noise.fixed import Fixed
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.noise.student_t import StudentT

__all__ = [
    "Fixed",
    "GeneralizedKernel",
    "NearestNeighbors",
    "NoiseModel",
    "StereoNoise",
    "StudentT",
]
