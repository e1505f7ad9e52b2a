"""PROBE: a scalar weight for each feature, from its nearest neighbours in the prediction space (PROBE IV-B, Fig. 3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Any, Literal, Self

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.likeness import difference
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.noise.base import StereoNoise
from probevo.noise.fixed import Fixed
from probevo.noise.metric import UNDEFINED, Metric
from probevo.noise.model_file import ModelFile
from probevo.noise.neighbors import NeighborIndex
from probevo.noise.student_t import StudentT

Average = Literal["arithmetic", "geometric"]
BASE_NAMES: dict[type[Fixed] | type[StudentT], str] = {Fixed: "fixed", StudentT: "student-t"}
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
        average: of the α, over the neighbours and over all. PROBE's is arithmetic; the geometric one, the exponential
            of the mean logarithm, does not let one α that is off by metres decide for all its neighbours.
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
        self.neighbors, self.exponent, self.average = neighbors, exponent, average
        self.base, self.camera, self.training = base or StudentT(), camera, training or {}

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
        """Take in N samples: places in the prediction space [N, M], and the error α > 0 of a motion at each, [N].

        Sets ``metric_``, ``index_`` and ``log_mean_alpha_`` (of ᾱ).

        Args:
            predictors, alphas: the samples.
            metric: what makes places near to each other; by default the columns are standardised over the samples, and
                none may be undefined.

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
        self.metric_ = metric or Metric.fitted(predictors)
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
        return self.base.predict(predictors).scaled(self.weights(predictors))

    def check_camera(self, camera: StereoCamera) -> None:
        """Refuse a camera unlike that of the training data.

        Raises:
            InputError: says in what it differs.
        """
        unlike = difference(camera, self.camera) if self.camera else ""
        if unlike:
            what = f"it was trained with another camera: {unlike}."
            raise InputError("noise model", what.replace("its", "this one's", 1), "Train one with this camera.")

    def samples(self) -> tuple[FloatArray, FloatArray]:
        """The training data as they lie in the model: places φ [N, M], NaN where undefined, and ln(α/ᾱ) [N]."""
        standard = self.index_.samples.T / self.metric_.weight
        places = np.where(standard == UNDEFINED, np.nan, standard * self.metric_.spread + self.metric_.mean)
        values = self.index_.values.astype(np.float64)
        return places, (values if self.average == "geometric" else np.log(values)) - self.log_mean_alpha_

    def to_file(self) -> ModelFile:
        """What a file needs to hold."""
        metric, index = self.metric_, self.index_
        arrays = {field.name: getattr(index, field.name) for field in fields(NeighborIndex)}
        arrays |= {"mean": metric.mean, "spread": metric.spread, "weight": metric.weight}
        facts = {
            "columns": list(metric.columns),
            "may_be_undefined": list(metric.may_be_undefined),
            "neighbors": self.neighbors,
            "exponent": self.exponent,
            "average": self.average,
            "log_mean_alpha": self.log_mean_alpha_,
            "base": {"name": BASE_NAMES[type(self.base)]},
            "camera": asdict(self.camera) | {"size_px": list(self.camera.size_px or ())} if self.camera else None,
            "training": dict(self.training),
        }
        return ModelFile("knn", arrays, facts)

    @staticmethod
    def from_file(file: ModelFile) -> NearestNeighbors:
        """The model that ``to_file`` put there.

        Raises:
            KeyError, TypeError, ValueError: the file does not hold such a model.
        """
        facts, arrays = file.facts, file.arrays
        camera = facts["camera"]
        if camera is not None:
            camera = StereoCamera(**camera | {"size_px": tuple(camera["size_px"]) or None})
        base = {name: kind for kind, name in BASE_NAMES.items()}[facts["base"]["name"]]()
        model = NearestNeighbors(
            facts["neighbors"], facts["exponent"], facts["average"], base, camera, facts["training"]
        )
        model.log_mean_alpha_ = facts["log_mean_alpha"]
        names, undefined = tuple(facts["columns"]), tuple(facts["may_be_undefined"])
        model.metric_ = Metric(names, undefined, arrays["mean"], arrays["spread"], arrays["weight"])
        model.index_ = NeighborIndex(**{field.name: arrays[field.name] for field in fields(NeighborIndex)})
        model._check_shapes()
        return model

    def _check_shapes(self) -> None:
        """Arrays that do not fit together would be read beyond their ends."""
        index, dimension = self.index_, len(self.columns)
        count, cells = len(index.values), index.centers.shape[1]
        metric = (self.metric_.may_be_undefined, self.metric_.mean, self.metric_.spread, self.metric_.weight)
        fits = (
            all(len(part) == dimension for part in metric)
            and index.centers.shape == (dimension, cells)
            and index.samples.shape == (dimension, count)
            and index.first_of_cell.shape == (cells + 1,)
            and (np.diff(index.first_of_cell) >= 0).all()
            and (index.first_of_cell[0], index.first_of_cell[-1]) == (0, count)
            and 1 <= self.neighbors <= count
            and all(array.dtype == np.float32 for array in (index.centers, index.samples, index.values))
        )
        if not fits:
            raise ValueError("its arrays do not fit together")
