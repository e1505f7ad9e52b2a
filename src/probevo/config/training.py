"""Every setting of ``probevo train``, with its bounds and its reason."""

from __future__ import annotations

import math
from typing import Any, Literal

from pydantic import Field

from probevo.config import GyroConfig, OdometryConfig, RansacConfig
from probevo.config.networks import NetworkSettings
from probevo.config.settings import Settings

SupervisionName = Literal["gt", "sparse", "position", "loop", "none"]
BaseName = Literal["fixed", "student-t"]

PUBLISHED_PREDICTORS = (
    "acceleration",
    "turn_rate",
    "blur",
    "entropy",
    "frequency",
    "flow_variance",
)
"""The predictors of PROBE."""
PROBE_PREDICTORS = (
    "blur",
    "entropy",
    "frequency",
    "flow_variance",
    "place",
    "disparity",
    "disparity_change",
    "residual_flow",
    "row_offset",
    "forward_backward",
    "structure",
)
"""Default predictors of PROBE. None needs an accelerometer, as a model that needs one is of no use
to a recording without it."""
KERNEL_PREDICTORS = (
    "place",
    "last_residual",
    "age",
    "turn_rate",
    "blur",
    "entropy",
    "frequency",
    "structure",
    "forward_backward",
    "window_difference",
    "alignment",
)
"""Default predictors of PROBE-GK, among which the kernel chooses. None is computed from the very
measurements whose noise is predicted: a weight that is correlated with the error of a disparity, or
with how well a feature agrees with the predicted motion (``disparity``, ``flow``,
``residual_flow``), makes residuals more likely and motions worse."""
PROBE_ONLY = (
    "base",
    "iterations",
    "subset",
    "contrast",
    "relative",
    "average",
    "neighbors",
    "exponent",
)
"""Fields of ``TrainSettings`` that only PROBE uses."""
KERNEL_ONLY = ("variant", "neighbors", "reach", "prior_counts", "bias", "centers", "iterations")
"""Fields of ``KernelSettings`` that only the generalized kernel uses; the static Student-t uses the
others, too."""


class KernelSettings(Settings):
    """Settings of PROBE-GK; a hyperparameter that is not given is chosen by cross-validation.

    The criterion is the likelihood of blocks of time that were left out.
    """

    variant: Literal["robust", "published"] = Field(
        "robust",
        description=(
            "Student-t fitted to the K nearest errors, or the inverse-Wishart posterior as"
            " published."
        ),
    )
    neighbors: int | None = Field(None, ge=1, description="K, the errors that a fit uses.")
    reach: float | None = Field(
        None,
        gt=0,
        le=1e6,
        description="ρ, in standard deviations; farther samples do not contribute.",
    )
    prior_counts: float | None = Field(
        None, gt=0, le=1e9, description="Number of errors that the static prior counts for."
    )
    bias: bool = Field(
        False,
        description=(
            "Learn the mean of errors too, not only their scatter, in the robust variant. It makes"
            " residuals more likely, but without truth a bias cannot be separated from a motion,"
            " and each EM iteration moves both a little further."
        ),
    )
    centers: int = Field(
        2000,
        ge=1,
        le=1_000_000,
        description="Places at which the fitted noise is stored; the cost of a run depends on it.",
    )
    iterations: int = Field(
        5,
        ge=1,
        le=1000,
        description="EM iterations: motions given the noise, the noise given their residuals.",
    )
    quadratic: bool = Field(
        False,
        description=(
            "Solve for the motions of EM by least squares, as PROBE-GK derives it, instead of its"
            " robust loss."
        ),
    )
    refers_to: Literal["observation", "residual"] = Field(
        "observation",
        description=(
            "Learn the noise of single observations, from which the solver derives the noise of the"
            " residual for any depth and speed; or the noise of the residual as a whole, as"
            " published."
        ),
    )
    time_correlation: bool = Field(
        True,
        description=(
            "Learn how much of a disparity's error is time-correlated, the same in both frames,"
            " beside what is new in each; the noise of a residual as a whole has no such part."
        ),
    )
    truth_sigma_m: float | None = Field(
        None,
        ge=0,
        le=1000,
        description=(
            "Standard deviation of the true motion between two known positions, m; by default it"
            " is estimated."
        ),
    )
    truth_sigma_deg: float | None = Field(
        None,
        ge=0,
        le=180,
        description="The same for attitudes; to be given together with the other.",
    )

    @property
    def learns_time_correlation(self) -> bool:
        """Whether the noise has a time-correlated part, and it is to be learned."""
        return (
            self.time_correlation and self.refers_to == "observation" and self.variant == "robust"
        )

    @staticmethod
    def published() -> KernelSettings:
        """Return the settings of PROBE-GK as published.

        The noise describes residuals, the posterior is an inverse Wishart, the motions of EM are
        solved by least squares, the rig is rigid, and the truth is exact.
        """
        return KernelSettings(
            variant="published",
            refers_to="residual",
            quadratic=True,
            truth_sigma_m=0.0,
            truth_sigma_deg=0.0,
        )

    def given(self) -> dict[str, Any]:
        """Return the hyperparameters that are given, as ``GeneralizedKernel`` takes them."""
        hyperparameters: dict[str, Any] = {
            "neighbors": self.neighbors,
            "reach": self.reach,
            "prior_counts": self.prior_counts,
        }
        if not self.bias:
            # An infinite weight of the prior, whose bias is 0.
            hyperparameters["bias_counts"] = math.inf
        return {name: value for name, value in hyperparameters.items() if value is not None}


class TrainSettings(Settings):
    """Settings of a training."""

    # What is learned, and from what.
    kind: str = Field(
        "knn",
        description=(
            "What to learn. Noise models: knn is PROBE, weights from the nearest neighbours in the"
            " prediction space; gk is PROBE-GK, a covariance and a loss for each feature; student-t"
            " is one Student-t for all, fitted to the same data. Networks that serve as sensors for"
            " `probevo run --sensor`: the rotation between two left images (rotation, HydraNet),"
            " a correction of the odometry's own motions (correction, DPC-Net), and the direction"
            " of the sun (sun, Sun-BCNN)."
        ),
    )
    supervision: SupervisionName = Field(
        "gt",
        description=(
            "Ground truth to use: the pose of every frame (gt) or of some frames (sparse), only"
            " positions (position), the fact that each drive ends where it began (loop; or its"
            " true last pose, if known), or none. With none, the motion of all features is the"
            " reference for the motion of a few, which is better than a truth with errors of"
            " centimetres from frame to frame, such as KITTI's."
        ),
    )
    every_s: float = Field(
        0.0,
        ge=0,
        le=3600,
        description=(
            "With sparse and position: interval between the true poses that are used; 0 uses all."
        ),
    )
    predictors: tuple[str, ...] | None = Field(
        None,
        min_length=1,
        description=(
            "Predictors that span the prediction space; by default, those that suit the kind and"
            " the recordings."
        ),
    )
    # PROBE (``PROBE_ONLY``).
    base: BaseName = Field(
        "student-t",
        description=(
            "The model whose noise is scaled: PROBE's is Gaussian (fixed), student-t is robust too."
        ),
    )
    iterations: int = Field(
        40,
        ge=2,
        le=10_000,
        description=("Random subsets at each step; PROBE takes 10. More than 40 only cost time."),
    )
    subset: int = Field(
        8,
        ge=6,
        le=10_000,
        description=(
            "Features in a subset. In a small one, the error of each has more effect; PROBE takes a"
            " tenth of the features of a frame."
        ),
    )
    contrast: float = Field(
        3.0,
        ge=0,
        le=100,
        description=(
            "How similar the features of a subset are: each subset prefers a random direction of"
            " the prediction space, so that its error is characteristic of one region of it. 0 is"
            " PROBE: purely random subsets."
        ),
    )
    relative: bool = Field(
        True,
        description=(
            "Divide α by the error that the covariance of its subset predicts, and by the mean over"
            " all subsets of the same stretch. PROBE does not, but an error that all subsets share"
            " says nothing about single features."
        ),
    )
    average: Literal["arithmetic", "geometric"] = Field(
        "geometric",
        description=(
            "Mean of α over the neighbours; PROBE's is arithmetic, which single large α dominate."
        ),
    )
    neighbors: int | None = Field(
        None, ge=1, description="K; by default chosen by cross-validation over blocks of time."
    )
    exponent: float | None = Field(
        None,
        ge=0,
        le=1000,
        description=(
            "γ; by default the least one whose error on the training drives is within a standard"
            " error of the best."
        ),
    )
    # PROBE-GK, and what all kinds share.
    gk: KernelSettings = KernelSettings()
    # Networks that measure.
    nets: NetworkSettings = NetworkSettings()
    max_frames: int | None = Field(
        None, ge=2, description="Use at most this many frames of each recording."
    )
    odometry: OdometryConfig = OdometryConfig(estimator="two-frame")

    @staticmethod
    def published() -> TrainSettings:
        """Return the settings of PROBE as published.

        These are its predictors, Gaussian noise, the gyro's pre-filter instead of RANSAC, ten
        random subsets of 60 features (it took tenths of some 600), absolute α, arithmetic means.
        """
        return TrainSettings(
            predictors=PUBLISHED_PREDICTORS,
            base="fixed",
            iterations=10,
            subset=60,
            contrast=0.0,
            relative=False,
            average="arithmetic",
            odometry=OdometryConfig(
                estimator="two-frame",
                ransac=RansacConfig(mode="off"),
                gyro=GyroConfig(prefilter_deg=5.0),
            ),
        )
