"""Every setting of ``probevo train``, with its bounds and its why."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from probevo.config import GyroConfig, OdometryConfig, RansacConfig
from probevo.settings import Settings

SupervisionName = Literal["gt", "sparse", "position", "loop", "none"]
BaseName = Literal["fixed", "student-t"]

PUBLISHED = ("acceleration", "turn_rate", "blur", "entropy", "frequency", "flow_variance")
"""The predictors of PROBE."""
DEFAULT = ("blur", "entropy", "frequency", "flow_variance", "place", "disparity", "disparity_change", "residual_flow",
           "row_offset", "forward_backward", "structure")  # fmt: skip
"""No accelerometer: a model that needs one is of no use to a recording that has none."""


class TrainSettings(Settings):
    """What a noise model is trained with."""

    kind: Literal["knn"] = Field("knn", description="PROBE: weights from the nearest neighbours in prediction space.")
    supervision: SupervisionName = Field(
        "gt",
        description="What is known of the drives: the pose at every frame, or at some (sparse), positions alone, only"
        " that each ends where it began (loop; or where the truth says, if it knows both ends), or none of it: then the"
        " motion of all features stands in for the truth of a few, better than a truth that is off by centimetres from"
        " frame to frame, as KITTI's is.",
    )
    every_s: float = Field(
        0.0,
        ge=0,
        le=3600,
        description="With sparse and position: use the truth only so often; 0 uses all that there is.",
    )
    predictors: tuple[str, ...] = Field(DEFAULT, min_length=1, description="What spans the prediction space.")
    base: BaseName = Field(
        "student-t",
        description="The model whose noise is scaled: PROBE's is Gaussian (fixed), student-t is robust too.",
    )
    iterations: int = Field(
        40, ge=2, le=10_000, description="Motions of random subsets at each step; PROBE takes 10. More cost time alone."
    )
    subset: int = Field(
        8,
        ge=6,
        le=10_000,
        description="Features in a subset. Few let each one's error show; PROBE takes a tenth of a frame's.",
    )
    contrast: float = Field(
        3.0,
        ge=0,
        le=100,
        description="How much alike the features of a subset are: each subset leans towards a random direction of the"
        " prediction space, so that its error tells of one region of it. 0 is PROBE: subsets at random.",
    )
    relative: bool = Field(
        True,
        description="Compare α with what other subsets reached on the same step. PROBE does not; but what a whole step"
        " has in common says nothing of which of its features to trust.",
    )
    average: Literal["arithmetic", "geometric"] = Field(
        "geometric", description="Of α over the neighbours; PROBE's is arithmetic, which single large α carry away."
    )
    neighbors: int | None = Field(None, ge=1, description="K; left out, by cross-validation over blocks of time.")
    exponent: float | None = Field(
        None, ge=0, le=1000, description="γ; left out, the one with the least error on the training drives."
    )
    max_frames: int | None = Field(None, ge=2, description="Of each recording, use so many frames.")
    odometry: OdometryConfig = OdometryConfig()

    @staticmethod
    def published() -> TrainSettings:
        """As in PROBE: its predictors, Gaussian noise, no RANSAC but the gyro's pre-filter, ten random subsets of 60
        features (it took tenths of some 600), absolute α, arithmetic means."""
        return TrainSettings(
            predictors=PUBLISHED,
            base="fixed",
            iterations=10,
            subset=60,
            contrast=0.0,
            relative=False,
            average="arithmetic",
            odometry=OdometryConfig(ransac=RansacConfig(mode="off"), gyro=GyroConfig(prefilter_deg=5.0)),
        )
