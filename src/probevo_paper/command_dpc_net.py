"""``probevo paper dpc-net``: from the first rendered drive to the last file."""

from __future__ import annotations

import hashlib
from pathlib import Path

import cv2

from probevo import __version__
from probevo.cli.progress import progress_bar
from probevo.cli.text import table
from probevo.config import OdometryConfig
from probevo.config.networks import NetworkSettings
from probevo.nets.correction_training import train_correction
from probevo.output.comparison.comparison_files import write_csv
from probevo.output.json_file import write_json
from probevo.sequences.base import Sequence
from probevo.storage.files import write_atomically
from probevo_paper.command_steps import render
from probevo_paper.dpc_net import METHODS, NETWORK, ROTATION, UNCORRECTED, Drift, drifts
from probevo_paper.dpc_net_config import DpcNetConfig
from probevo_sim.scene.config import PresetName, SceneConfig
from probevo_sim.spoiling.config import SpoilConfig
from probevo_sim.spoiling.recording import SpoiledRecording

HEAD = (
    *("calibration", "drive", "correction", "drift, %", "of that without", "rotation, °/m"),
    *("of that without", "ANEES"),
)
NOTES = (
    "Drift and rotation: over segments of 10 to 50 m, on drives that were not learned from.",
    "ANEES: of the steps; 6 is consistent. Baselines keep the covariance of the odometry.",
)
STREETS: tuple[PresetName, PresetName] = ("city", "residential")
RIGHT = "right"
WRONG = "wrong"


def repeat_experiment(settings: DpcNetConfig, out: Path) -> list[str]:
    """Repeat the experiment; return the lines to print.

    Drives that an earlier call has rendered, and networks that it has trained, are taken.

    Args:
        settings: of drives and networks.
        out: folder for dpc_net.csv, .json and .txt, recordings/ and models/.

    Raises:
        InputError: JAX is missing, or a file cannot be read or written.
    """
    cv2.setNumThreads(1)
    drives = [_drive(settings, number, out) for number in range(settings.drives + 4)]
    records: list[dict[str, object]] = []
    rows = []
    for calibration in (RIGHT, WRONG):
        seen = [_seen(drive, calibration, settings) for drive in drives]
        networks = {
            method: _network(settings, seen[: settings.drives + 2], f"{calibration} {method}", out)
            for method in (NETWORK, ROTATION)
        }
        for drive in seen[settings.drives + 2 :]:
            print(f"{drive.path.name}, {calibration} calibration: correcting", flush=True)
            drift_by_method = drifts(drive, networks, _odometry(settings))
            for method in METHODS:
                drift = drift_by_method[method]
                row = (calibration, _street(drive), method)
                rows.append((*row, *_texts(drift, drift_by_method[UNCORRECTED])))
                record: dict[str, object] = dict(
                    zip(("calibration", "drive", "correction"), row, strict=True)
                )
                records.append(record | drift._asdict())
    text = "\n".join([table(HEAD, rows), "", *NOTES, ""])
    write_atomically(out / "dpc_net.txt", text)
    write_csv(out / "dpc_net.csv", iter(records))
    document = {
        "probevo": __version__,
        "settings": settings.model_dump(mode="json"),
        "notes": NOTES,
        "results": records,
    }
    write_json(out / "dpc_net.json", document)
    return [text, str(out / "dpc_net.txt")]


def _drive(settings: DpcNetConfig, number: int, out: Path) -> Sequence:
    """Return a rendered drive; the last two are tested on, the two before are left out."""
    preset = STREETS[number % 2]
    seed = 100 * settings.seed + number
    config = SceneConfig(preset=preset, seed=seed, distance_m=settings.distance_m)
    return render(f"{preset} {seed}", config, out / "recordings")


def _seen(drive: Sequence, calibration: str, settings: DpcNetConfig) -> Sequence:
    """Return a drive with a right or a wrong calibration."""
    if calibration == RIGHT or not (settings.focal_error or settings.radial_distortion):
        return drive
    wrong = SpoilConfig(
        preset="calibration",
        focal_error=settings.focal_error,
        radial_distortion=settings.radial_distortion,
    )
    return SpoiledRecording.of(drive, wrong)


def _network(settings: DpcNetConfig, drives: list[Sequence], name: str, out: Path) -> Path:
    """Return the file of a trained network; drives left out are the last two."""
    nets = NetworkSettings(
        heads=settings.heads,
        epochs=settings.epochs,
        seed=settings.seed,
        left_out=2,
        rotation_only=ROTATION in name,
    )
    digest = hashlib.sha256(f"{settings!r} {__version__}".encode()).hexdigest()[:8]
    label = name.replace(" ", "-").replace(",", "").replace("(", "").replace(")", "")
    file = out / "models" / f"{label}-{digest}.safetensors"
    if not file.exists():
        with progress_bar(name, "reading the drives") as show:
            train_correction(drives, nets, file, odometry=_odometry(settings), on_progress=show)
    return file


def _odometry(settings: DpcNetConfig) -> OdometryConfig:
    """Return the settings of the odometry that is corrected."""
    return OdometryConfig(estimator=settings.estimator)


def _street(drive: Sequence) -> str:
    """Return the name of a drive without the digest of its settings."""
    return drive.path.name.rpartition("-")[0].replace("-", " ")


def _texts(one: Drift, uncorrected: Drift) -> tuple[str, ...]:
    """Return the figures of a method as the table shows them."""
    return (
        _text(one.translation_percent, 3),
        _ratio(one.translation_percent, uncorrected.translation_percent),
        _text(one.rotation_deg_per_m, 5),
        _ratio(one.rotation_deg_per_m, uncorrected.rotation_deg_per_m),
        _text(one.anees, 1),
    )


def _text(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _ratio(value: float | None, reference: float | None) -> str:
    return "–" if value is None or not reference else f"{value / reference:.2f}"
