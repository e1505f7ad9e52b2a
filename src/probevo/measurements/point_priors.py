"""Priors of the points that stereo observations show, before a motion is estimated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import (
    compiled,
    compiled_into_callers,
    invert_positive_definite,
    invert_symmetric_4,
)

UNKNOWN_PX2 = 1e6
"""Variance of a point of which nothing is known."""


class JitterPrior(NamedTuple):
    """A Gaussian over the rig's jitter ω in the previous frame: ω = mean + L η, η ~ N(0, I)."""

    mean: FloatArray
    """[3], rad."""
    root: FloatArray
    """L, [3, 3], rad."""
    sensitivity: FloatArray
    """∂(d, δ)/∂η of the M features with a state in the disparity filter, [M, 2, 3], px."""

    @property
    def cov(self) -> FloatArray:
        """Covariance of ω, [3, 3], rad²."""
        cov: FloatArray = self.root @ self.root.T
        return cov


@dataclass(frozen=True)
class DisparityPrior:
    """The disparity filter's prior of M features in the previous frame."""

    rows: IntArray
    """Indices of these features among all N, [M]."""
    disparity: FloatArray
    """Mean of the true disparity d, [M], px."""
    error: FloatArray
    """Mean of δ, the time-correlated error of the measured disparity in both frames, [M], px."""
    cov: FloatArray
    """Covariance of (d, δ), [M, 2, 2], px²."""
    jitter: JitterPrior | None = None
    """Prior of the rig's jitter in the previous frame; None if there is none."""

    @staticmethod
    def none() -> DisparityPrior:
        """Return a prior on no feature."""
        return DisparityPrior(
            rows=np.zeros(0, np.int64),
            disparity=np.zeros(0),
            error=np.zeros(0),
            cov=np.zeros((0, 2, 2)),
        )


@dataclass(frozen=True)
class PointPrior:
    """N points before a solve: s = (u, v, d) in the previous frame, and the time-correlated error δ
    of the measured disparities."""

    point: FloatArray
    """s, [N, 3], px."""
    error: FloatArray
    """Mean of δ, [N], px."""
    cov: FloatArray
    """Covariance (scale matrix) of (u, v, d, δ), [N, 4, 4], px²."""
    gain: FloatArray
    """K, with s = K y for a point of which only y is known, [N, 3, 4]."""

    @staticmethod
    def of(
        observed: FloatArray,
        scale: FloatArray,
        *,
        propagate: bool,
        time_correlated: FloatArray | None,
    ) -> PointPrior:
        """Build the prior from the observations alone.

        Without other information, d is the measured disparity and δ = 0. Whatever part of the
        measured disparity is δ is missing in d, so their errors are equal and opposite: covariance
        −τ².

        Args:
            observed: y in the previous frame, [N, 4], px.
            scale: R of these, [N, 4, 4], px².
            propagate: whether to propagate their noise; otherwise the points are exact.
            time_correlated: variance of δ, [N], px²; None if there is no such error.
        """
        count = len(observed)
        point = np.empty((count, 3))
        cov = np.zeros((count, 4, 4))
        gain = observation_to_point(
            np.ascontiguousarray(observed), scale, propagate, point=point, point_cov=cov
        )
        if time_correlated is not None:
            cov[:, 2, 2] += time_correlated
            cov[:, 3, 3] = time_correlated
            cov[:, 2, 3] = cov[:, 3, 2] = -time_correlated  # what is δ is missing in d
        return PointPrior(point=point, error=np.zeros(count), cov=cov, gain=gain)

    def given(self, prior: DisparityPrior) -> PointPrior:
        """Replace the disparities that the filter knows by its states, independent of u and v."""
        if not len(prior.rows):
            return self
        # The filter's states have no cross-covariance with (u, v): a track is where it was last
        # seen.
        point = self.point.copy()
        error = self.error.copy()
        cov = self.cov.copy()
        point[prior.rows, 2] = prior.disparity
        error[prior.rows] = prior.error
        cov[prior.rows, :2, 2:] = cov[prior.rows, 2:, :2] = 0.0
        cov[prior.rows, 2:, 2:] = prior.cov
        return replace(self, point=point, error=error, cov=cov)


@compiled
def observation_to_point(
    observed: FloatArray,
    scale: FloatArray,
    propagate: bool,
    point: FloatArray,
    point_cov: FloatArray,
) -> FloatArray:
    """Compute the point s = (u, v, d) behind each stereo observation y, and its scale matrix S.

    With ``propagate``, s = K y is the generalised least-squares estimate of y = H s under the scale
    R: the two rows are averaged by their information, and S = (Hᵀ R⁻¹ H)⁻¹. Without, s averages the
    rows plainly, as g does, and S is 0. Of a point whose R is singular nothing is known.

    Fills point [N, 3] from observed [N, 4], px, and that part of point_cov [N, 4, 4] from scale
    [N, 4, 4], px²; returns K, [N, 3, 4].
    """
    gain = np.empty((len(observed), 3, 4))
    inverse = np.empty((4, 4))
    lower = np.zeros((4, 4))
    weighted = np.empty((3, 4))
    normal = np.empty((3, 3))
    lower_3 = np.zeros((3, 3))
    S = np.zeros((3, 3))
    K = np.zeros((3, 4))
    _set_average(K)
    for n in range(len(observed)):
        is_new = propagate and n == 0
        # Most models give all features the same scale: invert it only if it differs from the last.
        if propagate and n > 0:
            for i in range(4):
                for j in range(4):
                    is_new = is_new or scale[n, i, j] != scale[n - 1, i, j]
        if is_new:
            # What stays if R is singular.
            _set_average(K)
            for i in range(3):
                for j in range(3):
                    S[i, j] = UNKNOWN_PX2 if i == j else 0.0
        if is_new and invert_symmetric_4(scale[n], inverse, lower):
            for k in range(4):  # Hᵀ R⁻¹; H maps (u, v, d) to (u, v, u − d, v)
                weighted[0, k] = inverse[0, k] + inverse[2, k]
                weighted[1, k] = inverse[1, k] + inverse[3, k]
                weighted[2, k] = -inverse[2, k]
            # Hᵀ R⁻¹ H, whose inverse is S; then K = S Hᵀ R⁻¹.
            for i in range(3):
                normal[i, 0] = weighted[i, 0] + weighted[i, 2]
                normal[i, 1] = weighted[i, 1] + weighted[i, 3]
                normal[i, 2] = -weighted[i, 2]
            if invert_positive_definite(normal, lower_3, S):
                for i in range(3):
                    for k in range(4):
                        K[i, k] = (
                            S[i, 0] * weighted[0, k]
                            + S[i, 1] * weighted[1, k]
                            + S[i, 2] * weighted[2, k]
                        )
        for i in range(3):
            for j in range(3):
                point_cov[n, i, j] = S[i, j]
            for k in range(4):
                gain[n, i, k] = K[i, k]
        for i in range(3):
            point[n, i] = (
                K[i, 0] * observed[n, 0]
                + K[i, 1] * observed[n, 1]
                + K[i, 2] * observed[n, 2]
                + K[i, 3] * observed[n, 3]
            )
    return gain


@compiled_into_callers
def _set_average(K: FloatArray) -> None:
    """Set K, [3, 4], to the plain average of g: u = u_l, v = ½ (v_l + v_r), d = u_l − u_r."""
    K[:] = 0.0
    K[0, 0] = K[2, 0] = 1.0
    K[2, 2] = -1.0
    K[1, 1] = K[1, 3] = 0.5
