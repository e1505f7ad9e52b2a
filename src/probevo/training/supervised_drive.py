"""What there is to learn from: a drive, and what is known of it. In memory, or part by part from
files."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol
from uuid import uuid4

import numpy as np

from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.files import NO_ARCHIVE, write_atomically
from probevo.noise.moments import Moments
from probevo.training.drive import Drive, drive_bytes, load_drive
from probevo.training.supervision import Supervision


@dataclass(frozen=True)
class DriveFacts:
    """What need be known of a drive before its parts are read."""

    digest: str
    """SHA-256 of all that the odometry was given."""
    parts: int
    steps: int
    features: int
    used: int
    """Those of the features that may teach something."""
    moments: Moments
    """Of the predictors of all features."""

    @staticmethod
    def of(parts: Iterable[Drive], digest: Callable[[], str], columns: int) -> DriveFacts:
        """Of a drive of M columns whose parts are looked at once, and whose digest is known after
        that."""
        count = 0
        steps = 0
        features = 0
        used = 0
        moments = Moments.none(columns)
        for part in parts:
            count = count + 1
            steps = steps + len(part.T_curr_prev)
            features = features + len(part.phi)
            used = used + int(part.used.sum())
            moments = moments + Moments.of(part.phi)
        return DriveFacts(digest(), count, steps, features=features, used=used, moments=moments)


class SupervisedDrive(Protocol):
    """A drive, and what is known of it."""

    @property
    def camera(self) -> StereoCamera:
        """Rectified camera of the drive."""

    @property
    def facts(self) -> DriveFacts:
        """Of the drive."""

    @property
    def supervision(self) -> Supervision:
        """What is known of it."""

    def parts(self) -> Iterator[Drive]:
        """The drive, one stretch of steps after another."""


@dataclass(frozen=True)
class DriveInMemory:
    """One in memory."""

    drive: Drive
    camera: StereoCamera
    supervision: Supervision

    @property
    def facts(self) -> DriveFacts:
        """Of the drive, of which the digest is not known."""
        return DriveFacts.of([self.drive], str, self.drive.phi.shape[1])

    def parts(self) -> Iterator[Drive]:
        """The whole drive."""
        yield self.drive


@dataclass(frozen=True)
class DriveOnDisk:
    """One on disk, of which no more than a part is in memory; any process may write it, and only
    whole files count."""

    folder: Path
    number: int
    camera: StereoCamera
    name: str = "drive"
    """How its files' names begin."""

    @property
    def is_whole(self) -> bool:
        """Whether the drive is through. Its facts are written last."""
        return self._path(self.name, ".json").exists()

    @property
    def is_complete(self) -> bool:
        """Whether what is known of it is there too."""
        return self.is_whole and self._path(f"{self.name}-truth", ".npz").exists()

    @property
    def frames_done(self) -> int:
        """How many frames a worker was through when it last told."""
        try:
            return int(self._path(self.name, ".frames").read_text("utf-8"))
        except OSError:
            return 0

    def tell(self, frames: int) -> None:
        """That so many frames are done."""
        self._write(self._path(self.name, ".frames"), str(frames).encode())

    @property
    def facts(self) -> DriveFacts:
        """Of the drive."""
        path = self._path(self.name, ".json")
        with whole(path):
            found = json.loads(path.read_text("utf-8"))
            arrays = {name: np.array(value) for name, value in found["moments"].items()}
            return DriveFacts(
                **found | {"moments": Moments(**arrays | {"rows": found["features"]})}
            )

    @property
    def supervision(self) -> Supervision:
        """What is known of it."""
        path = self._path(f"{self.name}-truth", ".npz")
        with whole(path), np.load(path, allow_pickle=False) as archive:
            return Supervision(str(archive["kind"]), archive["frames"], archive["T_world_cam"])  # type: ignore[arg-type]

    def parts(self) -> Iterator[Drive]:
        """The drive, one file after another."""
        for k in range(self.facts.parts):
            path = self._path(self.name, f"-{k}.npz")
            with whole(path):
                part = load_drive(path)
            yield part

    def keep_drive(self, parts: Iterable[Drive], digest: Callable[[], str], columns: int) -> None:
        """Write a drive of M columns, part by part as it comes; the digest is asked for after the
        last."""

        def kept() -> Iterator[Drive]:
            for k, part in enumerate(parts):
                self._write(self._path(self.name, f"-{k}.npz"), drive_bytes(part))
                yield part

        facts = asdict(DriveFacts.of(kept(), digest, columns))
        facts["moments"] = {
            name: np.asarray(value).tolist() for name, value in facts["moments"].items()
        }
        self._write(self._path(self.name, ".json"), json.dumps(facts, indent=1).encode())

    def keep_supervision(self, supervision: Supervision) -> None:
        """Write what is known of it, unless it is there."""
        path = self._path(f"{self.name}-truth", ".npz")
        buffer = io.BytesIO()
        if not path.exists():
            known: dict[str, Any] = {
                name: np.asarray(value) for name, value in vars(supervision).items()
            }
            np.savez(buffer, allow_pickle=False, **known)
            self._write(path, buffer.getvalue())

    def _path(self, what: str, end: str) -> Path:
        return self.folder / f"{what}-{self.number}{end}"

    def _write(self, path: Path, content: bytes) -> None:
        # A worker that was given up for lost may still write the same file: the same bytes, but not
        # at the same time.
        write_atomically(path, content, f".{uuid4().hex}")


@contextmanager
def whole(path: Path) -> Iterator[None]:
    """Say which file it is if it cannot be read."""
    try:
        yield
    except (KeyError, *NO_ARCHIVE) as error:
        raise InputError(
            path, f"this is damaged ({error}).", f"Delete the folder {path.parent}."
        ) from error
