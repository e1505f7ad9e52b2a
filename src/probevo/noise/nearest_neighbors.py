"""PROBE: a scalar weight for each feature, from its nearest neighbours in the prediction space (PROBE IV-B, Fig. 3)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal, Self

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.noise.base import NoiseModel, StereoNoise
from probevo.noise.metric import Metric
from probevo.noise.neighbors import NeighborIndex
from probevo.noise.student_t import StudentT

Average = Literal["arithmetic", "geometric"]
LARGEST_WEIGHT = 1e4
"""β stays between one over this and this: beyond, a feature has no say anyhow, or all of it."""


class NearestNeighbors:
    """Scales the noise R of a static model by β = (mean of the K nearest α / ᾱ)^γ (PROBE Fig. 3).

    α is the error of a motion that a feature helped to estimate, ᾱ the mean of all α. What counts is how the α compare,
    not their unit: training may give them as RMSE in metres, as PROBE does, or relative to what others reached on the
    same step.

    Args:
        neighbors: K.
        exponent: γ, which maps small differences of α to β of several orders of magnitude; 0 is the static model.
        average: of the α, over the neighbours and over all. PROBE's is arithmetic; the geometric one, the exponential of
            the mean logarithm, does not let one α that is off by metres decide for all its neighbours.
        base: the static model whose noise is scaled; it must refer to single observations.
    """

    def __init__(
        self,
        neighbors: int = 100,
        exponent: float = 8.0,
        average: Average = "geometric",
        base: NoiseModel | None = None,
    ) -> None:
        self.neighbors, self.exponent, self.average = neighbors, exponent, average
        self.base: NoiseModel = base or StudentT()

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the predictors, in their order."""
        return self.metric_.columns

    def fit(
        self,
        predictors: FloatArray,
        alphas: FloatArray,
        *,
        columns: Sequence[str] = (),
        may_be_undefined: Sequence[bool] = (),
        weight: FloatArray | None = None,
    ) -> Self:
        """Take in N samples: places in the prediction space [N, M], and the error α > 0 of a motion at each, [N].

        Sets ``metric_``, ``index_`` and ``log_mean_alpha_`` (of ᾱ).

        Args:
            predictors, alphas: the samples.
            columns: names of the M columns.
            may_be_undefined: which of the columns may hold NaN, which says that a predictor is undefined.
            weight: how much a standard deviation of each column counts, [M]; all alike if left out.

        Raises:
            InputError: no samples, fewer than K, an α that is no positive number, or NaN where it may not be.
        """
        if len(predictors) != len(alphas):
            raise InputError("training data", f"{len(predictors)} places, but {len(alphas)} errors α.")
        if len(alphas) < self.neighbors:
            what = f"K is {self.neighbors}, but there are only {len(alphas)} samples."
            raise InputError("--neighbors", what, "Choose a smaller K, or train on more.")
        if self.neighbors < 1:
            raise InputError("--neighbors", f"K is {self.neighbors}.", "It must be at least 1.")
        if not (np.isfinite(alphas) & (alphas > 0.0)).all():
            raise InputError("training data", "an error α is no positive number.")
        self.metric_ = Metric.fitted(predictors, columns, may_be_undefined, weight)
        values = np.log(alphas) if self.average == "geometric" else alphas
        self.log_mean_alpha_ = float(np.mean(values) if self.average == "geometric" else np.log(np.mean(values)))
        self.index_ = NeighborIndex.build(self.metric_.coordinates(predictors), values)
        return self

    def log_relative_alpha(self, predictors: FloatArray) -> FloatArray:
        """ln(mean of the K nearest α / ᾱ) at each of N places [N, M]: [N]."""
        mean = self.index_.mean_of_nearest(self.metric_.coordinates(predictors), np.array([self.neighbors]))[:, 0]
        relative: FloatArray = (mean if self.average == "geometric" else np.log(mean)) - self.log_mean_alpha_
        return relative

    def weights(self, predictors: FloatArray) -> FloatArray:
        """β of each of N features from its place [N, M]: [N]."""
        limit = np.log(LARGEST_WEIGHT)
        beta: FloatArray = np.exp(np.clip(self.exponent * self.log_relative_alpha(predictors), -limit, limit))
        return beta

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """β R for each of N features from its place in the prediction space [N, M]."""
        noise = self.base.predict(predictors)
        return replace(noise, scale=self.weights(predictors)[:, None, None] * noise.scale)
