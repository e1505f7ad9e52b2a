"""What the tables of PROBE-GK have in common: their estimators, and the settings that they are
trained and run with."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from probevo.config import OdometryConfig
from probevo.run_config import SharedConfig
from probevo.training.settings import KERNEL_ONLY, KernelSettings, SupervisionName, TrainSettings

FIXED = "fixed"
STATIC = "student-t"
FITTED = "student-t fitted"
GK_GT = "GK-GT"
GK_EM = "GK-EM"
"""The fixed covariance; the static M-estimator, as shipped and with its scale matrix fitted to the
training data; the generalized kernel, trained with the truth and without."""
ESTIMATOR_NOTE = (
    f"{STATIC}: the static M-estimator as shipped; {FITTED}, of which nothing was published: the"
    " same with the scale matrix and the degrees of freedom of the training data."
)


class KernelTableConfig(OdometryConfig):
    """All runs and trainings share these; the estimators differ in their noise model alone."""

    gk: KernelSettings = Field(
        KernelSettings(), description="How the generalized kernel is trained."
    )

    def shared(
        self, *, self_calibration: bool | None = None, max_frames: int | None = None
    ) -> SharedConfig:
        """The settings of the runs."""
        given = {name: getattr(self, name) for name in OdometryConfig.model_fields}
        given |= {} if self_calibration is None else {"self_calibration": self_calibration}
        return SharedConfig.model_validate(given | {"max_frames": max_frames})

    def training(
        self, kind: Literal["gk", "student-t"], supervision: SupervisionName, runs: SharedConfig
    ) -> TrainSettings:
        """The settings of a training for such runs."""
        odometry = OdometryConfig.model_validate(
            {name: getattr(runs, name) for name in OdometryConfig.model_fields}
        )
        gk = self.gk
        if kind == "student-t":  # which would refuse what is the kernel's alone
            default = KernelSettings()
            gk = gk.model_copy(update={name: getattr(default, name) for name in KERNEL_ONLY})
        return TrainSettings(
            kind=kind, supervision=supervision, gk=gk, max_frames=runs.max_frames, odometry=odometry
        )
