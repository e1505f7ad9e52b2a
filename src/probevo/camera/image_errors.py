"""The errors of a rig's images beside their rows: a Gaussian estimate with a prior that is learned.

The errors c are b₁ and b₂ of the disparity (``camera.rig_calibration``) and the coefficients of the
distortion field (``camera.distortion_field``). What is seen of them adds to an information matrix Λ
and a moment m = Λ c, and the estimate is

    c = (Λ + P)⁻¹ m,

with P the information of the prior. That of the field depends on the lenses: its standard deviation
τ, the same for all coefficients, is the most likely one given what is seen (type-II maximum
likelihood), of which each step takes one iteration of EM, τ² = mean of (c² + its variance). Images
of an exact camera so lower τ to hundredths of a pixel, and their field vanishes; raw 0005 of KITTI
raises it to 0.4 px.

The error ε of log f looks like lens distortion, so that neither can be corrected for certain. c is
estimated for ε = 0; ε has a prior of its own, and what is left unknown of it, beside c, is part of
the covariance of the motions (``estimation.rig_update``).

The readout time of the shutter (``camera.rolling_shutter``) is estimated jointly with c, and c for
the readout time that is corrected: none, until the images show one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.distortion_field import NUM_COEFFICIENTS
from probevo.camera.rolling_shutter import ReadoutTime

DISPARITY_SIGMA_PX = np.array([1.0, 1.0])
"""Prior standard deviation of b₁, b₂."""
INITIAL_SIGMA_PX = 0.2
"""τ before anything is seen: the field is then 0.2 px rms over the image, about as much as
calibrations leave."""
MAX_SIGMA_PX = 0.5
"""Largest τ. Lenses that are further off have to be calibrated. Where features move by themselves,
as on a lorry that fills the road, a field of many pixels could explain that."""
FOCAL_SIGMA = 0.005
"""Prior standard deviation of the error of log f, that of a usual calibration."""
NUM_ERRORS = len(DISPARITY_SIGMA_PX) + NUM_COEFFICIENTS
_DISTORTION = slice(len(DISPARITY_SIGMA_PX), NUM_ERRORS)


def _prior_variance(distortion_sigma_px: float) -> FloatArray:
    """Return the diagonal of P⁻¹, [NUM_ERRORS], px²."""
    sigma_px = np.concatenate([DISPARITY_SIGMA_PX, np.full(NUM_COEFFICIENTS, distortion_sigma_px)])
    return sigma_px**2


class ImageEquations(NamedTuple):
    """Normal equations of a step about the errors c, with motion and jitter eliminated."""

    information: FloatArray
    """About c, [NUM_ERRORS, NUM_ERRORS], px⁻²."""
    gradient: FloatArray
    """By c at the estimate, by which the tracks were corrected, [NUM_ERRORS], px⁻¹."""
    with_radial: FloatArray
    """Off-diagonal information between c and a₆, [NUM_ERRORS], px⁻²."""
    with_focal: FloatArray
    """Off-diagonal information between c and the error ε of log f, [NUM_ERRORS], px⁻¹."""
    focal_information: float
    """About ε."""
    focal_gradient: float
    """By ε, at ε = 0 and the estimate of c."""
    with_readout: FloatArray
    """Off-diagonal information between c and the readout time, [NUM_ERRORS], 1/(px s)."""
    readout_information: float
    """About the readout time, s⁻²."""
    readout_gradient: float
    """By the readout time, at that by which the tracks were corrected, s⁻¹."""

    def scaled(self, factor: float) -> ImageEquations:
        """Return the equations of so many times the information."""
        return ImageEquations(
            information=factor * self.information,
            gradient=factor * self.gradient,
            with_radial=factor * self.with_radial,
            with_focal=factor * self.with_focal,
            focal_information=factor * self.focal_information,
            focal_gradient=factor * self.focal_gradient,
            with_readout=factor * self.with_readout,
            readout_information=factor * self.readout_information,
            readout_gradient=factor * self.readout_gradient,
        )


@dataclass(frozen=True)
class ImageErrors:
    """A Gaussian estimate of b₁, b₂ and the distortion field, given the radial error a₆ of the
    rows."""

    mean: FloatArray
    """c, [NUM_ERRORS], px."""
    cov: FloatArray
    """Its covariance (Λ + P)⁻¹, [NUM_ERRORS, NUM_ERRORS], px²."""
    seen: FloatArray
    """Λ, [NUM_ERRORS, NUM_ERRORS], px⁻²."""
    moment: FloatArray
    """m for a readout time of 0, [NUM_ERRORS], px⁻¹."""
    with_radial: FloatArray
    """Off-diagonal information between c and a₆, [NUM_ERRORS], px⁻²."""
    distortion_sigma_px: float
    """τ."""
    with_focal: FloatArray
    """Off-diagonal information between c and the error ε of log f, [NUM_ERRORS], px⁻¹."""
    focal_seen: float = 0.0
    """Information about ε, for a given c."""
    focal_moment: float = 0.0
    """What is seen of ε and c together, as the moment of ε at c = 0."""
    with_readout: FloatArray = field(default_factory=lambda: np.zeros(NUM_ERRORS))
    """Off-diagonal information between c and the readout time, [NUM_ERRORS], 1/(px s)."""
    readout_seen: float = 0.0
    """Information about the readout time, for a given c, s⁻²."""
    readout_moment: float = 0.0
    """What is seen of the readout time and c together, as the moment of the former at c = 0,
    s⁻¹."""
    readout_s: float = 0.0
    """The readout time that is corrected; 0 until it is noticeable."""
    readout_prior: ReadoutTime = field(default_factory=ReadoutTime.prior)
    """Prior of the readout time."""

    @staticmethod
    def initial(
        distortion_sigma_px: float = INITIAL_SIGMA_PX, readout_s: float = 0.0
    ) -> ImageErrors:
        """Return the prior.

        Args:
            distortion_sigma_px: τ to begin with.
            readout_s: the readout time by the calibration; 0 if it does not give any.
        """
        readout = ReadoutTime.prior(readout_s)
        return ImageErrors(
            mean=np.zeros(NUM_ERRORS),
            cov=np.diag(_prior_variance(distortion_sigma_px)),
            seen=np.zeros((NUM_ERRORS, NUM_ERRORS)),
            moment=np.zeros(NUM_ERRORS),
            with_radial=np.zeros(NUM_ERRORS),
            distortion_sigma_px=distortion_sigma_px,
            with_focal=np.zeros(NUM_ERRORS),
            readout_s=readout.noticeable_s,
            readout_prior=readout,
        )

    @property
    def shift_by_focal(self) -> FloatArray:
        """∂c/∂ε, [NUM_ERRORS], px: where the estimate would be with another focal length."""
        shift: FloatArray = -self.cov @ self.with_focal
        return shift

    @property
    def distortion_shift_by_focal(self) -> FloatArray:
        """The part of the distortion field in it, [NUM_COEFFICIENTS], px."""
        return self.shift_by_focal[_DISTORTION]

    @property
    def focal_rms(self) -> float:
        """Root of the second moment of ε about 0, for which c is estimated: that of the prior, or
        less, where the images agree with the focal length.

        Where they contradict it, that may be the lenses, whose distortion looks alike; so they show
        nothing then.
        """
        # The joint posterior of (c, ε), of which c is eliminated.
        information = self.focal_seen + FOCAL_SIGMA**-2.0 + self.with_focal @ self.shift_by_focal
        mean = (self.focal_moment - self.with_focal @ self.mean) / information
        return min(math.sqrt(mean**2 + 1.0 / information), FOCAL_SIGMA)

    @property
    def shift_by_readout(self) -> FloatArray:
        """∂c/∂(readout time), [NUM_ERRORS], px/s."""
        shift: FloatArray = -self.cov @ self.with_readout
        return shift

    @property
    def distortion_shift_by_readout(self) -> FloatArray:
        """The part of the distortion field in it, [NUM_COEFFICIENTS], px/s."""
        return self.shift_by_readout[_DISTORTION]

    @property
    def readout_sigma_s(self) -> float:
        """Standard deviation of the readout time that is corrected; 0 where none is."""
        return self.readout.sigma_s if self.readout_s else 0.0

    @property
    def readout(self) -> ReadoutTime:
        """The readout time by what is seen of it, whether or not it is corrected."""
        # The joint posterior of c and the readout time, of which c is eliminated.
        of_prior = self.readout_prior.sigma_s**-2.0
        information = of_prior + self.readout_seen + self.with_readout @ self.shift_by_readout
        moment = of_prior * self.readout_prior.mean_s + self.readout_moment
        moment += float(self.shift_by_readout @ self.moment)
        return ReadoutTime(
            mean_s=float(moment / information), sigma_s=float(1.0 / math.sqrt(information))
        )

    @property
    def disparity(self) -> FloatArray:
        """b₁, b₂, [2], px."""
        return self.mean[: _DISTORTION.start]

    @property
    def distortion(self) -> FloatArray:
        """The coefficients of the distortion field, [NUM_COEFFICIENTS], px."""
        return self.mean[_DISTORTION]

    @property
    def disparity_cov(self) -> FloatArray:
        """Covariance of b₁, b₂, [2, 2], px²."""
        return self.cov[: _DISTORTION.start, : _DISTORTION.start]

    @property
    def distortion_cov(self) -> FloatArray:
        """Covariance of these coefficients, [NUM_COEFFICIENTS, NUM_COEFFICIENTS], px²."""
        return self.cov[_DISTORTION, _DISTORTION]

    def with_step(self, step: ImageEquations) -> ImageErrors:
        """Return the estimate after what the residuals of a step show, and τ after one
        iteration."""
        seen = self.seen + step.information
        moment = self.moment + step.information @ self.mean + step.gradient
        moment += step.with_readout * self.readout_s
        prior = np.diag(1.0 / _prior_variance(self.distortion_sigma_px))
        cov = np.linalg.inv(seen + prior).astype(np.float64, copy=False)
        with_readout = self.with_readout + step.with_readout
        mean = cov @ (moment - with_readout * self.readout_s)
        mean_square = float(np.mean(mean[_DISTORTION] ** 2 + np.diagonal(cov)[_DISTORTION]))
        updated = ImageErrors(
            mean=mean,
            cov=cov,
            seen=seen,
            moment=moment,
            with_radial=self.with_radial + step.with_radial,
            distortion_sigma_px=min(math.sqrt(mean_square), MAX_SIGMA_PX),
            with_focal=self.with_focal + step.with_focal,
            focal_seen=self.focal_seen + step.focal_information,
            focal_moment=(
                self.focal_moment + step.focal_gradient + float(step.with_focal @ self.mean)
            ),
            with_readout=with_readout,
            readout_seen=self.readout_seen + step.readout_information,
            readout_moment=(
                self.readout_moment
                + step.readout_gradient
                + step.readout_information * self.readout_s
                + float(step.with_readout @ self.mean)
            ),
            readout_s=self.readout_s,
            readout_prior=self.readout_prior,
        )
        return updated.with_readout_corrected()

    def with_readout_corrected(self) -> ImageErrors:
        """Return the estimate for the readout time that the images show, or for none where that is
        not noticeable."""
        readout_s = self.readout.noticeable_s
        if readout_s == self.readout_s:
            return self
        mean = self.cov @ (self.moment - self.with_readout * readout_s)
        return replace(self, mean=mean, readout_s=readout_s)

    def with_radial_moved(self, change_px: float) -> ImageErrors:
        """Return the estimate given another a₆: it moves along the regression of c on a₆."""
        moment = self.moment - self.with_radial * change_px
        mean = self.cov @ (moment - self.with_readout * self.readout_s)
        return replace(self, mean=mean, moment=moment)
