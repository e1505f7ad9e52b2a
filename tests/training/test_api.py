"""The whole training on small recordings: same bytes when resumed, better motions, refusals."""

import os
import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config.training import TrainSettings
from probevo.errors import InputError
from probevo.noise import Fixed, NoiseModel
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.predictors import Needs, Predictor, Step, prediction_space
from probevo.sequences.base import Sequence
from probevo.sequences.content import FIRST_FRAMES
from probevo.sequences.frame import Frame
from probevo.training.sources import RecordingAt, checked_sources
from probevo_sim.point_world import write_points
from sequences.recordings import image, write_image, write_kitti_flow, write_tracks
from training.supervised_drives import point_world, rmse_m, true_motions

FRAMES = 8
SETTINGS = pv.TrainSettings(predictors=("place", "row_offset"), iterations=4, subset=6)


@pytest.fixture(scope="module")
def tracks(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two short drives through different worlds, some 75 landmarks a frame."""
    folder = tmp_path_factory.mktemp("tracks")
    for seed in range(2):
        write_points(
            point_world("column", seed=seed, frames=FRAMES, landmarks=400), folder / f"{seed}.npz"
        )
    return [folder / f"{seed}.npz" for seed in range(2)]


@pytest.fixture(scope="module")
def recordings(tracks: list[Path]) -> list[Sequence]:
    return [pv.open_sequence(path) for path in tracks]


@dataclass(frozen=True)
class Trained:
    """A model that a training has written, and the progress that it showed."""

    path: Path
    shown: list[tuple[int, int]]


@pytest.fixture(scope="module")
def trained(recordings: list[Sequence], tmp_path_factory: pytest.TempPathFactory) -> Trained:
    """A training that was not stopped; nothing else is in the folder of its model."""
    out = tmp_path_factory.mktemp("model") / "models" / "model.safetensors"
    shown: list[tuple[int, int]] = []
    assert train(recordings, out, on_progress=lambda *each: shown.append(each)) == out
    return Trained(out, shown)


@pytest.fixture(scope="module")
def model_bytes(trained: Trained) -> bytes:
    return trained.path.read_bytes()


def train(
    recordings: list[Sequence],
    out: Path,
    settings: pv.TrainSettings = SETTINGS,
    on_progress: Callable[[int, int], None] | None = None,
) -> Path:
    return pv.train_model(recordings, settings, out, on_progress)


def neighbors_of(path: Path) -> NearestNeighbors:
    """Read a model that is one of PROBE."""
    model = pv.load_model(path)
    assert isinstance(model, NearestNeighbors)
    return model


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "models" / "model.safetensors"


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_a_name_that_is_no_text_is_written_with_question_marks(
    tracks: list[Path], tmp_path: Path
) -> None:
    strange = tmp_path / os.fsdecode(b"dr\xe4ive.npz")
    shutil.copy(tracks[0], strange)
    out = train([pv.open_sequence(strange)], tmp_path / "model.safetensors")
    assert neighbors_of(out).training["recordings"][0]["name"] == "dr?ive.npz"


def test_the_model_describes_its_training(recordings: list[Sequence], trained: Trained) -> None:
    model = neighbors_of(trained.path)
    assert model.columns == ("x", "y", "row_offset")
    assert model.camera == recordings[0].camera
    assert len(model.index_.values) <= 2 * (FRAMES - 1) * SETTINGS.iterations * SETTINGS.subset
    assert [entry["name"] for entry in model.training["recordings"]] == ["0.npz", "1.npz"]
    assert [entry["frames"] for entry in model.training["recordings"]] == [FRAMES, FRAMES]
    assert len({entry["sha256"] for entry in model.training["recordings"]}) == 2
    assert pv.TrainSettings.model_validate(model.training["settings"]) == SETTINGS
    searches = model.training["searches"]
    assert (searches["neighbors"]["chosen"], searches["exponent"]["chosen"]) == (
        model.neighbors,
        model.exponent,
    )


def test_nothing_but_the_model_is_left(trained: Trained) -> None:
    assert list(trained.path.parent.iterdir()) == [trained.path]


def test_the_same_settings_give_the_same_bytes(
    recordings: list[Sequence], model_bytes: bytes, out: Path
) -> None:
    """In place of an earlier model, too."""
    out.parent.mkdir()
    out.write_text("an earlier one")
    assert train(recordings, out).read_bytes() == model_bytes


def test_another_seed_gives_another_model(
    recordings: list[Sequence], model_bytes: bytes, out: Path
) -> None:
    other = SETTINGS.model_copy(update={"odometry": pv.OdometryConfig(seed=1)})
    assert train(recordings, out, other).read_bytes() != model_bytes


def test_progress_is_that_of_all_frames_and_iterations(trained: Trained) -> None:
    shown = trained.shown
    total = 2 * FRAMES * (1 + SETTINGS.iterations)
    assert {each for _, each in shown} == {total}
    assert all(before <= after for (before, _), (after, _) in pairwise(shown))
    assert shown[0][0] == 1
    assert shown[-1][0] == total


def stopping_after(calls: int) -> Callable[[int, int], None]:
    """Return a progress callback that raises KeyboardInterrupt after so many reports."""
    left = iter(range(calls))

    def show(_done: int, _total: int) -> None:
        if next(left, None) is None:
            raise KeyboardInterrupt

    return show


def test_stopped_at_any_moment_and_resumed_it_gives_the_same_bytes(
    recordings: list[Sequence], trained: Trained, model_bytes: bytes, tmp_path: Path
) -> None:
    """Once, at each fifth of the moments at which it tells of its progress."""
    for calls in range(0, len(trained.shown), 5):
        out = tmp_path / f"{calls}.safetensors"
        with pytest.raises(KeyboardInterrupt):
            train(recordings, out, on_progress=stopping_after(calls))
        assert not out.exists()
        assert train(recordings, out).read_bytes() == model_bytes


@pytest.mark.parametrize("seed", range(4))
def test_stopped_again_and_again_it_gives_the_same_bytes(
    recordings: list[Sequence], model_bytes: bytes, out: Path, seed: int
) -> None:
    """At up to ten random moments, each of which may come before anything new was done."""
    stops: list[int] = np.random.default_rng(seed).integers(0, 12, 10).tolist()
    for calls in stops:
        try:
            train(recordings, out, on_progress=stopping_after(calls))
        except KeyboardInterrupt:
            continue
        break
    assert train(recordings, out).read_bytes() == model_bytes


@dataclass(frozen=True)
class Counted:
    """A recording that counts how many of its frames were asked for."""

    inner: Sequence
    asked: list[int]

    def __getattr__(self, name: str) -> object:
        return getattr(self.inner, name)

    @property
    def num_asked(self) -> int:
        return len(self.asked)

    def __len__(self) -> int:
        return len(self.inner)

    def __iter__(self) -> Iterator[Frame]:
        for frame in self.inner:
            self.asked.append(frame.index)
            yield frame


def test_what_is_done_is_not_done_again(
    recordings: list[Sequence], model_bytes: bytes, out: Path
) -> None:
    """Stopped in the midst of the second recording, the first is not looked at again; after both,
    neither is; but for the first frames, by which each is recognised."""
    counted = [Counted(recording, []) for recording in recordings]
    sequences: list[Sequence] = list(counted)  # type: ignore[arg-type]
    with pytest.raises(KeyboardInterrupt):
        train(sequences, out, on_progress=stopping_after(FRAMES + 6))
    assert [each.num_asked - FIRST_FRAMES for each in counted] == [FRAMES, 6]
    with pytest.raises(KeyboardInterrupt):
        train(sequences, out, on_progress=stopping_after(FRAMES + 3))
    assert [each.num_asked - 2 * FIRST_FRAMES for each in counted] == [FRAMES, 6 + FRAMES]
    assert train(sequences, out).read_bytes() == model_bytes
    assert [each.num_asked - 3 * FIRST_FRAMES for each in counted] == [FRAMES, 6 + FRAMES]


@pytest.mark.parametrize("supervision", ["gt", "sparse", "position", "loop", "none"])
def test_every_supervision_gives_a_model(
    recordings: list[Sequence], out: Path, supervision: str
) -> None:
    every_s = 0.2 if supervision in ("sparse", "position") else 0.0
    settings = SETTINGS.model_copy(update={"supervision": supervision, "every_s": every_s})
    model = neighbors_of(train(recordings, out, settings))
    assert model.training["settings"]["supervision"] == supervision
    _, log_alpha = model.samples()
    assert np.isfinite(log_alpha).all()
    assert log_alpha.std() > 0.01


@pytest.mark.parametrize(
    "changes",
    [
        {"base": "fixed"},
        {"average": "arithmetic"},
        {"relative": False},
        {"contrast": 0.0, "subset": 20},
        {"neighbors": 7, "exponent": 2.5},
        {"max_frames": 5},
    ],
)
def test_every_setting_gives_a_model(
    recordings: list[Sequence], out: Path, changes: dict[str, object]
) -> None:
    settings = SETTINGS.model_copy(update=changes)
    model = neighbors_of(train(recordings, out, settings))
    assert np.isfinite(model.weights(np.zeros((3, 3)))).all()
    assert model.average == settings.average
    if settings.neighbors:
        assert (model.neighbors, model.exponent, model.training["searches"]) == (7, 2.5, {})
    if settings.max_frames:
        assert [entry["frames"] for entry in model.training["recordings"]] == [5, 5]


def motions(path: Path, noise: NoiseModel) -> FloatArray:
    sequence = pv.open_sequence(path)
    odometry = pv.StereoOdometry(
        sequence.camera, noise, config=pv.OdometryConfig(self_calibration=False)
    )
    return np.array([odometry.step(frame).T_curr_prev for frame in sequence])[1:]


def test_what_was_learned_on_one_recording_makes_another_one_better(tmp_path: Path) -> None:
    """σ grows from 0.05 px to 1 px from left to right, and all that the model sees is where a
    feature is."""
    worlds = [point_world("column", seed=seed, frames=24) for seed in (0, 1)]
    for name, world in zip(("train", "test"), worlds, strict=True):
        write_points(world, tmp_path / f"{name}.npz")
    settings = SETTINGS.model_copy(
        update={"predictors": ("place",), "base": "fixed", "iterations": 30, "subset": 8}
    )
    model = pv.load_model(
        train([pv.open_sequence(tmp_path / "train.npz")], tmp_path / "m.safetensors", settings)
    )
    learned, static = (
        rmse_m(motions(tmp_path / "test.npz", noise), true_motions(worlds[1]))
        for noise in (model, Fixed())
    )
    assert learned < 0.9 * static


def own(value: Callable[[Step], FloatArray], undefined: str = "") -> Predictor:
    return Predictor(
        "own", {"own": "1"}, "test", needs=Needs.TRACKS, compute=value, undefined=undefined
    )


def first_undefined(step: Step) -> FloatArray:
    return np.where(np.arange(len(step.tracks)) == 0, np.nan, step.uv[:, 0])


def test_a_predictor_of_one_s_own_is_learned_from(recordings: list[Sequence], out: Path) -> None:
    """And undefined where it says that it may be; to use the model, it has to be given again."""
    predictor = own(first_undefined, undefined="for the first")
    pv.train_model(recordings, SETTINGS, out, own_predictors=[predictor])
    model = neighbors_of(out)
    assert model.columns == ("x", "y", "row_offset", "own")
    assert model.metric_.may_be_undefined == (False, False, False, True)
    camera = recordings[0].camera
    with pytest.raises(InputError, match="its predictor own is not known"):
        pv.StereoOdometry(camera, model)
    known = pv.predictors.prediction_space(["place", "row_offset"])
    space = pv.predictors.PredictionSpace((*known.predictors, predictor))
    odometry = pv.StereoOdometry(camera, model, predictors=space)
    for frame in recordings[0]:
        odometry.step(frame)
    assert odometry.phi.shape == (len(odometry.tracks), 4)
    np.testing.assert_array_equal(
        np.isnan(odometry.phi[:, 3]), np.arange(len(odometry.tracks)) == 0
    )


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_value_of_phi_that_is_no_number_is_refused(
    recordings: list[Sequence], out: Path, value: float
) -> None:
    with pytest.raises(InputError) as caught:
        pv.train_model(
            recordings,
            SETTINGS,
            out,
            own_predictors=[own(lambda step: np.full(len(step.tracks), value))],
        )
    assert str(caught.value).startswith(f"predictor own: feature 0 (from 0) has the value {value}.")
    assert "may be undefined" in caught.value.cure
    assert not out.exists()


@pytest.mark.parametrize("name", ["place", "own"])
def test_two_predictors_of_one_name_are_refused(
    recordings: list[Sequence], out: Path, name: str
) -> None:
    """No odometry could tell which is which."""
    twice = [
        replace(
            own(lambda step: step.uv[:, 0]),
            name=name,
            columns={"x" if name == "place" else name: "1"},
        )
    ] * 2
    with pytest.raises(InputError, match=name):
        pv.train_model(recordings, SETTINGS, out, own_predictors=twice)


def refuse(
    recordings: list[Sequence], out: Path, settings: pv.TrainSettings, *fragments: str
) -> None:
    """Assert that the training is refused with a cure, and writes no model."""
    with pytest.raises(InputError) as caught:
        train(recordings, out, settings)
    for fragment in fragments:
        assert fragment in str(caught.value)
    assert caught.value.cure
    assert not out.exists()


def test_no_recording_at_all_is_refused(out: Path) -> None:
    refuse([], out, SETTINGS, "SEQUENCE: no recording is named.")


def test_a_recording_of_one_frame_is_refused(tmp_path: Path, out: Path) -> None:
    one = pv.open_sequence(write_tracks(tmp_path, 1, omega=None, C_cam_imu=None))
    refuse(
        [one],
        out,
        SETTINGS,
        f"{tmp_path / 'tracks.npz'}: it has one frame, and so no motion to learn from.",
    )


def test_recordings_of_different_cameras_are_refused(
    recordings: list[Sequence], tmp_path: Path, out: Path
) -> None:
    other = pv.open_sequence(write_tracks(tmp_path))
    refuse(
        [*recordings, other],
        out,
        SETTINGS,
        f"{other.path}: its camera is not that of {recordings[0].path}",
    )


@pytest.mark.parametrize("supervision", ["gt", "sparse", "position"])
def test_supervision_without_truth_is_refused(tmp_path: Path, out: Path, supervision: str) -> None:
    blind = pv.open_sequence(write_tracks(tmp_path, T_world_cam=None))
    settings = SETTINGS.model_copy(update={"supervision": supervision})
    refuse(
        [blind],
        out,
        settings,
        f"no ground truth, which --supervision {supervision} needs.",
        "--supervision none",
    )


def test_an_unknown_predictor_is_refused(recordings: list[Sequence], out: Path) -> None:
    settings = SETTINGS.model_copy(update={"predictors": ("place", "blurr")})
    refuse(recordings, out, settings, "--predictors: blurr is not known.", "Did you mean blur?")


@pytest.mark.parametrize(
    ("name", "lacking"), [("blur", "images"), ("acceleration", "accelerometer")]
)
def test_a_predictor_that_lacks_what_it_needs_is_refused_and_no_obstacle(
    recordings: list[Sequence], model_bytes: bytes, out: Path, name: str, lacking: str
) -> None:
    """Whoever then leaves it out is not refused because of a training with other settings."""
    settings = SETTINGS.model_copy(update={"predictors": ("place", name)})
    refuse(
        recordings,
        out,
        settings,
        f"{recordings[0].path}: it has no {lacking}, which the predictor {name} needs.",
    )
    assert not out.parent.exists()
    assert train(recordings, out).read_bytes() == model_bytes


def test_more_neighbours_than_samples_are_refused(recordings: list[Sequence], out: Path) -> None:
    settings = SETTINGS.model_copy(update={"neighbors": 10_000})
    refuse(recordings, out, settings, "--neighbors: K is 10000, but there are only 336 samples.")


def test_with_fewer_neighbours_it_goes_on_where_it_was(
    recordings: list[Sequence], out: Path
) -> None:
    """K and γ are no matter of what was done before: another K needs no other motions."""
    counted = [Counted(recording, []) for recording in recordings]
    sequences: list[Sequence] = list(counted)  # type: ignore[arg-type]
    refuse(sequences, out, SETTINGS.model_copy(update={"neighbors": 10_000}), "--neighbors")
    train(sequences, out, SETTINGS.model_copy(update={"neighbors": 10}))
    assert neighbors_of(out).neighbors == 10
    assert [each.num_asked - 2 * FIRST_FRAMES for each in counted] == [FRAMES, FRAMES]


def test_two_frames_are_too_few_for_the_predictors_by_default(
    recordings: list[Sequence], out: Path
) -> None:
    """Whoever has named none cannot leave one out."""
    settings = TrainSettings(kind="gk", max_frames=2)
    refuse(recordings, out, settings, "predictor last_residual", "Give a longer recording")
    refuse(
        recordings,
        out.with_name("named.safetensors"),
        settings.model_copy(update={"predictors": ("place", "last_residual")}),
        "predictor last_residual",
        "Leave it out.",
    )


def test_steps_with_too_few_features_leave_nothing_to_learn_from(
    recordings: list[Sequence], out: Path
) -> None:
    settings = SETTINGS.model_copy(update={"subset": 500})
    refuse(recordings, out, settings, "no step has 500 features to learn from", "--subset")


def test_a_recording_without_features_is_no_fault_of_the_predictors(
    tmp_path: Path, out: Path
) -> None:
    none = np.zeros(0, np.int64)
    blind = pv.open_sequence(write_tracks(tmp_path, frame=none, track=none, uv=np.zeros((0, 4))))
    refuse([blind], out, SETTINGS, "training data: ", "feature")


def test_other_settings_on_unfinished_work_are_refused(
    recordings: list[Sequence], out: Path
) -> None:
    with pytest.raises(KeyboardInterrupt):
        train(recordings, out, on_progress=stopping_after(FRAMES + 3))
    other = SETTINGS.model_copy(update={"predictors": ("place",)})
    refuse(
        recordings,
        out,
        other,
        f"{out}.work: ",
        "other recordings, predictors or odometry",
        "delete this folder",
    )


def test_what_a_stopped_training_knew_of_its_drives_is_not_taken_for_that_of_others(
    recordings: list[Sequence], tracks: list[Path], tmp_path: Path, out: Path
) -> None:
    """Stopped so early that only the truth of the first drive was written."""
    with np.load(tracks[0]) as archive:
        arrays = {name: archive[name] for name in archive.files}
    arrays["T_world_cam"][:, :3, 3] *= 1.1
    np.savez(tmp_path / "longer.npz", allow_pickle=False, **arrays)
    others: list[Sequence] = [pv.open_sequence(tmp_path / "longer.npz")]
    with pytest.raises(KeyboardInterrupt):
        train(recordings, out, on_progress=stopping_after(0))
    assert list(out.with_name(out.name + ".work").glob("drive-truth-*"))
    fresh = train(others, tmp_path / "fresh" / "model.safetensors").read_bytes()
    assert train(others, out).read_bytes() == fresh


def changed(path: Path, to: Path, **changes: Callable[[FloatArray], FloatArray]) -> list[Sequence]:
    """Write the recording with some of its arrays changed, and open it."""
    with np.load(path) as archive:
        arrays = {name: changes.get(name, np.asarray)(archive[name]) for name in archive.files}
    np.savez(to, allow_pickle=False, **arrays)
    return [pv.open_sequence(to)]


def test_truth_corrected_before_it_goes_on_is_learned_from(
    tracks: list[Path], tmp_path: Path, out: Path
) -> None:
    """Stopped after the first recording: its features need not be found anew, but its errors are
    others."""
    path = tmp_path / "drive.npz"
    longer = changed(tracks[0], path, T_world_cam=lambda T: T * np.array([1.0, 1.0, 1.0, 1.5]))
    with pytest.raises(KeyboardInterrupt):
        train(longer, out, on_progress=stopping_after(FRAMES + 2))
    right = changed(tracks[0], path)
    assert (
        train(right, out).read_bytes() == train(right, tmp_path / "fresh.safetensors").read_bytes()
    )


def test_a_calibration_corrected_before_it_goes_on_is_refused(
    tracks: list[Path], tmp_path: Path, out: Path
) -> None:
    path = tmp_path / "drive.npz"
    wider = changed(tracks[0], path, camera=lambda c: c * np.array([1.0, 1.0, 1.0, 1.0, 1.1]))
    with pytest.raises(KeyboardInterrupt):
        train(wider, out, on_progress=stopping_after(FRAMES + 2))
    refuse(
        changed(tracks[0], path),
        out,
        SETTINGS,
        f"{out}.work: ",
        "other recordings, predictors or odometry",
    )


def test_features_that_are_others_than_before_are_refused(
    tracks: list[Path], tmp_path: Path, out: Path
) -> None:
    """Of a recording under the same path; a copy is none."""
    path = tmp_path / "drive.npz"
    with pytest.raises(KeyboardInterrupt):
        train(changed(tracks[0], path), out, on_progress=stopping_after(FRAMES + 2))
    moved = changed(tracks[0], path, uv=lambda uv: uv + 0.25)
    refuse(moved, out, SETTINGS, f"{out}.work: ", "other recordings, predictors or odometry")
    train(changed(tracks[0], path), out)


def test_a_copy_of_a_recording_is_refused(tracks: list[Path], tmp_path: Path, out: Path) -> None:
    """It would count double. One that begins alike is another recording."""
    copy = changed(tracks[0], tmp_path / "copy.npz")
    recording = pv.open_sequence(tracks[0])
    refuse([recording, *copy], out, SETTINGS, f"copy.npz: its frames are those of {tracks[0]}.")

    def differently_ended(uv: FloatArray) -> FloatArray:
        return np.vstack([uv[:-1], uv[-1:] + 0.25])

    other = changed(tracks[0], tmp_path / "other.npz", uv=differently_ended)
    assert len(checked_sources([recording, *other], SETTINGS, prediction_space(()))) == 2


def test_other_subsets_go_on_from_the_recordings(
    recordings: list[Sequence], model_bytes: bytes, out: Path
) -> None:
    """Iterations with another subset are of no use to these settings, but recordings that are
    through are."""
    refuse(
        recordings,
        out,
        SETTINGS.model_copy(update={"subset": 9, "neighbors": 10_000}),
        "--neighbors",
    )
    counted = [Counted(recording, []) for recording in recordings]
    assert train(list(counted), out).read_bytes() == model_bytes  # type: ignore[arg-type]
    assert [each.num_asked for each in counted] == [FIRST_FRAMES, FIRST_FRAMES]


def test_what_is_not_ours_survives_a_training_and_stops_the_next(
    recordings: list[Sequence], model_bytes: bytes, out: Path
) -> None:
    """Put into the folder of the work while it goes on."""
    notes = out.with_name(out.name + ".work") / "notes.txt"
    train(recordings, out, on_progress=lambda _done, _total: void(notes.write_text("mine")))
    assert out.read_bytes() == model_bytes
    assert list(notes.parent.iterdir()) == [notes]
    with pytest.raises(InputError, match=r"holds notes\.txt, which is none of ours"):
        train(recordings, out)
    assert (out.read_bytes(), notes.read_text()) == (model_bytes, "mine")


def void(_: object) -> None:
    """Discard a value."""


def test_a_recording_named_twice_is_refused(recordings: list[Sequence], out: Path) -> None:
    twice = [*recordings, recordings[0]]
    refuse(twice, out, SETTINGS, f"{recordings[0].path}: this recording is named twice.")


def test_two_scenes_of_one_folder_are_two_recordings(tmp_path: Path) -> None:
    """But not one scene, named twice."""
    folder = write_kitti_flow(tmp_path / "training", scenes=(3, 4))
    write_image(folder / "image_0" / "000004_11.png", image(4))
    recordings = [RecordingAt(folder, "kitti-flow", {"scene": scene}) for scene in (3, 4, 4)]
    settings = TrainSettings(kind="student-t", supervision="none")
    space = prediction_space(())
    assert len(checked_sources(recordings[:2], settings, space)) == 2
    with pytest.raises(InputError, match="named twice"):
        checked_sources(recordings[1:], settings, space)


def test_drives_too_short_for_two_folds_need_k_and_gamma(
    recordings: list[Sequence], out: Path
) -> None:
    for given in ({}, {"neighbors": 3}, {"exponent": 1.0}):
        settings = SETTINGS.model_copy(update={"max_frames": 2, **given})
        refuse(
            recordings[:1],
            out,
            settings,
            "the drives are too short to choose K and γ by blocks of time.",
        )
    both = SETTINGS.model_copy(update={"max_frames": 2, "neighbors": 3, "exponent": 1.0})
    assert train(recordings[:1], out, both) == out


def test_an_output_that_cannot_be_written_is_refused_at_once(
    recordings: list[Sequence], tmp_path: Path
) -> None:
    """Before a single frame was looked at."""
    (tmp_path / "file").write_text("")
    (tmp_path / "folder.safetensors").mkdir()

    def looked_at(_done: int, _total: int) -> None:
        pytest.fail("it should have been refused before")

    for path in (tmp_path / "file" / "m.safetensors", tmp_path / "folder.safetensors"):
        with pytest.raises(InputError, match=r"file|folder"):
            train(recordings, path, on_progress=looked_at)


def test_the_model_of_another_camera_is_refused(
    recordings: list[Sequence], trained: Trained
) -> None:
    model = pv.load_model(trained.path)
    camera: StereoCamera = replace(recordings[0].camera, baseline_m=0.1)
    with pytest.raises(InputError, match="trained with another camera"):
        model.check_camera(camera)


def test_names_and_settings_may_be_plain(
    tracks: list[Path], model_bytes: bytes, tmp_path: Path
) -> None:
    """Text for paths, and a dictionary of the settings that differ."""
    plain = SETTINGS.model_dump(mode="json", exclude_defaults=True)
    out = str(tmp_path / "plain.safetensors")
    given = pv.train_model([str(path) for path in tracks], plain, out)
    assert given.read_bytes() == model_bytes


@pytest.mark.parametrize(
    ("recordings", "settings", "out", "said"),
    [
        ("drive", None, "m.safetensors", "recordings: is 'drive'"),
        (Path("drive"), None, "m.safetensors", "recordings: is "),
        ([1], None, "m.safetensors", "recordings: holds 1"),
        ([], None, "m.safetensors", "no recording is named"),
        (["drive"], 3, "m.safetensors", "settings: is 3"),
        (["drive"], {"kin": "gk"}, "m.safetensors", "kin"),
        (["drive"], None, 3, "out: is 3"),
    ],
)
def test_other_arguments_are_refused_by_name(
    recordings: Any, settings: Any, out: Any, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        pv.train_model(recordings, settings, out)


def test_what_is_no_model_is_not_saved(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="model: is a int, which has nothing to be kept"):
        pv.save_model(3, tmp_path / "m.safetensors")  # type: ignore[arg-type]
