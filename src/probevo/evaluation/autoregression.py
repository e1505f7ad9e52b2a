"""Autoregressive models of a series, which tell its innovations from what the past predicts.

Any stationary series with a spectrum that has no zero is an autoregression of enough orders, so
that the order that the series supports makes a model of it without an assumption about its
correlation: the autoregressive sieve (Bühlmann 1997, "Sieve bootstrap for time series").
"""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from probevo.arrays import FloatArray

_ORDERS_PER_DECADE = 10.0
"""The highest order is ten times the decimal logarithm of the length: the custom since Akaike, and
more than the criterion chooses."""
_MIN_VALUES_PER_ORDER = 4
"""Values for each order, at least: the criterion corrects for fewer, but its expansion fails."""
_ROUNDING = 1e-9
"""Variation below this, relative to the largest value, is rounding."""


def fit_autoregression(values: FloatArray) -> FloatArray:
    """Fit an autoregression Σ aⱼ x(k−j) = e(k) to a series, [K]: a with a₀ = 1, [1 + order].

    The coefficients are Burg's (Percival and Walden 1993, sec. 9.5), whose model is stable. Their
    order has the least corrected information criterion (Hurvich and Tsai 1989). Without need, a
    mean that is estimated hides a part of the correlation (Kendall 1954), so that the series has
    none unless the criterion of Schwarz (1978) asks for one. A constant has order 0.
    """
    count = len(values)
    best: FloatArray = np.ones(1)
    if np.ptp(values) <= _ROUNDING * np.abs(values).max():
        return best
    highest = min(int(_ORDERS_PER_DECADE * np.log10(count)), count // _MIN_VALUES_PER_ORDER)
    # No order is the true one, but there is a mean or none: hence the two criteria.
    least = np.inf
    for mean, mean_penalty in ((0.0, 0.0), (values.mean(), np.log(count))):
        for order, (coefficients, variance) in enumerate(_burg(values - mean, highest)):
            parameters = order + 1  # and the variance
            order_penalty = 2.0 * parameters * count / (count - parameters - 1)
            criterion = count * np.log(variance) + order_penalty + mean_penalty
            if criterion < least:
                least = criterion
                best = coefficients
    return best


def innovations(coefficients: FloatArray, series: FloatArray) -> FloatArray:
    """Filter what the past does not predict out of series, [..., K], with zeros before each."""
    return np.asarray(lfilter(coefficients, [1.0], series, axis=-1))


def series_of(coefficients: FloatArray, innovations: FloatArray) -> FloatArray:
    """Compute the series that have given innovations, [..., K]: the inverse of ``innovations``."""
    return np.asarray(lfilter([1.0], coefficients, innovations, axis=-1))


def _burg(values: FloatArray, highest: int) -> list[tuple[FloatArray, float]]:
    """Fit all orders up to the highest: coefficients, [1 + order], and variance of innovations."""
    variance = float(np.mean(values**2))
    coefficients: FloatArray = np.ones(1)
    fits = [(coefficients, variance)]
    # Errors of the prediction from the past, and of that from the future.
    forward = values
    backward = values
    for _ in range(highest):
        forward = forward[1:]
        backward = backward[:-1]
        power = float(forward @ forward + backward @ backward)
        if power == 0.0:
            break  # the past predicts all of it
        # The reflection coefficient with the least power of both errors, and Levinson's recursion.
        reflection = -2.0 * float(forward @ backward) / power
        past = backward + reflection * forward
        forward = forward + reflection * backward
        backward = past
        longer = np.append(coefficients, 0.0)
        coefficients = longer + reflection * longer[::-1]
        variance *= max(1.0 - reflection**2, _ROUNDING**2)
        fits.append((coefficients, variance))
    return fits
