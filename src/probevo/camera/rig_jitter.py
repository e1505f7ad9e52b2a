"""The jitter of the rig: an error that is common to all features of a frame, and new in each frame.

The two cameras of a rig are never exactly where the calibration says. Mounts bend, and exposures
that are not simultaneous look like a rotation of one camera relative to the other. In each frame,
the right camera is therefore rotated relative to the left one by a small random ω, which moves its
observation of a point at (x, y) = ((u_r − c_u)/f_u, (v_r − c_v)/f_v) by

    δu_r = f_u (−x y ω_x + (1 + x²) ω_y − y ω_z),
    δv_r = f_v (−(1 + y²) ω_x + x y ω_y + x ω_z).

The yaw ω_y offsets all disparities, the pitch ω_x offsets all rows, and the roll ω_z tilts the
rows. Such an error does not average out over features. Its covariance S is estimated online. Errors
that persist over frames are not part of it, but of the calibration (``camera.rig_calibration``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.rig_jitter_numba import right_offsets
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics

PRIOR_SIGMA_RAD = np.array([1e-4, 1.5e-4, 1.5e-4])
"""Initial standard deviation of (pitch, yaw, roll): 0.1 px of disparity at f = 700 px. KITTI has
0.04 px, a flexible rig 0.3 px and more."""
PRIOR_FRAMES = 1.0
"""Number of frames that the prior counts for."""
EM_STEP_EXPONENT = 0.7
"""The n-th step of online EM has the size n^−0.7 (Cappé & Moulines 2009, who need an exponent in
(0.5, 1]). With 1/n, the first frames, which were weighted by a wrong S, would never be
forgotten."""
LARGER = 1.5
"""Ratio of two jitter variances above which the step is worth solving again."""
LEARNED_FRAMES = 10.0
"""Number of frames that a covariance learned with a noise model counts for: the rig may have been
remounted since."""
MAX_FRAMES = 300.0
"""Largest number of frames that count: mounts warm up and roads change, so old frames are
forgotten."""
MIN_SIGMA_RAD = 1e-6
"""Smallest standard deviation of an angle, so that S can be inverted: a thousandth of a pixel."""


@dataclass(frozen=True)
class RigJitter:
    """An estimate of the covariance of the jitter: S of ω = (pitch, yaw, roll) ~ N(0, S)."""

    cov: FloatArray
    """S, [3, 3], rad²."""
    frames: float
    """Number of frames that the estimate is worth, including the prior's."""

    @staticmethod
    def initial(cov: FloatArray | None = None, frames: float = PRIOR_FRAMES) -> RigJitter:
        """Return the prior.

        Args:
            cov: S of a rig that is known, [3, 3], rad²; by default the prior for unknown rigs.
            frames: number of frames that it counts for.
        """
        if cov is None:
            cov = np.diag(PRIOR_SIGMA_RAD**2)
        return RigJitter(cov=cov, frames=frames)

    @property
    def sigma_rad(self) -> FloatArray:
        """Standard deviation of (pitch, yaw, roll), [3], rad."""
        sigma: FloatArray = np.sqrt(np.diagonal(self.cov))
        return sigma

    def exceeds(self, cov: FloatArray | None) -> bool:
        """Return whether a variance is over ``LARGER`` times the variance in another covariance."""
        return cov is not None and bool((np.diagonal(self.cov) > LARGER * np.diagonal(cov)).any())

    def with_change(self, second_moment: FloatArray, *, novelty: float = 1.0) -> RigJitter:
        """Update S with the change ω_k − ω_{k−1} in one step: one step of online EM.

        Two frames show only the change of the jitter well, whose covariance is 2 S. A step without
        information about it has the second moment 2 S, and leaves S unchanged.

        Args:
            second_moment: E[(ω_k − ω_{k−1})(ω_k − ω_{k−1})ᵀ] given the step's residuals, [3, 3].
            novelty: how much the step counts, 0 to 1: a rig that stands does not flex.
        """
        # S ← (1 − n^−0.7) S + n^−0.7 · ½ E[…]: the change has the covariance 2 S, hence the ½. The
        # last line keeps S symmetric and invertible.
        frames = min(self.frames + novelty, MAX_FRAMES)
        share = novelty * frames**-EM_STEP_EXPONENT
        cov = self.cov + share * (0.5 * second_moment - self.cov)
        cov = 0.5 * (cov + cov.T) + share * MIN_SIGMA_RAD**2 * np.eye(3)
        return replace(self, cov=cov, frames=frames)


def common_sigma_px(jitter_cov: FloatArray | None, camera: StereoCamera) -> float:
    """Return the standard deviation of the offset between two frames that all u_r have in common,
    by the yaw of a jitter of covariance S, [3, 3], rad²; 0 without one, px."""
    if jitter_cov is None:
        return 0.0
    return camera.fu_px * float(np.sqrt(2.0 * jitter_cov[1, 1]))


def jitter_offsets(pixels: FloatArray, camera: StereoCamera) -> FloatArray:
    """Return ∂(u_r, v_r)/∂ω at N observations, [N, 4] to [N, 2, 3], px/rad."""
    offsets = np.empty((len(pixels), 2, 3))
    right_offsets(Intrinsics.of(camera), np.ascontiguousarray(pixels), offsets)
    return offsets
