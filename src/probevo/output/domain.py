"""How much of a run the noise model had to guess, in words."""

from __future__ import annotations

from probevo.output.table import readable

WARN_ABOVE = 0.1
"""Share of features out of domain from which on a reader is warned."""


def domain_text(out_of_domain: float) -> str:
    """The share, 0 … 1, of features out of domain."""
    return f"{readable(100.0 * out_of_domain)} % of the features solved with"


def domain_warning(out_of_domain: float | None) -> str | None:
    """What a large share of features out of domain means, and what to do about it; None if there is
    nothing to fear."""
    if out_of_domain is None or out_of_domain <= WARN_ABOVE:
        return None
    return (
        f"The noise model was trained on nothing like {domain_text(out_of_domain)}. For these it"
        " falls back on what it expects of any feature, and weights and covariance deserve less"
        " trust. Train it on recordings like this one, with probevo train."
    )
