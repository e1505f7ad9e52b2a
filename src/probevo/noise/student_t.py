"""The static M-estimator: one Student-t for every feature (PROBE-GK section 1.5.3, after Kerl et
al. 2013)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.noise.base import Refers, StereoNoise, disparity_variance
from probevo.noise.model_file import ModelFile
from probevo.noise.origin import OriginFacts, origin_facts, refuse_other_camera
from probevo.noise.student_t_fit import fit_static

DOF = 2.5
SIGMA_PX = 0.17
"""Nearly the tails of real tracks, whose ν is 1.9 to 2.1 when it is fitted: from 2 down they would
have no variance."""
TIME_CORRELATION = 0.7
"""By likelihood, on both of KITTI's recordings with images that this was tried on: 0.2 px. Sparse
tracks have more."""


class _Facts(OriginFacts):
    """What a file says beside its arrays."""

    dof: Annotated[float, Field(gt=0)] | Literal["inf"]
    """JSON has no infinity."""
    refers_to: Refers
    time_correlation: float = Field(0.0, ge=0)


class StudentT:
    """Student-t noise of one scale matrix for every feature.

    Args:
        dof: degrees of freedom ν; small values trust outliers less, and np.inf is Gaussian.
        scale: scale matrix of (u_l, v_l, u_r, v_r), [4, 4], px²; by default that of tracked
            corners.
        refers_to: whether that is the noise of an observation, or of the residual.
        camera: the camera of the training data; None if it was not trained.
        training: how the training data came about, in plain values that JSON can hold.
        time_correlation: how many times as large the error of a disparity is that is the same in both
            frames, as the one that is new in each; by default, 0 for a scale that is given. The
            noise of a residual as a whole has none.
    """

    columns: tuple[str, ...] = ()

    def __init__(
        self,
        dof: float = DOF,
        scale: FloatArray | None = None,
        refers_to: Refers = "observation",
        camera: StereoCamera | None = None,
        training: Mapping[str, Any] | None = None,
        time_correlation: float | None = None,
    ) -> None:
        shipped = TIME_CORRELATION if scale is None and refers_to == "observation" else 0.0
        self.time_correlation = shipped if time_correlation is None else time_correlation
        self.dof = self.dof_ = dof
        self.scale = self.scale_ = SIGMA_PX**2 * np.eye(4) if scale is None else scale
        self.refers_to = refers_to
        self.camera = camera
        self.training = training or {}

    def fit(
        self, predictors: FloatArray, residuals: FloatArray, *, spread: FloatArray | None = None
    ) -> Self:
        """Set ``scale_``, in full, and ``dof_`` by maximum likelihood (EM).

        Args:
            predictors: of N features, [N, M]; they do not matter.
            residuals: their errors, [N, 4], px.
            spread: covariance of what is not known of each error, [N, 4, 4], px².

        Raises:
            InputError: there is no residual, or one is not finite.
        """
        fitted = fit_static(np.asarray(residuals, dtype=np.float64), spread)
        self.scale_ = fitted.scale[0]
        self.dof_ = float(fitted.dof[0])
        return self

    def predict(self, predictors: FloatArray) -> StereoNoise:
        """The same noise for each of N features, whatever their predictors [N, M]."""
        count = len(predictors)
        scale = np.broadcast_to(np.asarray(self.scale_, dtype=np.float64), (count, 4, 4))
        time_correlated = (
            self.time_correlation**2 * disparity_variance(scale) if self.time_correlation else None
        )
        return StereoNoise(
            scale,
            np.full(count, self.dof_),
            np.zeros((count, 4)),
            refers_to=self.refers_to,
            time_correlation=time_correlated,
        )

    def check_camera(self, camera: StereoCamera) -> None:
        """Refuse another camera than that of the training; untrained, it takes any.

        Raises:
            InputError: it is another camera.
        """
        refuse_other_camera(self.camera, camera)

    def to_file(self) -> ModelFile:
        """What a file needs to hold."""
        facts = {
            "dof": "inf" if np.isinf(self.dof_) else self.dof_,
            "refers_to": self.refers_to,
            "time_correlation": self.time_correlation,
            **origin_facts(self.camera, self.training),
        }
        return ModelFile("student-t", {"scale": np.asarray(self.scale_, dtype=np.float64)}, facts)

    @staticmethod
    def from_file(file: ModelFile) -> StudentT:
        """The model that ``to_file`` put there.

        Raises:
            KeyError, ValueError, InputError: the file does not hold such a model.
        """
        facts = _Facts.of(file)
        scale = file.arrays["scale"]
        if (
            scale.shape != (4, 4)
            or scale.dtype != np.float64
            or not np.linalg.eigvalsh(scale)[0] > 0.0
        ):
            raise ValueError("its scale is no positive definite matrix")
        return StudentT(
            float(facts.dof),
            scale,
            facts.refers_to,
            camera=facts.camera,
            training=facts.training,
            time_correlation=facts.time_correlation,
        )
