"""Expectation maximisation of noise models over drives (PROBE-GK Alg. 3).

Each iteration has two steps:

- E-step: the motions of all drives given the noise model, fused with whatever truth is known, and
  the errors of the features at these motions (``expectation``).
- M-step: the noise model that is fitted to these errors, and the covariance of the rig's jitter
  (``training.gk.jitter``).

If the truth is exact, the motions are known, and one iteration suffices (PROBE-GK Alg. 1). The
noise starts as the static Student-t, which is itself fitted by EM. This is EM in spirit: motions
enter as Gaussians around the solve, errors of single observations by a fixed point, and the gyro
does not contribute. The likelihood of an iteration is the residuals' at its motions.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from probevo.arrays import FloatArray
from probevo.config.training import TrainSettings
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.student_t import StudentT
from probevo.training.gk.error_samples import (
    ErrorSamples,
    FeatureLikelihoods,
    gather_error_samples,
)
from probevo.training.gk.jitter import initial_covariance, learned_covariance
from probevo.training.gk.recording_factors import (
    fit_kernel_with_factors,
    fit_with_factors,
    recording_factors,
)
from probevo.training.gk.time_correlation import TimeCorrelationProfile, smallest_likely_ratio
from probevo.training.trainer import TrainingContext

STATIC_ITERATIONS = 5
"""Iterations of the static Student-t without time correlation; as many follow with it."""
TIME_CORRELATION_GAIN = 0.03
"""Smallest gain in likelihood, nats a feature, for which time-correlated errors are accepted. Where
errors are new in each frame, but their noise differs from place to place, time correlation seems to
gain up to 0.02 (point world, six laws); on KITTI it gains 0.15 to 0.65."""
TIME_CORRELATION_STEP = 0.5
"""Share of the way to the likeliest time correlation taken in each iteration: it explains the same
residuals as the scale, and both together would overshoot."""
Model = StudentT | GeneralizedKernel


def learn_student_t(context: TrainingContext) -> StudentT:
    """Learn the one Student-t, with its full scale matrix, under which the drives are likeliest.

    The time correlation is learned in a second half of the iterations, and kept only if it makes
    the residuals of the same features likelier by a margin: where noise differs from place to
    place, a model that is the same everywhere may mistake this for time correlation.
    """
    model = StudentT(
        refers_to=context.settings.gk.refers_to,
        camera=context.drives[0].camera,
        training={"iterations": []},
        time_correlation_ratio=0.0,
        jitter_cov=_initial_jitter(context.settings),
    )
    uncorrelated = model
    without: FeatureLikelihoods | None = None
    last = num_static_iterations(context.settings) - 1
    for number in range(last + 1):
        has_correlation = number >= STATIC_ITERATIONS
        if number == STATIC_ITERATIONS:
            uncorrelated = model
        stored = context.checkpoint.em_model(number)
        if isinstance(stored, StudentT):
            model = stored
        else:
            model, likelihoods = _iterated(context, model, learns_time_correlation=has_correlation)
            # The likelihoods belong to the model before the iteration: the first iteration with
            # time correlation evaluates the last model without.
            if number == STATIC_ITERATIONS:
                without = likelihoods
            if has_correlation and number == last:
                if without is None:
                    # The iteration was done before the training was stopped and resumed.
                    without = _errors_under(context, uncorrelated, _unreported).likelihoods
                gain = likelihoods.gain_over(without)
                model.training = {**model.training, "time_correlation_gain": gain}
            context.checkpoint.keep_em_model(number, model)
        context.progress.iteration_done()
    return _chosen(context, model, uncorrelated)


def _iterated(
    context: TrainingContext, previous: StudentT, *, learns_time_correlation: bool
) -> tuple[StudentT, FeatureLikelihoods]:
    """Return the model after one EM iteration, and the likelihoods of the features under the model
    before."""
    # E-step: motions given the noise, and the errors of the features at these motions.
    samples = _errors_under(context, previous, context.progress.within_iteration)
    # M-step: the Student-t of these errors, whose uncertainty is in their covariance.
    noisy = samples.with_noise()
    model = copy(previous)
    factors = recording_factors(previous.training, len(context.drives))
    factors = fit_with_factors(model, noisy, factors)
    model.scale_is_relative_ = True  # the size of a new recording's errors is not known
    model.jitter_cov = updated_jitter(previous.jitter_cov, samples)
    if learns_time_correlation:
        model.time_correlation_ratio_ = updated_time_correlation(
            previous.time_correlation_ratio_, noisy
        )
    model.training = {
        "iterations": [*previous.training["iterations"], samples.progress],
        "recording_factors": factors.tolist(),
    }
    return model, samples.likelihoods


def _errors_under(
    context: TrainingContext, model: StudentT, on_part: Callable[[float], None]
) -> ErrorSamples:
    """Return the errors of the features at the motions that a static model finds.

    Args:
        context: the drives.
        model: the noise.
        on_part: is called with the share of the drives that is done.
    """
    factors = recording_factors(model.training, len(context.drives))
    return gather_error_samples(context, model, on_part, factors=factors)


def _chosen(context: TrainingContext, last: StudentT, uncorrelated: StudentT) -> StudentT:
    """Decide between the last model and the one without time correlation, and complete what the
    model says of its training."""
    model = last
    kept: dict[str, Any] = {}
    gain = last.training.get("time_correlation_gain")
    if gain is not None:
        kept["time_correlation_gain"] = gain
        if gain < TIME_CORRELATION_GAIN:
            model = uncorrelated
    # The first iteration with time correlation has evaluated the model without.
    num_iterations_kept = len(model.training["iterations"])
    iterations = last.training["iterations"]
    if model is uncorrelated:
        iterations = iterations[: num_iterations_kept + 1]
    kept["kept_iteration"] = num_iterations_kept
    kept["recording_factors"] = model.training["recording_factors"]
    model.training = training_facts(context, iterations, searches={}) | kept
    return model


@dataclass(frozen=True)
class _KernelHistory:
    """The iterations of a kernel so far.

    The first one chooses the hyperparameters that are not given, and all later ones take them.
    """

    iterations: Sequence[Mapping[str, float]]
    """What each iteration says of its progress."""
    searches: Mapping[str, Any]
    """The log of the choice; empty before the first iteration."""
    given: Mapping[str, Any]
    """Hyperparameters of the next iteration, as ``GeneralizedKernel`` takes them."""

    def facts_after(
        self, model: GeneralizedKernel, factors: FloatArray, progress: Mapping[str, float]
    ) -> dict[str, Any]:
        """Return the history after one more iteration, in values that JSON can hold.

        Args:
            model: fitted in that iteration.
            factors: factor of its variances in each recording, [D].
            progress: what the iteration says of itself.
        """
        chosen = model.shape_.as_given() | {"weights": model.weights_.tolist()}
        return {
            "iterations": [*self.iterations, progress],
            "searches": self.searches or model.search_,
            # JSON does not know infinity.
            "given": {name: None if value == np.inf else value for name, value in chosen.items()},
            "recording_factors": factors.tolist(),
        }

    @staticmethod
    def of_facts(facts: Mapping[str, Any]) -> _KernelHistory:
        """Undo ``facts_after``."""
        given = {name: np.inf if value is None else value for name, value in facts["given"].items()}
        given["weights"] = np.array(given["weights"])
        return _KernelHistory(facts["iterations"], facts["searches"], given)


def learn_kernel(context: TrainingContext) -> GeneralizedKernel:
    """Learn the generalized kernel of the drives (PROBE-GK Alg. 3).

    Hyperparameters that are not given are chosen in the first iteration and then kept.
    """
    settings = context.settings.gk
    # The noise model of the first E-step is static. The iterations of both are numbered
    # consecutively, for the checkpoint.
    static = learn_student_t(context)
    previous: Model = static
    num_recordings = len(context.drives)
    model = GeneralizedKernel()
    history = _KernelHistory(iterations=[], searches={}, given=settings.given())
    first = num_static_iterations(context.settings)
    for number in range(first, num_iterations(context.settings)):
        stored = context.checkpoint.em_model(number)
        if isinstance(stored, GeneralizedKernel):
            model = stored
        else:
            # E-step: motions given the noise, and the errors of the features at these motions.
            samples = gather_error_samples(
                context,
                previous,
                lambda share: context.progress.within_iteration(0.5 * share),
                factors=recording_factors(previous.training, num_recordings),
            )
            # M-step: the kernel over these errors.
            noisy = samples.with_noise()
            model = GeneralizedKernel(
                settings.variant,
                **history.given,
                centers=settings.centers,
                refers_to=settings.refers_to,
            )
            factors = fit_kernel_with_factors(
                model,
                noisy,
                num_recordings,
                metric=context.metric,
                on_progress=lambda done, total: context.progress.within_iteration(
                    0.5 + 0.5 * done / max(total, 1)
                ),
            )
            model.jitter_cov = updated_jitter(previous.jitter_cov, samples)
            if previous.time_correlation_ratio_:
                model.time_correlation_ratio_ = updated_time_correlation(
                    previous.time_correlation_ratio_, noisy
                )
            model.training = history.facts_after(model, factors, samples.progress)
            model = model.without_samples()
            context.checkpoint.keep_em_model(number, model)
        # From what the model's file holds, so that a resumed training has the same bits.
        history = _KernelHistory.of_facts(model.training)
        model.weights_ = history.given["weights"]
        previous = model
        context.progress.iteration_done()

    # One more E-step measures how well the last model explains the residuals.
    factors = recording_factors(model.training, num_recordings)
    last = gather_error_samples(context, model, _unreported, factors=factors).progress
    model.camera = context.drives[0].camera
    iterations = [*history.iterations, last]
    facts = training_facts(context, iterations, searches=history.searches)
    model.training = facts | {
        "kept_iteration": len(iterations) - 1,
        "recording_factors": factors.tolist(),
    }
    return model


def _unreported(share: float) -> None:
    """Report no progress: an E-step beside the iterations."""


def updated_time_correlation(previous: float, samples: ErrorSamples) -> float:
    """Return the time correlation κ, half the way from the previous one to the likeliest."""
    profile = TimeCorrelationProfile.of_rows(samples.profile)
    return TIME_CORRELATION_STEP * (previous + smallest_likely_ratio(profile))


def updated_jitter(previous: FloatArray | None, samples: ErrorSamples) -> FloatArray | None:
    """Return the covariance of the rig's jitter by the samples, [3, 3], rad².

    If no step was solved with a jitter, as for a rig that is taken as rigid, it is the previous
    one.
    """
    if not len(samples.jitter_moments):
        return previous
    return learned_covariance(samples.jitter_moments)


def num_static_iterations(settings: TrainSettings) -> int:
    """Return how many EM iterations the static Student-t takes."""
    return STATIC_ITERATIONS * (2 if settings.gk.learns_time_correlation else 1)


def num_iterations(settings: TrainSettings) -> int:
    """Return how many EM iterations the generalized kernel takes, the static ones included."""
    return num_static_iterations(settings) + settings.gk.iterations


def _initial_jitter(settings: TrainSettings) -> FloatArray | None:
    """Return the covariance of the jitter to begin with, [3, 3], rad²; None if it is not learned.

    It is not learned if the rig is taken as calibrated, if the solver is an alignment, which does
    not model common errors, or if a bias is learned, which moves all features in the same way. The
    published variant has no jitter: PROBE-GK takes the rig as rigid.
    """
    odometry = settings.odometry
    kernel = settings.gk
    learns = odometry.self_calibration and odometry.solver.method == "reprojection"
    if not learns or kernel.bias or kernel.variant == "published":
        return None
    return initial_covariance()


def training_facts(
    context: TrainingContext,
    iterations: Sequence[Mapping[str, float]],
    searches: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the metadata that a model keeps of its training, in plain values."""
    return {
        "settings": context.settings.model_dump(mode="json"),
        "recordings": [dict(recording) for recording in context.recordings],
        "iterations": [dict(iteration) for iteration in iterations],
        "searches": dict(searches),
    }
