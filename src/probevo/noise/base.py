"""The interface of all noise models, and the noise of N stereo features as a value.

A noise model maps the predictors φ of a feature to the distribution of its error. Each error is
Student-t distributed, e ~ t_ν(b, Σ) (PROBE-GK eq. (12)); ν = ∞ is the Gaussian N(b, Σ). The scale
matrix Σ is not the covariance, which is ν/(ν − 2) Σ and exists for ν > 2 only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, Protocol, get_args

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError, brief
from probevo.noise.model_file import ModelFile
from probevo.noise.student_t_numba import mahalanobis_and_log_det

RefersTo = Literal["observation", "residual"]
"""What a scale matrix describes: a single observation, or the residual of a pair of them."""

MIN_VARIANCE_DOF = 3.0
"""Smallest degrees of freedom ν for which the variance of a Student-t, scale · ν/(ν − 2), is used
as it is. Heavier tails have a larger one, or none, but RANSAC has cut them off."""


@dataclass(frozen=True)
class StereoNoise:
    """Noise of N stereo features: the error of each is Student-t (PROBE-GK eq. (12))."""

    scale: FloatArray
    """Scale matrix Σ, [N, 4, 4], px²; the covariance is dof/(dof − 2) Σ, and exists for dof > 2."""
    dof: FloatArray
    """Degrees of freedom ν, [N]; np.inf is Gaussian."""
    bias: FloatArray
    """Mean of the residual, [N, 4], px, whatever the scale refers to."""
    refers_to: RefersTo = "residual"
    """What the scale describes. ``residual``: the residual y' − f(T g(y)) as a whole.
    ``observation``: each of the two observations y and y'; the solver propagates the noise of y
    through the triangulation to obtain the covariance of the residual."""
    out_of_domain: BoolArray | None = None
    """Which features lie where the model has no training data, [N]; None for models without a
    domain."""
    time_correlated: FloatArray | None = None
    """Variance of the disparity error that is common to both frames of a feature, [N], px². It is
    added to ``scale``, whose errors are independent from frame to frame. None if there is none;
    only for noise that refers to observations."""
    prev_scale: FloatArray | None = None
    """Scale matrix of the earlier observation y, [N, 4, 4], px², where it differs from
    ``scale``, which then describes the current one y' alone. None means the same scale for both;
    only for noise that refers to observations."""
    jitter_cov: FloatArray | None = None
    """Covariance S of the rig's jitter (pitch, yaw, roll) in each frame, [3, 3], rad²: an error
    that all features of a frame have in common (``camera.rig_jitter``). None for a rigid rig."""

    def subset(self, chosen: IntArray) -> StereoNoise:
        """Return the noise of some of the features, given their indices [n]."""
        out_of_domain = None if self.out_of_domain is None else self.out_of_domain[chosen]
        time_correlated = None if self.time_correlated is None else self.time_correlated[chosen]
        prev_scale = None if self.prev_scale is None else self.prev_scale[chosen]
        return StereoNoise(
            scale=self.scale[chosen],
            dof=self.dof[chosen],
            bias=self.bias[chosen],
            refers_to=self.refers_to,
            out_of_domain=out_of_domain,
            time_correlated=time_correlated,
            prev_scale=prev_scale,
            jitter_cov=self.jitter_cov,
        )

    @property
    def scale_of_prev(self) -> FloatArray:
        """Scale matrix of the earlier observation y, [N, 4, 4], px²."""
        return self.scale if self.prev_scale is None else self.prev_scale

    def scaled(self, factors: FloatArray | float) -> StereoNoise:
        """Return the same noise with every (co)variance of a feature times its factor, [N], or
        times one factor for all."""
        factors = np.full(len(self.dof), factors)
        time_correlated = self.time_correlated
        if time_correlated is not None:
            time_correlated = factors * time_correlated
        prev_scale = self.prev_scale
        if prev_scale is not None:
            prev_scale = factors[:, None, None] * prev_scale
        return replace(
            self,
            scale=factors[:, None, None] * self.scale,
            time_correlated=time_correlated,
            prev_scale=prev_scale,
        )

    def with_correlated_error(self, error_px: FloatArray) -> StereoNoise:
        """Return the noise with one more error of each observation in each of the two frames.

        It is independent between the frames, and fully correlated between the four coordinates of
        an observation.

        Args:
            error_px: its standard deviation, with the signs of a joint move, [N, 4], px.
        """
        cov = np.einsum("ni,nj->nij", error_px, error_px)
        if self.refers_to == "residual":
            return replace(self, scale=self.scale + 2.0 * cov)
        prev_scale = None if self.prev_scale is None else self.prev_scale + cov
        return replace(self, scale=self.scale + cov, prev_scale=prev_scale)

    @property
    def covariance_factor(self) -> FloatArray:
        """ν/(ν − 2), the covariance of each feature over its scale, [N].

        It is infinite for ν ≤ 2; below ``MIN_VARIANCE_DOF`` it is taken at that ν.
        """
        factor: FloatArray = 1.0 / (1.0 - 2.0 / np.maximum(self.dof, MIN_VARIANCE_DOF))
        return factor

    def log_likelihood(self, residuals: FloatArray) -> FloatArray:
        """Return the log density of residuals [N, 4], px, under ``scale``, [N], nats.

        The noise of a single feature is broadcast to all residuals.
        """
        # ln t_ν(e; b, Σ) by s = (e − b)ᵀ Σ⁻¹ (e − b) and ln |Σ|. The compiled loop takes
        # contiguous, writable arrays.
        squared = np.empty(len(residuals))
        log_det = np.empty(len(residuals))
        scale = np.array(np.broadcast_to(self.scale, (len(residuals), 4, 4)), order="C")
        centered = np.ascontiguousarray(residuals - self.bias)
        mahalanobis_and_log_det(scale, centered, squared, log_det=log_det)
        return log_density(squared, log_det, self.dof)


def log_density(squared: FloatArray, log_det: FloatArray, dof: FloatArray) -> FloatArray:
    """Return the log density of a four-dimensional Student-t, [N], nats (PROBE-GK eq. (12)).

    Args:
        squared: squared Mahalanobis distance eᵀ Σ⁻¹ e, [N].
        log_det: ln |Σ|, [N].
        dof: degrees of freedom ν, [N]; np.inf is Gaussian.
    """
    # (ν + d) log(1 + s/ν) tends to s as ν → ∞; ν = 1 is only a number that stands in there.
    nu = np.where(np.isinf(dof), 1.0, dof)
    exponent = np.where(np.isinf(dof), squared, (nu + 4.0) * np.log1p(squared / nu))
    # Γ(ν/2 + 2) = (ν/2 + 1) (ν/2) Γ(ν/2), so that no difference of large log-gammas cancels. Over
    # (ν π)² of the density for d = 4, this leaves (1 + 2/ν)/(4 π²).
    density: FloatArray = np.log((1.0 + 2.0 / dof) / (4.0 * np.pi**2)) - 0.5 * (log_det + exponent)
    return density


def disparity_variance(scale: FloatArray) -> FloatArray:
    """Return the variance of the disparity u_l − u_r under scales [..., 4, 4], px²: [...]."""
    variance: FloatArray = scale[..., 0, 0] + scale[..., 2, 2] - 2.0 * scale[..., 0, 2]
    return variance


class NoiseModel(Protocol):
    """A noise model maps predictors to the noise of each feature; ``predict`` is pure.

    With a property ``scale_is_relative`` that is true, the odometry learns its scale online, by
    the features whose ν is finite.
    """

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the M predictors that it needs, in their order; empty for a static model."""

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """Return the noise of N features from their places φ in the prediction space, [N, M]."""

    def check_camera(self, camera: StereoCamera) -> None:
        """Refuse a camera for which the model does not hold.

        Raises:
            InputError: the model was learned with another camera.
        """


def predicted_noise(model: NoiseModel, phi: FloatArray) -> StereoNoise:
    """Return the noise of N features by a model, which may be the user's own.

    Args:
        model: the model.
        phi: the places of the features in its prediction space, [N, M].

    Raises:
        InputError: its ``predict`` does not return a ``StereoNoise`` of N features, a value is not
            finite, a variance is negative, ν is not positive, or ``refers_to`` is unknown.
    """
    noise = model.predict(phi)
    if not isinstance(noise, StereoNoise):
        raise InputError(
            "noise model",
            f"its predict returns a {type(noise).__name__}, where a StereoNoise is expected.",
            "See CONTRIBUTING.md, “Add a noise model”.",
        )
    shapes = (noise.scale.shape, noise.dof.shape, noise.bias.shape)
    count = len(phi)
    if shapes != ((count, 4, 4), (count,), (count, 4)):
        raise InputError(
            "noise model",
            f"for {count} features, its predict returns scale {shapes[0]}, dof {shapes[1]}, bias"
            f" {shapes[2]}.",
            "Expected are [N, 4, 4], [N] and [N, 4].",
        )
    check_refers_to(noise.refers_to)
    _check_values(noise)
    return noise


def check_refers_to(refers_to: object) -> None:
    """Refuse a word that is neither of ``RefersTo``: each would take it for another one.

    Raises:
        InputError: names the known ones.
    """
    if refers_to not in get_args(RefersTo):
        known = " and ".join(get_args(RefersTo))
        raise InputError("noise model", f"refers_to is {brief(refers_to)}.", f"Known are {known}.")


def _check_values(noise: StereoNoise) -> None:
    """Refuse values that no distribution has. That scales are definite is not checked: it would
    take as long as using them.

    Raises:
        InputError: names the value.
    """
    arrays = {
        "scale": noise.scale,
        "bias": noise.bias,
        "prev_scale": noise.prev_scale,
        "time_correlated": noise.time_correlated,
    }
    for name, array in arrays.items():
        if array is not None and not np.isfinite(array).all():
            raise InputError("noise model", f"its predict returns a {name} that is not finite.")
    if not (noise.dof > 0.0).all():  # NaN fails, too
        raise InputError("noise model", "its predict returns a dof that is not positive.")
    if (np.diagonal(noise.scale, axis1=1, axis2=2) < 0.0).any():
        raise InputError("noise model", "its predict returns a negative variance.")


def has_relative_scale(model: NoiseModel) -> bool:
    """Return whether a model describes how the errors of features compare, but not their size in a
    recording: the property ``scale_is_relative``, which a model may have.

    The odometry scales such noise to the recording (``estimation.noise_scale``).
    """
    return bool(getattr(model, "scale_is_relative", False))


class LearnedNoiseModel(NoiseModel, Protocol):
    """A noise model that was learned from recordings, and can be stored in a file."""

    camera: StereoCamera | None
    """Camera of the training data; None if it is unknown."""
    training: Mapping[str, Any]
    """Settings, recordings and progress of the training, in plain values that JSON can hold."""

    def to_file(self) -> ModelFile:
        """Return the content of the file of this model."""
