"""Errors that all features of a frame have in common: the jitter of the rig.

The two cameras of a rig are never quite where the calibration says. Mounts bend, and two exposures
that are not quite at one instant look like a turn of one camera against the other. In every frame
the right camera is turned against the left one by a small rotation ω, new in each frame, which
moves what it sees of a point at (x, y) = ((u_r − c_u)/f_u, (v_r − c_v)/f_v) by

    δu_r = f_u (−x y ω_x + (1 + x²) ω_y − y ω_z),
    δv_r = f_v (−(1 + y²) ω_x + x y ω_y + x ω_z).

The yaw ω_y acts as an offset of all disparities, the pitch ω_x as one of all rows, and the roll ω_z
tilts the rows. No number of features averages such an error out. Its covariance S is estimated from
the frames themselves. What lasts from frame to frame is not part of it, but of the calibration
(``camera.rig_calibration``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.rig_jitter_numba import right_offsets
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics

PRIOR_SIGMA_RAD = np.array([1e-4, 1.5e-4, 1.5e-4])
"""Standard deviation of (pitch, yaw, roll) that is assumed at first: 0.1 px of disparity at
f = 700 px. KITTI has 0.04 px, a rig that flexes 0.3 px and more."""
PRIOR_FRAMES = 1.0
"""How many frames the prior counts for."""
EM_STEP_EXPONENT = 0.7
"""The n-th step of on-line EM goes n^−0.7 of the way (Cappé & Moulines 2009, who need an exponent
in (0.5, 1]): with 1/n, the first frames, which were weighed by a wrong S, would count for ever."""
LARGER = 1.5
"""Factor between two variances of the jitter from which a motion differs noticeably."""
LEARNED_FRAMES = 10.0
"""How many frames a covariance counts for that a noise model has learned: the rig may have been
mounted anew since."""
MOST_FRAMES = 300.0
"""Beyond so many frames, old ones are forgotten: mounts warm up, and roads change."""
LEAST_SIGMA_RAD = 1e-6
"""Least standard deviation of an angle, so that S can be inverted: a thousandth of a pixel."""


@dataclass(frozen=True)
class RigJitter:
    """An estimate of the covariance of the jitter: S of ω = (pitch, yaw, roll) ~ N(0, S)."""

    cov: FloatArray
    """S, [3, 3], rad²."""
    frames: float
    """How many frames it is worth, the prior's included."""

    @staticmethod
    def initial(cov: FloatArray | None = None, frames: float = PRIOR_FRAMES) -> RigJitter:
        """Return the prior.

        Args:
            cov: S of a rig that is known, [3, 3], rad²; by default that of an unknown one.
            frames: how many frames it counts for.
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
        """Return whether a variance is more than ``LARGER`` times that of a covariance, [3, 3]."""
        return cov is not None and bool((np.diagonal(self.cov) > LARGER * np.diagonal(cov)).any())

    def with_change(self, second_moment: FloatArray) -> RigJitter:
        """Update S with what one step shows of the change ω_k − ω_{k−1} (one step of on-line EM).

        Of two frames only the change of the jitter is seen well: its variance is 2 S. A step that
        shows nothing of it has the second moment 2 S, and leaves S as it is.

        Args:
            second_moment: E[(ω_k − ω_{k−1})(ω_k − ω_{k−1})ᵀ] given the step's residuals, [3, 3].
        """
        frames = min(self.frames + 1.0, MOST_FRAMES)
        share = frames**-EM_STEP_EXPONENT
        cov = self.cov + share * (0.5 * second_moment - self.cov)
        cov = 0.5 * (cov + cov.T) + share * LEAST_SIGMA_RAD**2 * np.eye(3)
        return replace(self, cov=cov, frames=frames)


def jitter_offsets(pixels: FloatArray, camera: StereoCamera) -> FloatArray:
    """Return ∂(u_r, v_r)/∂ω at N observations, [N, 4] to [N, 2, 3], px/rad."""
    offsets = np.empty((len(pixels), 2, 3))
    right_offsets(Intrinsics.of(camera), np.ascontiguousarray(pixels), offsets)
    return offsets
