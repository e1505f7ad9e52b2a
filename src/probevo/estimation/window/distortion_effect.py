"""What errors of the distortion field and of the readout time do to the poses of a window.

The window is handed tracks that are corrected by the field, and does not estimate it. The field of
the lenses is c; that of step k was corrected by ĉ_k, so that its motion is off by G_k (c − ĉ_k),
with the gain G_k = ∂ξ/∂c of its solve. Along the path these errors add up,

    S_k = Ad_k S_{k−1} + G_k,    s_k = Ad_k s_{k−1} + G_k ĉ_k,

and the pose is off by S_k c − s_k. With the newest estimate, c ~ N(ĉ, Σ), its second moment is

    S_k Σ S_kᵀ + (S_k ĉ − s_k)(S_k ĉ − s_k)ᵀ.

So what is learned of the lenses later makes earlier poses more certain, or less, if it is other
than what they were corrected by. Not all of the field is that of the lenses
(``window.field_variation``).

The focal length is not corrected. An error ε of its logarithm moves each motion by the gain ∂ξ/∂ε,
which adds up to F_k as G_k does to S_k, and moves the estimate of c by ∂c/∂ε, so that the second
moment has the term E[ε²] (F_k + S_k ∂c/∂ε)(…)ᵀ besides.

The readout time τ of a rolling shutter (``camera.rolling_shutter``) is corrected from the frame on
in which it is noticeable. Like c, it has a gain, which adds up to R_k, and corrections, which add
up to r_k; so poses before that frame are known to be off by R_k τ̂ − r_k. What a step has left
unknown of the velocity at its two frames (``estimation.velocity_change``) is new in each frame, and
moves its pose only: each frame has half of the covariance that this adds to the motion of the step.
For a global shutter, all of this is zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.distortion_field import NUM_COEFFICIENTS
from probevo.camera.image_errors import ImageErrors
from probevo.estimation.rig_update import CommonMode
from probevo.estimation.window.field_variation import POSE, FieldVariation
from probevo.geometry import se3


@dataclass(frozen=True)
class DistortionEffect:
    """How the distortion field moves the poses of K frames."""

    sensitivity: FloatArray
    """S_k of each, [K, 6, NUM_COEFFICIENTS], m/px and rad/px."""
    corrected: FloatArray
    """s_k of each, [K, 6], m and rad."""
    mean: FloatArray
    """ĉ, [NUM_COEFFICIENTS], px."""
    cov: FloatArray
    """Σ, [NUM_COEFFICIENTS, NUM_COEFFICIENTS], px²."""
    focal_sensitivity: FloatArray
    """F_k of each, [K, 6], m and rad."""
    shift_by_focal: FloatArray
    """∂c/∂ε, [NUM_COEFFICIENTS], px."""
    focal_rms: float
    """Root mean square of ε."""
    readout_sensitivity: FloatArray
    """R_k of each, [K, 6], m/s and rad/s."""
    readout_corrected: FloatArray
    """r_k of each, [K, 6], m and rad."""
    readout_s: float
    """τ̂; 0 until it is noticeable."""
    readout_sigma_s: float
    """Its standard deviation; 0 until it is noticeable."""
    shift_by_readout: FloatArray
    """∂c/∂τ, [NUM_COEFFICIENTS], px/s."""
    velocity_cov: FloatArray
    """What is unknown of the velocity at each frame adds this to the covariance of its pose,
    [K, 6, 6]."""
    variation: FieldVariation
    """The part of the field that changes from place to place."""
    sigma_px: float
    """τ, the standard deviation of the coefficients."""

    @staticmethod
    def none() -> DistortionEffect:
        """Return the effect on the first frame, which is none."""
        return DistortionEffect(
            sensitivity=np.zeros((1, POSE, NUM_COEFFICIENTS)),
            corrected=np.zeros((1, POSE)),
            mean=np.zeros(NUM_COEFFICIENTS),
            cov=np.zeros((NUM_COEFFICIENTS, NUM_COEFFICIENTS)),
            focal_sensitivity=np.zeros((1, POSE)),
            shift_by_focal=np.zeros(NUM_COEFFICIENTS),
            focal_rms=0.0,
            readout_sensitivity=np.zeros((1, POSE)),
            readout_corrected=np.zeros((1, POSE)),
            readout_s=0.0,
            readout_sigma_s=0.0,
            shift_by_readout=np.zeros(NUM_COEFFICIENTS),
            velocity_cov=np.zeros((1, POSE, POSE)),
            variation=FieldVariation.none(),
            sigma_px=0.0,
        )

    def subset(self, frames: BoolArray) -> DistortionEffect:
        """Return the effect on some of the frames."""
        return replace(
            self,
            sensitivity=self.sensitivity[frames],
            corrected=self.corrected[frames],
            focal_sensitivity=self.focal_sensitivity[frames],
            readout_sensitivity=self.readout_sensitivity[frames],
            readout_corrected=self.readout_corrected[frames],
            velocity_cov=self.velocity_cov[frames],
            variation=self.variation.subset(frames),
        )

    def carried_to_new(self, prev: int, T_curr_prev: FloatArray) -> DistortionEffect:
        """Return the effect with one more frame, whose motion from another, [4, 4], adds none."""
        adjoint = se3.adjoint(T_curr_prev)

        def carried(of_frames: FloatArray) -> FloatArray:
            """Append what the frame before the motion has, in the axes of the new one."""
            return np.concatenate([of_frames, (adjoint @ of_frames[prev])[None]])

        return replace(
            self,
            sensitivity=carried(self.sensitivity),
            corrected=carried(self.corrected),
            focal_sensitivity=carried(self.focal_sensitivity),
            readout_sensitivity=carried(self.readout_sensitivity),
            readout_corrected=carried(self.readout_corrected),
            velocity_cov=np.concatenate([self.velocity_cov, np.zeros((1, POSE, POSE))]),
            variation=self.variation.carried_to_new(prev, T_curr_prev),
        )

    def with_step(
        self,
        motion: CommonMode,
        *,
        used: ImageErrors,
        errors: ImageErrors,
        velocity_cov: FloatArray,
    ) -> DistortionEffect:
        """Return the effect with that of the last step added, and with the newest estimate.

        Args:
            motion: how errors of the calibration move the step.
            used: the estimate by which its tracks were corrected.
            errors: the estimate after the step.
            velocity_cov: what the velocity within the step, as far as it is unknown, adds to the
                covariance of its motion, [6, 6].
        """
        gain = motion.distortion_gain
        sensitivity = self.sensitivity.copy()
        sensitivity[-1] += gain
        corrected = self.corrected.copy()
        corrected[-1] += gain @ used.distortion
        focal_sensitivity = self.focal_sensitivity.copy()
        focal_sensitivity[-1] += motion.focal_gain
        readout_sensitivity = self.readout_sensitivity.copy()
        readout_sensitivity[-1] += motion.readout_gain
        readout_corrected = self.readout_corrected.copy()
        readout_corrected[-1] += motion.readout_gain * used.readout_s
        of_frames = self.velocity_cov.copy()
        of_frames[-1] += 0.5 * velocity_cov
        return DistortionEffect(
            sensitivity=sensitivity,
            corrected=corrected,
            mean=errors.distortion,
            cov=errors.distortion_cov,
            focal_sensitivity=focal_sensitivity,
            shift_by_focal=errors.distortion_shift_by_focal,
            focal_rms=errors.focal_rms,
            readout_sensitivity=readout_sensitivity,
            readout_corrected=readout_corrected,
            readout_s=errors.readout_s,
            readout_sigma_s=errors.readout_sigma_s,
            shift_by_readout=errors.distortion_shift_by_readout,
            velocity_cov=of_frames,
            variation=self.variation.with_step(gain),
            sigma_px=errors.distortion_sigma_px,
        )

    def of_pose(self, slot: int) -> FloatArray:
        """Return the second moment of the error of a pose, [6, 6]."""
        of_lenses = self._second_moment(
            self.sensitivity[slot],
            self.corrected[slot],
            self.focal_sensitivity[slot],
            readout_sensitivity=self.readout_sensitivity[slot],
            readout_corrected=self.readout_corrected[slot],
        )
        of_field = of_lenses + self.variation.of_pose(slot, self.sigma_px)
        moment: FloatArray = of_field + self.velocity_cov[slot]
        return moment

    def between(self, slot: int, other: int, adjoint: FloatArray) -> FloatArray:
        """Return the second moment of the error of the motion between two frames, [6, 6].

        Args:
            slot: of the frame at the end of the motion.
            other: of the frame at its start.
            adjoint: of the motion, [6, 6].
        """

        def difference(of_frames: FloatArray) -> FloatArray:
            """Return what has been added from the other frame to this one."""
            return np.asarray(of_frames[slot] - adjoint @ of_frames[other])

        of_lenses = self._second_moment(
            difference(self.sensitivity),
            difference(self.corrected),
            difference(self.focal_sensitivity),
            readout_sensitivity=difference(self.readout_sensitivity),
            readout_corrected=difference(self.readout_corrected),
        )
        if slot == other:
            return of_lenses
        of_other = adjoint @ self.velocity_cov[other] @ adjoint.T
        moment: FloatArray = of_lenses + self.velocity_cov[slot] + of_other
        return moment

    def _second_moment(
        self,
        sensitivity: FloatArray,
        corrected: FloatArray,
        focal_sensitivity: FloatArray,
        *,
        readout_sensitivity: FloatArray,
        readout_corrected: FloatArray,
    ) -> FloatArray:
        """Return the second moment of S c − s + F ε + R τ − r, [6, 6]."""
        left = sensitivity @ self.mean - corrected
        left += readout_sensitivity * self.readout_s - readout_corrected
        of_focal = self.focal_rms * (focal_sensitivity + sensitivity @ self.shift_by_focal)
        of_readout = self.readout_sigma_s * (
            readout_sensitivity + sensitivity @ self.shift_by_readout
        )
        moment: FloatArray = (
            sensitivity @ self.cov @ sensitivity.T
            + np.outer(left, left)
            + np.outer(of_focal, of_focal)
            + np.outer(of_readout, of_readout)
        )
        return moment
