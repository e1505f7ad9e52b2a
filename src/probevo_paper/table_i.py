"""PROBE Table I: ten trials of KITTI, their published errors, and which can be repeated."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from probevo.config import OdometryConfig
from probevo.config.training import TrainSettings
from probevo.errors import InputError

NOMINAL = "nominal"
AGGRESSIVE = "aggressive"
STUDENT_T = "student-t"
PROBE = "PROBE"
OURS = "PROBE, ours"
ESTIMATORS = (NOMINAL, AGGRESSIVE, STUDENT_T, PROBE, OURS)
PREFILTER_DEG = 5.0
"""Features that turn by more than this against the gyro are removed (PROBE section V-A)."""


@dataclass(frozen=True)
class KittiDrive:
    """A drive of KITTI raw."""

    date: str
    number: str

    @property
    def name(self) -> str:
        """Name as PROBE writes it, e.g. 26_drive_0051."""
        return f"{self.date[-2:]}_drive_{self.number}"

    @property
    def folder(self) -> Path:
        """Folder of the drive, relative to the folder of KITTI raw."""
        return Path(self.date, f"{self.date}_drive_{self.number}_sync")


CITY = KittiDrive("2011_09_26", "0005")
RESIDENTIAL = KittiDrive("2011_09_26", "0046")
ROAD = KittiDrive("2011_09_26", "0015")
TRAINING_DRIVES = {CITY: "City", RESIDENTIAL: "Residential", ROAD: "Road"}
"""The drives that PROBE was trained on, and the kind of place that each stands for."""


@dataclass(frozen=True)
class PublishedTrial:
    """A row of PROBE Table I."""

    drive: KittiDrive
    place: str
    """City, Residential or Road."""
    training: KittiDrive
    path_length_m: float
    published: dict[str, tuple[float, float]]
    """ARMSE and final error, m, by the name of the estimator."""


# The length and all errors in m; each estimator has its ARMSE and its final error. Drive
# 30_drive_0027 is PROBE's exception: its moving vehicles are better represented in the training
# drive of the city.
_PRINTED_TABLE = """
drive            place        trained_on  length  nominal       aggressive    PROBE
2011_09_26 0051  City         0005        251.1   4.84   12.6   3.30   8.62   3.48  8.07
2011_09_26 0104  City         0005        245.1   0.977  4.43   0.850  3.46   1.19  3.61
2011_09_29 0071  City         0005        234.0   5.44   30.3   5.44   30.4   3.03  12.8
2011_09_26 0117  City         0005        322.5   2.29   9.07   2.29   9.07   2.76  9.08
2011_09_30 0027  Residential  0005        667.8   4.22   12.2   4.30   10.6   3.64  4.57
2011_09_26 0022  Residential  0046        515.3   2.21   3.99   2.66   6.09   3.06  4.99
2011_09_26 0023  Residential  0046        410.8   1.64   8.20   1.77   8.27   1.71  8.13
2011_09_26 0027  Road         0015        339.9   1.63   8.75   1.63   8.65   1.40  7.57
2011_09_26 0028  Road         0015        777.5   4.31   16.9   3.72   13.1   3.92  13.2
2011_09_30 0016  Road         0015        405.0   4.56   19.5   3.33   14.6   2.76  13.9
"""


def _read_row(line: str) -> PublishedTrial:
    """Read one line of the printed table."""
    date, number, place, trained_on, length, *errors = line.split()
    errors_m = [float(error) for error in errors]
    (training,) = (drive for drive in TRAINING_DRIVES if drive.number == trained_on)
    return PublishedTrial(
        drive=KittiDrive(date, number),
        place=place,
        training=training,
        path_length_m=float(length),
        published={
            NOMINAL: (errors_m[0], errors_m[1]),
            AGGRESSIVE: (errors_m[2], errors_m[3]),
            PROBE: (errors_m[4], errors_m[5]),
        },
    )


TRIALS = tuple(_read_row(line) for line in _PRINTED_TABLE.strip().splitlines()[1:])


@dataclass(frozen=True)
class TablePlan:
    """The part of the table that can be repeated, and why the rest cannot."""

    trials: tuple[PublishedTrial, ...]
    missing: tuple[str, ...] = ()
    """Absent drives and their consequence, one sentence each."""

    @property
    def training_drives(self) -> tuple[KittiDrive, ...]:
        """The training drives that these trials need, each once."""
        return tuple(dict.fromkeys(trial.training for trial in self.trials))


def plan_table(root: Path) -> TablePlan:
    """Find the drives below a folder of KITTI raw; a trial needs its training drive, too.

    Raises:
        InputError: there is no such folder, or no trial in it can be run.

    """
    if not root.is_dir():
        what = f"{root} is {'a file' if root.exists() else 'missing'}."
        cure = f"Give the folder of KITTI raw, the one in which {CITY.date} lies."
        raise InputError("--kitti", what, cure)
    drives = [*TRAINING_DRIVES, *(trial.drive for trial in TRIALS)]
    present = {drive for drive in drives if (root / drive.folder).is_dir()}
    trials = tuple(trial for trial in TRIALS if {trial.drive, trial.training} <= present)
    if not trials:
        raise _nothing_to_run(root, present)
    return TablePlan(trials, _missing(present))


def _missing(present: set[KittiDrive]) -> tuple[str, ...]:
    """Name the absent trials, the absent training drives, and the trials that these block."""
    sentences = []
    absent = [trial.drive for trial in TRIALS if trial.drive not in present]
    if absent:
        sentences.append(f"Absent trials: {_names(absent)}.")
    untrained = [
        f"{drive.name} ({place.lower()})"
        for drive, place in TRAINING_DRIVES.items()
        if drive not in present
    ]
    if untrained:
        sentences.append(f"Absent training drives: {', '.join(untrained)}.")
    blocked = [
        f"{trial.drive.name} (needs {trial.training.name})"
        for trial in TRIALS
        if trial.drive in present and trial.training not in present
    ]
    if blocked:
        sentences.append(f"Not run, for want of the drive to train on: {', '.join(blocked)}.")
    return tuple(sentences)


def _nothing_to_run(root: Path, present: set[KittiDrive]) -> InputError:
    """Return the error that says what is there, and which drives are needed at least."""
    indent = "\n         "
    pairs = [
        f"{place}: {training.folder}, and one of"
        f" {_names(trial.drive for trial in TRIALS if trial.training == training)}"
        for training, place in TRAINING_DRIVES.items()
    ]
    cure = (
        f"Needed are, below {root}, as KITTI raw is unpacked, a drive to train on and a trial:"
        f"{indent}{indent.join(pairs)}."
    )
    trials = [trial.drive for trial in TRIALS if trial.drive in present]
    training = [drive for drive in TRAINING_DRIVES if drive in present]
    if trials:
        what = f"{root} has trials, {_names(trials)}, but none of the drives to train on for them."
    elif training:
        what = f"{root} has drives to train on, {_names(training)}, but no trial."
    else:
        what = f"{root} holds none of the drives of PROBE Table I."
        # A frequent mistake is to name the folder of a date instead of the one above it.
        if re.fullmatch(r"\d{4}_\d\d_\d\d", root.resolve().name):
            what += f" Perhaps it is {root.resolve().parent} that you mean."
    return InputError("--kitti", what, cure)


def _names(drives: Iterable[KittiDrive]) -> str:
    return ", ".join(drive.name for drive in drives)


def probe_settings(settings: OdometryConfig) -> OdometryConfig:
    """Return the settings as PROBE runs: no RANSAC, features pre-filtered by the gyro (V-A)."""
    ransac = settings.ransac.model_copy(update={"mode": "off"})
    gyro = settings.gyro.model_copy(update={"prefilter_deg": PREFILTER_DEG})
    return settings.model_copy(update={"ransac": ransac, "gyro": gyro})


def training_settings(settings: OdometryConfig) -> dict[str, TrainSettings]:
    """Return how each learned estimator is trained for runs with these settings, by its name.

    PROBE is trained as published. Ours does without the truth of KITTI, whose centimetres from
    frame to frame hide the errors of single features.
    """
    odometry = OdometryConfig.model_validate(
        {name: getattr(settings, name) for name in OdometryConfig.model_fields}
    )
    published = TrainSettings.published().model_copy(update={"odometry": probe_settings(odometry)})
    return {PROBE: published, OURS: TrainSettings(supervision="none", odometry=odometry)}
