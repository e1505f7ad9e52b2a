"""probevo convert: what is converted runs to the same bytes; runs become bags of odometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from cli.rendering import write_wall
from probevo.cli.main import main
from probevo.sequences import open_sequence
from probevo.storage.lock import LOCK
from sequences.recordings import T_CAM_IMU, write_folder_sequence, write_kitti_raw

TARGETS = ("recording.bag", "recording.mcap", "recording.db3", "recording")


def trajectory(recording: Path, out: Path, *more: str) -> bytes:
    assert main(["run", str(recording), "--out", str(out), *more]) == 0
    return (out / "trajectory.tum").read_bytes()


@pytest.mark.parametrize("target", TARGETS)
def test_a_converted_recording_holds_the_same(target: str, tmp_path: Path) -> None:
    """Images, stamps, camera and IMU to the last bit, poses to rounding."""
    original = open_sequence(write_folder_sequence(tmp_path / "original"))
    assert main(["convert", str(original.path), "--out", str(tmp_path / target)]) == 0
    converted = open_sequence(tmp_path / target)
    assert converted.camera == original.camera
    assert converted.imu is not None
    assert converted.truth is not None
    assert original.truth is not None
    np.testing.assert_allclose(converted.imu.T_cam_imu, T_CAM_IMU, atol=1e-12)
    np.testing.assert_allclose(converted.truth.T_world_cam, original.truth.T_world_cam, atol=1e-12)
    for mine, theirs in zip(converted, original, strict=True):
        assert mine.stamp_ns == theirs.stamp_ns
        np.testing.assert_array_equal(mine.left, theirs.left)
        np.testing.assert_array_equal(mine.right, theirs.right)
        assert (mine.imu is None) == (theirs.imu is None)
        if mine.imu is not None and theirs.imu is not None:
            np.testing.assert_array_equal(mine.imu.gyro_rad_s, theirs.imu.gyro_rad_s)
            np.testing.assert_array_equal(mine.imu.accel_m_s2, theirs.imu.accel_m_s2)


def test_a_bag_becomes_a_folder_again(tmp_path: Path) -> None:
    wall = write_wall(tmp_path / "wall", 4)
    assert main(["convert", str(wall), "--out", str(tmp_path / "a.db3"), "--compressed"]) == 0
    assert main(["convert", str(tmp_path / "a.db3"), "--out", str(tmp_path / "b")]) == 0
    expected = trajectory(wall, tmp_path / "of_wall")
    assert trajectory(tmp_path / "b", tmp_path / "of_b") == expected


def test_kitti_raw_with_its_imu_becomes_a_folder(tmp_path: Path) -> None:
    drive = write_kitti_raw(tmp_path / "raw")
    assert main(["convert", str(drive), "--out", str(tmp_path / "folder")]) == 0
    assert open_sequence(tmp_path / "folder").imu is not None


def test_a_folder_keeps_the_readout_of_its_shutter_and_a_bag_says_that_it_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    original = write_folder_sequence(tmp_path / "original", imu=False)
    with (original / "calib.yaml").open("a") as file:
        file.write("readout_s: 0.025\n")
    assert main(["convert", str(original), "--out", str(tmp_path / "folder")]) == 0
    assert open_sequence(tmp_path / "folder").camera.readout_s == 0.025
    assert "readout" not in capsys.readouterr().out
    assert main(["convert", str(original), "--out", str(tmp_path / "a.mcap")]) == 0
    assert "The readout time of the shutter has no place in a bag" in capsys.readouterr().out


@pytest.mark.data
@pytest.mark.slow
def test_kitti_runs_to_the_same_bytes_in_each_format(data_root: Path, tmp_path: Path) -> None:
    kitti = data_root / "kitti_odometry" / "sequences" / "06"
    expected = trajectory(kitti, tmp_path / "of_png", "--max-frames", "6")
    for target in (*TARGETS, "packed.mcap"):
        more = ["--compressed"] if target.startswith("packed") else []
        words = ["convert", str(kitti), "--out", str(tmp_path / target), "--max-frames", "6"]
        assert main([*words, *more]) == 0
        assert trajectory(tmp_path / target, tmp_path / f"of_{target}") == expected, target


def test_run_and_convert_write_the_same_odometry(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--write of a run, and convert of its folder; the second has no CameraInfo."""
    from output.ros.test_odometry_bag import read

    wall = write_wall(tmp_path / "wall", 4)
    now = tmp_path / "now.mcap"
    later = tmp_path / "later.mcap"
    frames = ["--ros.odom-frame", "map"]
    words = ["run", str(wall), "--out", str(tmp_path / "out"), "--write", str(now)]
    assert main([*words, *frames]) == 0
    assert f"odometry: {now}\n" in capsys.readouterr().out
    assert main(["convert", str(tmp_path / "out"), "--out", str(later), *frames]) == 0
    one = read(now)["/odometry"]
    other = read(later)["/odometry"]
    assert len(one) == len(other) == 4
    for mine, theirs in zip(one, other, strict=True):
        assert mine.header.frame_id == "map"
        np.testing.assert_array_equal(mine.pose.covariance, theirs.pose.covariance)
        np.testing.assert_array_equal(mine.twist.covariance, theirs.twist.covariance)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--out", "full"], "is not empty"),
        (["--out", "new", "--compressed"], "is not a bag"),
        (["--out", "x.bag", "--max-frames", "0"], "at least 1"),
        (["--out", "x.bag", "--ros.T-base-cam", *["0"] * 16], "rigid transform"),
    ],
)
def test_refusals(
    more: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    source = write_folder_sequence(tmp_path / "source", imu=False)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("x")
    monkeypatch.chdir(tmp_path)
    assert main(["convert", str(source), *more]) == 2
    assert message in capsys.readouterr().err
    assert sorted(each.name for each in tmp_path.iterdir()) == ["full", "source"]


def test_flags_that_open_a_recording_are_refused_for_a_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wall = write_wall(tmp_path / "wall", 4)
    trajectory(wall, tmp_path / "run")
    words = ["convert", str(tmp_path / "run"), "--out", str(tmp_path / "run.mcap")]
    assert main([*words, "--calibration", str(wall / "calib.yaml")]) == 2
    assert "--calibration: is for a recording" in capsys.readouterr().err
    assert main([*words, "--topics.left", "/left"]) == 2
    assert "--topics: is for a recording" in capsys.readouterr().err
    assert main(words) == 0


def test_a_file_that_exists_is_never_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Not even the source itself, of which --max-frames would keep a part."""
    source = write_folder_sequence(tmp_path / "source", imu=False)
    bag = tmp_path / "drive.mcap"
    assert main(["convert", str(source), "--out", str(bag)]) == 0
    before = bag.read_bytes()
    assert main(["convert", str(bag), "--out", str(bag), "--max-frames", "2"]) == 2
    assert "drive.mcap exists" in capsys.readouterr().err
    assert bag.read_bytes() == before


def test_what_a_kill_has_left_beside_a_whole_file_goes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The next call refuses to replace the file, and leaves nothing else."""
    source = write_folder_sequence(tmp_path / "source", imu=False)
    words = ["convert", str(source), "--out", str(tmp_path / "drive.mcap")]
    assert main(words) == 0
    left = tmp_path / "drive.mcap.work"
    left.mkdir()
    (left / LOCK).write_text("process 1")
    assert main(words) == 2
    assert "drive.mcap exists" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["drive.mcap", "source"]


def test_a_folder_is_there_when_it_is_complete(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What stops it leaves nothing; what a kill leaves is gone after the next call."""
    source = write_folder_sequence(tmp_path / "source")
    out = tmp_path / "out"
    words = ["convert", str(source), "--out", str(out)]

    def stop(*_: object, **__: object) -> None:
        assert list((tmp_path / "out.work" / "recording" / "left").iterdir())
        assert not out.exists()
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("probevo.output.recording_folder.write_kitti_poses", stop)
        assert main(words) == 130
    assert [path.name for path in tmp_path.iterdir()] == ["source"]
    left = tmp_path / "out.work" / "recording" / "left"
    left.mkdir(parents=True)
    (left / "999999.png").write_bytes(b"")
    assert main(words) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out", "source"]
    assert len(open_sequence(out)) == len(open_sequence(source))


def test_an_ending_of_no_bag_is_refused_before_the_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wall = write_wall(tmp_path / "wall", 3)
    words = ["run", str(wall), "--out", str(tmp_path / "out"), "--write", str(tmp_path / "a.csv")]
    assert main(words) == 2
    assert "--write" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
