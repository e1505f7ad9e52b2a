"""Thesis Table 1.2 (PROBE-GK Table I): four places, what was published of them, and the drives that
repeat them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.output.trial_table import Errors
from probevo.run_config import CommonRunSettings
from probevo.sequences.base import Sequence
from probevo.training.settings import TrainSettings
from probevo_paper.kernel_trials import FITTED, FIXED, GK_EM, GK_GT, STATIC
from probevo_paper.table_1_2_config import RowName, Table12Config
from probevo_sim.point_config import PointConfig, PointOutliers
from probevo_sim.scene.config import Effects, SceneConfig

ESTIMATORS = (FIXED, STATIC, FITTED, GK_GT, GK_EM)
OWN = "own"
"""The row of the user's recordings."""
SYNTHETIC = PointConfig(outliers=PointOutliers(fraction=0.05, range_px=20.0))
"""PROBE-GK's point world: noise by row, a small subset of gross outliers; 90 m to train on, 180 m
to test on."""
EFFECTS = Effects(traffic=0.5, shadows=0.5, noise=0.3)
ROAD_EFFECTS = Effects(traffic=0.25, shadows=0.25, noise=0.15)
"""Half of it: on the bare road, with all of it, most features are on the cars that drive along."""
TRAIN_SEED = 1
TEST_SEED = 2


@dataclass(frozen=True)
class PublishedRow:
    """A row of the printed table."""

    path_length_m: float
    errors: dict[str, Errors]
    """ARMSE of translation, m, and of rotation, rad, of the four estimators."""


def _row(length_m: float, trans_m: tuple[float, ...], rot_rad: tuple[float, ...]) -> PublishedRow:
    names = (FIXED, STATIC, GK_GT, GK_EM)
    return PublishedRow(length_m, dict(zip(names, zip(trans_m, rot_rad, strict=True), strict=True)))


PUBLISHED: dict[str, PublishedRow] = {
    "synthetic": _row(180.0, (3.87, 2.49, 1.59, 1.66), (0.18, 0.13, 0.070, 0.073)),
    "city": _row(332.9, (3.84, 2.99, 1.69, 2.87), (0.032, 0.021, 0.0046, 0.018)),
    "residential": _row(714.1, (13.48, 9.37, 1.97, 8.80), (0.068, 0.050, 0.013, 0.044)),
    "road": _row(723.8, (17.69, 9.38, 5.24, 8.87), (0.060, 0.027, 0.015, 0.024)),
}


def scenes(name: RowName, settings: Table12Config) -> tuple[SceneConfig, SceneConfig] | None:
    """The drives to train on and to test on, through different streets; None for the point world."""
    if name == "synthetic":
        return None
    distance_m, effects = (
        (settings.road_m, ROAD_EFFECTS) if name == "road" else (settings.street_m, EFFECTS)
    )
    train, test = (
        SceneConfig(preset=name, seed=seed, distance_m=distance_m, effects=effects)
        for seed in (TRAIN_SEED, TEST_SEED)
    )
    return train, test


@dataclass(frozen=True)
class Row:
    """A row to repeat."""

    name: str
    train: Sequence
    test: Sequence
    runs: CommonRunSettings
    """Settings of its runs, and of its trainings."""

    @property
    def has_truth(self) -> bool:
        """Whether the pose at every frame that is trained on is known."""
        truth = self.train.truth
        return truth is not None and bool(
            np.isfinite(truth.T_world_cam[: self.runs.max_frames]).all()
        )

    def trainings(self, settings: Table12Config) -> dict[str, TrainSettings]:
        """How each learned estimator is trained; GK-GT only with all of the truth, which the
        Student-t takes too."""
        known = self.has_truth
        found = {FITTED: settings.training("student-t", "gt" if known else "none", self.runs)}
        if known:
            found[GK_GT] = settings.training("gk", "gt", self.runs)
        return found | {GK_EM: settings.training("gk", "none", self.runs)}


def run_settings(name: str, settings: Table12Config) -> CommonRunSettings:
    """Of the runs in a row; the rig of the point world is flawless, so that nothing is to be
    calibrated."""
    return settings.shared(
        self_calibration=False if name == "synthetic" else None, max_frames=settings.max_frames
    )
