"""Check of the rows of a rectified pair, and of the delay of its right image, by stereo matches.

In a perfect pair, a point is in the same row of both images. If the right image is exposed δ later,
the point is δ v̇ farther down, where v̇ is the speed of its row:

    v_r − v_l = a·(1, x, y, x², xy, y², y r²) + δ v̇

Only the part of v̇ due to the camera's rotation is used: pitching moves all rows up and down. The
part due to driving ahead grows with y in every frame, just like lens errors, so it has no
information. The speed is predicted from the motion of all points, so that the noise of the match is
not on both sides of the equation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.rig_calibration import ROW_SIGMA_PX, row_basis
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer import transfer
from probevo.evaluation.clustered_regression import Regression, regress
from probevo.geometry import se3, so3

DELAY_SIGMA_S = 0.1
"""Prior standard deviation of δ: a frame of a camera at ten frames a second."""
_MOMENT_S = 1e-3
"""Duration of the difference quotient for a speed."""
DELAY = 7
"""Index of δ among the coefficients; before it come the coefficients of ``row_basis``."""


@dataclass(frozen=True)
class RowSamples:
    """The stereo matches of one frame, N of them."""

    pixels: FloatArray
    """(u_l, v_l, u_r, v_r) as matched, without any correction, [N, 4], px."""
    row_speed_px_s: FloatArray
    """Speed of each point's row in the left image by the camera's rotation, [N]."""
    ids: IntArray
    """Identity of each feature, the same in all frames that show it, [N]."""

    @staticmethod
    def of(
        raw_px: FloatArray,
        corrected_px: FloatArray,
        ids: IntArray,
        *,
        rate_rad_s: FloatArray,
        camera: StereoCamera,
    ) -> RowSamples:
        """Predict the speeds from the camera's rotation.

        Args:
            raw_px: observations in a frame, [N, 4], px.
            corrected_px: the same, corrected by the rig's calibration, [N, 4], px.
            ids: identity of each feature, [N].
            rate_rad_s: Log(C_curr_prev) per second at the time of the frame, [3], camera frame: the
                mean of the steps before and after it.
            camera: the rectified camera.
        """
        # Transfer the points back by a moment: C_before_now = Exp(−ω δt), as the rate belongs to
        # C_curr_prev. A rotation alone moves images of points at any depth alike.
        back = so3.exp(-_MOMENT_S * rate_rad_s)
        before = transfer(corrected_px, se3.from_parts(back, np.zeros(3)), camera)
        row = 0.5 * (corrected_px[:, 1] + corrected_px[:, 3])
        speed = (row - before[:, 1]) / _MOMENT_S
        known = np.isfinite(speed)
        return RowSamples(raw_px[known], speed[known], ids[known])


def check_rows(frames: list[RowSamples], camera: StereoCamera) -> Regression:
    """Estimate a₀ … a₆, px, and δ, s, of the matches of some frames."""
    pixels = np.concatenate([frame.pixels for frame in frames])
    speed = np.concatenate([frame.row_speed_px_s for frame in frames])
    number = np.repeat(np.arange(len(frames)), [len(frame.pixels) for frame in frames])
    # The prior is weaker than the odometry's: here the rectification is tested, not corrected.
    return regress(
        np.column_stack([row_basis(pixels, camera), speed]),
        pixels[:, 3] - pixels[:, 1],
        number,
        prior_sigma=np.r_[10.0 * ROW_SIGMA_PX, DELAY_SIGMA_S],
        # A feature keeps the part of its error due to its texture for as long as it is seen.
        track=np.concatenate([frame.ids for frame in frames]),
    )
