"""The trainers of the generalized kernel (PROBE-GK), and of the static Student-t it starts from."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.config.training import (
    KERNEL_ONLY,
    KERNEL_PREDICTORS,
    PROBE_ONLY,
    KernelSettings,
    TrainSettings,
)
from probevo.errors import InputError
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.predictors import PredictionSpace
from probevo.training.gk.expectation_maximization import (
    learn_kernel,
    learn_student_t,
    num_iterations,
    num_static_iterations,
)
from probevo.training.trainer import OTHER_KIND, Trainer, TrainingContext


def learn_pruned_kernel(context: TrainingContext) -> GeneralizedKernel:
    """Learn a generalized kernel, and keep only the columns of predictors that contribute.

    A run need not compute the other predictors.
    """
    model = learn_kernel(context)
    return model.subset(contributing_columns(context.space, model.metric_.weight))


def contributing_columns(space: PredictionSpace, weight: FloatArray) -> IntArray:
    """Return the columns of the predictors of which at least one column has a positive weight.

    Args:
        space: predictors with M columns in all.
        weight: weight of each column, [M].
    """
    # A predictor is computed as a whole, so that one column that contributes keeps its others.
    columns_per_predictor = [len(predictor.columns) for predictor in space.predictors]
    predictor_of_column = np.repeat(np.arange(len(space.predictors)), columns_per_predictor)
    contributing = predictor_of_column[weight > 0.0]
    return np.flatnonzero(np.isin(predictor_of_column, contributing))


def check_kernel_settings(settings: TrainSettings) -> None:
    """Refuse settings of ``settings.gk`` that contradict each other or the rest.

    Raises:
        InputError: names the flag.
    """
    kernel = settings.gk
    given = [name for name in ("m", "deg") if getattr(kernel, f"truth_sigma_{name}") is not None]
    if given and settings.supervision == "none":
        raise InputError(
            f"--gk.truth-sigma-{given[0]}", "--supervision none uses no truth.", "Leave it out."
        )
    # The published kernel has a fixed support and an inverse-Wishart prior.
    if kernel.variant == "published":
        _check_published(kernel)
    # Alignment weighs the points of both frames, and so needs the noise of each observation.
    if kernel.refers_to == "residual" and settings.odometry.solver.method == "alignment":
        raise InputError(
            "--gk.refers-to",
            "residual has no noise of single observations, which"
            " --odometry.solver.method alignment needs.",
            "Take observation, or the method reprojection.",
        )
    # The truth of a motion has six components.
    if len(given) == 1:
        missing = "deg" if given[0] == "m" else "m"
        raise InputError(
            f"--gk.truth-sigma-{given[0]}",
            f"it means nothing without --gk.truth-sigma-{missing}.",
            "Give both, or none to have them estimated.",
        )


def _check_published(kernel: KernelSettings) -> None:
    if kernel.neighbors is not None:
        raise InputError(
            "--gk.neighbors", "as published, all within --gk.reach contribute.", "Leave it out."
        )
    if kernel.bias:
        raise InputError(
            "--gk.bias",
            "as published, the errors have no bias.",
            "Leave it out, or take --gk.variant robust.",
        )
    if kernel.prior_counts is not None and kernel.prior_counts <= 3.0:
        raise InputError(
            "--gk.prior-counts",
            f"{kernel.prior_counts:g} is too few: an inverse Wishart of four dimensions needs more"
            " than 3.",
            "Take more, or leave it out.",
        )


_UNUSED = dict.fromkeys(PROBE_ONLY, OTHER_KIND)

GK_TRAINER = Trainer(
    learn=learn_pruned_kernel,
    num_iterations=num_iterations,
    default_predictors=KERNEL_PREDICTORS,
    thins_steps=True,
    unused_settings=_UNUSED | {"neighbors": "Its K is --gk.neighbors."},
    check=check_kernel_settings,
)
STUDENT_T_TRAINER = Trainer(
    learn=learn_student_t,
    num_iterations=num_static_iterations,
    thins_steps=True,
    unused_settings=_UNUSED | {f"gk.{name}": OTHER_KIND for name in KERNEL_ONLY},
    check=check_kernel_settings,
)
