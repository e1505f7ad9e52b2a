"""Online calibration of the rig: the errors that the rectification has left in the right image.

In a rectified pair, a point should be in the same row of both images, and its disparity should be
due to the baseline alone. Real pairs have errors in both. They are modelled as smooth functions of
the place (x, y) = ((u − c_u)/f_u, (v − c_v)/f_v) in the left image:

- rows: v_r − v_l = a₀ + a₁ x + a₂ y + a₃ x² + a₄ x y + a₅ y² + a₆ y r², from the tracks' stereo
  matches; no motion is needed. On KITTI a₄ is about 6.8 px on two calibrations of different days,
  and modelling it reduces the scatter of v_r − v_l from 0.39 to 0.15 px.
  A roll of the right image causes a₁, and a difference of the lenses' radial distortion a₆. Both
  also move u_r, by −a₁ y and a₆ x r². Disparities alone do not reveal that, so u_r is corrected by
  what the rows show. For a₁ and a₆, x is taken in the right image, and r² = x² + y².
- disparity: true minus measured = b₀ + b₁ x + b₂ x², from how well the features agree on one motion
  (``estimation.rig_update``). On KITTI b₂ is 1.7 to 2.1 px: points at the sides seem too far, which
  on a motorway, where the useful points are at the sides, makes every step too long.
- both views, and the disparity beyond this parabola: a smooth field of errors over the image
  (``camera.distortion_field``), estimated together with b₁ and b₂.

b₀ is deliberately held at zero: noise in the disparity makes near points look like a mix of near
and far ones, which mimics b₀ (regression dilution), so that an estimated b₀ diverges on noisy
tracks. The place in the image is known without noise, so b₁ and b₂ do not have this bias. The
uncertainty of all three enters the covariance of the motion as a common-mode error.

Errors that are new in each frame are modelled separately: ``camera.rig_jitter``.

All are Gaussian estimates that start at zero with the prior below and are updated by recursive
robust least squares.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.distortion_field import DISPARITY_MODES, DISPLACEMENT_MODES, modes_at
from probevo.camera.distortion_field_numba import correct_by_field
from probevo.camera.exposure_delay import ExposureDelay
from probevo.camera.focal_length import FocalLengthEstimate
from probevo.camera.image_errors import NUM_ERRORS, ImageEquations, ImageErrors
from probevo.camera.rig_jitter import RigJitter
from probevo.camera.rig_rows import fit_row_offsets
from probevo.camera.rig_rows_numba import (
    RADIAL,
    RowOffsetNoise,
    correct_observations,
    fill_row_basis,
)
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics

ROW_SIGMA_PX = np.array([1.0, 1.0, 1.0, 1.0, 3.0, 1.0, 3.0])
"""Prior standard deviation of a₀ … a₆."""
CONSTANT_SIGMA_PX = 0.1
"""Prior standard deviation of the constant b₀, a consider parameter: two frames do not estimate
it."""
ROW_SCATTER_PX = 0.2
"""Scale of v_r − v_l around its model; it has the tails of a Student-t with 5 degrees of
freedom."""
ROW_DOF = 5.0
"""Degrees of freedom of the Student-t of a row offset."""
CORRELATED_FEATURES = 20.0
"""Number of features that count as one: neighbours have common errors, and the same points return
in successive frames."""
ROW_NOISE = RowOffsetNoise(sigma_px=ROW_SCATTER_PX, dof=ROW_DOF, correlated=CORRELATED_FEATURES)
ROW_ITERATIONS = 3
"""Iterations of IRLS for the rows of a frame, from the estimate before it."""
PLACES = 9
"""Columns and rows of the grid over the image on which its largest row offset is looked for; a
polynomial of the third degree has few extrema, and they are at the border."""
NO_DISPARITY_ERROR_PX = np.zeros(2)


class RowErrors(NamedTuple):
    """How far the rows of the right image are off by an estimate of the rig."""

    sigmas: float
    """Largest coefficient, in standard deviations of its prior."""
    largest_px: float
    """Largest offset |v_r − v_l| over the image, px."""


@dataclass(frozen=True)
class RigCalibration:
    """A Gaussian estimate of the errors of a rectified pair: of its rows, and of its images."""

    rows: FloatArray
    """a₀ … a₆, [7], px."""
    rows_information: FloatArray
    """Inverse covariance of the rows' coefficients, [7, 7], px⁻²."""
    image: ImageErrors = field(default_factory=ImageErrors.initial)
    """b₁, b₂ and the distortion field."""
    jitter: RigJitter = field(default_factory=RigJitter.initial)
    """Covariance S of the rig's jitter, a rotation that is new in each frame."""
    delay: ExposureDelay = field(default_factory=lambda: ExposureDelay(ROW_SIGMA_PX))
    """Exposure delay of the right camera."""
    focal: FocalLengthEstimate = field(default_factory=FocalLengthEstimate.initial)
    """Error of the focal length; it is reported, never corrected."""

    @staticmethod
    def initial(jitter: RigJitter | None = None, readout_s: float = 0.0) -> RigCalibration:
        """Return the prior: no correction, with the standard deviations above.

        Args:
            jitter: the prior of the jitter; by default the one for unknown rigs.
            readout_s: the readout time of the shutter where it is known, else 0.
        """
        return RigCalibration(
            rows=np.zeros(len(ROW_SIGMA_PX)),
            rows_information=np.diag(ROW_SIGMA_PX**-2.0),
            image=ImageErrors.initial(readout_s=readout_s),
            jitter=RigJitter.initial() if jitter is None else jitter,
        )

    @property
    def has_seen_rows(self) -> bool:
        """Whether the row offsets of a frame are in the estimate."""
        return bool(self.rows_information[0, 0] > ROW_SIGMA_PX[0] ** -2.0)

    def row_errors(self, camera: StereoCamera) -> RowErrors:
        """Return how far the rows are off, over the image of a camera."""
        width, height = camera.extent_px
        u, v = np.meshgrid(
            np.linspace(0.0, width - 1.0, PLACES), np.linspace(0.0, height - 1.0, PLACES)
        )
        pixels = np.column_stack([u.ravel(), v.ravel(), u.ravel(), v.ravel()])
        offsets_px = row_basis(pixels, camera) @ self.rows
        return RowErrors(
            sigmas=float(np.abs(self.rows / ROW_SIGMA_PX).max()),
            largest_px=float(np.abs(offsets_px).max()),
        )

    @property
    def disparity(self) -> FloatArray:
        """b₁, b₂, [2], px."""
        return self.image.disparity

    @property
    def disparity_and_field_cov(self) -> FloatArray:
        """Joint covariance of (b₀, b₁, b₂) and the distortion field, [1 + NUM_ERRORS, 1 +
        NUM_ERRORS], px²."""
        # b₀ is not estimated, so that it is independent of the others and keeps its prior.
        covariance = np.zeros((1 + NUM_ERRORS, 1 + NUM_ERRORS))
        covariance[0, 0] = CONSTANT_SIGMA_PX**2
        covariance[1:, 1:] = self.image.cov
        return covariance

    def corrected(self, pixels: FloatArray, camera: StereoCamera) -> FloatArray:
        """Return observations [N, 4], px, corrected for all estimated errors."""
        return self._without_errors(pixels, camera, disparity_px=self.disparity)

    def corrected_for_window(self, pixels: FloatArray, camera: StereoCamera) -> FloatArray:
        """Return observations [N, 4], px, corrected for all errors but b₁ and b₂, which the window
        estimates itself."""
        return self._without_errors(pixels, camera, disparity_px=NO_DISPARITY_ERROR_PX)

    def _without_errors(
        self, pixels: FloatArray, camera: StereoCamera, disparity_px: FloatArray
    ) -> FloatArray:
        modes = modes_at(pixels, camera)
        corrected = np.array(pixels, np.float64, order="C")
        correct_observations(corrected, Intrinsics.of(camera), self.rows, disparity_px)
        correct_by_field(
            corrected,
            modes,
            self.image.distortion,
            displacement_modes=DISPLACEMENT_MODES,
            disparity_modes=DISPARITY_MODES,
        )
        return corrected

    def with_rows(
        self, pixels: FloatArray, camera: StereoCamera, *, novelty: float = 1.0
    ) -> RigCalibration:
        """Update the row coefficients with the raw stereo matches of one frame.

        The errors of the images are conditional on a₆, so they change along with a₆.

        Args:
            pixels: the matches, [N, 4], px.
            camera: the rectified camera.
            novelty: the share of information in their errors that earlier frames did not have, 0
                to 1: a rig that stands repeats the same errors, and one flexure. The first frame
                counts in full.
        """
        if not self.has_seen_rows:
            novelty = 1.0
        if novelty == 0.0:
            return self
        rows, information = fit_row_offsets(
            row_basis(pixels, camera),
            pixels[:, 3] - pixels[:, 1],
            (self.rows, self.rows_information),
            noise=ROW_NOISE._replace(correlated=CORRELATED_FEATURES / novelty),
            iterations=ROW_ITERATIONS,
        )
        return replace(
            self,
            rows=rows,
            rows_information=information,
            image=self.image.with_radial_moved(rows[RADIAL] - self.rows[RADIAL]),
        )

    def with_delay(
        self, pixels: FloatArray, twist: FloatArray, camera: StereoCamera
    ) -> RigCalibration:
        """Update the delay of the right image with the raw stereo matches [N, 4], px, of one frame.

        Args:
            pixels: the matches.
            twist: Log(T_curr_prev) per second at that frame, [6], m/s and rad/s.
            camera: the rectified camera.
        """
        # The delay has row coefficients of its own, which are estimated jointly with it.
        basis = row_basis(pixels, camera)
        updated = self.delay.updated(
            pixels,
            basis,
            twist,
            camera=camera,
            noise=ROW_NOISE,
            jitter_cov=self.jitter.cov,
        )
        return replace(self, delay=updated)

    def with_image_errors(self, step: ImageEquations) -> RigCalibration:
        """Update the errors c of the images with the normal equations of a motion's residuals.

        Residuals of neighbouring features are correlated, so their information is reduced
        (``CORRELATED_FEATURES``).
        """
        return replace(self, image=self.image.with_step(step.scaled(1.0 / CORRELATED_FEATURES)))


def row_basis(pixels: FloatArray, camera: StereoCamera) -> FloatArray:
    """Return (1, x, y, x², xy, y², y r²) at N features, [N, 7].

    The second and the last, which describe the right image, use the x of the right image; the
    others use the x of the left image.
    """
    basis = np.empty((len(pixels), len(ROW_SIGMA_PX)))
    fill_row_basis(np.array(pixels, np.float64, order="C"), Intrinsics.of(camera), basis)
    return basis


def disparity_basis(pixels: FloatArray, camera: StereoCamera) -> FloatArray:
    """Return (1, x, x²) at the left observations of N features, [N, 3]."""
    x, _ = camera.normalized(pixels[:, 0], pixels[:, 1])
    return np.column_stack([np.ones_like(x), x, x * x])
