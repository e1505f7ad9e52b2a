"""What a stopped training leaves: complete files, which the same training resumes, and no other."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from probevo import __version__
from probevo.config import OdometryConfig
from probevo.config.training import TrainSettings
from probevo.errors import InputError
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.storage.files import remove_stale
from probevo.storage.lock import LOCK
from probevo.training import checkpoint
from probevo.training.checkpoint import Checkpoint, Iteration
from probevo.training.drive import Drive, joined
from probevo.training.probe.subsets import SubsetErrors
from probevo.training.sources import calibration
from training.supervised_drives import Recording, drive_of, known, point_world, recording
from worlds import CAMERA


def rounded(drive: Drive) -> Drive:
    """Round a drive to its precision on disk, so that it is read as it was written."""
    single = {
        name: getattr(drive, name).astype(np.float32) for name in ("prev_px", "curr_px", "phi")
    }
    return replace(drive, **{name: array.astype(np.float64) for name, array in single.items()})


SETTINGS = TrainSettings(predictors=("place",))
RECORDINGS = [recording(None), recording(None, frames=7)]
WORLD = point_world(frames=4)
DRIVE = rounded(drive_of(WORLD))
SUPERVISION = known(WORLD)
ITERATION: Iteration = [
    SubsetErrors(np.array([3, 1, 4]), np.array([0.1, 0.2, 1e-6])),
    SubsetErrors(np.zeros(0, np.int64), np.zeros(0)),
    SubsetErrors(np.array([7]), np.array([np.pi])),
]


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "models" / "city.safetensors"


def opened(
    out: Path,
    settings: TrainSettings = SETTINGS,
    recordings: list[Recording] = RECORDINGS,
    columns: tuple[str, ...] = ("x", "y"),
    truth: str = "",
) -> Checkpoint:
    facts = [
        [str(r.path.resolve()), len(r), r.stamps_ns[[0, -1]].tolist(), calibration(r)]
        for r in recordings
    ]
    return Checkpoint.opened(out, facts, [truth] * len(facts), settings=settings, columns=columns)


def keep(work: Checkpoint, number: int, drive: Drive = DRIVE, digest: str = "") -> None:
    """Write the drive in two parts, and its supervision; the second part may have no step."""
    stored = work.drive(number, CAMERA)
    cut = len(drive.T_curr_prev) // 2
    stored.keep_drive(
        [part_of(drive, 0, cut), part_of(drive, cut, None)], lambda: digest, drive.phi.shape[1]
    )
    stored.keep_supervision(SUPERVISION)


def part_of(drive: Drive, first: int, last: int | None) -> Drive:
    """Return the steps from the first up to the last."""
    places = drive.first_of_step[first : None if last is None else last + 1]
    rows = slice(places[0], places[-1])
    features = {
        name: getattr(drive, name)[rows] for name in ("prev_px", "curr_px", "ids", "phi", "used")
    }
    return Drive(
        T_curr_prev=drive.T_curr_prev[first:last],
        numbers=drive.numbers[first:last],
        first_of_step=places - places[0],
        **features,
    )


def drive_of_number(work: Checkpoint, number: int) -> Drive | None:
    """Read the whole drive, if all of it is recorded."""
    drive = work.drive(number, CAMERA)
    return joined(drive.parts()) if drive.is_recorded else None


def test_it_lies_beside_the_model(out: Path) -> None:
    assert opened(out).folder == out.with_name("city.safetensors.work")
    assert opened(out).folder.is_dir()


def test_at_first_nothing_is_done(out: Path) -> None:
    work = opened(out)
    assert drive_of_number(work, 0) is None
    assert work.iteration(0) is None


def assert_same(a: Drive, b: Drive) -> None:
    for field in fields(Drive):
        one = getattr(a, field.name)
        other = getattr(b, field.name)
        assert type(one) is type(other)
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other, strict=True)
        else:
            assert one == other


def test_a_drive_comes_back(out: Path) -> None:
    drive = replace(DRIVE, phi=np.where(DRIVE.phi > 1.0, np.nan, DRIVE.phi))
    keep(opened(out), 1, drive)
    work = opened(out)
    found = drive_of_number(work, 1)
    assert found is not None
    assert_same(found, drive)
    assert drive_of_number(work, 0) is None


def test_a_drive_without_any_feature_comes_back(out: Path) -> None:
    nothing = {
        name: getattr(DRIVE, name)[:0] for name in ("prev_px", "curr_px", "ids", "phi", "used")
    }
    drive = replace(DRIVE, first_of_step=np.zeros(4, np.int64), **nothing)
    keep(opened(out), 0, drive)
    found = drive_of_number(opened(out), 0)
    assert found is not None
    assert_same(found, drive)
    assert len(found.tracks(2)) == 0


def test_an_iteration_comes_back(out: Path) -> None:
    """Drives without a sample too."""
    opened(out).keep_iteration(11, ITERATION)
    found = opened(out).iteration(11)
    assert found is not None
    assert len(found) == len(ITERATION)
    for (features, alphas), (expected_features, expected_alphas) in zip(
        found, ITERATION, strict=True
    ):
        np.testing.assert_array_equal(features, expected_features, strict=True)
        np.testing.assert_array_equal(alphas, expected_alphas, strict=True)


def test_the_order_of_many_drives_is_kept(out: Path) -> None:
    """Eleven, so that names in the order of the alphabet would be found out."""
    many: Iteration = [SubsetErrors(np.array([k]), np.array([float(k + 1)])) for k in range(11)]
    opened(out).keep_iteration(0, many)
    found = opened(out).iteration(0)
    assert found is not None
    assert [int(features[0]) for features, _ in found] == list(range(11))


def test_what_was_being_written_when_it_was_stopped_does_not_count(out: Path) -> None:
    work = opened(out)
    keep(work, 0)
    content = (work.folder / "drive-0-0.npz").read_bytes()
    (work.folder / "drive-1-0.npz.0123abcd.part").write_bytes(content[: len(content) // 2])
    (work.folder / "iteration-0.npz.part").write_bytes(b"")
    assert drive_of_number(opened(out), 0) is not None
    assert drive_of_number(opened(out), 1) is None
    assert opened(out).iteration(0) is None


OTHERS = {
    "predictors": (
        SETTINGS.model_copy(update={"predictors": ("place", "age")}),
        RECORDINGS,
        ("x", "y"),
    ),
    "frames": (SETTINGS.model_copy(update={"max_frames": 5}), RECORDINGS, ("x", "y")),
    "seed": (
        SETTINGS.model_copy(update={"odometry": OdometryConfig(seed=1)}),
        RECORDINGS,
        ("x", "y"),
    ),
    "columns": (SETTINGS, RECORDINGS, ("x", "y", "own")),
    "fewer recordings": (SETTINGS, RECORDINGS[:1], ("x", "y")),
    "another order": (SETTINGS, RECORDINGS[::-1], ("x", "y")),
    "another recording": (
        SETTINGS,
        [RECORDINGS[0], replace(RECORDINGS[1], path=Path("other"))],
        ("x", "y"),
    ),
    "a longer recording": (SETTINGS, [recording(None, frames=12), RECORDINGS[1]], ("x", "y")),
    "another camera": (
        SETTINGS,
        [replace(RECORDINGS[0], camera=replace(CAMERA, baseline_m=0.5)), RECORDINGS[1]],
        ("x", "y"),
    ),
    "an IMU": (
        SETTINGS,
        [replace(RECORDINGS[0], imu=ImuCalibration(np.eye(4), 1e-3, 1e-3)), RECORDINGS[1]],
        ("x", "y"),
    ),
    "another time": (SETTINGS, [recording(None, start_ns=7), RECORDINGS[1]], ("x", "y")),
}


@pytest.mark.parametrize(("settings", "recordings", "columns"), OTHERS.values(), ids=OTHERS.keys())
def test_another_training_is_refused(
    out: Path, settings: TrainSettings, recordings: list[Recording], columns: tuple[str, ...]
) -> None:
    """The folder to delete is named; what lies in it stays as it is."""
    work = opened(out)
    keep(work, 0)
    before = {path.name: path.read_bytes() for path in work.folder.iterdir()}
    with pytest.raises(InputError) as caught:
        opened(out, settings, recordings, columns)
    assert caught.value.where == str(work.folder)
    assert "a training that was stopped here had other recordings, predictors or odometry." in str(
        caught.value
    )
    assert "delete this folder" in caught.value.cure
    assert {path.name: path.read_bytes() for path in work.folder.iterdir()} == before
    assert drive_of_number(opened(out), 0) is not None


def test_work_of_another_version_is_refused_as_such(out: Path) -> None:
    work = opened(out)
    keep(work, 0)
    plan = work.folder / "plan.json"
    plan.write_text(plan.read_text().replace(f'"probevo": "{__version__}"', '"probevo": "0.0.9"'))
    with pytest.raises(InputError, match=f"had other code, probevo 0.0.9 instead of {__version__}"):
        opened(out)


def test_where_nothing_was_done_yet_other_settings_are_welcome(out: Path) -> None:
    """A recording that was refused for a predictor it has no images for leaves no work, and no
    obstacle."""
    opened(out)
    other = opened(out, SETTINGS.model_copy(update={"predictors": ("disparity",)}))
    keep(other, 0)
    with pytest.raises(InputError, match="other recordings, predictors or odometry"):
        opened(out)


class KilledError(Exception):
    """The process was killed."""


@pytest.mark.parametrize("num_removed", [0, 1, 3])
def test_the_rest_of_a_removal_that_was_stopped_is_no_work(
    out: Path, num_removed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Drives of other settings must not pass for those of these."""
    work = opened(out)
    keep(work, 0)
    waiting = [remove_stale] * num_removed

    def killed(path: Path) -> None:
        if not waiting:
            raise KilledError
        waiting.pop()(path)

    monkeypatch.setattr(checkpoint, "remove_stale", killed)
    with pytest.raises(KilledError):
        work.remove()
    monkeypatch.undo()
    assert drive_of_number(opened(out, SETTINGS.model_copy(update={"subset": 9})), 0) is None
    assert [path.name for path in work.folder.iterdir()] == ["plan.json"]


def test_files_of_our_names_without_a_plan_are_those_of_somebody_else(out: Path) -> None:
    """Not every iteration-1.npz is ours."""
    folder = out.with_name("city.safetensors.work")
    folder.mkdir(parents=True)
    for name in ("iteration-1.npz", "drive-1.json", "lease"):
        (folder / name).write_text("mine")
        with pytest.raises(InputError, match=rf"holds {name} but no plan\.json"):
            opened(out)
        assert [path.read_text() for path in folder.iterdir()] == ["mine"]
        (folder / name).unlink()


def test_what_lies_there_before_the_plan_is_no_obstacle(out: Path) -> None:
    folder = out.with_name("city.safetensors.work")
    folder.mkdir(parents=True)
    for name in (LOCK, "plan.json.0123-4-56.part"):
        (folder / name).write_text("")
    opened(out)
    assert sorted(path.name for path in folder.iterdir()) == [LOCK, "plan.json"]


@pytest.mark.parametrize(
    "changes",
    [
        {"subset": 9},
        {"contrast": 0.0},
        {"supervision": "none"},
        {"base": "fixed"},
        {"relative": False},
        {"every_s": 1.0},
    ],
)
def test_what_concerns_the_iterations_alone_drops_those_alone(
    out: Path, changes: dict[str, object]
) -> None:
    """And they do not come back with the settings that made them."""
    work = opened(out)
    keep(work, 0)
    work.keep_iteration(0, ITERATION)
    other = opened(out, SETTINGS.model_copy(update=changes))
    assert drive_of_number(other, 0) is not None
    assert other.iteration(0) is None
    assert opened(out).iteration(0) is None


def test_other_truth_drops_what_was_made_with_it(out: Path) -> None:
    work = opened(out)
    keep(work, 0)
    work.keep_iteration(0, ITERATION)
    other = opened(out, truth="corrected")
    assert drive_of_number(other, 0) is not None
    assert not other.drive(0, CAMERA).is_complete
    assert other.iteration(0) is None


@pytest.mark.parametrize(
    "changes", [{"iterations": 9}, {"neighbors": 3}, {"exponent": 1.0}, {"average": "arithmetic"}]
)
def test_what_comes_after_the_iterations_drops_nothing(
    out: Path, changes: dict[str, object]
) -> None:
    work = opened(out)
    keep(work, 0)
    work.keep_iteration(0, ITERATION)
    other = opened(out, SETTINGS.model_copy(update=changes))
    assert drive_of_number(other, 0) is not None
    assert other.iteration(0) is not None


@pytest.mark.parametrize("content", [b"{", b"[1]", b"null", b"\xff", b""])
def test_a_broken_plan_is_said_to_be_damaged(out: Path, content: bytes) -> None:
    work = opened(out)
    keep(work, 0)
    plan = work.folder / "plan.json"
    plan.write_bytes(content)
    with pytest.raises(InputError) as caught:
        opened(out)
    assert_damaged(caught.value, plan)
    assert (work.folder / "drive-0-0.npz").exists()


def assert_damaged(error: InputError, path: Path) -> None:
    """It names the file, and the folder to delete."""
    assert str(error).startswith(f"{path}: this is damaged")
    assert error.cure == f"Delete the folder {path.parent}."


@pytest.mark.parametrize("part", [0.0, 0.5, 0.99])
def test_a_file_cut_short_is_said_to_be_damaged(out: Path, part: float) -> None:
    work = opened(out)

    def whole_drive(number: int) -> Drive | None:
        return drive_of_number(work, number)

    keep(work, 0)
    work.keep_iteration(0, ITERATION)
    for name, read in (
        ("drive-0-0.npz", whole_drive),
        ("drive-0.json", whole_drive),
        ("iteration-0.npz", work.iteration),
    ):
        content = (work.folder / name).read_bytes()
        (work.folder / name).write_bytes(content[: int(part * len(content))])
        with pytest.raises(InputError) as caught:
            read(0)
        assert_damaged(caught.value, work.folder / name)


def test_a_file_that_lacks_an_array_is_said_to_be_damaged(out: Path) -> None:
    work = opened(out)
    keep(work, 0)
    np.savez(work.folder / "drive-0-0.npz", phi=DRIVE.phi)
    with pytest.raises(InputError) as caught:
        drive_of_number(work, 0)
    assert_damaged(caught.value, work.folder / "drive-0-0.npz")


def test_what_is_not_ours_is_refused_and_nothing_is_removed(out: Path) -> None:
    """Whoever named the model like that keeps his notes; and our work, until he has moved them."""
    work = opened(out)
    keep(work, 0)
    (work.folder / "notes.txt").write_text("mine")
    before = {path.name: path.read_bytes() for path in work.folder.iterdir()}
    for settings in (SETTINGS, SETTINGS.model_copy(update={"subset": 9})):
        with pytest.raises(InputError) as caught:
            opened(out, settings)
        assert str(caught.value).startswith(
            f"{work.folder}: holds notes.txt, which is none of ours"
        )
        assert {path.name: path.read_bytes() for path in work.folder.iterdir()} == before
    (work.folder / "plan.json").unlink()
    with pytest.raises(InputError, match=r"notes\.txt"):
        opened(out)
    assert (work.folder / "drive-0-0.npz").exists()


def test_what_is_not_ours_is_not_removed_with_the_rest(out: Path) -> None:
    work = opened(out)
    keep(work, 0)
    (work.folder / "notes.txt").write_text("mine")
    work.remove()
    assert [path.name for path in work.folder.iterdir()] == ["notes.txt"]


def test_removed_it_leaves_nothing(out: Path) -> None:
    work = opened(out)
    keep(work, 0)
    work.keep_iteration(0, ITERATION)
    work.remove()
    assert list(work.folder.iterdir()) == []
    work.remove()
    assert drive_of_number(opened(out), 0) is None


def test_a_file_in_its_place_is_refused(out: Path) -> None:
    out.parent.mkdir()
    out.with_name("city.safetensors.work").write_text("mine")
    with pytest.raises(InputError, match=r"city\.safetensors\.work"):
        opened(out)
    assert out.with_name("city.safetensors.work").read_text() == "mine"
