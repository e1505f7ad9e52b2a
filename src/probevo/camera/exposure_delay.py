"""Online estimate of the exposure delay of the right camera.

A right image that is exposed τ later than the left one shows a point where it is by then. In the
camera's frame a point p at rest moves by ṗ = ω × p + v, where (v, ω) is the twist of T_curr_prev
per second. With x = (u_r − c_u)/f_u, y = (v_l − c_v)/f_v and Z = f_u b/d at the time of the left
image, its mean velocity over τ in the right image is

    u̇_r = f_u (ṗ_x − x ṗ_z)/(Z + τ ṗ_z),    v̇_r = f_v (ṗ_y − y ṗ_z)/(Z + τ ṗ_z).

This is exact for a camera that does not turn: u_r = f_u (p_x − b)/p_z + c_u before and after. A car
that drives ahead thus moves v_r by y v d τ/b. Unlike errors of the rectification, this depends on
the disparity d, so a frame with near points determines τ. Both are estimated together from
v_r − v_l, by recursive robust least squares,

    v_r − v_l = a·(1, x, y, x², x y, y², y r²) + τ v̇_r,

where x is taken in the right image for a₁ and a₆, which describe it, and in the left image
elsewhere (``row_basis``); the motion during τ is removed from u_r and v_r.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.rig_rows import OffsetsOfFrame, fit_row_offsets
from probevo.camera.rig_rows_numba import RowOffsetNoise
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics, velocity_over_depth
from probevo.compiled import compiled

DELAY_SIGMA_S = 0.02
"""Prior standard deviation of τ."""
USUAL_DELAY_S = 0.001
"""Apparent delay that rectification errors can cause: up to 0.4 ms on KITTI, whose cameras are
triggered together."""
ITERATIONS = 4
"""Iterations of IRLS for the delay of a frame."""
MIN_SHARE = 0.1
"""Smallest depth of a point at the time of the right image, as a share of that before, and least
distance of the cameras, by which depth is known, as a share of the baseline."""
DELAY = 7
"""Index of τ among the coefficients; before it are a₀ … a₆."""


def _prior_information(row_sigma_px: FloatArray) -> FloatArray:
    """Return the inverse covariance of the prior of (a₀ … a₆, τ), [8, 8], which is diagonal."""
    information = np.zeros((DELAY + 1, DELAY + 1))
    np.fill_diagonal(information[:DELAY, :DELAY], row_sigma_px**-2.0)
    information[DELAY, DELAY] = DELAY_SIGMA_S**-2.0
    return information


@dataclass(frozen=True)
class ExposureDelay:
    """A Gaussian estimate of τ, jointly with the row coefficients."""

    row_sigma_px: FloatArray
    """Prior standard deviation of a₀ … a₆, [7]."""
    coefficients: FloatArray = field(default_factory=lambda: np.zeros(DELAY + 1))
    """a₀ … a₆, px, and τ, s, [8]."""
    learned: FloatArray = field(default_factory=lambda: np.zeros((DELAY + 1, DELAY + 1)))
    """Information on the coefficients without the prior's, [8, 8]."""

    @property
    def information(self) -> FloatArray:
        """Inverse covariance of the coefficients, [8, 8]."""
        information: FloatArray = self.learned + _prior_information(self.row_sigma_px)
        return information

    @property
    def estimate_s(self) -> float:
        """The estimate of τ."""
        return float(self.coefficients[DELAY])

    @property
    def sigma_s(self) -> float:
        """Standard deviation of the estimate."""
        return float(np.sqrt(np.linalg.inv(self.information)[DELAY, DELAY]))

    @property
    def delay_s(self) -> float:
        """The delay to correct for: τ, shrunk to zero unless it exceeds noise and rectification
        errors."""
        # Smooth shrinkage: a hard threshold would make the correction jump. The factor tends to 1
        # where τ is far above noise and rectification errors, and to 0 with the fourth power of τ
        # where it is far below.
        ratio = self.estimate_s**2 / (USUAL_DELAY_S**2 + self.sigma_s**2)
        return self.estimate_s * ratio**2 / (1.0 + ratio**2)

    def differs_from(self, delay_s: float) -> bool:
        """Return whether a delay differs from this one by more than rectification errors can
        cause."""
        return is_noticeable(self.delay_s - delay_s)

    def updated(
        self,
        pixels: FloatArray,
        basis: FloatArray,
        twist: FloatArray,
        *,
        camera: StereoCamera,
        noise: RowOffsetNoise,
        jitter_cov: FloatArray,
    ) -> ExposureDelay:
        """Update the estimate by the raw stereo matches of one frame.

        The jitter of the rig moves the rows differently in each frame. Over a few frames it looks
        like a delay, so it is marginalised.

        Args:
            pixels: the matches, [N, 4], px.
            basis: what a₀ … a₆ multiply at each, [N, 7].
            twist: Log(T_curr_prev) per second, [6], m/s and rad/s.
            camera: the rectified camera.
            noise: of v_r − v_l.
            jitter_cov: covariance of the rig's jitter, [3, 3], rad².
        """
        # The model v_r − v_l = basis · a + τ v̇_r is linear in (a, τ) once v̇_r, which depends on τ
        # too, is taken at the present estimate of τ: one more column, px/s.
        without_delay_px = without_delay(pixels, self.estimate_s, twist, camera)
        row_speed_px_s = right_velocity(without_delay_px, twist, camera, self.estimate_s)[:, 1]
        coefficients, information = fit_row_offsets(
            np.column_stack([basis, row_speed_px_s]),
            pixels[:, 3] - pixels[:, 1],
            (self.coefficients, self.information),
            noise=noise,
            iterations=ITERATIONS,
            frame_change=OffsetsOfFrame(_jitter_effect(camera), jitter_cov),
        )
        return ExposureDelay(
            row_sigma_px=self.row_sigma_px,
            coefficients=coefficients,
            learned=information - _prior_information(self.row_sigma_px),
        )


def _jitter_effect(camera: StereoCamera) -> FloatArray:
    """Return how the rig's jitter (pitch, yaw, roll) of a frame moves a₀ … a₆ and τ, [8, 3], px/rad
    (``rig_jitter``)."""
    # δv_r = f_v (−(1 + y²) ω_x + x y ω_y + x ω_z), where a₀ multiplies 1, a₁ x, a₄ x y and a₅ y².
    # a₄ has the x of the left image instead of the right one; what that misses, d y ω_y, is
    # negligible at angles of 10⁻⁴ rad. A jitter leaves τ unchanged: its row is 0.
    effect = np.zeros((DELAY + 1, 3))
    effect[[0, 5], 0] = -camera.fv_px
    effect[4, 1] = camera.fv_px
    effect[1, 2] = camera.fv_px
    return effect


def without_delay(
    pixels: FloatArray, delay_s: float, twist: FloatArray, camera: StereoCamera
) -> FloatArray:
    """Return observations [N, 4], px, with u_r and v_r corrected to the time of the left image.

    Args:
        pixels: the observations.
        delay_s: τ.
        twist: Log(T_curr_prev) per second, [6], m/s and rad/s.
        camera: the rectified camera.
    """
    corrected: FloatArray = pixels.copy()
    if delay_s:
        _remove_delay(corrected, twist, Intrinsics.of(camera), delay_s)
    return corrected


def right_velocity(
    pixels: FloatArray, twist: FloatArray, camera: StereoCamera, delay_s: float
) -> FloatArray:
    """Return the mean velocity (u̇_r, v̇_r) of points at rest over τ, [N, 2], px/s.

    Args:
        pixels: observations of both cameras at one time, [N, 4], px.
        twist: Log(T_curr_prev) per second, [6], m/s and rad/s.
        camera: the rectified camera.
        delay_s: τ.
    """
    velocity = np.empty((len(pixels), 2))
    _fill_right_velocity(pixels, twist, Intrinsics.of(camera), delay_s, velocity)
    return velocity


@compiled
def _fill_right_velocity(
    pixels: FloatArray,
    twist: FloatArray,
    camera: Intrinsics,
    delay_s: float,
    velocity: FloatArray,
) -> None:
    """Fill the mean velocities, [N, 2], px/s."""
    fu, fv, cu, cv, fb = camera
    for k in range(len(pixels)):
        x = (pixels[k, 0] - cu) / fu
        y = (pixels[k, 1] - cv) / fv
        x_right = (pixels[k, 2] - cu) / fu
        inverse_depth = (pixels[k, 0] - pixels[k, 2]) / fb
        rate_x, rate_y, rate_z = velocity_over_depth(x, y, inverse_depth, twist)
        # Differences of u_r = f_u (p_x − b)/p_z + c_u and v_r = f_v p_y/p_z + c_v over τ
        share = max(1.0 + delay_s * rate_z, MIN_SHARE)
        velocity[k, 0] = fu * (rate_x - x_right * rate_z) / share
        velocity[k, 1] = fv * (rate_y - y * rate_z) / share


@compiled
def _remove_delay(
    pixels: FloatArray,
    twist: FloatArray,
    camera: Intrinsics,
    delay_s: float,
) -> None:
    """Move u_r and v_r of observations, [N, 4], px, to the time of the left image.

    With ρ = 1/Z, ṗ/Z = r + ρ v, where r = ω × (x_l, y, 1), and x' of the right image after τ,

        x' (1 + τ (r_z + ρ v_z)) = x_l + τ (r_x + ρ v_x) − ρ b,

    which is linear in ρ. Observations that no point at rest can have stay as they are.
    """
    fu, fv, cu, cv, fb = camera
    baseline_m = fb / fu
    vx, vy, vz, wx, wy, wz = twist
    for k in range(len(pixels)):
        x = (pixels[k, 0] - cu) / fu
        y = (pixels[k, 1] - cv) / fv
        x_later = (pixels[k, 2] - cu) / fu
        turned_x = wy - wz * y
        turned_y = wz * x - wx
        turned_z = wx * y - wy * x
        apart_m = baseline_m + delay_s * (x_later * vz - vx)
        if apart_m < MIN_SHARE * baseline_m:
            continue
        inverse_depth = x + delay_s * turned_x - x_later * (1.0 + delay_s * turned_z)
        inverse_depth /= apart_m
        rate_z = turned_z + inverse_depth * vz
        share = 1.0 + delay_s * rate_z
        if share < MIN_SHARE:
            continue
        rate_y = turned_y + inverse_depth * vy
        pixels[k, 2] = pixels[k, 0] - fb * inverse_depth
        pixels[k, 3] -= delay_s * fv * (rate_y - y * rate_z) / share


def is_noticeable(delay_s: float) -> bool:
    """Return whether a delay is larger than rectification errors can cause."""
    return abs(delay_s) > USUAL_DELAY_S
