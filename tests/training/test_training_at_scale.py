"""Training by many workers: the same bytes as by one, even if a worker is killed; small parts."""

import os
import signal
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import probevo as pv
from probevo.arrays import FloatArray
from probevo.config import SolverConfig
from probevo.config.training import KernelSettings
from probevo.errors import InputError
from probevo.noise import StudentT
from probevo.noise.metric import Metric
from probevo.predictors import Needs, Predictor, Step, prediction_space
from probevo.sequences.base import Sequence
from probevo.sequences.frame import Frame
from probevo.training import extraction, recording
from probevo.training.drive import Drive, joined
from probevo.training.extraction import Extraction
from probevo.training.gk import error_samples, thinning
from probevo.training.gk.expectation import Expectation, expect, solve_drive
from probevo.training.gk.expectation_maximization import learn_student_t
from probevo.training.gk.thinning import thinned
from probevo.training.lease import leased
from probevo.training.sources import checked_sources
from probevo.training.supervised_drive import DriveInMemory, DriveOnDisk
from probevo.training.trainer import TrainingContext
from probevo.training.workers import Workers
from probevo_sim.point_world import write_points
from training.supervised_drives import drive_of, in_memory, known, point_world

FRAMES = 16
GK = pv.TrainSettings(
    kind="gk",
    predictors=("place",),
    supervision="sparse",
    every_s=0.5,
    gk=KernelSettings(neighbors=50, prior_counts=8.0, iterations=1, centers=100),
)
STATIC = GK.model_copy(
    update={
        "kind": "student-t",
        "predictors": None,
        "gk": KernelSettings(time_correlation=False),
    }
)
KNN = pv.TrainSettings(predictors=("place", "row_offset"), iterations=3, subset=6)
TWO = Workers(jobs=2)


@pytest.fixture(scope="module")
def tracks(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three short drives through different worlds, some 75 landmarks a frame."""
    folder = tmp_path_factory.mktemp("tracks")
    for seed in range(3):
        write_points(
            point_world("column", seed=seed, frames=FRAMES, landmarks=400), folder / f"{seed}.npz"
        )
    return [folder / f"{seed}.npz" for seed in range(3)]


@pytest.fixture(scope="module")
def static_bytes(tracks: list[Path], tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the static model as one process trains it."""
    return pv.train_model(
        tracks, STATIC, tmp_path_factory.mktemp("static") / "m.safetensors"
    ).read_bytes()


@pytest.mark.parametrize("settings", [GK, KNN], ids=["gk", "knn"])
def test_two_processes_give_the_bytes_of_one(
    tracks: list[Path], tmp_path: Path, settings: pv.TrainSettings
) -> None:
    """Recordings are given by their paths, or open."""
    one = pv.train_model(
        [pv.open_sequence(path) for path in tracks], settings, tmp_path / "one.safetensors"
    )
    shown: list[tuple[int, int]] = []
    two = pv.train_model(
        tracks, settings, tmp_path / "two.safetensors", lambda *d: shown.append(d), workers=TWO
    )
    assert two.read_bytes() == one.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "one.safetensors",
        "two.safetensors",
    ]
    assert shown == sorted(shown)
    assert shown[-1][0] <= shown[-1][1]


def test_of_more_features_than_a_model_takes_some_are_drawn(
    tracks: list[Path], static_bytes: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The draw does not depend on the workers, and leaves some features out."""
    monkeypatch.setattr(error_samples, "MAX_FEATURES", 1000)
    one, two = (
        pv.train_model(tracks, STATIC, tmp_path / f"{workers.jobs}.safetensors", workers=workers)
        for workers in (Workers(), TWO)
    )
    assert one.read_bytes() == two.read_bytes() != static_bytes


def test_of_many_drives_some_steps_are_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The draw depends neither on workers nor on parts; a short drive may lose all its steps."""
    monkeypatch.setattr(thinning, "MAX_FEATURES", 500)
    monkeypatch.setattr(thinning, "STEPS_TOGETHER", 3)
    world = point_world(frames=60, landmarks=400)
    drive = drive_of(world)
    nothing = known(world, "none")
    settings = pv.TrainSettings(
        kind="student-t", supervision="none", gk=KernelSettings(time_correlation=False)
    )
    found = []
    for name, parts, workers in (("a", 1, Workers()), ("b", 12, TWO)):
        stored = DriveOnDisk(tmp_path / name, 0, world.camera)
        pieces = np.array_split(np.arange(59), parts)
        stored.keep_drive((drive.subset(np.isin(np.arange(59), piece)) for piece in pieces), str, 2)
        stored.keep_supervision(nothing)
        short = DriveOnDisk(tmp_path / name, 1, world.camera)
        short.keep_drive([drive.subset(np.arange(59) == 0)], str, 2)
        short.keep_supervision(nothing)
        thin = thinned([stored, short], 0, workers)
        metric = Metric.fitted(drive.phi)
        model = learn_student_t(TrainingContext(drives=thin, metric=metric, settings=settings))
        found.append((joined(thin[0].parts()), model.scale_))
    (one, scale), (other, other_scale) = found
    for mine, theirs in zip(vars(one).values(), vars(other).values(), strict=True):
        np.testing.assert_array_equal(mine, theirs)
    np.testing.assert_array_equal(scale, other_scale)
    share = thinning.FEATURES_PER_DRAWN * 500 / drive.used.sum()
    assert abs(len(one.T_curr_prev) - 59 * share) < 4 * np.sqrt(3 * 59 * share * (1 - share))
    taken = [
        k for k in range(59) if (one.T_curr_prev == drive.T_curr_prev[k]).all(axis=(1, 2)).any()
    ]
    np.testing.assert_allclose(
        one.curr_px, drive.subset(np.isin(np.arange(59), taken)).curr_px, atol=1e-4
    )


@dataclass(frozen=True)
class Deadly:
    """A recording that once kills the process that looks at its tenth frame, unless that is this
    one."""

    inner: Sequence
    grave: Path
    spared: int

    def __getattr__(self, name: str) -> object:
        if name.startswith("__") or name == "inner":  # while it is unpickled
            raise AttributeError(name)
        return getattr(self.inner, name)

    def __len__(self) -> int:
        return len(self.inner)

    def __iter__(self) -> Iterator[Frame]:
        for frame in self.inner:
            if frame.index == 9 and os.getpid() != self.spared and not self.grave.exists():
                self.grave.touch()
                os.kill(os.getpid(), signal.SIGKILL)
            yield frame


def test_with_a_worker_killed_midway_they_are_the_same(
    tracks: list[Path], static_bytes: bytes, tmp_path: Path
) -> None:
    sequences = [pv.open_sequence(path) for path in tracks]
    deadly: Sequence = Deadly(sequences[1], tmp_path / "grave", os.getpid())  # type: ignore[assignment]
    killed = pv.train_model(
        [sequences[0], deadly, sequences[2]], STATIC, tmp_path / "m.safetensors", workers=TWO
    )
    assert (tmp_path / "grave").exists()
    assert killed.read_bytes() == static_bytes


def infinite(step: Step) -> np.ndarray:
    return np.full(len(step.tracks), np.inf)


def test_what_a_worker_refuses_is_refused(tracks: list[Path], tmp_path: Path) -> None:
    """As in one process; and what the others did is kept."""
    own = Predictor("own", {"own": "1"}, "test", needs=Needs.TRACKS, compute=infinite)
    with pytest.raises(InputError) as caught:
        pv.train_model(tracks, KNN, tmp_path / "m.safetensors", own_predictors=[own], workers=TWO)
    assert str(caught.value).startswith("predictor own: feature 0 (from 0) has the value inf.")
    assert "may be undefined" in caught.value.cure


def test_a_cluster_gives_them_too(tracks: list[Path], static_bytes: bytes, tmp_path: Path) -> None:
    """Two workers of Dask on this machine, one of which is killed midway."""
    distributed = pytest.importorskip("distributed")
    sequences = [pv.open_sequence(path) for path in tracks]
    deadly: Sequence = Deadly(sequences[1], tmp_path / "grave", os.getpid())  # type: ignore[assignment]
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50
    ) as cluster:
        workers = Workers(cluster=cluster.scheduler_address)
        sequences[1] = deadly
        killed = pv.train_model(sequences, STATIC, tmp_path / "killed.safetensors", workers=workers)
    assert (tmp_path / "grave").exists()
    assert killed.read_bytes() == static_bytes


def test_a_worker_whose_lease_has_expired_stops(tracks: list[Path], tmp_path: Path) -> None:
    """Tasks of a cluster cannot be interrupted by Ctrl-C; they stop at the next frame."""
    asked: list[int] = []

    @dataclass(frozen=True)
    class Watched:
        inner: Sequence

        def __getattr__(self, name: str) -> object:
            return getattr(self.inner, name)

        def __len__(self) -> int:
            return len(self.inner)

        def __iter__(self) -> Iterator[Frame]:
            for frame in self.inner:
                asked.append(frame.index)
                yield frame

    space = prediction_space(["place"])
    sequence = Watched(pv.open_sequence(tracks[0]))
    (source,) = checked_sources([sequence], GK, space)  # type: ignore[list-item]
    asked.clear()  # the first frames have been read to recognise the recording
    drive = DriveOnDisk(tmp_path, 0, source.camera)
    with leased(tmp_path) as lease:
        pass
    with pytest.raises(recording.LeaseExpiredError):
        recording._record_elsewhere(recording._Task(source, drive, space, settings=GK, lease=lease))
    assert asked == [0]
    assert not drive.is_recorded
    with leased(tmp_path) as lease:
        recording._record_elsewhere(recording._Task(source, drive, space, settings=GK, lease=lease))
    assert drive.is_complete
    assert drive.frames_done == FRAMES


def extracted(path: Path) -> list[Drive]:
    sequence = pv.open_sequence(path)
    return list(
        Extraction(
            sequence, prediction_space(["place"]), pv.OdometryConfig(), num_frames=len(sequence)
        )
    )


def test_parts_are_no_larger_than_they_may_be(
    tracks: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither in steps nor in bytes; joined, they are the drive, however it was cut."""
    (whole,) = extracted(tracks[0])
    monkeypatch.setattr(extraction, "MAX_STEPS", 4)
    parts = extracted(tracks[0])
    assert [len(part.T_curr_prev) for part in parts] == [4, 4, 4, 3]
    monkeypatch.setattr(extraction, "MAX_BYTES", 8_000)
    smaller = extracted(tracks[0])
    assert len(smaller) > 4
    for cut in (parts, smaller):
        for one, other in zip(vars(joined(cut)).values(), vars(whole).values(), strict=True):
            np.testing.assert_array_equal(one, other)


def test_what_is_written_takes_as_much_as_was_reckoned(
    tracks: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for the headers of the arrays, 2 kB."""
    monkeypatch.setattr(extraction, "MAX_BYTES", 20_000)
    drive = DriveOnDisk(tmp_path, 3, pv.open_sequence(tracks[0]).camera)
    drive.keep_drive(extracted(tracks[0]), str, 2)
    sizes = [path.stat().st_size for path in tmp_path.glob("drive-3-*.npz")]
    assert len(sizes) == drive.facts.parts == 3
    assert max(sizes) < 22_000


@dataclass(frozen=True)
class CutDrive(DriveInMemory):
    """In parts of five steps."""

    def parts(self) -> Iterator[Drive]:
        for first in range(0, len(self.drive.T_curr_prev), 5):
            steps = np.arange(len(self.drive.T_curr_prev))
            yield self.drive.subset((steps >= first) & (steps < first + 5))


@pytest.mark.parametrize("share", [1.0, 0.3])
@pytest.mark.parametrize(("kind", "every"), [("gt", 1), ("sparse", 7), ("loop", 1), ("none", 1)])
def test_stretches_may_go_on_from_part_to_part(kind: str, every: int, share: float) -> None:
    """Motions, errors and which features are drawn are the same as those of a drive in one piece,
    to the last bit."""
    world = point_world(frames=24)
    drive = drive_of(world)
    supervision = known(world, kind, every)

    def expected(supervised: DriveInMemory) -> Expectation:
        return expect(
            supervised,
            StudentT().predict,
            SolverConfig(),
            truth_sigma=None,
            share=share,
            seed=(0, 7),
        )

    whole, cut = (
        expected(way(drive, world.camera, supervision)) for way in (DriveInMemory, CutDrive)
    )
    np.testing.assert_array_equal(cut.T_curr_prev, whole.T_curr_prev)
    np.testing.assert_array_equal(cut.T_features_only, whole.T_features_only)
    for one, other in zip(
        vars(cut.feature_errors).values(), vars(whole.feature_errors).values(), strict=True
    ):
        np.testing.assert_array_equal(one, other)
    assert abs(len(whole.feature_errors.features) / drive.used.sum() - share) < 0.05


def test_a_drive_on_disk_needs_no_more_than_its_number(tmp_path: Path) -> None:
    world = point_world(frames=4)
    drive = DriveOnDisk(tmp_path, 5, world.camera)
    assert not drive.is_complete
    drive.keep_drive([drive_of(world)], lambda: "abc", 2)
    drive.keep_supervision(known(world))
    found = replace(drive)
    assert found.is_complete
    assert found.facts.digest == "abc"
    np.testing.assert_array_equal(found.supervision.T_world_cam, known(world).T_world_cam)
    assert found.facts.features == len(drive_of(world).phi)


def test_across_a_gap_nothing_is_remembered() -> None:
    """A track that is seen again after steps that were not taken starts anew, as in a drive of its
    own."""
    world = point_world(frames=24)
    drive = drive_of(world)
    model = StudentT()
    steps = np.arange(23)
    second = drive.subset(steps >= 12)
    with_gap = drive.subset((steps < 6) | (steps >= 12))

    def solved(part: Drive) -> FloatArray:
        return solve_drive(in_memory(part, world), model.predict, SolverConfig()).T_curr_prev

    np.testing.assert_array_equal(solved(with_gap)[6:], solved(second))
    np.testing.assert_array_equal(solved(with_gap)[:6], solved(drive)[:6])
    assert np.abs(solved(drive)[12:] - solved(second)).max() > 1e-5
