"""PROBE-GK: the noise of each feature from the errors of similar features (thesis section 1.5).

Training data are errors e_i at points φ_i of the prediction space. The noise of a new feature at φ
is the posterior predictive Student-t of the errors around it (PROBE-GK eq. (12)),

    e | φ ~ t_ν(φ)(b(φ), Σ(φ)),

each error counting with a kernel k(φ, φ_i) that falls to zero with the distance; see ``posterior``.
The scales of the columns and the hyperparameters are chosen by cross-validation; see
``hyperparameter_search``. The fitted noise is stored at a few thousand centers and interpolated
between them; see ``centers``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import replace
from typing import Any, Self, get_args

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, IntArray, evenly
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.noise.base import RefersTo, StereoNoise, disparity_variance
from probevo.noise.gk.centers import Centers
from probevo.noise.gk.hyperparameter_search import check_given, choose_shape
from probevo.noise.gk.model_facts import KernelFacts, Variant, check_arrays
from probevo.noise.gk.posterior import KernelPosterior, KernelSamples, KernelShape
from probevo.noise.jitter_array import jitter_arrays, jitter_cov_of
from probevo.noise.metric import Metric
from probevo.noise.model_file import ModelFile
from probevo.noise.origin import origin_facts, refuse_other_camera
from probevo.noise.student_t_arrays import DIM, StudentTBatch
from probevo.noise.student_t_fit import check_errors

MAX_DOMAIN_SAMPLES = 5000
"""Number of samples from which the radius of the domain is estimated, at most."""
REACH_QUANTILE = 0.99
REACH_FACTOR = 2.0
"""Unless given, ρ is ``REACH_FACTOR`` times the distance within which the share ``REACH_QUANTILE``
of the training data have their K nearest samples."""
MIN_REACH = 1e-6
FAR_QUANTILE = 0.9
"""Outside of the domain, the noise is at least as large as at this quantile of the centers."""


class GeneralizedKernel:
    """Student-t noise with a scale, degrees of freedom and a bias for each feature.

    Args:
        variant: ``robust``, or ``published`` as in the paper (see ``posterior``).
        neighbors: K, the number of errors that contribute at a point. This and the next five
            arguments are chosen from the data if None.
        reach: support ρ, in standard deviations; samples farther away do not contribute.
        prior_counts: number of errors that the prior scale counts for; in the published variant
            this is ν₀ itself, which must exceed 3.
        dof_counts: the same for the prior degrees of freedom; np.inf holds them.
        bias_counts: the same for the bias, whose prior is zero; np.inf holds it there.
        weights: weight of each of the M standardised columns in the distance, [M].
        centers: number of points at which the fitted noise is stored.
        refers_to: whether the errors are residuals, or errors of single observations.
        camera: camera of the training data; None if it is unknown.
        training: settings, recordings and searches of the training, in plain values that JSON can
            hold.
        time_correlation_ratio: standard deviation of the disparity error that is common to both
            frames, over that of the error that is independent in each; ``fit`` does not estimate
            it.
        jitter_cov: covariance of the rig's jitter (``camera.rig_jitter``), [3, 3], rad²; None if it
            is not known. ``fit`` does not estimate it.
    """

    def __init__(
        self,
        variant: Variant = "robust",
        *,
        neighbors: int | None = None,
        reach: float | None = None,
        prior_counts: float | None = None,
        dof_counts: float | None = None,
        bias_counts: float | None = None,
        weights: FloatArray | None = None,
        centers: int = 2000,
        refers_to: RefersTo = "residual",
        camera: StereoCamera | None = None,
        training: Mapping[str, Any] | None = None,
        time_correlation_ratio: float = 0.0,
        jitter_cov: FloatArray | None = None,
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
        self.time_correlation_ratio = time_correlation_ratio
        self.time_correlation_ratio_ = time_correlation_ratio
        self.jitter_cov = jitter_cov

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the predictors, in their order."""
        return self.metric_.columns

    @property
    def scale_is_relative(self) -> bool:
        """Whether the odometry learns online how large the errors of a recording are against those
        of the training (``has_relative_scale``); not as published."""
        return self.variant == "robust"

    def fit(
        self,
        predictors: FloatArray,
        residuals: FloatArray,
        groups: IntArray | None = None,
        *,
        error_cov: FloatArray | None = None,
        metric: Metric | None = None,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> Self:
        """Learn from N samples; what was not given is chosen by cross-validation.

        Sets ``metric_``, ``weights_``, ``shape_``, ``search_``, ``posterior_``, ``centers_``,
        ``domain_radius_``, ``prior_`` and ``num_samples_``, which is N.

        Args:
            predictors: points φ of the samples, [N, M].
            residuals: their errors e, [N, 4], px.
            groups: number of the group of each sample, [N]. A group, such as a block of time of a
                drive, is held out as a whole; by default blocks of consecutive samples.
            error_cov: covariance of each error, [N, 4, 4], px²; None if they are known exactly.
            metric: names of the columns and their standardisation; by default over the samples, and
                none may be undefined.
            on_progress: called with the number of steps of the search that are done, and the
                largest number of them.

        Raises:
            InputError: there are no samples or columns, shapes do not fit, a value is NaN where it
                must be defined, or a given hyperparameter is not valid.
        """
        predictors = np.asarray(predictors, dtype=np.float64)
        residuals = np.asarray(residuals, dtype=np.float64)
        published = self.variant == "published"
        self._check_input(predictors, residuals, groups, error_cov)
        self.metric_ = metric or Metric.fitted(predictors)
        check_given(self._given() | {"centers": self.centers}, len(self.columns), published)

        # Choose the weights of the columns and the hyperparameters.
        samples = KernelSamples(self.metric_.coordinates(predictors), residuals, error_cov)
        self.weights_, shape, self.search_ = choose_shape(
            samples, groups, self._given(), published=published, on_progress=on_progress
        )
        if "weights" in self.search_:
            # By name, since the model may later be reduced to fewer columns.
            log = self.search_["weights"]
            log["candidates"] = [self.columns[m] for m in log["candidates"]]
            log["chosen"] = dict(zip(self.columns, self.weights_.tolist(), strict=True))
        self.metric_ = replace(self.metric_, weight=self.metric_.weight * self.weights_)
        if not self.metric_.weight.any():
            raise InputError("predictors", "no column that has a weight has one in the metric too.")

        # The posterior over all samples, in the chosen columns.
        samples = replace(samples, coordinates=self._coordinates(predictors))
        self.posterior_ = KernelPosterior.of(samples, published=published)
        center_rows = evenly(len(residuals), int(self.centers))
        points = samples.coordinates[center_rows]
        # A support that was not chosen covers nearly all points with K neighbours.
        if not np.isfinite(shape.reach):
            radius = self.posterior_.radius(points, shape.neighbors)
            reach = REACH_FACTOR * float(np.quantile(radius, REACH_QUANTILE))
            shape = replace(shape, reach=max(reach, MIN_REACH))
        self.shape_ = shape
        self.num_samples_ = len(residuals)

        # Store the predictive distribution at the centers, which are some of the samples, and learn
        # from the other samples where the domain ends.
        fitted, _ = self.posterior_.at(points, shape)
        self.centers_ = Centers.of(points, fitted)
        other_rows = np.setdiff1d(np.arange(len(residuals)), center_rows)
        other_rows = other_rows[evenly(len(other_rows), MAX_DOMAIN_SAMPLES)]
        self.domain_radius_ = self.centers_.domain_radius_of(samples.coordinates[other_rows])
        self.prior_ = self._far_prior(fitted)
        return self

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """Return the noise of n features from their points in the prediction space, [n, M].

        It is interpolated between the centers; its cost does not depend on N. Features whose
        predictors are undefined where they hardly ever were in training are out of domain.
        """
        coordinates = self._coordinates(predictors)
        students, out_of_domain = self.centers_.at(coordinates, self.domain_radius_, self.prior_)
        unknown = self.metric_.is_unknown(np.asarray(predictors, dtype=np.float64))
        return self._noise(students.replaced(unknown, self.prior_), out_of_domain | unknown)

    def predict_exact(self, predictors: FloatArray) -> StereoNoise:
        """Return the posterior of all samples instead of the interpolation between centers.

        Only a model with its samples can do so, not one that was read from a file. Places without a
        sample within reach are out of domain, and so are the features that are for ``predict``;
        there the noise is the posterior's own prior, which is not widened as in ``predict``.

        Args:
            predictors: points φ of n features in the prediction space, [n, M], in the units of
                their columns.

        Returns:
            Noise of (u_l, v_l, u_r, v_r) of n features, with scale matrices [n, 4, 4], px².
        """
        coordinates = self._coordinates(predictors)
        students, counts = self.posterior_.at(coordinates, self.shape_)
        unknown = self.metric_.is_unknown(np.asarray(predictors, dtype=np.float64))
        students = students.replaced(unknown, self.posterior_.prior)
        return self._noise(students, unknown | (counts == 0.0))

    def _noise(self, students: StudentTBatch, out_of_domain: BoolArray) -> StereoNoise:
        time_correlated = None
        if self.time_correlation_ratio_:
            time_correlated = self.time_correlation_ratio_**2 * disparity_variance(students.scale)
        return StereoNoise(
            scale=students.scale,
            dof=students.dof,
            bias=students.bias,
            refers_to=self.refers_to,
            out_of_domain=out_of_domain,
            time_correlated=time_correlated,
            jitter_cov=self.jitter_cov,
        )

    def _coordinates(self, predictors: FloatArray) -> FloatArray:
        return self.metric_.contributing(np.asarray(predictors, dtype=np.float64))

    def _far_prior(self, fitted: StudentTBatch) -> StudentTBatch:
        """Return the distribution outside of the domain, C = 1, given those at the centers.

        As published, it is the prior. In the robust variant the prior is widened to the size
        |Σ|^(1/d) of the worst tenth of the centers, if that is larger: features unlike all training
        data are rarely among the good ones.
        """
        prior = self.posterior_.prior
        if self.variant == "published":
            # Eq. (12) without any sample: ν* = ν₀ and Ψ* = ν₀ R̂.
            nu = self.shape_.prior_counts
            dof = nu - DIM + 1.0
            return StudentTBatch(scale=prior.scale * nu / dof, dof=np.array([dof]), bias=prior.bias)
        # |Σ|^(1/d), px², of the centers, [C], and of the prior
        sizes = np.exp(np.linalg.slogdet(fitted.scale)[1] / DIM)
        prior_size = np.exp(np.linalg.slogdet(prior.scale)[1] / DIM)[0]
        widening = max(1.0, float(np.quantile(sizes, FAR_QUANTILE) / prior_size))
        return StudentTBatch(scale=prior.scale * widening, dof=prior.dof, bias=prior.bias)

    def _check_input(
        self,
        predictors: FloatArray,
        residuals: FloatArray,
        groups: IntArray | None,
        error_cov: FloatArray | None,
    ) -> None:
        """Refuse settings that are unknown, and samples whose shapes do not fit together.

        Raises:
            InputError: names what is wrong.
        """
        if self.variant not in get_args(Variant) or self.refers_to not in get_args(RefersTo):
            raise InputError(
                "generalized kernel",
                f"variant {self.variant!r}, refers_to {self.refers_to!r}.",
                f"Known are {get_args(Variant)} and {get_args(RefersTo)}.",
            )
        check_errors(residuals, error_cov)
        num_groups = len(residuals if groups is None else groups)
        if not len(predictors) == len(residuals) == num_groups:
            raise InputError(
                "training data",
                f"{len(predictors)} points, {len(residuals)} residuals and {num_groups} groups.",
            )

    def _given(self) -> dict[str, Any]:
        """Return the hyperparameters that need not be chosen, by name."""
        names = ("neighbors", "reach", "prior_counts", "dof_counts", "bias_counts", "weights")
        return {name: value for name in names if (value := getattr(self, name)) is not None}

    def without_samples(self) -> GeneralizedKernel:
        """Return the same model without its samples, as small as its file.

        It cannot ``predict_exact``.
        """
        model = copy(self)
        model.__dict__.pop("posterior_", None)  # a model of a file has none
        return model

    def subset(self, columns: IntArray) -> GeneralizedKernel:
        """Return the same model on some of its columns, given their indices.

        Raises:
            ValueError: a column that is left out has a weight.
        """
        metric = self.metric_
        left_out = np.setdiff1d(np.arange(len(self.columns)), columns)
        if metric.weight[left_out].any():
            raise ValueError("a column that contributes cannot be left out")
        model = copy(self)
        model.metric_ = metric.subset(columns)
        if hasattr(self, "weights_"):  # a model of a file has none
            model.weights_ = self.weights_[columns]
        return model

    def check_camera(self, camera: StereoCamera) -> None:
        """Refuse a camera unlike the one of the training data.

        Raises:
            InputError: the cameras differ; the message says in what.
        """
        refuse_other_camera(self.camera, camera)

    def to_file(self) -> ModelFile:
        """Return the content of the file of this model: its centers, and no training data."""
        metric = self.metric_
        prior = self.prior_
        shape = self.shape_
        arrays: dict[str, AnyArray] = {
            **metric.arrays,
            "places": self.centers_.points,
            "values": self.centers_.parameters,
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
            "domain_radius": self.domain_radius_,
            "prior_counts": shape.prior_counts,
            "refers_to": self.refers_to,
            "time_correlation_ratio": self.time_correlation_ratio_,
            "samples": self.num_samples_,
            **origin_facts(self.camera, self.training),
        }
        return ModelFile("gk", arrays | jitter_arrays(self.jitter_cov), facts)

    @staticmethod
    def from_file(file: ModelFile) -> GeneralizedKernel:
        """Read the model that ``to_file`` has described.

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
            time_correlation_ratio=facts.time_correlation_ratio,
            jitter_cov=jitter_cov_of(file),
        )
        model.metric_ = Metric.from_arrays(facts.columns, facts.may_be_undefined, arrays)
        model.centers_ = Centers(points=arrays["places"], parameters=arrays["values"])
        model.prior_ = StudentTBatch(
            scale=arrays["prior_scale"], dof=arrays["prior_dof"], bias=arrays["prior_bias"]
        )
        model.shape_ = KernelShape(
            reach=facts.reach, neighbors=facts.neighbors, prior_counts=facts.prior_counts
        )
        model.num_samples_ = facts.samples
        model.domain_radius_ = facts.domain_radius
        check_arrays(model.metric_, model.centers_, model.prior_)
        return model
