"""Features of a run that lie outside of the noise model's domain, in words."""

from __future__ import annotations

from probevo.output.table import readable

WARN_ABOVE = 0.1
"""Share of features out of domain above which a reader is warned."""


def domain_text(out_of_domain: float) -> str:
    """Say which share, 0 … 1, of the features is out of domain."""
    return f"{readable(100.0 * out_of_domain)} % of the features solved with"


def domain_warning(out_of_domain: float | None) -> str | None:
    """Warn of a large share of features out of domain, and say what to do; None if it is small.

    Args:
        out_of_domain: the share, 0 … 1; None if the noise model has no domain.
    """
    if out_of_domain is None or out_of_domain <= WARN_ABOVE:
        return None
    return (
        f"{domain_text(out_of_domain)} lie outside the training data of the noise model. For these"
        " it falls back on its prior, and their weights and covariances deserve less trust. Train"
        " it on recordings like this one, with probevo train."
    )
