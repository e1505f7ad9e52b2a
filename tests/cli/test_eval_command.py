"""``probevo eval``: the same figures as the run's own, and how poses find their frames."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from cli.rendering import true_poses
from probevo.cli.main import main
from probevo.geometry import se3
from probevo.measurements import PosePrior
from probevo.measurements.variables import pose_of
from probevo.output.motions_file import read_motions
from probevo.runs.runner import run_sequence
from probevo.sequences import Frame, open_sequence
from probevo.sequences.pose_files import read_tum, write_kitti_poses, write_tum
from probevo.sequences.poses import interpolate_poses


def eval_exit(*words: object) -> int:
    return main(["eval", *map(str, words)])


@pytest.mark.parametrize("form", ["kitti", "tum"])
def test_a_run_evaluates_to_its_own_metrics(form: str, wall_run: Path, tmp_path: Path) -> None:
    run = shutil.copytree(wall_run, tmp_path / "run")
    (run / "metrics.json").unlink()
    if form == "kitti":
        write_kitti_poses(tmp_path / "gt.txt", true_poses(8))
    else:
        write_tum(tmp_path / "gt.txt", read_tum(run / "trajectory.tum")[0], true_poses(8))
    assert eval_exit(run, "--gt", tmp_path / "gt.txt") == 0
    ours, theirs = (json.loads((folder / "metrics.json").read_text()) for folder in (run, wall_run))
    for nested in ("nees_coverage", "faults"):
        assert ours.pop(nested) == theirs.pop(nested)
    assert ours["smoothed"]["armse_m"] < 0.01
    assert ours.pop("smoothed") == pytest.approx(theirs.pop("smoothed"), abs=1e-6)
    assert ours == pytest.approx(theirs, abs=1e-6)


def gps(_: Frame, frame: Frame) -> list[PosePrior]:
    """Measure the true pose; a frame beyond the fourth is measured 5 m too far ahead."""
    T_world_cam = true_poses(8)[frame.index]
    if frame.index > 4:
        T_world_cam = T_world_cam @ se3.exp(np.array([0.0, 0.0, 5.0, 0.0, 0.0, 0.0]))
    cov = np.diag([1e-6] * 3 + [1e-8] * 3)
    return [PosePrior(pose_of(frame.index), se3.inverse(T_world_cam), cov)]


def test_a_run_that_sensors_corrected_evaluates_to_its_own_metrics(
    wall: Path, tmp_path: Path
) -> None:
    """The motions alone do not tell its path, and not what became of the sensor."""
    out = tmp_path / "run"
    run = run_sequence(open_sequence(wall), {"estimator": "two-frame"}, out, sensors=[gps])
    back = read_motions(out)
    assert back.sensors == run.result.sensors
    np.testing.assert_array_equal(back.T_world_cam, run.result.T_world_cam)
    assert np.abs(back.T_world_cam - se3.chain_motions(back.T_curr_prev)).max() > 1e-5
    # The covariances are those of the corrected poses, as certain as GPS until it is excluded, and
    # not of the motions.
    covariances = back.drift_covariances_from(0)
    np.testing.assert_array_equal(covariances, run.result.drift_covariances_from(0))
    sigma_m = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2)[:, :3].max(axis=1))
    of_motions_m = np.sqrt(np.diagonal(back.cov, axis1=1, axis2=2)[:, :3].max(axis=1))
    assert (sigma_m[1:5] < 1.01e-3).all()
    assert (of_motions_m[:4] > 1.01e-3).all()
    assert (sigma_m[6:] > 1.01e-3).all()
    before = json.loads((out / "metrics.json").read_text())
    write_kitti_poses(tmp_path / "gt.txt", true_poses(8))
    assert eval_exit(out, "--gt", tmp_path / "gt.txt") == 0
    after = json.loads((out / "metrics.json").read_text())
    for nested in ("nees_coverage", "faults"):
        assert after.pop(nested) == before.pop(nested)
    assert after == pytest.approx(before, abs=1e-9)


@pytest.mark.parametrize("name", ["trajectory.tum", "trajectory.kitti.txt"])
def test_a_trajectory_against_itself_has_no_error(
    name: str, wall_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = shutil.copy(wall_run / name, tmp_path)
    assert eval_exit(path, "--gt", wall_run / "trajectory.kitti.txt") == 0
    assert "End error" in capsys.readouterr().out
    assert {entry.name for entry in tmp_path.iterdir()} == {name}


def test_poses_beyond_the_run_are_left_out_and_that_is_said(
    wall_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = shutil.copytree(wall_run, tmp_path / "run")
    write_kitti_poses(tmp_path / "gt.txt", true_poses(12))
    assert eval_exit(run, "--gt", tmp_path / "gt.txt") == 0
    assert "first 8 of 12 true poses" in capsys.readouterr().out


def test_poses_of_missing_frames_are_not_taken_for_those_behind_them(
    wall_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Eight frames, of which the last four come 0.4 s late: 12 true poses."""
    run = shutil.copytree(wall_run, tmp_path / "run")
    with np.load(run / "motions.npz") as file:
        arrays = dict(file)
    arrays["stamps_ns"][4:] += 4 * (arrays["stamps_ns"][1] - arrays["stamps_ns"][0])
    np.savez(run / "motions.npz", **arrays)
    before = (run / "metrics.json").read_bytes()
    write_kitti_poses(tmp_path / "gt.txt", true_poses(12))
    assert eval_exit(run, "--gt", tmp_path / "gt.txt") == 2
    message = capsys.readouterr().err
    assert "12 poses for the 8 frames" in message
    assert "of which 4 are missing by the times" in message
    assert (run / "metrics.json").read_bytes() == before
    write_kitti_poses(tmp_path / "gt.txt", true_poses(8))
    assert eval_exit(run, "--gt", tmp_path / "gt.txt") == 0


def test_tum_poses_are_matched_by_time(
    wall_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """True poses of another rate, between the frames, over the first five of them: nothing is off
    but the rounding."""
    run = shutil.copytree(wall_run, tmp_path / "run")
    stamps_ns, T_world_cam = read_tum(run / "trajectory.tum")
    others_ns = stamps_ns[0] + 13_000_000 * np.arange(31)
    write_tum(tmp_path / "gt.tum", others_ns, interpolate_poses(stamps_ns, T_world_cam, others_ns))
    assert eval_exit(run, "--gt", tmp_path / "gt.tum") == 0
    assert "4 of 8 frames have no true pose" in capsys.readouterr().out
    metrics = json.loads((run / "metrics.json").read_text())
    assert metrics["num_frames"] == 4
    assert metrics["armse_m"] < 1e-3


@pytest.fixture(scope="module")
def bad_poses(wall_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of pose files with mistakes, for a run of eight frames."""
    folder = tmp_path_factory.mktemp("poses")
    stamps_ns, T_world_cam = read_tum(wall_run / "trajectory.tum")
    known_once = np.where(np.arange(8)[:, None, None] > 0, np.nan, true_poses(8))
    csv_lines = "#time(ns),px,py,pz,qw,qx,qy,qz\n1403715273262142976,0,0,0,1,0,0,0\n"
    write_kitti_poses(folder / "short.txt", true_poses(5))
    write_tum(folder / "late.tum", stamps_ns + 10**12, T_world_cam)
    write_tum(folder / "long.tum", np.arange(20) * 10**8, true_poses(20))
    write_kitti_poses(folder / "unknown.txt", known_once)
    (folder / "text.txt").write_text("three words here\n")
    (folder / "data.csv").write_text(csv_lines)
    (folder / "far.txt").write_text("1 0 0 1e300 0 1 0 0 0 0 1 0\n" * 8)
    (folder / "empty").mkdir()
    return folder


@pytest.mark.parametrize(
    ("run", "gt", "fragments"),
    [
        ("RUN", "short.txt", ["short.txt: 5 poses for the 8 frames", "motions.npz"]),
        ("RUN", "late.tum", ["late.tum: 0 of 8 frames have a true pose", "same clock"]),
        ("RUN", "unknown.txt", ["unknown.txt: 1 of 8 frames have a true pose; two are needed"]),
        ("BAD/unknown.txt", "short.txt", ["unknown.txt: pose 1 (from 0) is not known"]),
        (
            "RUN/trajectory.kitti.txt",
            "long.tum",
            ["long.tum: 20 poses for the 8 frames", "trajectory.tum"],
        ),
        (
            "RUN",
            "text.txt",
            ["text.txt:1: this line has 3 columns", "12 columns in the KITTI format"],
        ),
        ("RUN", "data.csv", ["data.csv:2: ", "commas", "EuRoC's own truth is of the body"]),
        ("RUN", "far.txt", ["far.txt: the position of pose 0 (from 0) is over 1e+09 m away"]),
        ("RUN", "none.txt", ["none.txt: this file is missing"]),
        ("RUN", "empty", ["empty: is a folder", "Give a file of poses"]),
        ("BAD/empty", "short.txt", ["empty/motions.npz: this file is missing"]),
    ],
)
def test_mistakes_exit_with_2(
    run: str,
    gt: str,
    fragments: list[str],
    wall_run: Path,
    bad_poses: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = run.replace("RUN", str(wall_run)).replace("BAD", str(bad_poses))
    assert eval_exit(run, "--gt", bad_poses / gt) == 2
    shown = capsys.readouterr().err
    for fragment in fragments:
        assert fragment in shown


def test_an_unknown_format_is_refused_with_the_known_ones(
    wall_run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        eval_exit(wall_run, "--gt", "gt.txt", "--gt-format", "euroc")
    assert caught.value.code == 2
    shown = capsys.readouterr().err
    assert "kitti" in shown
    assert "None" not in shown


def test_steps_of_another_length_than_the_true_ones_are_warned_of(
    wall_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = shutil.copytree(wall_run, tmp_path / "run")
    truth = true_poses(8)
    truth[:, :3, 3] *= 0.5
    write_kitti_poses(tmp_path / "gt.txt", truth)
    assert eval_exit(run, "--gt", tmp_path / "gt.txt") == 0
    assert "times as long as the true ones" in capsys.readouterr().err
