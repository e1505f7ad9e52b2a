"""The static M-estimator: one Student-t for all features (PROBE-GK 1.5.3; Kerl et al. 2013).

Its few degrees of freedom make the loss of the solver robust: (ν + d) ln(1 + e²/ν) grows with the
logarithm of an outlier, not with its square.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field

from probevo.arrays import AnyArray, FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError, brief
from probevo.noise.base import RefersTo, StereoNoise, check_refers_to, disparity_variance
from probevo.noise.jitter_array import jitter_arrays, jitter_cov_of
from probevo.noise.model_file import ModelFile
from probevo.noise.origin import OriginFacts, origin_facts, refuse_other_camera
from probevo.noise.positive_definite import check_positive_definite, is_positive_definite
from probevo.noise.student_t_fit import fit_static

DOF = 2.5
"""Degrees of freedom ν of an untrained model, close to the tails of real tracks. Fits to these have
1.9 to 2.1, but for ν ≤ 2 there would be no variance."""
SIGMA_PX = 0.17
"""Standard deviation of each coordinate in an untrained model. It is where the odometry starts:
how large the noise of a recording is, it learns while running (``estimation.noise_scale``)."""
DEFAULT_SCALE = SIGMA_PX**2 * np.eye(4)
TIME_CORRELATION_RATIO = 0.7
"""Default of an untrained model: the most likely ratio on both of KITTI's recordings with images
that were tried, 0.2 px. Sparse tracks have more."""


class StudentT:
    """Student-t noise with one scale matrix for every feature.

    Without ``fit``, the model predicts what it is given.

    Args:
        dof: degrees of freedom ν. Small values trust outliers less; np.inf is Gaussian.
        scale: scale matrix of (u_l, v_l, u_r, v_r), [4, 4], px²; by default as for tracked
            corners.
        refers_to: whether the scale describes an observation or the residual.
        camera: camera of the training data; None if the model was not trained.
        training: settings, recordings and progress of the training, in plain values that JSON can
            hold.
        time_correlation_ratio: standard deviation of the disparity error that is common to both
            frames, over that of the error that is independent in each. By default 0 for a scale
            that is given or fitted. Noise that refers to the residual has none.
        jitter_cov: covariance of the rig's jitter (``camera.rig_jitter``), [3, 3], rad²; None if it
            is not known. ``fit`` does not estimate it.
        scale_is_relative: whether the size of the errors differs from recording to recording, and
            the odometry learns it online (``has_relative_scale``). By default it does so for the
            default scale alone; training sets it. For ν = ∞ it cannot: a Gaussian has no room for
            outliers, so that its scale is no measure of theirs.

    Raises:
        InputError: ν is not positive, the scale is not positive definite, ``refers_to`` is
            unknown, or the scale is to be relative for ν = ∞.
    """

    columns: tuple[str, ...] = ()

    def __init__(
        self,
        dof: float = DOF,
        scale: FloatArray | None = None,
        refers_to: RefersTo = "observation",
        *,
        camera: StereoCamera | None = None,
        training: Mapping[str, Any] | None = None,
        time_correlation_ratio: float | None = None,
        jitter_cov: FloatArray | None = None,
        scale_is_relative: bool | None = None,
    ) -> None:
        check_refers_to(refers_to)
        _check_dof(dof)
        if scale_is_relative and np.isinf(dof):
            raise InputError(
                "noise model",
                "its scale_is_relative is True where its dof is inf: the size of Gaussian errors is"
                " not learned while running.",
                "Give a finite dof, or leave scale_is_relative out.",
            )
        if scale is not None:
            check_positive_definite(scale, "scale", 4)
        self.dof = dof
        self.scale = DEFAULT_SCALE.copy() if scale is None else scale
        self.refers_to = refers_to
        self.camera = camera
        self.training = training or {}
        self.time_correlation_ratio = time_correlation_ratio
        self.jitter_cov = jitter_cov
        # What ``predict`` and the odometry use; ``fit`` replaces it. The default ratio belongs to
        # the default scale.
        is_default = np.array_equal(self.scale, DEFAULT_SCALE)
        default_ratio = 0.0
        if scale is None and refers_to == "observation":
            default_ratio = TIME_CORRELATION_RATIO
        self.dof_ = dof
        self.scale_ = self.scale
        self.time_correlation_ratio_ = (
            default_ratio if time_correlation_ratio is None else time_correlation_ratio
        )
        self.scale_is_relative_ = is_default if scale_is_relative is None else scale_is_relative

    @property
    def scale_is_relative(self) -> bool:
        """Whether the odometry is to learn online how large the errors of a recording are; never
        for ν = ∞."""
        return self.scale_is_relative_ and bool(np.isfinite(self.dof_))

    def fit(
        self, predictors: FloatArray, residuals: FloatArray, *, error_cov: FloatArray | None = None
    ) -> Self:
        """Fit ``scale_`` and ``dof_`` by maximum likelihood (EM). The scale is then no longer
        relative.

        Args:
            predictors: of N features, [N, M]; they have no influence.
            residuals: errors of the features, [N, 4], px.
            error_cov: covariance of each error, [N, 4, 4], px²; None if they are known exactly.

        Raises:
            InputError: there is no residual, or one is not finite.
        """
        fitted = fit_static(np.asarray(residuals, dtype=np.float64), error_cov)
        self.scale_ = fitted.scale[0]
        self.dof_ = float(fitted.dof[0])
        self.scale_is_relative_ = False
        if self.time_correlation_ratio is None:
            self.time_correlation_ratio_ = 0.0
        return self

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """Return the same noise for each of N features, whatever their predictors [N, M]."""
        count = len(predictors)
        # A view: it is the same matrix for all features.
        scale = np.broadcast_to(np.asarray(self.scale_, dtype=np.float64), (count, 4, 4))
        time_correlated = None
        if self.time_correlation_ratio_:
            # τ² = κ² σ_d², with σ_d² the variance of the disparity that is new in each frame
            time_correlated = self.time_correlation_ratio_**2 * disparity_variance(scale)
        return StereoNoise(
            scale=scale,
            dof=np.full(count, self.dof_),
            bias=np.zeros((count, 4)),
            refers_to=self.refers_to,
            time_correlated=time_correlated,
            jitter_cov=self.jitter_cov,
        )

    def check_camera(self, camera: StereoCamera) -> None:
        """Refuse a camera unlike the training's; an untrained model accepts any.

        Raises:
            InputError: the cameras differ; the message says in what.
        """
        refuse_other_camera(self.camera, camera)

    def to_file(self) -> ModelFile:
        """Return the content of the file of this model."""
        facts = {
            # JSON takes no infinity, and no numbers of NumPy.
            "dof": "inf" if np.isinf(self.dof_) else float(self.dof_),
            "refers_to": self.refers_to,
            "time_correlation_ratio": float(self.time_correlation_ratio_),
            "scale_is_relative": bool(self.scale_is_relative),
            **origin_facts(self.camera, self.training),
        }
        arrays: dict[str, AnyArray] = {"scale": np.asarray(self.scale_, dtype=np.float64)}
        return ModelFile("student-t", arrays | jitter_arrays(self.jitter_cov), facts)

    @staticmethod
    def from_file(file: ModelFile) -> StudentT:
        """Read the model that ``to_file`` has described.

        Raises:
            KeyError, ValueError, InputError: the file does not hold such a model.
        """
        facts = _Facts.of(file)
        scale = file.arrays["scale"]
        if not is_positive_definite(scale, 4):
            raise ValueError("its scale is not a positive definite matrix")
        return StudentT(
            dof=float(facts.dof),
            scale=scale,
            refers_to=facts.refers_to,
            camera=facts.camera,
            training=facts.training,
            time_correlation_ratio=facts.time_correlation_ratio,
            jitter_cov=jitter_cov_of(file),
            scale_is_relative=facts.scale_is_relative,
        )


def _check_dof(dof: object) -> None:
    """Refuse degrees of freedom that are not positive.

    Raises:
        InputError: says what they are.
    """
    if not isinstance(dof, int | float | np.number) or not dof > 0.0:  # NaN fails, too
        cure = "Give a positive number, or inf."
        raise InputError("noise model", f"its dof is {brief(dof)}.", cure)


class _Facts(OriginFacts):
    """The facts that a file states beside its array."""

    dof: Annotated[float, Field(gt=0)] | Literal["inf"]
    """JSON has no infinity."""
    refers_to: RefersTo
    time_correlation_ratio: float = Field(0.0, ge=0, le=1e6)
    scale_is_relative: bool
