"""PROBE Table I: ten trials of KITTI, what was published of them, and which of them a KITTI folder
allows to repeat."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.training.settings import TrainSettings

NOMINAL = "nominal"
AGGRESSIVE = "aggressive"
STUDENT_T = "student-t"
PROBE = "PROBE"
OURS = "PROBE, ours"
ESTIMATORS = (NOMINAL, AGGRESSIVE, STUDENT_T, PROBE, OURS)
PREFILTER_DEG = 5.0
"""PROBE section V-A: features that turn by more than this against the gyro are left out."""


@dataclass(frozen=True)
class Drive:
    """A drive of KITTI raw."""

    date: str
    number: str

    @property
    def name(self) -> str:
        """As PROBE writes it, e.g. 26_drive_0051."""
        return f"{self.date[-2:]}_drive_{self.number}"

    @property
    def folder(self) -> Path:
        """Where it lies below the KITTI folder."""
        return Path(self.date, f"{self.date}_drive_{self.number}_sync")


CITY, RESIDENTIAL, ROAD = (Drive("2011_09_26", number) for number in ("0005", "0046", "0015"))
"""What PROBE was trained on for each kind of place."""
KINDS = {CITY: "City", RESIDENTIAL: "Residential", ROAD: "Road"}


@dataclass(frozen=True)
class Trial:
    """A row of PROBE Table I."""

    drive: Drive
    kind: str
    training: Drive
    path_length_m: float
    published: dict[str, tuple[float, float]]
    """ARMSE and final error, m, of the three estimators that were published."""


def _trial(
    date: str, number: str, kind: str, training: Drive, length_m: float, *figures_m: float
) -> Trial:
    names = (NOMINAL, AGGRESSIVE, PROBE)
    published = dict(zip(names, zip(figures_m[::2], figures_m[1::2], strict=True), strict=True))
    return Trial(Drive(date, number), kind, training, path_length_m=length_m, published=published)


TRIALS = (
    _trial("2011_09_26", "0051", "City", CITY, 251.1, 4.84, 12.6, 3.30, 8.62, 3.48, 8.07),
    _trial("2011_09_26", "0104", "City", CITY, 245.1, 0.977, 4.43, 0.850, 3.46, 1.19, 3.61),
    _trial("2011_09_29", "0071", "City", CITY, 234.0, 5.44, 30.3, 5.44, 30.4, 3.03, 12.8),
    _trial("2011_09_26", "0117", "City", CITY, 322.5, 2.29, 9.07, 2.29, 9.07, 2.76, 9.08),
    # PROBE's exception: its moving vehicles are better represented in the city's training drive.
    _trial("2011_09_30", "0027", "Residential", CITY, 667.8, 4.22, 12.2, 4.30, 10.6, 3.64, 4.57),
    _trial(
        "2011_09_26", "0022", "Residential", RESIDENTIAL, 515.3, 2.21, 3.99, 2.66, 6.09, 3.06, 4.99
    ),
    _trial(
        "2011_09_26", "0023", "Residential", RESIDENTIAL, 410.8, 1.64, 8.20, 1.77, 8.27, 1.71, 8.13
    ),
    _trial("2011_09_26", "0027", "Road", ROAD, 339.9, 1.63, 8.75, 1.63, 8.65, 1.40, 7.57),
    _trial("2011_09_26", "0028", "Road", ROAD, 777.5, 4.31, 16.9, 3.72, 13.1, 3.92, 13.2),
    _trial("2011_09_30", "0016", "Road", ROAD, 405.0, 4.56, 19.5, 3.33, 14.6, 2.76, 13.9),
)


@dataclass(frozen=True)
class Plan:
    """What of the table can be repeated, and why the rest cannot."""

    trials: tuple[Trial, ...]
    missing: tuple[str, ...] = ()
    """What is absent and what follows, one sentence each."""

    @property
    def trainings(self) -> tuple[Drive, ...]:
        """The training drives that these trials need."""
        return tuple(dict.fromkeys(trial.training for trial in self.trials))


def plan_table(root: Path) -> Plan:
    """Look which drives are below a folder of KITTI raw; a trial needs its training drive.

    Raises:
        InputError: there is no such folder, or nothing in it that could be run.
    """
    if not root.is_dir():
        what = f"{root} is {'a file' if root.exists() else 'missing'}."
        raise InputError(
            "--kitti", what, f"Give the folder of KITTI raw, the one in which {CITY.date} lies."
        )
    drives = [*KINDS, *(trial.drive for trial in TRIALS)]
    present = {drive for drive in drives if (root / drive.folder).is_dir()}
    trials = tuple(trial for trial in TRIALS if {trial.drive, trial.training} <= present)
    if not trials:
        raise _nothing_to_run(root, present)
    blocked = [
        trial for trial in TRIALS if trial.drive in present and trial.training not in present
    ]
    absent = [trial.drive for trial in TRIALS if trial.drive not in present]
    untrained = [
        f"{drive.name} ({kind.lower()})" for drive, kind in KINDS.items() if drive not in present
    ]
    missing = [f"Absent trials: {_names(absent)}."] if absent else []
    missing += [f"Absent training drives: {', '.join(untrained)}."] if untrained else []
    if blocked:
        needs = [f"{trial.drive.name} (needs {trial.training.name})" for trial in blocked]
        missing.append(f"Not run, for want of the drive to train on: {', '.join(needs)}.")
    return Plan(trials, tuple(missing))


def _nothing_to_run(root: Path, present: set[Drive]) -> InputError:
    pairs = "\n         ".join(
        f"{KINDS[training]}: {training.folder}, and one of"
        f" {_names(t.drive for t in TRIALS if t.training == training)}"
        for training in KINDS
    )
    cure = (
        f"Needed are, below {root}, as KITTI raw is unpacked, a drive to train on and a trial:\n   "
        f"      {pairs}."
    )
    if not present:
        dated = re.fullmatch(r"\d{4}_\d\d_\d\d", root.resolve().name)
        what = f"{root} holds none of the drives of PROBE Table I."
        above = f" Perhaps it is {root.resolve().parent} that you mean." if dated else ""
        return InputError("--kitti", what + above, cure)
    trials = [trial.drive for trial in TRIALS if trial.drive in present]
    if trials:
        what = f"{root} has trials, {_names(trials)}, but none of the drives to train on for them."
    else:
        what = (
            f"{root} has drives to train on, {_names(d for d in KINDS if d in present)}, but no"
            " trial."
        )
    return InputError("--kitti", what, cure)


def probe_settings(settings: OdometryConfig) -> OdometryConfig:
    """The same as PROBE runs: without RANSAC, features pre-filtered by the gyro (section V-A)."""
    ransac = settings.ransac.model_copy(update={"mode": "off"})
    gyro = settings.gyro.model_copy(update={"prefilter_deg": PREFILTER_DEG})
    return settings.model_copy(update={"ransac": ransac, "gyro": gyro})


def trainings(settings: OdometryConfig) -> dict[str, TrainSettings]:
    """How each learned estimator is trained for runs with these settings."""
    odometry = OdometryConfig.model_validate(
        {name: getattr(settings, name) for name in OdometryConfig.model_fields}
    )
    published = TrainSettings.published().model_copy(update={"odometry": probe_settings(odometry)})
    return {PROBE: published, OURS: TrainSettings(supervision="none", odometry=odometry)}


def _names(drives: Iterable[Drive]) -> str:
    return ", ".join(drive.name for drive in drives)
