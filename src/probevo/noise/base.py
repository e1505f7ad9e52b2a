"""What every noise model promises, and the noise of N features as a value."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.noise.student_t_numba import measure

Refers = Literal["observation", "residual"]


@dataclass(frozen=True)
class StereoNoise:
    """Noise of N stereo features: each is Student-t with the given scale, dof and bias (PROBE-GK
    eq. 12)."""

    scale: FloatArray
    """Scale matrix, [N, 4, 4], px²; the covariance is dof/(dof − 2) times this; there is none for
    dof ≤ 2."""
    dof: FloatArray
    """Degrees of freedom, [N]; np.inf is Gaussian."""
    bias: FloatArray
    """Expected residual, [N, 4], px, whatever the scale refers to."""
    refers_to: Refers = "residual"
    """What the scale describes: the residual y' − f(T g(y)) as a whole (learned models), or each
    single observation y and y' (classical models), from which the solver derives the residual's,
    the triangulated point's noise included."""
    out_of_domain: BoolArray | None = None
    """Which of the N features lie where the model has seen no training data, [N]; None for models
    that have seen none, which are at home everywhere."""
    time_correlation: FloatArray | None = None
    """Variance of the error of each feature's disparity that is the same in both frames, [N], px²,
    beside ``scale``, which is new in each; None if there is none. Only of noise that refers to
    single observations."""

    def of(self, chosen: IntArray) -> StereoNoise:
        """The noise of some of the features, by their indices."""
        outside = None if self.out_of_domain is None else self.out_of_domain[chosen]
        time_correlated = None if self.time_correlation is None else self.time_correlation[chosen]
        return StereoNoise(
            self.scale[chosen],
            self.dof[chosen],
            self.bias[chosen],
            refers_to=self.refers_to,
            out_of_domain=outside,
            time_correlation=time_correlated,
        )

    def scaled(self, factors: FloatArray) -> StereoNoise:
        """The same noise, the scale of each feature times a factor, [N]."""
        time_correlated = None if self.time_correlation is None else factors * self.time_correlation
        return replace(
            self, scale=factors[:, None, None] * self.scale, time_correlation=time_correlated
        )

    def log_likelihood(self, residuals: FloatArray) -> FloatArray:
        """Log density of residuals [N, 4], px, in nats, [N]; the noise of one feature does for all."""
        squared = np.empty(len(residuals))
        log_det = np.empty(len(residuals))
        scale = np.array(np.broadcast_to(self.scale, (len(residuals), 4, 4)), order="C")
        measure(scale, np.ascontiguousarray(residuals - self.bias), squared, log_det=log_det)
        return log_density(squared, log_det, self.dof)


def log_density(squared: FloatArray, log_det: FloatArray, dof: FloatArray) -> FloatArray:
    """That of a Student-t in four dimensions, nats, [N], by eᵀ Σ⁻¹ e, ln |Σ| and ν; ν = ∞ is
    Gaussian (eq. 12)."""
    nu = np.where(np.isinf(dof), 1.0, dof)
    robust = np.where(np.isinf(dof), squared, (nu + 4.0) * np.log1p(squared / nu))
    # Γ(ν/2 + 2) = (ν/2 + 1) (ν/2) Γ(ν/2): no difference of large logarithms is left
    density: FloatArray = np.log((1.0 + 2.0 / dof) / (4.0 * np.pi**2)) - 0.5 * (log_det + robust)
    return density


def disparity_variance(scale: FloatArray) -> FloatArray:
    """That of u_l − u_r under scales of single observations [..., 4, 4], px²: [...]."""
    variance: FloatArray = scale[..., 0, 0] + scale[..., 2, 2] - 2.0 * scale[..., 0, 2]
    return variance


class NoiseModel(Protocol):
    """Predictors in, the noise of each feature out. ``predict`` is pure."""

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the M columns of the prediction space that it needs, in their order; none for a
        static model."""

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """Noise of N features from their place φ in the prediction space, [N, M]."""

    def check_camera(self, camera: StereoCamera) -> None:
        """Refuse a camera for which the model does not hold.

        Raises:
            InputError: the model was learned with another camera.
        """
