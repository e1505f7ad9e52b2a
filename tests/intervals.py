"""Intervals for statistics whose distribution is known: ``from intervals import chi2_interval``."""

from scipy.stats import chi2


def chi2_interval(dof: int, count: int, confidence: float = 0.999) -> tuple[float, float]:
    """Two-sided interval of the average of ``count`` independent χ² values of ``dof`` degrees.

    The average NEES of consistent estimates lies in it with this probability: their sum is χ² of
    ``count`` times ``dof`` degrees of freedom.
    """
    tail = 0.5 * (1.0 - confidence)
    low = chi2.ppf(tail, df=count * dof) / count
    high = chi2.ppf(1.0 - tail, df=count * dof) / count
    return float(low), float(high)
