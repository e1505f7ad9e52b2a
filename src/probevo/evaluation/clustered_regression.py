"""Robust linear regression whose errors are correlated within frames, and from frame to frame.

The estimates maximise a Student-t likelihood. Their variances come from the sandwich A⁻¹ B A⁻¹
(Huber 1967). B is computed from the sums of the scores of each frame (Liang and Zeger 1986); hence
the variances hold whatever the errors of a frame have in common. Frames share errors, too, for
example where a rig flexes: B is the spectrum of these sums at the lowest frequencies. A recording
has few of those, and so σ itself is uncertain. A test with Student's t allows for this (Lazarus,
Lewis, Stock and Watson 2018).

A feature may keep its error for as long as it is seen: where the sums of the scores of each feature
over all frames scatter more, these give the variances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import dct
from scipy.special import stdtr

from probevo.arrays import FloatArray, IntArray

DOF = 5.0
"""Degrees of freedom of the likelihood: between Gaussian errors and outliers."""
ITERATIONS = 30
"""Iterations of IRLS, far more than it needs to converge."""
COSINES = 0.4
"""Number of cosines that show the variance of a sum over K frames, as a multiple of K^⅔. With more
of them, slow errors seem smaller than they are; with fewer, less is significant. The balance
follows Lazarus, Lewis, Stock and Watson (2018), for frames with a correlation of about 0.7."""
MIN_COSINES = 4
"""Minimum number of cosines, for recordings of a second or two. With only two, Student's t exceeds
±28 once in 800 times, and hardly any error would be significant."""
_MEDIAN_OF_ABSOLUTE = 0.6745
"""Median of the absolute value of a standard normal variable."""


@dataclass(frozen=True)
class Regression:
    """Estimates of P coefficients."""

    values: FloatArray
    """The coefficients, [P]."""
    sigma: FloatArray
    """Their standard deviations, [P]."""
    dof: int
    """Degrees of freedom of their estimates."""
    cost: float
    """Negative logarithm of likelihood and prior, up to a constant."""

    def p_value(self, value: float, sigma: float) -> float:
        """Return how probable a value at least as far from zero is, if the truth is zero."""
        return two_sided_p(value / sigma, self.dof)


def two_sided_p(t: float, dof: float) -> float:
    """Return the probability that Student's t with that many degrees of freedom exceeds ±t."""
    return float(2.0 * stdtr(max(dof, 1.0), -abs(t)))


def regress(
    design: FloatArray,
    target: FloatArray,
    frame: IntArray,
    *,
    prior_sigma: FloatArray,
    track: IntArray | None = None,
) -> Regression:
    """Estimate β of target = design β + noise.

    Args:
        design: [N, P].
        target: [N].
        frame: the frame of each row, [N], ascending.
        prior_sigma: standard deviations of the Gaussian prior of β around zero, [P]. They keep
            coefficients that nothing constrains finite.
        track: the feature of each row, [N], whose errors may be correlated for as long as it is
            seen; None without features.

    Returns:
        The estimates. What the data do not constrain has the prior's standard deviation.
    """
    prior = np.diag(prior_sigma**-2.0)
    beta: FloatArray = np.zeros(design.shape[1])
    scale = max(float(np.median(np.abs(target))) / _MEDIAN_OF_ABSOLUTE, 1e-12)
    # IRLS of a Student-t, by EM: weights, coefficients, scale.
    for _ in range(ITERATIONS):
        residual = target - design @ beta
        weight = (DOF + 1.0) / (DOF + (residual / scale) ** 2)
        information = (design * weight[:, None]).T @ design / scale**2 + prior
        right_hand_side = design.T @ (weight * target) / scale**2
        beta = np.asarray(np.linalg.solve(information, right_hand_side), dtype=np.float64)
        residual = target - design @ beta
        scale = max(float(np.sqrt(np.mean(weight * residual**2))), 1e-12)
    # Sandwich covariance A⁻¹ B A⁻¹ at the estimate.
    squared = (residual / scale) ** 2
    weight = (DOF + 1.0) / (DOF + squared)
    # A: derivative of the estimating equations; ψ' = (ν + 1)(ν − r²)/(ν + r²)² of ψ = w r.
    slope = (DOF + 1.0) * (DOF - squared) / (DOF + squared) ** 2
    bread = np.linalg.inv((design * slope[:, None]).T @ design / scale**2 + prior)
    # A⁻¹ times the score of each row, [N, P]: how far it moves the estimates. Errors that cancel in
    # one coefficient and not in another have a variance of their own in each.
    moves = design @ bread * (weight * residual / scale**2)[:, None]
    frame_sums = _sums(moves, frame)
    count, num_coefficients = frame_sums.shape
    dof = _num_cosines(count, num_coefficients)
    variance = _long_run_variance(frame_sums, dof) * _unbiased(count, num_coefficients)
    if track is not None:
        order = np.argsort(track, kind="stable")
        track_sums = _sums(moves[order], track[order])
        track_variance = np.sum(track_sums**2, axis=0) * _unbiased(
            len(track_sums), num_coefficients
        )
        # Either of the two uncertain variances may be too small. The degrees of freedom of the test
        # stay the frames'.
        variance = np.maximum(variance, track_variance)
    variance += np.diag(bread @ prior @ bread)
    # −ln of N Student-t densities of this scale, and of the Gaussian prior
    cost = (
        0.5 * (DOF + 1.0) * float(np.log1p(squared / DOF).sum())
        + len(target) * float(np.log(scale))
        + 0.5 * float(beta @ prior @ beta)
    )
    return Regression(values=beta, sigma=np.sqrt(variance), dof=dof, cost=cost)


def _sums(rows: FloatArray, group: IntArray) -> FloatArray:
    """Add up the rows, [N, P], of each group, [K, P], which are consecutive."""
    # A group begins where the number changes.
    starts = np.flatnonzero(np.r_[True, np.diff(group) != 0])
    return np.asarray(np.add.reduceat(rows, starts, axis=0))


def _unbiased(count: int, num_coefficients: int) -> float:
    """Return by how much more that many sums scatter around the truth than around the fit.

    The fit takes away as many degrees of freedom as it has coefficients.
    """
    return count / max(count - num_coefficients, 1)


def _num_cosines(count: int, num_coefficients: int) -> int:
    """Return how many cosines show the variance of a sum over that many frames.

    There are no more of them than degrees of freedom that the fit has left.
    """
    wanted = round(float(COSINES * count ** (2.0 / 3.0)))
    return max(min(max(wanted, MIN_COSINES), count - num_coefficients), 1)


def _long_run_variance(frame_sums: FloatArray, num_cosines: int) -> FloatArray:
    """Estimate the variance of the sum of K values that are correlated with their neighbours.

    Their cosine transforms √(2/K) Σ u_k cos(π j (k − ½)/K), j = 1 … M, are independent, and K times
    the variance of each is the variance of the sum, if the correlation lasts for much less than
    2K/M frames. The mean of their squares has M degrees of freedom (Lazarus, Lewis, Stock and
    Watson, "HAR inference: recommendations for practice", J. Business & Economic Statistics 36,
    2018).

    Args:
        frame_sums: values of P sums, whose mean is zero, [K, P].
        num_cosines: M.

    Returns:
        The variances, [P].
    """
    transformed = dct(frame_sums, type=2, norm="ortho", axis=0)[1 : num_cosines + 1]
    return np.asarray(len(frame_sums) * np.mean(transformed**2, axis=0))
