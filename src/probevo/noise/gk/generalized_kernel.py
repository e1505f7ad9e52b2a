"""PROBE-GK: the full noise of each feature, by a generalized kernel over the prediction space
(thesis 4.4)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from typing import Any, Self, get_args

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, IntArray, evenly
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.noise.base import Refers, StereoNoise, disparity_variance
from probevo.noise.gk.centers import Centers
from probevo.noise.gk.hyperparameter_search import check_given, choose_shape
from probevo.noise.gk.model_facts import KernelFacts, Variant, check_arrays
from probevo.noise.gk.posterior import KernelPosterior, KernelShape
from probevo.noise.metric import Metric
from probevo.noise.model_file import ModelFile
from probevo.noise.origin import origin_facts, refuse_other_camera
from probevo.noise.student_t_fit import DIM, Students, check_errors

MOST_TO_SEE = 5000
"""Samples by which it is seen where the domain ends."""
REACH = 2.0
"""Without one given, ρ is so many times the distance within which 99 % of the training data have
their K nearest."""


class GeneralizedKernel:
    """Student-t noise of each feature, with a scale, a dof and a bias of its own, from the errors
    of those like it.

    Args:
        variant: ``robust``, or ``published`` as in the paper (see ``kernel_posterior``).
        neighbors: K, the errors that a place learns from; chosen from the data if None, as are the
            next five.
        reach: ρ, in standard deviations; farther samples do not contribute.
        prior_counts: how many errors the prior counts for; ν₀ of the published form, over 3.
        dof_counts, bias_counts: the same for the degrees of freedom, and for the bias; np.inf holds
            them at the prior.
        weights: how much a standard deviation of each of the M columns counts, [M].
        centers: how many places the posterior is distilled into.
        refers_to: what the errors are: residuals, or errors of single observations.
        camera: the camera of the training data; None if that is not known.
        training: how the training data came about, in plain values that JSON can hold.
        time_correlation: how many times as large the error of a disparity is that is the same in both
            frames, as the one that is new in each; ``fit`` does not choose it.
    """

    def __init__(
        self,
        variant: Variant = "robust",
        neighbors: int | None = None,
        reach: float | None = None,
        prior_counts: float | None = None,
        dof_counts: float | None = None,
        bias_counts: float | None = None,
        weights: FloatArray | None = None,
        centers: int = 2000,
        refers_to: Refers = "residual",
        camera: StereoCamera | None = None,
        training: Mapping[str, Any] | None = None,
        time_correlation: float = 0.0,
    ) -> None:
        self.variant = variant
        self.neighbors = neighbors
        self.reach = reach
        self.prior_counts = prior_counts
        self.dof_counts = dof_counts
        self.bias_counts = bias_counts
        self.weights = weights
        self.centers = centers
        self.refers_to = refers_to
        self.camera = camera
        self.training = training or {}
        self.time_correlation = time_correlation

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the predictors, in their order."""
        return self.metric_.columns

    def fit(
        self,
        predictors: FloatArray,
        residuals: FloatArray,
        groups: IntArray | None = None,
        *,
        spread: FloatArray | None = None,
        metric: Metric | None = None,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> Self:
        """Take in N samples, and choose whatever was not given by the likelihood of groups left
        out.

        Sets ``metric_``, ``weights_``, ``shape_``, ``posterior_``, ``prior_``, ``centers_``,
        ``edge_``, ``samples_`` and ``search_``.

        Args:
            predictors: places of the samples, [N, M].
            residuals: their errors, [N, 4], px.
            groups: samples of one group, such as a block of time of a drive, are left out together,
                [N]; consecutive samples by default.
            spread: covariance of what is not known of each error, [N, 4, 4], px².
            metric: names of the columns and their standardisation; by default over the samples, and
                none may be undefined.
            on_progress: called with how many steps of the search are done, and how many there are
                at most.

        Raises:
            InputError: no samples or columns, shapes that do not fit, NaN where it may not be, or a
                given shape of the kernel that is not valid.
        """
        if self.variant not in get_args(Variant) or self.refers_to not in get_args(Refers):
            what = f"variant {self.variant!r}, refers_to {self.refers_to!r}."
            raise InputError(
                "generalized kernel", what, f"Known are {get_args(Variant)} and {get_args(Refers)}."
            )
        predictors = np.asarray(predictors, dtype=np.float64)
        residuals = np.asarray(residuals, dtype=np.float64)
        check_errors(residuals, spread)
        if not len(predictors) == len(residuals) == len(residuals if groups is None else groups):
            what = f"{len(predictors)} places, {len(residuals)} residuals"
            raise InputError(
                "training data",
                f"{what} and {len(residuals if groups is None else groups)} groups.",
            )
        self.metric_ = metric or Metric.fitted(predictors)
        published = self.variant == "published"
        check_given(self._given() | {"centers": self.centers}, len(self.columns), published)
        self.weights_, shape, self.search_ = choose_shape(
            self.metric_.coordinates(predictors),
            residuals,
            spread,
            groups=groups,
            given=self._given(),
            published=published,
            on_progress=on_progress,
        )
        if "weights" in self.search_:  # by name: the model may be cut down to fewer columns
            found = self.search_["weights"]
            found["candidates"] = [self.columns[m] for m in found["candidates"]]
            found["chosen"] = dict(zip(self.columns, self.weights_.tolist(), strict=True))
        self.metric_ = replace(self.metric_, weight=self.metric_.weight * self.weights_)
        if not self.metric_.weight.any():
            raise InputError("predictors", "no column that has a weight has one in the metric too.")
        coordinates = self._coordinates(predictors)
        self.posterior_ = KernelPosterior.of(coordinates, residuals, spread, published=published)
        chosen = evenly(len(residuals), int(self.centers))
        if not np.isfinite(shape.reach):
            radius = self.posterior_.radius(coordinates[chosen], shape.neighbors)
            shape = replace(shape, reach=max(REACH * float(np.quantile(radius, 0.99)), 1e-6))
        self.shape_ = shape
        self.samples_ = len(residuals)
        students, _ = self.posterior_.at(coordinates[chosen], shape)
        self.centers_ = Centers.of(coordinates[chosen], students)
        others = np.setdiff1d(np.arange(len(residuals)), chosen)
        self.edge_ = self.centers_.edge_of(
            coordinates[others[:: max(1, len(others) // MOST_TO_SEE)]]
        )
        self.prior_ = self._beyond(students)
        return self

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """The noise of n features from their places in the prediction space, [n, M], whatever N was
        to learn from."""
        coordinates = self._coordinates(predictors)
        return self._noise(*self.centers_.at(coordinates, self.edge_, self.prior_))

    def predict_exact(self, predictors: FloatArray) -> StereoNoise:
        """The same from all samples instead of the centers; only of a model that was not read from
        a file.

        Out of domain is what has no sample within reach; there the prior itself holds, no wider
        than it is.
        """
        coordinates = self._coordinates(predictors)
        students, counts = self.posterior_.at(coordinates, self.shape_)
        return self._noise(students, counts == 0.0)

    def without_samples(self) -> GeneralizedKernel:
        """The same model, but for ``predict_exact``: what is left takes no more room than its file."""
        model = copy(self)
        del model.posterior_
        return model

    def kept(self, columns: IntArray) -> GeneralizedKernel:
        """The same model on some of its columns only, the others being of weight 0."""
        metric = self.metric_
        model = copy(self)
        if metric.weight[np.setdiff1d(np.arange(len(self.columns)), columns)].any():
            raise ValueError("a column that contributes cannot be left out")
        model.metric_ = metric.kept(columns)
        model.weights_ = self.weights_[columns]
        return model

    def check_camera(self, camera: StereoCamera) -> None:
        """Refuse a camera unlike that of the training data.

        Raises:
            InputError: says in what it differs.
        """
        refuse_other_camera(self.camera, camera)

    def to_file(self) -> ModelFile:
        """What a file needs to hold: the centers, and none of the training data."""
        metric = self.metric_
        prior = self.prior_
        shape = self.shape_
        arrays: dict[str, AnyArray] = {
            "mean": metric.mean,
            "spread": metric.spread,
            "weight": metric.weight,
            "places": self.centers_.places,
            "values": self.centers_.values,
            "prior_scale": prior.scale,
            "prior_dof": prior.dof,
            "prior_bias": prior.bias,
        }
        facts = {
            "columns": list(metric.columns),
            "may_be_undefined": list(metric.may_be_undefined),
            "variant": self.variant,
            "neighbors": shape.neighbors,
            "reach": shape.reach,
            "edge": self.edge_,
            "prior_counts": shape.prior_counts,
            "refers_to": self.refers_to,
            "time_correlation": self.time_correlation,
            "samples": self.samples_,
            **origin_facts(self.camera, self.training),
        }
        return ModelFile("gk", arrays, facts)

    @staticmethod
    def from_file(file: ModelFile) -> GeneralizedKernel:
        """The model that ``to_file`` put there.

        Raises:
            KeyError, ValueError, InputError: the file does not hold such a model.
        """
        facts = KernelFacts.of(file)
        arrays = file.arrays
        model = GeneralizedKernel(
            facts.variant,
            refers_to=facts.refers_to,
            camera=facts.camera,
            training=facts.training,
            time_correlation=facts.time_correlation,
        )
        model.metric_ = Metric(
            facts.columns,
            facts.may_be_undefined,
            arrays["mean"],
            spread=arrays["spread"],
            weight=arrays["weight"],
        )
        model.centers_ = Centers(arrays["places"], arrays["values"])
        model.prior_ = Students(arrays["prior_scale"], arrays["prior_dof"], arrays["prior_bias"])
        model.shape_ = KernelShape(facts.reach, facts.neighbors, facts.prior_counts)
        model.samples_ = facts.samples
        model.edge_ = facts.edge
        check_arrays(model.metric_, model.centers_, model.prior_)
        return model

    def _noise(self, students: Students, out_of_domain: BoolArray) -> StereoNoise:
        time_correlated = (
            self.time_correlation**2 * disparity_variance(students.scale)
            if self.time_correlation
            else None
        )
        return StereoNoise(
            students.scale,
            students.dof,
            students.bias,
            refers_to=self.refers_to,
            out_of_domain=out_of_domain,
            time_correlation=time_correlated,
        )

    def _coordinates(self, predictors: FloatArray) -> FloatArray:
        return self.metric_.contributing(np.asarray(predictors, dtype=np.float64))

    def _given(self) -> dict[str, Any]:
        names = ("neighbors", "reach", "prior_counts", "dof_counts", "bias_counts", "weights")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def _beyond(self, students: Students) -> Students:
        """What holds beyond the edge: the prior, as wide as the worst tenth of the centers at
        least."""
        prior = self.posterior_.prior
        if self.variant == "published":
            dof = self.shape_.prior_counts - DIM + 1.0
            return Students(
                prior.scale * self.shape_.prior_counts / dof, np.array([dof]), prior.bias
            )
        size, own = (np.exp(np.linalg.slogdet(part.scale)[1] / DIM) for part in (students, prior))
        return Students(
            prior.scale * max(1.0, float(np.quantile(size, 0.9) / own[0])), prior.dof, prior.bias
        )
