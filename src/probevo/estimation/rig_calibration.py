"""What is left of the rectification's errors, learned on the way: the right image against the left.

A rectified pair should show a point in the same row of both images, and its disparity should be
that of the baseline alone. Real pairs do neither. The correction is a smooth function of the place
(x, y) = ((u − cu)/fu, (v − cv)/fv) in the left image:

- rows: v_r − v_l = a₀ + a₁ x + a₂ y + a₃ x² + a₄ x y + a₅ y², from the tracks' stereo matches, no
  motion needed. On KITTI a₄ is about 6.8 px on two calibrations of different days, and modelling it
  takes the scatter of v_r − v_l from 0.39 to 0.15 px.
- disparity: true minus measured = b₀ + b₁ x + b₂ x², from how well the features agree on one
  motion. On KITTI b₂ is 1.7 to 2.1 px: points at the sides seem too far, which on a motorway, where
  the useful points are at the sides, lengthens every step. b₀ is held at zero on purpose: noise in
  the disparity makes near points look like a mix of near and far ones, which mimics b₀ (regression
  dilution), so that an estimated b₀ runs away on noisy tracks. The place in the image is known
  without noise, so b₁ and b₂ do not suffer from that. The doubt about all three enters the motion's
  covariance.

Both are Gaussian beliefs that start at zero with the prior below and are renewed by recursive
robust least squares.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.estimation.reprojection import ReprojectionSolution, sum_products
from probevo.tracking.tracks import Tracks

ROW_SIGMA_PX = np.array([1.0, 1.0, 1.0, 1.0, 3.0, 1.0])
"""Prior standard deviation of a₀ … a₅."""
DISPARITY_SIGMA_PX = np.array([1.0, 1.0])
"""Prior standard deviation of b₁, b₂."""
CONSTANT_SIGMA_PX = 0.1
"""Standard deviation of the constant b₀ that is not estimated, but whose doubt the covariance of
the motion carries."""
ROW_SCATTER_PX = 0.2
"""Scale of v_r − v_l around its model; its tails are those of a Student-t with 5 degrees of
freedom."""
CORRELATED_FEATURES = 20.0
"""How many features count as one: neighbours share their errors, and the same points come back
frame after frame."""


@dataclass(frozen=True)
class SelfCalibration:
    """Belief about the row and disparity errors of a rectified pair."""

    rows: FloatArray
    """a₀ … a₅, [6], px."""
    rows_information: FloatArray
    """Inverse covariance of the rows, [6, 6], px⁻²."""
    disparity: FloatArray
    """b₁, b₂, [2], px."""
    disparity_information: FloatArray
    """Inverse covariance of the disparity's coefficients, [2, 2], px⁻²."""

    @staticmethod
    def initial() -> SelfCalibration:
        """No correction yet, with the prior's doubt."""
        return SelfCalibration(
            np.zeros(6),
            np.diag(ROW_SIGMA_PX**-2.0),
            np.zeros(2),
            disparity_information=np.diag(DISPARITY_SIGMA_PX**-2.0),
        )

    def corrected(self, pixels: FloatArray, camera: StereoCamera) -> FloatArray:
        """Observations [N, 4], px, with u_r and v_r as a flawless rectification would have them."""
        corrected: FloatArray = pixels.copy()
        corrected[:, 2] -= disparity_basis(pixels, camera)[:, 1:] @ self.disparity
        corrected[:, 3] -= row_basis(pixels, camera) @ self.rows
        return corrected

    def corrected_tracks(self, tracks: Tracks, camera: StereoCamera) -> Tracks:
        """The tracks with both their observations corrected."""
        return replace(
            tracks,
            prev_px=self.corrected(tracks.prev_px, camera),
            curr_px=self.corrected(tracks.curr_px, camera),
        )

    def with_rows(self, pixels: FloatArray, camera: StereoCamera) -> SelfCalibration:
        """The belief after seeing the stereo matches [N, 4] of one frame, px, uncorrected."""
        basis = row_basis(pixels, camera)
        offsets = pixels[:, 3] - pixels[:, 1]
        rows = self.rows
        information = self.rows_information
        for _ in range(
            3
        ):  # IRLS: the weights of the first frame depend on the model that it teaches
            weight = 6.0 / (5.0 + ((offsets - basis @ rows) / ROW_SCATTER_PX) ** 2)
            weighted = basis * (weight / (ROW_SCATTER_PX**2 * CORRELATED_FEATURES))[:, None]
            information = self.rows_information + weighted.T @ basis
            rows = np.linalg.solve(
                information, self.rows_information @ self.rows + weighted.T @ offsets
            ).astype(float)
        return replace(self, rows=rows, rows_information=information)

    def with_motion(
        self, tracks: Tracks, solution: ReprojectionSolution, camera: StereoCamera
    ) -> tuple[SelfCalibration, FloatArray]:
        """The belief after a solve on the corrected tracks, and how the doubt before moves the
        solved motion, [6, 3].

        With D = ∂e/∂b and J = −∂e/∂ξ, the belief takes in the part of the residuals that a change
        of b explains, the motion being eliminated from the joint normal equations (Schur
        complement). The solution need not be at the optimum, but must know of the tracks only what
        these two frames show: what earlier ones have told was told under a belief of their time,
        and would confirm it.

        The second is the root of Schmidt's consider term, in columns for errors of unit variance.
        An error of the calibration moves all features together, so that no number of them averages
        it out, and all steps alike, so that it adds up along the path. Features that fix no motion
        without a gyro tell nothing.
        """
        if not np.isfinite(solution.cov).all():
            return self, np.zeros((6, 3))
        sensitivity = disparity_sensitivity(tracks, solution, camera)
        weighted = solution.whitened(sensitivity)
        residuals = solution.residuals
        cross = sum_products(solution.jacobian, weighted)
        gain = np.linalg.solve(solution.hessian, cross)
        doubt = np.zeros((3, 3))
        doubt[0, 0] = CONSTANT_SIGMA_PX**2
        doubt[1:, 1:] = np.linalg.inv(self.disparity_information)
        pull = np.einsum("nij,ni->j", solution.whitened(solution.jacobian), residuals)
        hessian = sum_products(sensitivity, weighted)
        gradient = gain.T @ pull - np.einsum("nij,ni->j", weighted, residuals)
        learned = (hessian - cross.T @ gain)[1:, 1:] / CORRELATED_FEATURES
        information = self.disparity_information + learned
        step = np.linalg.solve(information, gradient[1:] / CORRELATED_FEATURES)
        after = replace(self, disparity=self.disparity + step, disparity_information=information)
        return after, gain @ np.linalg.cholesky(doubt)


def row_basis(pixels: FloatArray, camera: StereoCamera) -> FloatArray:
    """(1, x, y, x², xy, y²) at the left observations of N features, [N, 6]."""
    x, y = camera.normalized(pixels[:, 0], pixels[:, 1])
    return np.column_stack([np.ones_like(x), x, y, x * x, x * y, y * y])


def disparity_basis(pixels: FloatArray, camera: StereoCamera) -> FloatArray:
    """(1, x, x²) at the left observations of N features, [N, 3]."""
    x, _ = camera.normalized(pixels[:, 0], pixels[:, 1])
    return np.column_stack([np.ones_like(x), x, x * x])


def disparity_sensitivity(
    tracks: Tracks, solution: ReprojectionSolution, camera: StereoCamera
) -> FloatArray:
    """∂e/∂(b₀, b₁, b₂), [N, 4, 3]: more disparity moves u_r' by itself, and the prediction f(T
    g(y)) by its depth."""
    before = disparity_basis(tracks.prev_px, camera)
    now = disparity_basis(tracks.curr_px, camera)
    sensitivity: FloatArray = -solution.disparity_jacobian[:, :, None] * before[:, None]
    sensitivity[:, 2] -= now
    return sensitivity
