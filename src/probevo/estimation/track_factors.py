"""The tracks of a step as factors of a factor graph, for a back end other than probevo's own solve.

A factor joins the pose of the previous frame, that of the current frame, a point, and the errors
that all tracks have in common: those of the disparity filter, and the rig's jitter. Its residual
has seven rows: the error of the point s = (u, v, d) against what the previous frames say of it, and
that of the current observation y'. Both contain the time-correlated error δ of the disparity, so
that their covariance is one matrix.
The derivation is in docs/other-back-ends.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import NEAREST, Intrinsics
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.disparity_filter_numba import NUM_LATENT
from probevo.measurements.jitter_numba import JITTER_DIM, JITTER_PAIR_DIM
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks

EXACT_PX = 1e-3
"""Standard deviation of a point that is held where the previous camera saw it: small against any
noise of a pixel, and large enough that the covariance of the factor can be inverted."""
BEHIND_PX = 1e3
"""Error of the current observation of a point that is behind the camera."""
_POINT = slice(0, 3)
_CURR = slice(3, 7)
"""Rows of the residual that are of the point (u, v, d), and of y'."""
_D = 2
_U_R = 5
"""Rows of d and of u_r', the only one in which δ is."""


class FactorLinearization(NamedTuple):
    """The residual of one factor and its derivatives."""

    residual: FloatArray
    """(s, f(T s)) minus the measured values of both, [7], px."""
    motion: FloatArray
    """Jacobian by a left perturbation ξ = [ρ; φ] of T_curr_prev, [7, 6], px/m and px/rad."""
    point: FloatArray
    """Jacobian by s, [7, 3]."""
    common: FloatArray
    """Jacobian by the latent errors, [7, K], px."""


@dataclass(frozen=True)
class TrackFactors:
    """N tracks, each as a factor between two poses, a point and the latent errors.

    The loss of a factor is the Student-t's, ½ (ν + 4) log(1 + rᵀ cov⁻¹ r/ν). Minimised over the
    point, it is the cost of the same track in ``solve_reprojection``.
    """

    point: FloatArray
    """s = (u, v, d) by the frames so far, [N, 3], px: also the initial value."""
    curr: FloatArray
    """y' less the bias and the estimate of δ, [N, 4], px."""
    cov: FloatArray
    """Scale matrix of the residual, [N, 7, 7], px²."""
    dof: FloatArray
    """ν of each track, [N]; np.inf is Gaussian."""
    common: FloatArray
    """∂(residual)/∂c of the latent errors c ~ N(0, I), [N, 7, K], px: six of the disparity
    filter (zero for a track without history) and, if the noise has a jitter of the rig, three of
    the current frame and three of the previous one; K = 6 or 12."""
    camera: Intrinsics

    @staticmethod
    def of(
        tracks: Tracks,
        noise: StereoNoise,
        camera: StereoCamera,
        disparities: DisparityFilter | None = None,
    ) -> TrackFactors:
        """Build the factors of N tracks.

        Args:
            tracks: those that the solve used, corrected by the rig's calibration.
            noise: of each of them, with the jitter of the rig if that is to be part of it.
            camera: the rectified camera.
            disparities: what earlier frames say of the disparities, ``state.disparities`` of the
                odometry *before* the step. None where the graph contains those frames itself.
        """
        history = (disparities or DisparityFilter.none()).of_tracks(tracks)
        observations = StereoObservations.of(
            tracks.prev_px,
            tracks.curr_px,
            noise,
            camera=camera,
            disparity_prior=history.states,
        )
        pairs = observations.pairs
        # Covariance of (s, y'): P of the point, and R' + Var δ for u_r'.
        point_cov = pairs.point_cov[:, :3, :3].copy()
        if noise.refers_to == "residual":
            point_cov += EXACT_PX**2 * np.eye(3)
        # δ enters the row of u_r: its variance adds to that of y', and its covariance with the
        # point is that of the two parts.
        cov = np.zeros((len(tracks), 7, 7))
        cov[:, _POINT, _POINT] = point_cov
        cov[:, _CURR, _CURR] = pairs.curr_scale
        cov[:, _U_R, _U_R] += pairs.point_cov[:, 3, 3]
        cov[:, _POINT, _U_R] = pairs.point_cov[:, :3, 3]
        cov[:, _U_R, _POINT] = pairs.point_cov[:, :3, 3]
        # Measured are s − V c and f(T s) − V_δ c + B η', with V the effect of c, or of η°, on (s,
        # δ). The derivatives take that out of the residual, which is predicted minus measured.
        jitter = observations.jitter
        common = np.zeros(
            (len(tracks), 7, NUM_LATENT if jitter is None else NUM_LATENT + JITTER_PAIR_DIM)
        )
        common[history.states.rows, _D, :NUM_LATENT] = -history.common_without_jitter[:, 0]
        common[history.states.rows, _U_R, :NUM_LATENT] = -history.common_without_jitter[:, 1]
        if jitter is not None:
            curr = slice(NUM_LATENT, NUM_LATENT + JITTER_DIM)
            prev = slice(NUM_LATENT + JITTER_DIM, NUM_LATENT + JITTER_PAIR_DIM)
            common[:, _U_R:, curr] = jitter.effects.basis
            common[:, _POINT, prev] = -jitter.effects.sensitivity[:, :3]
            common[:, _U_R, prev] = -jitter.effects.sensitivity[:, 3]
        return TrackFactors(
            point=pairs.point,
            curr=pairs.curr,
            cov=cov,
            dof=observations.noise.dof,
            common=common,
            camera=observations.camera,
        )

    def __len__(self) -> int:
        """Return the number of factors, N."""
        return len(self.point)

    def linearize(
        self, track: int, T_curr_prev: FloatArray, point: FloatArray, common: FloatArray
    ) -> FactorLinearization:
        """Evaluate one factor.

        Args:
            track: which, 0 to N − 1.
            T_curr_prev: the motion, [4, 4].
            point: s = (u, v, d), [3], px; the disparity may be zero or negative.
            common: the latent errors c, [K].
        """
        fu, fv, cu, cv, fb = self.camera
        C = T_curr_prev[:3, :3]
        t = T_curr_prev[:3, 3]
        residual = np.empty(7)
        motion_jacobian = np.zeros((7, 6))
        point_jacobian = np.zeros((7, 3))
        common_jacobian = self.common[track].copy()
        residual[_POINT] = point - self.point[track]
        point_jacobian[_POINT] = np.eye(3)
        # The point in the current frame over its depth in the previous one: q = C m + ρ t.
        rho = point[2] / fb
        x, y, z = C @ [(point[0] - cu) / fu, (point[1] - cv) / fv, 1.0] + rho * t
        if z < NEAREST:
            residual[_POINT] += common_jacobian[_POINT] @ common
            residual[_CURR] = BEHIND_PX
            common_jacobian[_CURR] = 0.0
            return FactorLinearization(residual, motion_jacobian, point_jacobian, common_jacobian)
        u = fu * x / z
        v = fv * y / z
        d = point[2] / z
        residual[_CURR] = np.array([u + cu, v + cv, u - d + cu, v + cv]) - self.curr[track]
        residual += common_jacobian @ common
        # ∂y'/∂q, and q under ξ and s; d itself is in u_r as well.
        projection_jacobian = (
            np.array([[fu, 0.0, -u], [0.0, fv, -v], [fu, 0.0, d - u], [0.0, fv, -v]]) / z
        )
        motion_jacobian[_CURR, :3] = rho * projection_jacobian
        motion_jacobian[_CURR, 3:] = projection_jacobian @ [
            [0.0, z, -y],
            [-z, 0.0, x],
            [y, -x, 0.0],
        ]  # −q^
        point_jacobian[_CURR] = projection_jacobian @ np.column_stack(
            [C[:, 0] / fu, C[:, 1] / fv, t / fb]
        )
        point_jacobian[_U_R, _D] -= 1.0 / z
        return FactorLinearization(residual, motion_jacobian, point_jacobian, common_jacobian)
