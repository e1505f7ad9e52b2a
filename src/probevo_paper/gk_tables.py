"""What the tables of PROBE-GK have in common: their estimators, and how these train and run."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from probevo.config import OdometryConfig
from probevo.config.training import KERNEL_ONLY, KernelSettings, SupervisionName, TrainSettings
from probevo.run_config import CommonRunSettings

FIXED = "fixed"
"""One Gaussian covariance for all features."""
STATIC = "student-t"
"""The static M-estimator as shipped: one Student-t for all features."""
FITTED = "student-t fitted"
"""The static M-estimator with scale matrix and degrees of freedom fitted to the training drive."""
GK_GT = "GK-GT"
"""The generalized kernel, trained with ground truth."""
GK_EM = "GK-EM"
"""The generalized kernel, trained by EM without ground truth."""
ESTIMATOR_NOTE = (
    f"{STATIC}: the static M-estimator as shipped; {FITTED}, of which nothing was published: the"
    " same with the scale matrix and the degrees of freedom of the training data."
)


class GkTableConfig(OdometryConfig):
    """The settings of all runs and trainings; estimators differ only in their noise model."""

    estimator: Literal["two-frame", "window"] = Field(
        "two-frame", description="Of all runs; what was published is of two frames."
    )
    gk: KernelSettings = Field(
        KernelSettings(), description="How the generalized kernel is trained."
    )

    def run_settings(
        self, *, self_calibration: bool | None = None, max_frames: int | None = None
    ) -> CommonRunSettings:
        """Return the settings of the runs, with another self-calibration if one is given."""
        settings = {name: getattr(self, name) for name in OdometryConfig.model_fields}
        if self_calibration is not None:
            settings["self_calibration"] = self_calibration
        return CommonRunSettings.model_validate(settings | {"max_frames": max_frames})

    def training_settings(
        self,
        kind: Literal["gk", "student-t"],
        supervision: SupervisionName,
        runs: CommonRunSettings,
    ) -> TrainSettings:
        """Return the settings of a training whose model is for such runs."""
        odometry = OdometryConfig.model_validate(
            {name: getattr(runs, name) for name in OdometryConfig.model_fields}
        )
        gk = self.gk
        if kind == "student-t":
            # A training of the Student-t refuses settings that only a kernel has.
            default = KernelSettings()
            gk = gk.model_copy(update={name: getattr(default, name) for name in KERNEL_ONLY})
        return TrainSettings(
            kind=kind, supervision=supervision, gk=gk, max_frames=runs.max_frames, odometry=odometry
        )
