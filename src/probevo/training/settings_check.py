"""Settings of a training that do not go together, refused before the long work."""

from __future__ import annotations

from probevo.errors import InputError
from probevo.training.settings import KernelSettings, TrainSettings

NEIGHBORS_ONLY = (
    "base",
    "iterations",
    "subset",
    "contrast",
    "relative",
    "average",
    "neighbors",
    "exponent",
)
KERNEL_ONLY = ("variant", "neighbors", "reach", "prior_counts", "bias", "centers", "turns")
"""Of ``settings.gk``; the rest holds for the static Student-t too."""


def check_settings(settings: TrainSettings) -> None:
    """Refuse what the kind of model cannot do, and what it would leave aside in silence.

    Raises:
        InputError: names the flag.
    """
    kind = settings.kind
    _check_supervision(settings)
    if settings.supervision == "position" and kind != "knn":
        what = (
            f"position is for --kind knn alone: {kind} takes the truth as a motion, and positions"
            " give no rotation."
        )
        raise InputError(
            "--supervision", what, "Take sparse if attitudes are known too, or else loop or none."
        )
    if kind == "student-t" and settings.predictors is not None:
        raise InputError(
            "--predictors", "student-t takes none: all features are alike to it.", "Leave it out."
        )
    default = TrainSettings()
    kernel = settings.gk
    wrong = (
        []
        if kind == "knn"
        else [n for n in NEIGHBORS_ONLY if getattr(settings, n) != getattr(default, n)]
    )
    fields = (
        ()
        if kind == "gk"
        else KERNEL_ONLY
        if kind == "student-t"
        else tuple(type(kernel).model_fields)
    )
    wrong += [f"gk.{n}" for n in fields if getattr(kernel, n) != getattr(default.gk, n)]
    if wrong:
        raise InputError(
            f"--{wrong[0].replace('_', '-')}",
            f"--kind {kind} does not take it.",
            _cure(wrong[0], kind),
        )
    if kernel.variant == "published":
        _check_published(kernel)
    if kernel.refers_to == "residual" and settings.odometry.solver.method == "alignment":
        what = (
            "residual has no noise of single observations, which --odometry.solver.method alignment"
            " needs."
        )
        raise InputError("--gk.refers-to", what, "Take observation, or the method reprojection.")
    if (kernel.truth_sigma_m is None) != (kernel.truth_sigma_deg is None):
        given, other = ("m", "deg") if kernel.truth_sigma_deg is None else ("deg", "m")
        what = f"it means nothing without --gk.truth-sigma-{other}."
        raise InputError(
            f"--gk.truth-sigma-{given}", what, "Give both, or none to have them estimated."
        )


def _check_supervision(settings: TrainSettings) -> None:
    if settings.every_s and settings.supervision not in ("sparse", "position"):
        what = f"--supervision {settings.supervision} does not take it."
        raise InputError(
            "--every-s", what, "Leave it out, or take --supervision sparse or position."
        )
    given = [
        name for name in ("m", "deg") if getattr(settings.gk, f"truth_sigma_{name}") is not None
    ]
    if given and settings.supervision == "none" and settings.kind != "knn":
        raise InputError(
            f"--gk.truth-sigma-{given[0]}", "--supervision none uses no truth.", "Leave it out."
        )


def _check_published(kernel: KernelSettings) -> None:
    if kernel.neighbors is not None:
        raise InputError(
            "--gk.neighbors", "as published, all within --gk.reach contribute.", "Leave it out."
        )
    if kernel.prior_counts is not None and kernel.prior_counts <= 3.0:
        what = (
            f"{kernel.prior_counts:g} is too few: an inverse Wishart of four dimensions needs more"
            " than 3."
        )
        raise InputError("--gk.prior-counts", what, "Take more, or leave it out.")


def _cure(name: str, kind: str) -> str:
    if name == "neighbors" and kind == "gk":
        return "Its K is --gk.neighbors."
    return "Leave it out, or choose another --kind."
