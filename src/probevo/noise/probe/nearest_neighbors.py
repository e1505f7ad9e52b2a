"""PROBE: the covariance of each feature is R times a scalar β, learned from nearest neighbours.

Training estimates motions from small subsets of the features. The error α of each such motion is
stored at the point φ in the prediction space of the features that gave it. For a new feature,

    β = (ᾱ_K(φ) / ᾱ)^γ,        R_i = β_i R,

where ᾱ_K(φ) is the mean α of the K stored samples nearest to φ, and ᾱ the mean of all samples:
features like the ones that gave poor motions get a larger covariance (PROBE section IV-B, Fig. 3).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Self, get_args

import numpy as np
from pydantic import Field, field_validator

from probevo.arrays import AnyArray, FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.noise.base import NoiseModel, StereoNoise, has_relative_scale
from probevo.noise.metric import FARTHEST, MAX_WEIGHT, Metric, have_shapes
from probevo.noise.model_file import ModelFile
from probevo.noise.origin import OriginFacts, origin_facts, refuse_other_camera
from probevo.noise.probe.base_file import BaseFacts, base_from_parts, base_parts
from probevo.noise.probe.neighbor_index import NeighborIndex
from probevo.noise.student_t import StudentT

Average = Literal["arithmetic", "geometric"]
MAX_BETA = 1e4
"""Bound of β and of 1/β: beyond it a feature contributes nothing, or dominates all others."""
MAX_LOG_ALPHA = 700.0
"""The exponential of a larger number would overflow."""


class NearestNeighbors:
    """Noise R of a static model, scaled for each feature by β = (ᾱ_K/ᾱ)^γ (PROBE Fig. 3).

    Only ratios of the α matter, not their unit: training may give them as RMSE in metres, as PROBE
    does, or relative to the other subsets of the same step.

    Args:
        neighbors: K.
        exponent: γ, which maps small differences of α to several orders of magnitude of β; 0 gives
            the static model.
        average: kind of the means ᾱ_K and ᾱ. PROBE's is arithmetic. The geometric mean, which is
            the exponential of the mean logarithm, keeps a single α that is off by metres from
            dominating a mean of millimetres.
        base: static model whose noise is scaled; by default a Student-t.
        camera: camera of the training data; None if it is unknown.
        training: settings, recordings and searches of the training, in plain values that JSON can
            hold.
    """

    def __init__(
        self,
        neighbors: int = 100,
        exponent: float = 8.0,
        average: Average = "geometric",
        *,
        base: NoiseModel | None = None,
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

    @property
    def scale_is_relative(self) -> bool:
        """Whether the scale of the static model is relative; β only compares features with each
        other."""
        return has_relative_scale(self.base)

    def fit(
        self,
        predictors: FloatArray,
        alphas: FloatArray,
        *,
        metric: Metric | None = None,
    ) -> Self:
        """Store N samples: points in the prediction space, and the error of a motion at each.

        Sets ``metric_``, ``index_`` and ``log_mean_alpha_``, which is ln ᾱ.

        Args:
            predictors: points φ of the samples, [N, M].
            alphas: errors α > 0 of the motions, [N].
            metric: distance between points; by default the columns are standardised over the
                samples, and none may be undefined.

        Raises:
            InputError: there are fewer samples than K, γ is negative, the average is unknown, an α
                is no positive number, or a predictor is NaN where it must be defined.
        """
        predictors = np.asarray(predictors, dtype=np.float64)
        alphas = np.asarray(alphas, dtype=np.float64)
        if len(predictors) != len(alphas):
            raise InputError(
                "training data", f"{len(predictors)} points, but {len(alphas)} errors α."
            )
        check_neighbors(self.neighbors, len(alphas))
        if not 0.0 <= self.exponent < np.inf or self.average not in get_args(Average):
            raise InputError(
                "nearest neighbours",
                f"exponent {self.exponent}, average {self.average!r}.",
                f"The exponent is 0 or more, and known averages are {get_args(Average)}.",
            )
        if not (np.isfinite(alphas) & (alphas > 0.0)).all():
            raise InputError("training data", "an error α is not a positive number.")
        metric = metric or Metric.fitted(predictors)
        # An undefined value is to have others like it for most of its K neighbours; the rest of
        # them are those with the lowest values.
        num_undefined = np.isnan(predictors).sum(axis=0)
        self.metric_ = metric.with_undefined_apart(num_undefined >= 0.5 * self.neighbors)
        # The geometric mean is an arithmetic mean of logarithms, so the index stores these.
        if self.average == "geometric":
            values = np.log(alphas)
            self.log_mean_alpha_ = float(np.mean(values))
        else:
            values = alphas
            self.log_mean_alpha_ = float(np.log(np.mean(values)))
        self.index_ = NeighborIndex.build(self.metric_.coordinates(predictors), values)
        return self

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """Return β R for each of N features from its point in the prediction space, [N, M]."""
        beta = self.weights(predictors)
        return self.base.predict(predictors).scaled(beta)

    def weights(self, predictors: FloatArray) -> FloatArray:
        """Compute β = (ᾱ_K/ᾱ)^γ at N points [N, M], bounded by ``MAX_BETA``: [N]."""
        # Logarithms, because a large exponent would overflow; β and 1/β have the same bound.
        bound = np.log(MAX_BETA)
        log_beta = self.exponent * self.log_relative_alpha(predictors)
        beta: FloatArray = np.exp(np.clip(log_beta, -bound, bound))
        return beta

    def log_relative_alpha(self, predictors: FloatArray) -> FloatArray:
        """Compute ln(ᾱ_K/ᾱ) at N points [N, M]: [N]."""
        coordinates = self.metric_.coordinates(predictors)
        # Mean over K of α, or of ln α, [N]
        mean = self.index_.mean_of_nearest(coordinates, np.array([self.neighbors]))[:, 0]
        return self._log_alpha(mean) - self.log_mean_alpha_

    def samples(self) -> tuple[FloatArray, FloatArray]:
        """Return the training samples, in the order of the index and to its single precision.

        Returns:
            Places φ [N, M], NaN where undefined; and ln(α/ᾱ) of each, [N].
        """
        metric = self.metric_
        coordinates = self.index_.samples.T
        # A value is undefined if it lies exactly where the metric puts such values.
        undefined = metric.may_be_undefined & (
            coordinates == (metric.undefined_at * metric.weight).astype(np.float32)
        )
        # The inverse of the standardisation
        points = coordinates / metric.weight * metric.spread + metric.mean
        values = self.index_.values.astype(np.float64)
        return np.where(undefined, np.nan, points), self._log_alpha(values) - self.log_mean_alpha_

    def _log_alpha(self, values: FloatArray) -> FloatArray:
        """Return ln α of values of the index, which holds α or ln α depending on the average."""
        return values if self.average == "geometric" else np.log(values)

    def check_camera(self, camera: StereoCamera) -> None:
        """Refuse a camera unlike the one of the training data.

        Raises:
            InputError: the cameras differ; the message says in what.
        """
        refuse_other_camera(self.camera, camera)

    def to_file(self) -> ModelFile:
        """Return the content of the file of this model, its samples in the order of the index.

        Raises:
            InputError: the base is of a class that a file cannot name.
        """
        metric = self.metric_
        index = self.index_
        base_arrays, base_facts = base_parts(self.base)
        arrays: dict[str, AnyArray] = {
            "centers": index.centers,
            "first_of_cell": index.first_of_cell,
            "samples": index.samples,
            "values": index.values,
            **metric.arrays,
            **base_arrays,
        }
        facts = {
            "columns": list(metric.columns),
            "may_be_undefined": list(metric.may_be_undefined),
            # JSON takes no numbers of NumPy.
            "neighbors": int(self.neighbors),
            "exponent": float(self.exponent),
            "average": self.average,
            "log_mean_alpha": self.log_mean_alpha_,
            "base": base_facts,
            **origin_facts(self.camera, self.training),
        }
        return ModelFile("knn", arrays, facts)

    @staticmethod
    def from_file(file: ModelFile) -> NearestNeighbors:
        """Read the model that ``to_file`` has described.

        Raises:
            KeyError, ValueError, InputError: the file does not hold such a model.
        """
        facts = _Facts.of(file)
        arrays = file.arrays
        model = NearestNeighbors(
            neighbors=facts.neighbors,
            exponent=facts.exponent,
            average=facts.average,
            base=base_from_parts(facts.base, arrays),
            camera=facts.camera,
            training=facts.training,
        )
        model.log_mean_alpha_ = facts.log_mean_alpha
        model.metric_ = Metric.from_arrays(facts.columns, facts.may_be_undefined, arrays)
        model.index_ = NeighborIndex(
            centers=arrays["centers"],
            first_of_cell=arrays["first_of_cell"],
            samples=arrays["samples"],
            values=arrays["values"],
        )
        model._check_arrays()
        return model

    def _check_arrays(self) -> None:
        """Refuse arrays that do not fit together: the compiled loops would read beyond their ends.

        Raises:
            ValueError: they do not.
        """
        index = self.index_
        first = index.first_of_cell
        dimension = len(self.columns)
        count = index.values.size
        expected: list[tuple[AnyArray, tuple[int, ...], type]] = [
            (index.centers, (dimension, first.size - 1), np.float32),
            (first, (first.size,), np.int64),
            (index.samples, (dimension, count), np.float32),
            (index.values, (count,), np.float32),
        ]
        fits = (
            self.metric_.is_valid
            and have_shapes(expected)
            and (np.abs(index.samples) <= FARTHEST * MAX_WEIGHT).all()
            and (np.abs(index.centers) <= FARTHEST * MAX_WEIGHT).all()
            and (self.average == "geometric" or (index.values > 0.0).all())
            and self.neighbors <= count
            # The cells are consecutive, in order, and cover all samples. The comparison of
            # neighbours avoids differences, which may wrap around.
            and first.size >= 2
            and first[0] == 0
            and first[-1] == count
            and (first[1:] >= first[:-1]).all()
        )
        if not fits:
            raise ValueError("its arrays do not fit together")


class _Facts(OriginFacts):
    """The facts that a file states beside its arrays."""

    columns: tuple[str, ...]
    may_be_undefined: tuple[bool, ...]
    neighbors: int = Field(ge=1)
    exponent: float = Field(ge=0)
    average: Average
    log_mean_alpha: float = Field(ge=-MAX_LOG_ALPHA, le=MAX_LOG_ALPHA)
    base: BaseFacts

    @field_validator("training")
    @classmethod
    def _check_searches(cls, training: dict[str, Any]) -> dict[str, Any]:
        searches = training.get("searches", {})
        if not searches.keys() <= {"neighbors", "exponent"}:
            raise ValueError("a search is for neither neighbors nor exponent")
        if any(
            not search["candidates"]
            or "errors" not in search
            or not isinstance(search.get("chosen"), int | float)
            for search in searches.values()
        ):
            raise ValueError("a search lacks candidates, errors or what was chosen")
        return training


def check_neighbors(neighbors: int, num_samples: int) -> None:
    """Refuse a K below one or above the number of samples.

    Raises:
        InputError: K is not possible.
    """
    if num_samples < neighbors:
        raise InputError(
            "--neighbors",
            f"K is {neighbors}, but there are only {num_samples} samples.",
            "Choose a smaller K, or train on more.",
        )
    if neighbors < 1:
        raise InputError("--neighbors", f"K is {neighbors}.", "It must be at least 1.")
