"""Meanings of the terms on the pages of ``probevo inspect`` and in its tables."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from markupsafe import Markup

from probevo.output.templating import rendered

_FACTS = {
    "Features": "Points that were followed into this frame.",
    "Out of domain": (
        "Share of the frame’s features that are unlike all training data; for these, the prior"
        " holds."
    ),
    "Time-correlated error": (
        "The part of a disparity’s error that is the same in both frames of a step."
    ),
    "Rig": (
        "Rotation of the right camera relative to the left one that is new in each frame, and moves"
        " all features together."
    ),
    "ν": (
        "Degrees of freedom of the Student-t: the fewer, the more outliers; with infinitely many it"
        " is a Gaussian."
    ),
    "Noise of": (
        "What σ describes: where a feature is seen in one frame (single observations), or the"
        " residual of a step, from two frames (residuals as a whole)."
    ),
}
"""Meanings of the facts at the top of a page that models of all kinds have."""
_COLUMNS = {
    "weight": (
        "how much a standard deviation counts in the distance between features; a column without"
        " one is not used"
    ),
    "gain": (
        "what it adds, beside those above, to the mean log-likelihood of a feature’s error, in"
        " nats, on blocks of time that were left out"
    ),
    "training": "mean and standard deviation of all features learned from",
    "this frame": "mean of the frame’s features",
}
"""Meanings of the heads of the tables of predictors."""


def meanings(names: Collection[str], own: Mapping[str, str]) -> dict[str, str]:
    """Return the meanings of those facts of a page that have one, in the order of the facts.

    Args:
        names: names of the facts.
        own: meanings of the facts that only models of this kind have.
    """
    known = {**_FACTS, **own}
    return {name: known[name] for name in names if name in known}


def column_notes(heads: Collection[str], *, has_frame: bool, samples: str) -> tuple[str, ...]:
    """Explain the heads of a table of predictors, one sentence each.

    Args:
        heads: titles of its columns.
        has_frame: whether the table is about a frame.
        samples: name of the samples that the table describes without a frame.
    """
    whose = "the frame’s features" if has_frame else samples
    known = {**_COLUMNS, "undefined": f"share of {whose} for which it has no value"}
    return tuple(f"{head.capitalize()}: {known[head]}." for head in heads if head in known)


def terms_section(terms: Mapping[str, str]) -> Markup:
    """Explain the facts at the top of a page, folded away; empty without any."""
    return rendered("terms", terms=terms) if terms else Markup("")
