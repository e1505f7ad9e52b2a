"""``probevo run``: its files, that they agree with each other, and those of an interrupted run."""

import json
import re
import shutil
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from cli.rendering import true_poses, write_wall
from output.undrawn import figures_undrawn
from probevo import __version__
from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.evaluation.metrics import evaluate
from probevo.noise import NearestNeighbors, StudentT
from probevo.noise.metric import Metric
from probevo.noise.model_io import save_model
from probevo.output.motions_file import read_motions
from probevo.run_config import RunConfig, read_config
from probevo.runs.runner import run_sequence
from probevo.sequences import open_sequence
from probevo.sequences.pose_files import read_kitti_poses, read_tum
from probevo.sequences.without_imu import WithoutImu
from sequences.damage import cut, replace
from sequences.recordings import write_folder_sequence, write_image, write_tracks
from strips import write_strips
from worlds import Homesick

FILES = {
    "config.yaml",
    "metrics.json",
    "motions.npz",
    "report.html",
    "trajectory.kitti.txt",
    "trajectory.smoothed.kitti.txt",
    "trajectory.smoothed.tum",
    "trajectory.tum",
}


def test_all_files_are_there_and_agree(wall: Path, wall_run: Path) -> None:
    assert {path.name for path in wall_run.iterdir()} == FILES
    result = read_motions(wall_run / "motions.npz")
    stamps_ns, T_world_cam = read_tum(wall_run / "trajectory.tum")
    np.testing.assert_array_equal(stamps_ns, open_sequence(wall).stamps_ns)
    np.testing.assert_allclose(T_world_cam, result.T_world_cam, atol=1e-14)
    np.testing.assert_array_equal(
        read_kitti_poses(wall_run / "trajectory.kitti.txt"), result.T_world_cam
    )
    metrics = evaluate(
        result.T_world_cam, true_poses(8), result.T_curr_prev, cov=result.cov
    ).as_dict()
    written = json.loads((wall_run / "metrics.json").read_text())
    assert written["stopped"] is None
    assert written.pop("faults") == {}
    assert metrics.pop("faults") is None  # the caller takes it from the run
    assert written.pop("nees_coverage") == metrics.pop("nees_coverage")
    assert written.pop("smoothed")["armse_m"] < 0.01
    assert metrics.pop("smoothed") is None
    assert written == pytest.approx(metrics, abs=1e-9)


def test_the_motion_is_right(wall_run: Path) -> None:
    """The error is a few percent of the path: the wall is 8 m away, and disparities are 6 px."""
    metrics = json.loads((wall_run / "metrics.json").read_text())
    assert metrics["final_error_m"] < 0.05 * metrics["path_length_m"]


def test_the_terminal_gives_each_warning_of_the_report(
    wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A focal length that was wrong by half once had a warning on the report alone."""
    said = {"Focal length": "It is wrong.", "A sensor is faulty": "The sun is."}
    # The report first: it takes the function from the other module when it is imported.
    monkeypatch.setattr("probevo.output.report.report.run_warnings", lambda *_: said)
    monkeypatch.setattr("probevo.output.run_warnings.run_warnings", lambda *_: said)
    assert main(["run", str(wall), "--out", str(tmp_path)]) == 0
    errors = capsys.readouterr().err
    report = (tmp_path / "report.html").read_text()
    for text in said.values():
        assert f"probevo: warning: {text}\n" in errors
        assert text in report


def test_the_same_run_gives_the_same_bytes(wall: Path, wall_run: Path, tmp_path: Path) -> None:
    assert main(["run", str(wall), "--out", str(tmp_path), "--threads", "2"]) == 0
    for name in FILES - {"motions.npz", "report.html"}:  # these two hold times
        assert (tmp_path / name).read_bytes() == (wall_run / name).read_bytes(), name
    with np.load(tmp_path / "motions.npz") as ours, np.load(wall_run / "motions.npz") as theirs:
        assert ours.files == theirs.files
        for name in ours.files:
            if not name.startswith("ms_") and name != "total_ms":
                assert ours[name].tobytes() == theirs[name].tobytes(), name


def test_the_effective_config_repeats_the_run(wall_run: Path, tmp_path: Path) -> None:
    assert main(["run", "--config", str(wall_run / "config.yaml"), "--out", str(tmp_path)]) == 0
    assert (wall_run / "config.yaml").read_text().startswith(f"# by probevo {__version__}\n")
    assert (tmp_path / "trajectory.tum").read_bytes() == (wall_run / "trajectory.tum").read_bytes()


def test_a_repeated_run_leaves_the_bag_of_the_first_alone(wall: Path, tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    bag = tmp_path / "first.bag"
    words = ["run", str(wall), "--max-frames", "3"]
    assert main([*words, "--out", str(tmp_path / "first"), "--write", str(bag)]) == 0
    before = bag.read_bytes()
    words = ["run", "--config", str(tmp_path / "first" / "config.yaml"), "--noise", "fixed"]
    assert main([*words, "--out", str(tmp_path / "again")]) == 0
    assert bag.read_bytes() == before


def test_defaults_yield_to_the_file_and_the_file_to_flags(wall: Path, tmp_path: Path) -> None:
    file = tmp_path / "settings.yaml"
    file.write_text("noise: fixed\ntracking: {num_features: 300, window_px: 13}\n")
    flags = ["--tracking.num-features", "200", "--no-self-calibration", "--max-frames", "3"]
    assert (
        main(["run", str(wall), "--out", str(tmp_path / "out"), "--config", str(file), *flags]) == 0
    )
    config = read_config(tmp_path / "out" / "config.yaml")
    assert (config.noise, config.tracking.num_features, config.tracking.window_px) == (
        "fixed",
        200,
        13,
    )
    assert (config.self_calibration, config.max_frames, config.sequence) == (False, 3, wall)
    assert len(read_motions(tmp_path / "out" / "motions.npz")) == 3
    assert "<dt>Frames</dt><dd>3 of 8 in" in (tmp_path / "out" / "report.html").read_text()


def test_a_damaged_image_leaves_what_came_before(
    wall: Path, wall_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = shutil.copytree(wall, tmp_path / "wall")
    out = tmp_path / "out"
    cut("right/000005.png", 0.5)(recording)
    assert main(["run", str(recording), "--out", str(out)]) == 2
    shown = capsys.readouterr().err
    assert "right/000005.png: this image is damaged" in shown
    assert f"The results of the first 5 frames are in {out}." in shown
    assert {path.name for path in out.iterdir()} == FILES
    before = read_motions(out / "motions.npz")
    whole = read_motions(wall_run / "motions.npz")
    np.testing.assert_array_equal(before.T_curr_prev, whole.T_curr_prev[:4])
    said = f"{recording / 'right/000005.png'}: this image is damaged: its end is missing."
    assert before.stopped == said
    assert json.loads((out / "metrics.json").read_text())["stopped"] == said
    page = (out / "report.html").read_text()
    assert f"After 5 frames: {said}" in page
    assert "<dt>Frames</dt><dd>5 of 8 in" in page
    assert "<dt>Truth</dt><dd>5 of 5 frames" in page
    assert main(["eval", str(out), "--gt", str(out / "trajectory.kitti.txt")]) == 0
    assert json.loads((out / "metrics.json").read_text())["stopped"] == said


def test_the_imu_can_be_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = write_folder_sequence(tmp_path / "folder")
    out = tmp_path / "out"
    tested = "not used in the window: it is being tested: its samples connect 4 of the 6 frames"
    for flags, imu in (([], tested), (["--no-imu"], "left out<")):
        assert main(["run", str(recording), "--out", str(out), *flags]) == 0
        assert f"<dt>IMU</dt><dd>{imu}" in (out / "report.html").read_text()
        assert read_config(out / "config.yaml").imu is (not flags)
    frames = list(WithoutImu.of(open_sequence(recording)))
    assert [frame.index for frame in frames] == [0, 1, 2, 3]
    assert not any(frame.imu for frame in frames)
    assert main(["run", str(recording), "--out", str(out), "--no-imu", "--gyro.prior"]) == 2
    assert "gyro.prior and ransac.rotation_from gyro need the IMU" in capsys.readouterr().err


def test_ctrl_c_leaves_what_came_before(wall: Path, tmp_path: Path) -> None:
    def press_ctrl_c(_: object) -> None:
        steps.append(None)
        if len(steps) == 4:
            raise KeyboardInterrupt

    steps: list[None] = []
    with pytest.raises(KeyboardInterrupt) as caught:
        run_sequence(open_sequence(wall), RunConfig(), tmp_path, on_step=press_ctrl_c)
    assert caught.value.__notes__ == [f"The results of the first 4 frames are in {tmp_path}."]
    assert "After 4 frames: stopped by Ctrl-C." in (tmp_path / "report.html").read_text()
    assert {path.name for path in tmp_path.iterdir()} == FILES


@pytest.fixture(scope="module")
def shorter_path(wall: Path, tmp_path_factory: pytest.TempPathFactory) -> FloatArray:
    """The smoothed path of a run of five frames with a window of three."""
    out = tmp_path_factory.mktemp("shorter")
    words = ["--window.frames", "3", "--max-frames", "5"]
    with figures_undrawn():
        assert main(["run", str(wall), "--out", str(out), *words]) == 0
    return read_tum(out / "trajectory.smoothed.tum")[1]


@pytest.mark.parametrize(
    "place",
    [
        "probevo.output.run_result.RunRecorder.add",
        "probevo.runs.smoothed_path.SmoothedPath.add",
        "probevo.runs.runner._Pictures.add",
        "probevo.tracking.pair_timing.PairTiming.add",
        "probevo.evaluation.ground_height.GroundHeights.add",
        "probevo.output.rows.Rows.add",
    ],
)
def test_ctrl_c_between_a_step_and_its_records_leaves_files_that_agree(
    place: str,
    wall: Path,
    shorter_path: FloatArray,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The odometry is then a frame ahead of some records; the path is that of a shorter run."""
    module, name, method = place.rsplit(".", 2)
    owner = getattr(import_module(module), name)
    add = getattr(owner, method)
    num_calls = {"RunRecorder": 6, "Rows": 33}.get(name, 6)
    calls: list[None] = []

    def interrupted(*args: object, **keywords: object) -> None:
        calls.append(None)
        if len(calls) == num_calls:
            raise KeyboardInterrupt
        add(*args, **keywords)

    monkeypatch.setattr(owner, method, interrupted)
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        run_sequence(open_sequence(wall), {"window": {"frames": 3}}, out)
    monkeypatch.undo()
    assert {path.name for path in out.iterdir()} == FILES
    _, live = read_tum(out / "trajectory.tum")
    _, smoothed = read_tum(out / "trajectory.smoothed.tum")
    assert len(smoothed) == len(live) == len(read_motions(out))
    # Poses that were still in the window may be improved by the frame that is not recorded.
    np.testing.assert_allclose(smoothed[:5], shorter_path[: len(smoothed)], atol=0.02)


def test_a_terminal_shows_frames_per_second(
    wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("FORCE_COLOR", "1")  # what Rich 13 looks at
    monkeypatch.setenv("COLUMNS", "120")
    assert main(["run", str(wall), "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr()
    assert "8/8" in shown.err
    assert "frames/s" in shown.err
    assert shown.out.startswith("8 frames")


def test_stale_results_of_an_earlier_run_go(wall: Path, wall_run: Path, tmp_path: Path) -> None:
    out = shutil.copytree(wall_run, tmp_path / "out")
    recording = shutil.copytree(wall, tmp_path / "wall")
    (recording / "poses.txt").unlink()
    assert main(["run", str(recording), "--out", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == FILES - {"metrics.json"}


@pytest.mark.usefixtures("undrawn")
def test_what_of_the_recording_is_not_used_is_said(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = shutil.copytree(wall, tmp_path / "wall")
    (recording / "times.txt").unlink()
    (recording / "poses.txt").unlink()
    for side in ("left", "right"):
        for k, image in enumerate(sorted((recording / side).iterdir())):
            image.rename(image.with_name(f"{1_600_000_000_000 + 100 * k}.png"))
    (recording / "right" / "1600000000300.png").unlink()
    assert main(["run", str(recording), "--out", str(tmp_path / "out")]) == 0
    assert re.search("probevo: warning: pairs: .*1 left, 0 right", capsys.readouterr().err)


def test_stale_results_go_although_the_bag_fails(
    wall: Path, wall_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise ``eval`` would take the smoothed path of the earlier run for that of this one."""
    out = shutil.copytree(wall_run, tmp_path / "out")
    assert (out / "trajectory.smoothed.tum").exists()

    def failing(*_: Any, **__: Any) -> None:
        raise InputError("o.mcap", "cannot be written.")

    monkeypatch.setattr("probevo.runs.runner.write_odometry_bag", failing)
    words = ["--estimator", "two-frame", "--write", str(tmp_path / "o.mcap")]
    assert main(["run", str(wall), "--out", str(out), *words]) == 2
    assert not list(out.glob("trajectory.smoothed.*"))


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
def test_a_recording_is_not_replaced_by_its_odometry(
    suffix: str, wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rosbags")
    recording = tmp_path / f"drive{suffix}"
    assert main(["convert", str(wall), "--out", str(recording)]) == 0
    before = recording.read_bytes()
    link = tmp_path / f"link{suffix}"
    link.symlink_to(recording)
    for source in (recording, wall):
        for target in (recording, link):
            words = ["--out", str(tmp_path / "out"), "--write", str(target)]
            capsys.readouterr()
            assert main(["run", str(source), *words]) == 2
            message = capsys.readouterr().err
            assert f"--write: {target} exists, and is not the odometry of a run" in message
            assert "Name another file" in message
    assert recording.read_bytes() == before
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("truth", [True, False])
def test_features_unlike_the_training_are_counted_and_warned_of(
    wall: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    truth: bool,
) -> None:
    monkeypatch.setattr("probevo.noise.named.untrained_model", lambda name: Homesick())
    recording = shutil.copytree(wall, tmp_path / "wall")
    out = tmp_path / "out"
    if not truth:
        (recording / "poses.txt").unlink()
    assert main(["run", str(recording), "--out", str(out)]) == 0
    result = read_motions(out / "motions.npz")
    page = (out / "report.html").read_text()
    shown = capsys.readouterr().err
    assert result.num_used is not None
    np.testing.assert_array_equal(result.num_out_of_domain, -(-result.num_used // 3))
    assert result.out_of_domain == pytest.approx(1.0 / 3.0, abs=0.01)
    if truth:
        assert (
            json.loads((out / "metrics.json").read_text())["out_of_domain"] == result.out_of_domain
        )
        assert main(["eval", str(out), "--gt", str(out / "trajectory.kitti.txt")]) == 0
        assert (
            json.loads((out / "metrics.json").read_text())["out_of_domain"] == result.out_of_domain
        )
    for text in (shown, page):
        assert re.search(r"33\.\d* % of the features solved with lie outside", text)
    assert "<dt>Out of its domain</dt><dd>33." in page


@pytest.mark.parametrize("frames", [2, 8])
def test_swapped_images_are_refused(
    tmp_path: Path, frames: int, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_wall(tmp_path / "wall", frames, swapped=True)
    assert main(["run", str(recording), "--out", str(tmp_path / "out")]) == 2
    assert "negative disparity.\n         Are left and right swapped?" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_an_image_on_both_sides_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_wall(tmp_path / "wall", 8)
    shutil.rmtree(recording / "right")
    shutil.copytree(recording / "left", recording / "right")
    assert main(["run", str(recording), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "left and right images are identical in the first 4 frames." in said
    assert "swapped" not in said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("is_interlaced", [False, True])
def test_interlaced_images_are_warned_of(
    is_interlaced: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_strips(tmp_path / "strips", 14)
    if is_interlaced:
        for side in ("left", "right"):
            paths = sorted((recording / side).iterdir())
            images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]
            for path, before, image in zip(paths[3:], images, images[3:], strict=False):
                assert before is not None
                assert image is not None
                image = image.copy()
                image[1::2] = before[1::2]
                write_image(path, image)
    assert main(["run", str(recording), "--out", str(tmp_path / "out")]) == 0
    said = "Rows of the images are of two times"
    assert (said in capsys.readouterr().err) == is_interlaced
    assert read_motions(tmp_path / "out").is_interlaced == is_interlaced
    assert main(["info", str(recording)]) == 0
    assert ("! interlacing" in capsys.readouterr().out) == is_interlaced


@pytest.mark.parametrize("late", [0, 1])
def test_right_images_of_other_frames_are_warned_of(
    late: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_strips(tmp_path / "strips", 18, right_late=late)
    assert main(["run", str(recording), "--out", str(tmp_path / "out")]) == 0
    said = "The right images are one frame late"
    assert (said in capsys.readouterr().err) == bool(late)
    assert (said in (tmp_path / "out" / "report.html").read_text()) == bool(late)
    assert read_motions(tmp_path / "out").right_late_frames == late


def test_sigterm_leaves_what_came_before(wall: Path, tmp_path: Path) -> None:
    steps: list[None] = []

    def kill(_: object) -> None:
        steps.append(None)
        if len(steps) == 4:
            raise KeyboardInterrupt("SIGTERM")  # as the command line does

    with pytest.raises(KeyboardInterrupt):
        run_sequence(open_sequence(wall), RunConfig(), tmp_path, on_step=kill)
    assert "After 4 frames: stopped by SIGTERM." in (tmp_path / "report.html").read_text()


@pytest.mark.parametrize("kind", ["path", "list", "generator"])
def test_what_is_no_recording_is_refused(kind: str, wall: Path, tmp_path: Path) -> None:
    given: Any = {
        "path": str(wall),
        "list": list(open_sequence(wall)),
        "generator": iter(open_sequence(wall)),
    }[kind]
    with pytest.raises(InputError, match=r"^sequence: is (?s:.*)such as open_sequence\(path\)"):
        run_sequence(given, None, tmp_path)


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), InputError("report.html", "disk full")])
def test_where_not_all_files_can_be_written_older_results_stay(
    stop: BaseException,
    wall: Path,
    wall_run: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def failing(*_: object, **__: object) -> None:
        raise stop

    out = shutil.copytree(wall_run, tmp_path / "out")
    monkeypatch.setattr("probevo.output.report.report.write_report", failing)
    with pytest.raises(type(stop)):
        run_sequence(open_sequence(wall), RunConfig(noise="fixed"), out)
    assert unchanged(out, wall_run)


@pytest.mark.parametrize(("baseline", "text"), [(1.02, None), (1.06, "1.06"), (0.001, "0.001")])
def test_a_baseline_that_contradicts_the_truth_is_warned_of(
    baseline: float,
    text: str | None,
    wall: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    recording = shutil.copytree(wall, tmp_path / "wall")
    right = open_sequence(wall).camera.baseline_m
    replace("calib.yaml", f"baseline_m: {right}", f"baseline_m: {baseline * right}")(recording)
    assert main(["run", str(recording), "--out", str(tmp_path / "out")]) == 0
    warned = capsys.readouterr().err
    if text is not None:
        found = re.search(r"The steps are ([0-9.]+) times as long as the true ones\.", warned)
        assert found is not None
        assert float(found[1]) == pytest.approx(float(text), rel=2e-2)
    assert ("times as long" in warned) is (text is not None)
    page = (tmp_path / "out" / "report.html").read_text()
    assert ("times as long as the true ones" in page) is (text is not None)


def test_where_the_first_frame_fails_older_results_stay(
    wall: Path, wall_run: Path, tmp_path: Path
) -> None:
    out = shutil.copytree(wall_run, tmp_path / "out")
    recording = shutil.copytree(wall, tmp_path / "wall")
    cut("left/000000.png", 0.5)(recording)
    assert main(["run", str(recording), "--out", str(out), "--noise", "fixed"]) == 2
    assert unchanged(out, wall_run)


def unchanged(out: Path, wall_run: Path) -> bool:
    return {path.name: path.read_bytes() for path in out.iterdir()} == {
        path.name: path.read_bytes() for path in wall_run.iterdir()
    }


def test_where_the_model_is_refused_older_results_stay(
    wall: Path, wall_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The model needs an accelerometer, and the recording has none."""
    out = shutil.copytree(wall_run, tmp_path / "out")
    phi = np.random.default_rng(0).normal(size=(50, 2))
    model = NearestNeighbors(5).fit(
        phi, np.ones(50), metric=Metric.fitted(phi, ("acceleration", "vibration"))
    )
    save_model(model, tmp_path / "m.safetensors")
    assert (
        main(["run", str(wall), "--out", str(out), "--noise", str(tmp_path / "m.safetensors")]) == 2
    )
    assert (
        f"{wall}: it has no accelerometer, which the predictor acceleration needs."
        in capsys.readouterr().err
    )
    assert unchanged(out, wall_run)


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        (
            "--gyro.prior --solver.method alignment",
            "gyro.prior needs solver.method reprojection: the alignment takes no prior.",
        ),
        (
            "--ransac.mode off --ransac.rotation-from gyro",
            "ransac.rotation_from gyro is for samples, and ransac.mode off draws none.",
        ),
        (
            "--north.heading-sigma-deg 5",
            "north.heading_sigma_deg is that of north.heading_deg: give both.",
        ),
    ],
)
def test_settings_that_contradict_each_other_are_named(
    flags: str, message: str, wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", str(wall), "--out", str(tmp_path / "out"), *flags.split()]) == 2
    assert capsys.readouterr().err.strip() == f"probevo: flags: {message}"


def test_where_it_stops_after_the_first_frame_older_results_stay(
    wall: Path, wall_run: Path, tmp_path: Path
) -> None:
    out = shutil.copytree(wall_run, tmp_path / "out")
    recording = shutil.copytree(wall, tmp_path / "wall")
    cut("left/000001.png", 0.5)(recording)
    assert main(["run", str(recording), "--out", str(out)]) == 2
    assert unchanged(out, wall_run)


def test_the_config_names_the_recording_from_anywhere(
    wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(wall.parent)
    assert main(["run", wall.name, "--out", str(tmp_path), "--max-frames", "2"]) == 0
    assert read_config(tmp_path / "config.yaml").sequence == wall.resolve()


def test_a_learned_model_is_named_by_its_path_and_may_refuse_the_camera(
    wall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Learned(StudentT):
        def check_camera(self, camera: StereoCamera) -> None:
            if self.dof == 3.0:
                raise InputError("city.safetensors", "was learned with another camera.")

    monkeypatch.setattr(
        "probevo.noise.named.load_model", lambda path: Learned(dof=float(path.read_text()))
    )
    monkeypatch.chdir(tmp_path)
    Path("city.safetensors").write_text("5.0")
    words = ["run", str(wall), "--out", "out", "--noise", "city.safetensors", "--max-frames", "3"]
    assert main(words) == 0
    assert read_config(Path("out/config.yaml")).noise == str(tmp_path / "city.safetensors")
    Path("city.safetensors").write_text("3.0")
    assert main([*words, "--out", "refused"]) == 2
    refusal = capsys.readouterr().err
    assert "was learned with another camera." in refusal
    assert "--any-camera" in refusal
    assert not Path("refused").exists()
    assert main([*words, "--out", "taken", "--any-camera"]) == 0
    assert "Of the noise model: was learned with another camera." in capsys.readouterr().err
    assert "was learned with another camera." in Path("taken/report.html").read_text()


def test_a_single_frame(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording = write_wall(tmp_path / "wall", 1)
    assert main(["run", str(recording), "--out", str(tmp_path / "out")]) == 0
    assert capsys.readouterr().out.startswith("1 frame, and so no motion\nresults: ")


def test_truth_out_of_bounds_is_refused(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = shutil.copytree(wall, tmp_path / "wall")
    poses = ["1 0 0 0 0 1 0 0 0 0 1 0", *["1 0 0 1e300 0 1 0 0 0 0 1 0"] * 7]
    (recording / "poses.txt").write_text("\n".join(poses))
    assert main(["run", str(recording), "--out", str(tmp_path / "out")]) == 2
    assert "true position is over 1e+09 m" in capsys.readouterr().err


def test_results_do_not_go_into_the_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = write_folder_sequence(tmp_path / "mine")
    before = sorted(recording.rglob("*"))
    assert main(["run", str(recording), "--out", str(tmp_path / "mine" / ".." / "mine")]) == 2
    assert "--out: is the folder of the recording itself" in capsys.readouterr().err
    assert sorted(recording.rglob("*")) == before


def test_results_do_not_go_into_another_recording(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = write_folder_sequence(tmp_path / "other")
    before = sorted(other.rglob("*"))
    assert main(["run", str(wall), "--out", str(other)]) == 2
    assert f"--out: {other} is a recording, by its format folder" in capsys.readouterr().err
    assert sorted(other.rglob("*")) == before


def test_a_baseline_in_millimetres_is_warned_of(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = shutil.copytree(wall, tmp_path / "wall")
    text = (recording / "calib.yaml").read_text()
    found = re.search(r"baseline_m: ([0-9.]+)", text)
    assert found is not None
    in_mm = f"baseline_m: {1000.0 * float(found[1])}"
    (recording / "calib.yaml").write_text(text.replace(found[0], in_mm))
    main(["run", str(recording), "--out", str(tmp_path / "out")])
    warned = capsys.readouterr().err
    assert re.search(r"warning: baseline: [0-9.]+ m is unusual. Is it in metres\?", warned)


@pytest.mark.parametrize("rows", [0, 5])
def test_a_pair_that_is_not_rectified_is_warned_of(
    rows: int, wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = shutil.copytree(wall, tmp_path / "wall")
    for path in (recording / "right").iterdir():
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        write_image(path, np.roll(image, rows, axis=0))
    main(["run", str(recording), "--out", str(tmp_path / "out")])
    warned = capsys.readouterr().err
    assert ("stereo matches look alike in other rows" in warned) == (rows > 0)


def test_frames_without_texture_or_features_end_well_but_are_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Random images have no tracks, and a tracks file has no images."""
    noise = write_folder_sequence(tmp_path / "noise")
    tracks = write_tracks(tmp_path)
    for path in (noise, tracks):
        assert main(["run", str(path), "--out", str(tmp_path / "out")]) == 0
        cov = read_motions(tmp_path / "out" / "motions.npz").cov
        assert np.isfinite(cov).all()
        page = (tmp_path / "out" / "report.html").read_text()
        said = capsys.readouterr().err
        for text in (page, said):
            assert "Only 0 of 3 steps are OK" in text
            assert "see `probevo info SEQUENCE`." in text


def test_strict_refuses_a_run_that_is_hardly_ok_but_keeps_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    noise = write_folder_sequence(tmp_path / "noise")
    words = ["run", str(noise), "--out", str(tmp_path / "out"), "--strict"]
    assert main(words) == 2
    assert "less than half of the steps are OK, which --strict refuses" in capsys.readouterr().err
    assert len(read_motions(tmp_path / "out" / "motions.npz")) == 4


def test_strict_accepts_a_run_that_is_ok(wall: Path, tmp_path: Path) -> None:
    words = ["--max-frames", "3", "--strict"]
    assert main(["run", str(wall), "--out", str(tmp_path / "out"), *words]) == 0


@pytest.mark.parametrize(
    ("words", "fragments"),
    [
        (["nowhere", "--out", "OUT"], ["nowhere: nothing is there."]),
        (["--out", "OUT"], ["SEQUENCE: no recording is named."]),
        (["WALL", "--out", "WALL/calib.yaml"], ["--out: ", "calib.yaml is a file."]),
        (["WALL", "--out", "OUT", "--format", "euroc"], ["sensor.yaml", "missing"]),
        (["WALL", "--out", "OUT", "--threads", "0"], ["--threads", "at least 1"]),
        (
            ["WALL", "--out", "OUT", "--tracking.num-features", "3"],
            ["--tracking.num-features is 3;", "equal to 8"],
        ),
        (["WALL", "--out", "OUT", "--gyro.prior"], ["--gyro.prior: the recording", "has no IMU."]),
        (
            ["WALL", "--out", "OUT", "--ransac.rotation-from", "gyro"],
            ["--ransac.rotation-from gyro: ", "no IMU."],
        ),
        (["WALL", "--out", "OUT", "--max-frames", "1"], ["--max-frames is 1;", "equal to 2"]),
        (
            ["WALL", "--out", "OUT", "--noise", "student"],
            ["noise: 'student' is not a known", "Did you mean student-t?"],
        ),
    ],
)
def test_mistakes_exit_with_2_and_name_the_fault(
    words: list[str],
    fragments: list[str],
    wall: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = [
        word.replace("WALL", str(wall)).replace("OUT", str(tmp_path / "out")) for word in words
    ]
    assert main(["run", *words]) == 2
    shown = capsys.readouterr().err
    assert shown.startswith("probevo: ")
    for fragment in fragments:
        assert fragment in shown


@pytest.mark.parametrize(
    "words", [["WALL"], ["WALL", "--out"], ["WALL", "--out", "x", "--tracking.num-feature", "9"]]
)
def test_flags_that_cannot_be_read_exit_with_2(words: list[str], wall: Path) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["run", *(word.replace("WALL", str(wall)) for word in words)])
    assert caught.value.code == 2


def test_the_window_writes_the_smoothed_path_too(wall: Path, tmp_path: Path) -> None:
    """Its newest pose is the live one; a run of two frames leaves no smoothed path of another."""
    out = tmp_path / "out"
    words = ["run", str(wall), "--out", str(out), "--window.frames", "4"]
    assert main(words) == 0
    _, live = read_tum(out / "trajectory.tum")
    _, smoothed = read_tum(out / "trajectory.smoothed.tum")
    np.testing.assert_allclose(smoothed[-1], live[-1], atol=1e-9)
    assert np.abs(smoothed[2:-4] - live[2:-4]).max() > 0.0
    # Later frames make a pose more certain, and the newest one has none.
    result = read_motions(out)
    assert result.smoothed_cov is not None
    live_cov = result.drift_covariances_from(0)
    assert len(result.smoothed_cov) == len(smoothed)
    np.testing.assert_allclose(result.smoothed_cov[-1], live_cov[-1], rtol=1e-6, atol=1e-15)
    assert np.trace(result.smoothed_cov[3]) < np.trace(live_cov[3])
    np.testing.assert_allclose(
        read_kitti_poses(out / "trajectory.smoothed.kitti.txt"), smoothed, atol=1e-9
    )
    assert json.loads((out / "metrics.json").read_text())["smoothed"]["armse_m"] >= 0.0
    assert main([*words[:4], "--estimator", "two-frame", "--max-frames", "2"]) == 0
    assert not (out / "trajectory.smoothed.tum").exists()
    assert read_motions(out).smoothed_cov is None
