"""Thesis Table 1.2 (PROBE-GK Table I): four kinds of place, as published and as simulated here."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.config.training import SupervisionName, TrainSettings
from probevo.output.trial_table import Errors
from probevo.run_config import CommonRunSettings
from probevo.sequences.base import Sequence
from probevo_paper.gk_tables import FITTED, FIXED, GK_EM, GK_GT, STATIC
from probevo_paper.table_1_2_config import RowName, Table12Config
from probevo_sim.point_config import PointConfig, PointOutliers
from probevo_sim.scene.config import Effects, SceneConfig

ESTIMATORS = (FIXED, STATIC, FITTED, GK_GT, GK_EM)
OWN = "own"
"""Name of the row of the user's recordings."""
SYNTHETIC = PointConfig(outliers=PointOutliers(fraction=0.05, range_px=20.0))
"""PROBE-GK's point world: noise by image row and a small share of gross outliers; 90 m to train on,
180 m to test on."""
EFFECTS = Effects(traffic=0.5, shadows=0.5, noise=0.3)
ROAD_EFFECTS = Effects(traffic=0.25, shadows=0.25, noise=0.15)
"""Half of ``EFFECTS``: with all of it, most features of the bare road are on the cars that drive
along."""
TRAIN_SEED = 1
TEST_SEED = 2


@dataclass(frozen=True)
class PublishedRow:
    """A row of the printed table."""

    path_length_m: float
    errors: dict[str, Errors]
    """ARMSE of translation, m, and of rotation, rad, by the name of the estimator."""


# ARMSE of translation, m, and of rotation, rad, of each estimator; the length in m.
_PRINTED_TABLE = """
row          length  fixed         student-t     GK-GT          GK-EM
synthetic    180.0    3.87  0.18   2.49  0.13    1.59  0.070    1.66  0.073
city         332.9    3.84  0.032  2.99  0.021   1.69  0.0046   2.87  0.018
residential  714.1   13.48  0.068  9.37  0.050   1.97  0.013    8.80  0.044
road         723.8   17.69  0.060  9.38  0.027   5.24  0.015    8.87  0.024
"""


def _read_row(line: str) -> tuple[str, PublishedRow]:
    """Read the name and the figures of one line of the printed table."""
    name, *figures = line.split()
    length_m, *errors = (float(figure) for figure in figures)
    row = PublishedRow(
        path_length_m=length_m,
        errors={
            FIXED: (errors[0], errors[1]),
            STATIC: (errors[2], errors[3]),
            GK_GT: (errors[4], errors[5]),
            GK_EM: (errors[6], errors[7]),
        },
    )
    return name, row


PUBLISHED = dict(_read_row(line) for line in _PRINTED_TABLE.strip().splitlines()[1:])


def scenes(name: RowName, settings: Table12Config) -> tuple[SceneConfig, SceneConfig] | None:
    """Return the scenes to train on and to test on, two different streets of one kind.

    None for the point world, which is not rendered.
    """
    if name == "synthetic":
        return None
    is_road = name == "road"
    train = SceneConfig(
        preset=name,
        seed=TRAIN_SEED,
        distance_m=settings.road_m if is_road else settings.street_m,
        effects=ROAD_EFFECTS if is_road else EFFECTS,
    )
    return train, train.model_copy(update={"seed": TEST_SEED})


def run_settings(name: str, settings: Table12Config) -> CommonRunSettings:
    """Return the settings of the runs in a row.

    The rig of the point world is flawless, so that its calibration is not estimated.
    """
    return settings.run_settings(
        self_calibration=False if name == "synthetic" else None, max_frames=settings.max_frames
    )


@dataclass(frozen=True)
class TrialRecordings:
    """The recordings of one row, and the settings that they are run with."""

    name: str
    train: Sequence
    test: Sequence
    runs: CommonRunSettings
    """Settings of the runs in the row, and of its trainings."""

    @property
    def has_truth(self) -> bool:
        """Whether the true pose at every frame of the training is known."""
        truth = self.train.truth
        return truth is not None and bool(
            np.isfinite(truth.T_world_cam[: self.runs.max_frames]).all()
        )

    def training_settings(self, settings: Table12Config) -> dict[str, TrainSettings]:
        """Return how each learned estimator is trained, by its name.

        GK-GT needs the ground truth of every frame; the fitted Student-t uses it where it is known.
        """
        supervision: SupervisionName = "gt" if self.has_truth else "none"
        trainings = {FITTED: settings.training_settings("student-t", supervision, self.runs)}
        if self.has_truth:
            trainings[GK_GT] = settings.training_settings("gk", "gt", self.runs)
        trainings[GK_EM] = settings.training_settings("gk", "none", self.runs)
        return trainings
