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
"""Prior standard deviation of the error of log f, as calibrations usually have it."""
NUM_ERRORS = len(DISPARITY_SIGMA_PX) + NUM_COEFFICIENTS
_DISTORTION = slice(len(DISPARITY_SIGMA_PX), NUM_ERRORS)


def _prior_variance(distortion_sigma_px: float) -> FloatArray:
    """Return the diagonal of P⁻¹, [NUM_ERRORS], px²."""
    sigma_px = np.concatenate([DISPARITY_SIGMA_PX, np.full(NUM_COEFFICIENTS, distortion_sigma_px)])
    return sigma_px**2


class ScalarEquations(NamedTuple):
    """What residuals show of one more number z beside the errors c: of the error ε of log f, or of
    the readout time."""

    coupling: FloatArray
    """Off-diagonal information between c and z, [NUM_ERRORS]."""
    information: float
    """Information about z, for a given c."""
    gradient: float
    """Gradient by z; in a sum over steps, the moment of z at c = 0 and z = 0."""

    @staticmethod
    def none() -> ScalarEquations:
        """Return that nothing is shown."""
        return ScalarEquations(np.zeros(NUM_ERRORS), 0.0, 0.0)

    def scaled(self, factor: float) -> ScalarEquations:
        """Return the equations of so many times the information."""
        return ScalarEquations(
            coupling=factor * self.coupling,
            information=factor * self.information,
            gradient=factor * self.gradient,
        )

    def with_step(self, step: ScalarEquations, mean: FloatArray, value: float) -> ScalarEquations:
        """Return the sum of these equations and those of a step.

        Args:
            step: its gradient is at the following values.
            mean: c, [NUM_ERRORS], px.
            value: z.
        """
        moment = self.gradient + step.gradient + step.information * value
        return ScalarEquations(
            coupling=self.coupling + step.coupling,
            information=self.information + step.information,
            gradient=moment + float(step.coupling @ mean),
        )


class ImageEquations(NamedTuple):
    """Normal equations of a step about the errors c, with motion and jitter eliminated."""

    information: FloatArray
    """Information about c, [NUM_ERRORS, NUM_ERRORS], px⁻²."""
    gradient: FloatArray
    """Gradient by c at the estimate by which the tracks were corrected, [NUM_ERRORS], px⁻¹."""
    with_radial: FloatArray
    """Off-diagonal information between c and a₆, [NUM_ERRORS], px⁻²."""
    focal: ScalarEquations
    """Equations of the error ε of log f; the gradient is at ε = 0 and the estimate of c."""
    readout: ScalarEquations
    """Equations of the readout time, s; the gradient is at the time by which the tracks were
    corrected."""

    def scaled(self, factor: float) -> ImageEquations:
        """Return the equations of so many times the information."""
        return ImageEquations(
            information=factor * self.information,
            gradient=factor * self.gradient,
            with_radial=factor * self.with_radial,
            focal=self.focal.scaled(factor),
            readout=self.readout.scaled(factor),
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
    focal_seen: ScalarEquations = field(default_factory=ScalarEquations.none)
    """What is seen of the error ε of log f."""
    readout_seen: ScalarEquations = field(default_factory=ScalarEquations.none)
    """What is seen of the readout time, s."""
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
            readout_s=readout.noticeable_s,
            readout_prior=readout,
        )

    @property
    def shift_by_focal(self) -> FloatArray:
        """∂c/∂ε, [NUM_ERRORS], px: where the estimate would be with another focal length."""
        shift: FloatArray = -self.cov @ self.focal_seen.coupling
        return shift

    @property
    def distortion_shift_by_focal(self) -> FloatArray:
        """The part of the distortion field in it, [NUM_COEFFICIENTS], px."""
        return self.shift_by_focal[_DISTORTION]

    @property
    def focal_rms(self) -> float:
        """Root of the second moment of ε about 0, for which c is estimated: the prior's,
        or less where the images agree with the focal length.

        Where they contradict it, that may be the lenses, whose distortion looks alike; so they show
        nothing then.
        """
        # The joint posterior of (c, ε), of which c is eliminated.
        seen = self.focal_seen
        information = seen.information + FOCAL_SIGMA**-2.0 + seen.coupling @ self.shift_by_focal
        mean = (seen.gradient - seen.coupling @ self.mean) / information
        return min(math.sqrt(mean**2 + 1.0 / information), FOCAL_SIGMA)

    @property
    def shift_by_readout(self) -> FloatArray:
        """∂c/∂(readout time), [NUM_ERRORS], px/s."""
        shift: FloatArray = -self.cov @ self.readout_seen.coupling
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
        seen = self.readout_seen
        prior_information = self.readout_prior.sigma_s**-2.0
        information = prior_information + seen.information + seen.coupling @ self.shift_by_readout
        moment = prior_information * self.readout_prior.mean_s + seen.gradient
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
        moment += step.readout.coupling * self.readout_s
        prior = np.diag(1.0 / _prior_variance(self.distortion_sigma_px))
        cov = np.linalg.inv(seen + prior).astype(np.float64, copy=False)
        readout_seen = self.readout_seen.with_step(step.readout, self.mean, self.readout_s)
        mean = cov @ (moment - readout_seen.coupling * self.readout_s)
        mean_square = float(np.mean(mean[_DISTORTION] ** 2 + np.diagonal(cov)[_DISTORTION]))
        updated = ImageErrors(
            mean=mean,
            cov=cov,
            seen=seen,
            moment=moment,
            with_radial=self.with_radial + step.with_radial,
            distortion_sigma_px=min(math.sqrt(mean_square), MAX_SIGMA_PX),
            focal_seen=self.focal_seen.with_step(step.focal, self.mean, value=0.0),
            readout_seen=readout_seen,
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
        mean = self.cov @ (self.moment - self.readout_seen.coupling * readout_s)
        return replace(self, mean=mean, readout_s=readout_s)

    def with_radial_moved(self, change_px: float) -> ImageErrors:
        """Return the estimate given another a₆: it moves along the regression of c on a₆."""
        moment = self.moment - self.with_radial * change_px
        mean = self.cov @ (moment - self.readout_seen.coupling * self.readout_s)
        return replace(self, mean=mean, moment=moment)
