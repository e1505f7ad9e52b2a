"""The file for the Rerun viewer, read back by its own reader."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cli.rendering import write_wall
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.output.run_result import RunResult
from probevo.output.viewer_file import write_viewer_file
from probevo.runs.runner import run_sequence
from probevo.sequences import open_sequence
from sequences.recordings import write_folder_sequence

ENTITIES = {
    "/world",
    "/world/estimate",
    "/world/truth",
    "/world/camera",
    "/world/camera_3_sigma",
    "/step/sigma_translation_m",
    "/step/sigma_rotation_deg",
    "/step/tracks",
    "/step/inliers",
    "/status",
}


OF_FRAMES = {
    "/world/camera/image",
    "/world/camera/image/features",
    "/world/camera/landmarks",
}
"""What each frame shows; only while a run goes on."""
FRAMES = 5


def rows(path: Path) -> dict[str, int]:
    """The number of rows of each entity of a file, by the SDK's reader."""
    pytest.importorskip("rerun")
    from rerun.chunk import RrdReader

    found: dict[str, int] = {}
    for chunk in RrdReader(path).stream():
        if not chunk.entity_path.startswith("/__"):
            found[chunk.entity_path] = found.get(chunk.entity_path, 0) + chunk.num_rows
    return found


def timelines(path: Path) -> set[str]:
    """The timelines of a file."""
    from rerun.chunk import RrdReader

    return {name for chunk in RrdReader(path).stream() for name in chunk.timeline_names}


def test_a_run_writes_what_its_frames_show(tmp_path: Path) -> None:
    """Image, features and landmarks of each frame, beside the path; with a window, it smoothed."""
    pytest.importorskip("rerun")
    wall = open_sequence(write_wall(tmp_path / "wall", FRAMES))
    path = tmp_path / "run.rrd"
    run_sequence(wall, {"viewer": path, "estimator": "window"}, tmp_path / "out")
    found = rows(path)
    assert set(found) == (ENTITIES | OF_FRAMES | {"/world/smoothed"}) - {"/status"}
    assert found["/world/camera/image/features"] == FRAMES
    assert found["/world/camera/landmarks"] == FRAMES
    assert found["/world/camera/image"] >= FRAMES
    assert found["/world/camera"] == FRAMES
    assert {"frame", "time"} <= timelines(path)


def listed(counts: dict[str, int]) -> dict[str, int]:
    """The entities and rows that docs/recordings.md lists, given the numbers behind its words."""
    page = Path(__file__).parents[2] / "docs" / "recordings.md"
    table = re.search(r"^\| entity \| what \| rows \|\n(.*?)\n\n", page.read_text(), re.M | re.S)
    assert table is not None
    rows = {}
    for line in table[1].splitlines()[1:]:
        entities, _, words = line.strip("| ").split(" | ")
        factor, _, what = words.rpartition(" × ")
        for entity in re.findall("`([^`]+)`", entities):
            rows[f"/{entity}"] = int(factor or 1) * counts[what]
    return rows


def test_a_file_has_the_entities_and_rows_that_the_docs_list(tmp_path: Path) -> None:
    """Of a recording with an IMU and truth, in whose images there is nothing to follow."""
    pytest.importorskip("rerun")
    recording = open_sequence(write_folder_sequence(tmp_path / "recording"))
    path = tmp_path / "run.rrd"
    run = run_sequence(recording, {"viewer": path, "estimator": "window"}, tmp_path / "out")
    num_bad = int(np.sum(run.result.status != Status.OK))
    num_frames = len(recording)
    words = {"1": 1, "frames": num_frames, "steps": num_frames - 1, "such steps": num_bad}
    assert num_bad > 0
    assert rows(path) == listed(words)
    assert timelines(path) == {"frame", "time", "log_time"}


def test_a_finished_run_is_shown_with_its_frames_while_the_recording_is_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same entities and rows as of the run itself; without the recording, those of the path."""
    pytest.importorskip("rerun")
    wall = open_sequence(write_wall(tmp_path / "wall", FRAMES))
    now = tmp_path / "now.rrd"
    config = {"viewer": now, "estimator": "window", "max_frames": FRAMES - 1}
    run_sequence(wall, config, tmp_path / "out")
    words = ["convert", str(tmp_path / "out"), "--out"]
    assert main([*words, str(tmp_path / "later.rrd")]) == 0
    assert "changed" not in capsys.readouterr().out
    assert rows(tmp_path / "later.rrd") == rows(now)

    # Another image in its place is noticed, fewer are refused.
    for side in ("left", "right"):
        shutil.copy(wall.path / side / "000003.png", wall.path / side / "000001.png")
    assert main([*words, str(tmp_path / "other.rrd")]) == 0
    assert "features are not exactly those" in capsys.readouterr().out
    shutil.rmtree(wall.path)
    write_wall(wall.path, 2)
    assert main([*words, str(tmp_path / "fewer.rrd")]) == 2
    assert "only 2" in capsys.readouterr().err
    assert not (tmp_path / "fewer.rrd").exists()

    shutil.rmtree(wall.path)
    assert main([*words, str(tmp_path / "without.rrd")]) == 0
    assert "without images and features" in capsys.readouterr().out
    expected = set(rows(now)) - OF_FRAMES - {"/world/truth"}
    assert set(rows(tmp_path / "without.rrd")) == expected


@pytest.mark.usefixtures("undrawn")
def test_without_a_file_a_window_is_opened_where_there_is_a_display(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What the window would be sent goes to a file here."""
    rerun = pytest.importorskip("rerun")
    wall = write_wall(tmp_path / "wall", FRAMES)
    words = ["run", str(wall), "--viewer", "--out", str(tmp_path / "out")]
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert main(words) == 2
    assert "--viewer: there is no display" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()

    monkeypatch.setenv("DISPLAY", ":0")
    shown = tmp_path / "shown.rrd"
    monkeypatch.setattr(rerun.RecordingStream, "spawn", lambda stream: stream.save(shown))
    assert main(words) == 0
    assert rows(shown)["/world/camera/image/features"] == FRAMES
    assert "viewer: window" in (tmp_path / "out" / "config.yaml").read_text()

    def fail(stream: object) -> None:
        raise RuntimeError("no executable")

    monkeypatch.setattr(rerun.RecordingStream, "spawn", fail)
    assert main(words) == 2
    assert "the viewer does not start: no executable" in capsys.readouterr().err


def test_the_imu_is_shown(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    recording = open_sequence(write_folder_sequence(tmp_path / "recording"))
    path = tmp_path / "run.rrd"
    run_sequence(recording, {"viewer": path}, tmp_path / "out")
    found = rows(path)
    assert found["/imu/gyro_rad_s"] == found["/imu/accel_m_s2"] == len(recording) - 1


def test_a_run_that_is_stopped_has_a_file_of_its_frames_so_far(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    wall = open_sequence(write_wall(tmp_path / "wall", FRAMES))
    path = tmp_path / "run.rrd"
    seen = []

    def stop(motion: MotionEstimate) -> None:
        seen.append(motion)
        if len(seen) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_sequence(wall, {"viewer": path}, tmp_path / "out", stop)
    assert rows(path)["/world/camera"] == 3


def test_a_run_without_any_result_leaves_no_file(tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    wall = open_sequence(write_wall(tmp_path / "wall", FRAMES))

    def stop(motion: MotionEstimate) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_sequence(wall, {"viewer": tmp_path / "run.rrd"}, tmp_path / "out", stop)
    assert [path.name for path in tmp_path.iterdir()] == ["wall"]


def test_every_entity_is_read_back(tmp_path: Path, make_run: Callable[..., RunResult]) -> None:
    pytest.importorskip("rerun")
    run = make_run(45)
    path = tmp_path / "run.rrd"
    write_viewer_file(path, run, run.T_world_cam)
    assert [each.name for each in tmp_path.iterdir()] == ["run.rrd"]
    found = rows(path)
    assert set(found) == ENTITIES
    assert found["/world/camera"] == found["/world/camera_3_sigma"] == 45
    assert found["/step/tracks"] == 44
    assert found["/status"] == 1  # the gap
    assert found["/world/estimate"] == found["/world/truth"] == 1


def test_without_the_extra_the_message_says_what_to_install(
    tmp_path: Path, make_run: Callable[..., RunResult], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(InputError, match=r"pip install 'probevo\[viewer\]'"):
        write_viewer_file(tmp_path / "run.rrd", make_run(3))
    with pytest.raises(InputError, match=r"does not end in \.rrd"):
        write_viewer_file(tmp_path / "run.txt", make_run(3))
