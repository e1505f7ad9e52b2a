"""A drive together with the truth about its motion, in memory or part by part on disk."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.noise.moments import Moments
from probevo.storage.files import write_atomically
from probevo.storage.npz import NO_NPZ, read_npz, write_npz
from probevo.training.drive import Drive, load_drive, save_drive
from probevo.training.supervision import Supervision


@dataclass(frozen=True)
class DriveFacts:
    """Facts of a drive that are needed before its parts are read."""

    digest: str
    """SHA-256 of all that the odometry was given."""
    parts: int
    steps: int
    features: int
    used: int
    """Number of features that took part in a solve, and so can be learned from."""
    moments: Moments
    """Moments of the predictors of all features."""

    @staticmethod
    def of(parts: Iterable[Drive], digest: Callable[[], str], columns: int) -> DriveFacts:
        """Gather the facts of a drive in one pass over its parts.

        Args:
            parts: the parts.
            digest: called after the last part, since the digest is known only then.
            columns: number M of predictor columns.
        """
        num_parts = 0
        num_steps = 0
        num_features = 0
        num_used = 0
        moments = Moments.none(columns)
        for part in parts:
            num_parts += 1
            num_steps += len(part.T_curr_prev)
            num_features += len(part.phi)
            num_used += int(part.used.sum())
            moments = moments + Moments.of(part.phi)
        return DriveFacts(
            digest=digest(),
            parts=num_parts,
            steps=num_steps,
            features=num_features,
            used=num_used,
            moments=moments,
        )


class SupervisedDrive(Protocol):
    """A drive, and the truth about its motion, as far as it is known."""

    @property
    def camera(self) -> StereoCamera:
        """Rectified camera of the drive."""

    @property
    def facts(self) -> DriveFacts:
        """Facts of the whole drive."""

    @property
    def supervision(self) -> Supervision:
        """The part of the truth that is used."""

    def parts(self) -> Iterator[Drive]:
        """Yield the drive, one run of consecutive steps after another."""


@dataclass(frozen=True)
class DriveInMemory:
    """A supervised drive in memory."""

    drive: Drive
    camera: StereoCamera
    supervision: Supervision

    @property
    def facts(self) -> DriveFacts:
        """Facts of the drive; its digest is not known."""
        return DriveFacts.of([self.drive], str, self.drive.phi.shape[1])

    def parts(self) -> Iterator[Drive]:
        """Yield the whole drive."""
        yield self.drive


@dataclass(frozen=True)
class DriveOnDisk:
    """A supervised drive on disk, of which at most one part is in memory.

    Any process may write it. Each file is written whole or not at all.
    """

    folder: Path
    number: int
    camera: StereoCamera
    name: str = "drive"
    """Prefix of the names of its files."""

    @property
    def is_recorded(self) -> bool:
        """Whether all parts are written; the facts are written after them."""
        return self._path(self.name, ".json").exists()

    @property
    def is_complete(self) -> bool:
        """Whether all parts and the supervision are written."""
        return self.is_recorded and self._path(f"{self.name}-truth", ".npz").exists()

    @property
    def frames_done(self) -> int:
        """Number of frames that a worker had done when it last reported."""
        try:
            return int(self._path(self.name, ".frames").read_text("utf-8"))
        except OSError:
            return 0

    def report_frames(self, frames: int) -> None:
        """Write how many frames are done."""
        write_atomically(self._path(self.name, ".frames"), str(frames))

    @property
    def facts(self) -> DriveFacts:
        """Facts of the whole drive."""
        path = self._path(self.name, ".json")
        with damage_reported(path):
            fields = json.loads(path.read_text("utf-8"))
            arrays = {name: np.array(value) for name, value in fields["moments"].items()}
            # ``rows`` counts all features, and is the one field that is no array.
            fields["moments"] = Moments(**arrays | {"rows": fields["features"]})
            return DriveFacts(**fields)

    @property
    def supervision(self) -> Supervision:
        """The part of the truth that is used."""
        path = self._path(f"{self.name}-truth", ".npz")
        with damage_reported(path):
            archive = read_npz(path)
            return Supervision(
                kind=str(archive["kind"]),  # type: ignore[arg-type]
                frames=archive["frames"],
                T_world_cam=archive["T_world_cam"],
            )

    def parts(self) -> Iterator[Drive]:
        """Yield the drive, one file after another."""
        for k in range(self.facts.parts):
            path = self._path(self.name, f"-{k}.npz")
            with damage_reported(path):
                part = load_drive(path)
            yield part

    def keep_drive(self, parts: Iterable[Drive], digest: Callable[[], str], columns: int) -> None:
        """Write a drive, part by part as it comes, and then its facts.

        Args:
            parts: the parts.
            digest: called after the last part, since the digest is known only then.
            columns: number M of predictor columns.
        """

        def written() -> Iterator[Drive]:
            """Yield each part once it is on disk."""
            for k, part in enumerate(parts):
                save_drive(self._path(self.name, f"-{k}.npz"), part)
                yield part

        # The facts come last: their file marks the drive as recorded.
        facts = asdict(DriveFacts.of(written(), digest, columns))
        facts["moments"] = {
            name: np.asarray(value).tolist() for name, value in facts["moments"].items()
        }
        write_atomically(self._path(self.name, ".json"), json.dumps(facts, indent=1))

    def keep_supervision(self, supervision: Supervision) -> None:
        """Write the supervision, unless it is there."""
        path = self._path(f"{self.name}-truth", ".npz")
        if path.exists():
            return
        write_npz(path, {name: np.asarray(value) for name, value in vars(supervision).items()})

    def _path(self, prefix: str, suffix: str) -> Path:
        return self.folder / f"{prefix}-{self.number}{suffix}"


@contextmanager
def damage_reported(path: Path) -> Iterator[None]:
    """Name the file if it cannot be read.

    Raises:
        InputError: the file is damaged.
    """
    try:
        yield
    except (KeyError, *NO_NPZ) as error:
        raise InputError(
            path, f"this is damaged ({error}).", f"Delete the folder {path.parent}."
        ) from error
