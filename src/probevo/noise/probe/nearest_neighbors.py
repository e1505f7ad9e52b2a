"""PROBE: a scalar weight for each feature, from its nearest neighbours in the prediction space
(PROBE IV-B, Fig. 3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field

from probevo.arrays import AnyArray, FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.noise.base import StereoNoise
from probevo.noise.classical import CLASSICAL
from probevo.noise.fixed import Fixed
from probevo.noise.metric import UNDEFINED, Metric
from probevo.noise.model_file import ModelFile
from probevo.noise.origin import OriginFacts, origin_facts, refuse_other_camera
from probevo.noise.probe.neighbor_index import NeighborIndex
from probevo.noise.student_t import StudentT
from probevo.settings import Settings

Average = Literal["arithmetic", "geometric"]
LARGEST_WEIGHT = 1e4
"""β stays between one over this and this: beyond, a feature contributes nothing anyhow, or
everything."""


class _Base(Settings):
    name: Literal["fixed", "student-t"]


class _Facts(OriginFacts):
    """What a file says beside its arrays."""

    columns: tuple[str, ...]
    may_be_undefined: tuple[bool, ...]
    neighbors: int = Field(ge=1)
    exponent: float = Field(ge=0)
    average: Average
    log_mean_alpha: float
    base: _Base


class NearestNeighbors:
    """Scales the noise R of a static model by β = (mean of the K nearest α / ᾱ)^γ (PROBE Fig. 3).

    α is the error of a motion that a feature helped to estimate, ᾱ the mean of all α. What counts
    is how the α compare, not their unit: training may give them as RMSE in metres, as PROBE does,
    or relative to what others reached on the same step.

    Args:
        neighbors: K.
        exponent: γ, which maps small differences of α to β of several orders of magnitude; 0 is the
            static model.
        average: of the α, over the neighbours and over all. PROBE's is arithmetic; the geometric
            one, the exponential of the mean logarithm, does not let one α that is off by metres
            decide for all its neighbours.
        base: the static model whose noise is scaled.
        camera: the camera of the training data; None if that is not known.
        training: how the training data came about, in plain values that JSON can hold.
    """

    def __init__(
        self,
        neighbors: int = 100,
        exponent: float = 8.0,
        average: Average = "geometric",
        base: Fixed | StudentT | None = None,
        camera: StereoCamera | None = None,
        training: Mapping[str, Any] | None = None,
    ) -> None:
        self.neighbors = neighbors
        self.exponent = exponent
        self.average = average
        self.base = base or StudentT()
        self.camera = camera
        self.training = training or {}

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the predictors, in their order."""
        return self.metric_.columns

    def fit(
        self,
        predictors: FloatArray,
        alphas: FloatArray,
        *,
        metric: Metric | None = None,
    ) -> Self:
        """Take in N samples: places in the prediction space [N, M], and the error α > 0 of a motion
        at each, [N].

        Sets ``metric_``, ``index_`` and ``log_mean_alpha_`` (of ᾱ).

        Args:
            predictors, alphas: the samples.
            metric: what makes places near to each other; by default the columns are standardised
                over the samples, and none may be undefined.

        Raises:
            InputError: no samples, fewer than K, an α that is no positive number, or NaN where it
                may not be.
        """
        predictors = np.asarray(predictors, dtype=np.float64)
        alphas = np.asarray(alphas, dtype=np.float64)
        if len(predictors) != len(alphas):
            raise InputError(
                "training data", f"{len(predictors)} places, but {len(alphas)} errors α."
            )
        check_neighbors(self.neighbors, len(alphas))
        if not (np.isfinite(alphas) & (alphas > 0.0)).all():
            raise InputError("training data", "an error α is no positive number.")
        self.metric_ = metric or Metric.fitted(predictors)
        values = np.log(alphas) if self.average == "geometric" else alphas
        self.log_mean_alpha_ = float(
            np.mean(values) if self.average == "geometric" else np.log(np.mean(values))
        )
        self.index_ = NeighborIndex.build(self.metric_.coordinates(predictors), values)
        return self

    def log_relative_alpha(self, predictors: FloatArray) -> FloatArray:
        """ln(mean of the K nearest α / ᾱ) at each of N places [N, M]: [N]."""
        mean = self.index_.mean_of_nearest(
            self.metric_.coordinates(predictors), np.array([self.neighbors])
        )[:, 0]
        relative: FloatArray = (
            mean if self.average == "geometric" else np.log(mean)
        ) - self.log_mean_alpha_
        return relative

    def weights(self, predictors: FloatArray) -> FloatArray:
        """β of each of N features from its place [N, M]: [N]."""
        limit = np.log(LARGEST_WEIGHT)
        beta: FloatArray = np.exp(
            np.clip(self.exponent * self.log_relative_alpha(predictors), -limit, limit)
        )
        return beta

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """β R for each of N features from its place in the prediction space [N, M]."""
        return self.base.predict(predictors).scaled(self.weights(predictors))

    def check_camera(self, camera: StereoCamera) -> None:
        """Refuse a camera unlike that of the training data.

        Raises:
            InputError: says in what it differs.
        """
        refuse_other_camera(self.camera, camera)

    def samples(self) -> tuple[FloatArray, FloatArray]:
        """The training data as they lie in the model: places φ [N, M], NaN where undefined, and
        ln(α/ᾱ) [N]."""
        metric = self.metric_
        coordinates = self.index_.samples.T
        undefined = metric.may_be_undefined & (
            coordinates == (UNDEFINED * metric.weight).astype(np.float32)
        )
        places = np.where(
            undefined, np.nan, coordinates / metric.weight * metric.spread + metric.mean
        )
        values = self.index_.values.astype(np.float64)
        return places, (
            values if self.average == "geometric" else np.log(values)
        ) - self.log_mean_alpha_

    def to_file(self) -> ModelFile:
        """What a file needs to hold."""
        metric = self.metric_
        index = self.index_
        arrays = {field.name: getattr(index, field.name) for field in fields(NeighborIndex)}
        arrays |= {"mean": metric.mean, "spread": metric.spread, "weight": metric.weight}
        facts = {
            "columns": list(metric.columns),
            "may_be_undefined": list(metric.may_be_undefined),
            "neighbors": self.neighbors,
            "exponent": self.exponent,
            "average": self.average,
            "log_mean_alpha": self.log_mean_alpha_,
            "base": {
                "name": next(name for name, kind in CLASSICAL.items() if kind is type(self.base))
            },
            **origin_facts(self.camera, self.training),
        }
        return ModelFile("knn", arrays, facts)

    @staticmethod
    def from_file(file: ModelFile) -> NearestNeighbors:
        """The model that ``to_file`` put there.

        Raises:
            KeyError, ValueError, InputError: the file does not hold such a model.
        """
        facts = _Facts.of(file)
        arrays = file.arrays
        base = CLASSICAL[facts.base.name]()
        model = NearestNeighbors(
            facts.neighbors,
            facts.exponent,
            facts.average,
            base=base,
            camera=facts.camera,
            training=facts.training,
        )
        model.log_mean_alpha_ = facts.log_mean_alpha
        model.metric_ = Metric(
            facts.columns,
            facts.may_be_undefined,
            arrays["mean"],
            spread=arrays["spread"],
            weight=arrays["weight"],
        )
        model.index_ = NeighborIndex(
            **{field.name: arrays[field.name] for field in fields(NeighborIndex)}
        )
        model._check_arrays()
        return model

    def _check_arrays(self) -> None:
        """Arrays that do not fit together would be read beyond their ends."""
        index = self.index_
        metric = self.metric_
        first = index.first_of_cell
        dimension = len(self.columns)
        count = index.values.size
        expected: list[tuple[AnyArray, tuple[int, ...], type]] = [
            (index.centers, (dimension, first.size - 1), np.float32),
            (first, (first.size,), np.int64),
            (index.samples, (dimension, count), np.float32),
            (index.values, (count,), np.float32),
            *(
                (array, (dimension,), np.float64)
                for array in (metric.mean, metric.spread, metric.weight)
            ),
        ]
        fits = (
            all(
                a.shape == shape and a.dtype == dtype and np.isfinite(a).all()
                for a, shape, dtype in expected
            )
            and len(set(self.columns)) == dimension == len(metric.may_be_undefined)
            and (metric.spread > 0.0).all()
            and (self.average == "geometric" or (index.values > 0.0).all())
            and self.neighbors <= count
            and first.size >= 2
            and (first[0], first[-1]) == (0, count)
            and (first[1:] >= first[:-1]).all()
        )
        if not fits:
            raise ValueError("its arrays do not fit together")


def check_neighbors(neighbors: int, num_samples: int) -> None:
    """Refuse a K that there cannot be.

    Raises:
        InputError: K is larger than the data, or less than one.
    """
    if num_samples < neighbors:
        what = f"K is {neighbors}, but there are only {num_samples} samples."
        raise InputError("--neighbors", what, "Choose a smaller K, or train on more.")
    if neighbors < 1:
        raise InputError("--neighbors", f"K is {neighbors}.", "It must be at least 1.")
