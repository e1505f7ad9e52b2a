"""The registry of formats: what is refused, options, and formats of other packages.

That every built-in format is recognised is tested in test_formats.
"""

import shutil
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, Literal

import pytest
from pydantic import Field

from probevo.config.settings import Settings
from probevo.errors import InputError
from probevo.sequences import (
    Sequence,
    SequenceFormat,
    format_names,
    open_sequence,
    register_format,
    registry,
    sequence_formats,
)
from probevo.sequences.recordings_nearby import MAX_LOOKED_AT
from sequences.damage import assert_refused
from sequences.recordings import (
    write_folder_sequence,
    write_kitti_flow,
    write_kitti_odometry,
    write_tracks,
)


def test_path_that_does_not_exist(tmp_path: Path) -> None:
    assert_refused(tmp_path / "nowhere", ["nowhere", "nothing is there"])


def test_path_whose_name_is_too_long(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nothing is there"):
        open_sequence(tmp_path / ("x" * 300))


def test_path_that_is_some_other_file(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello")
    assert_refused(tmp_path / "notes.txt", ["notes.txt", "not a recording", "an .npz file"])


def test_folder_of_no_known_format_says_what_was_looked_for(tmp_path: Path) -> None:
    (tmp_path / "pictures").mkdir()
    assert_refused(
        tmp_path, ["found pictures", "image_00 (kitti-raw)", "calib.yaml or left (folder)"]
    )


def test_of_a_folder_above_a_recording_the_recording_is_suggested(tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path / "drives" / "monday")
    (tmp_path / "motions.npz").write_bytes(b"")
    for above in (path.parent, tmp_path):
        assert_refused(above, [str(above), "not a recording", f"Did you mean {path}?"])


def test_of_many_recordings_below_the_first_are_named(tmp_path: Path) -> None:
    paths = [write_folder_sequence(tmp_path / f"{k}") for k in range(6)]
    (tmp_path / "run.bag").write_bytes(b"")
    names = ", ".join(map(str, paths[:4]))
    assert_refused(tmp_path, [f"Did you mean one of {names} and 3 more below it?"])


def test_far_below_and_among_thousands_of_files_nothing_is_searched_for(tmp_path: Path) -> None:
    deep = write_folder_sequence(tmp_path / "a" / "b" / "c" / "d")
    assert_refused(tmp_path, ["found a", "image_00 (kitti-raw)"])
    crowded = tmp_path / "a" / "b"
    for k in range(MAX_LOOKED_AT):
        (crowded / f"{k}.txt").touch()
    assert_refused(crowded, ["no known format"])
    assert_refused(deep.parent, [f"Did you mean {deep}?"])


def test_a_folder_of_images_leads_to_the_recording_that_it_is_part_of(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_folder_sequence(tmp_path / "drive")
    with pytest.raises(InputError, match="part of a recording") as refused:
        open_sequence(path / "left")
    assert str(refused.value).endswith(f"Did you mean {path}?")
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError) as refused:
        open_sequence("drive/left")
    assert str(refused.value).endswith("Did you mean drive?")
    monkeypatch.chdir(path / "right")
    with pytest.raises(InputError) as refused:
        open_sequence(".")
    assert str(refused.value).endswith(f"Did you mean {path}?")


def test_an_empty_folder_is_called_empty(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    assert_refused(tmp_path / "empty", ["this folder is empty", "image_00 (kitti-raw)"])


@pytest.mark.parametrize("format", [None, "folder"])
def test_path_may_be_text(format: str | None, tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path)
    assert open_sequence(str(path), format).path == open_sequence(path, format).path == path


@pytest.mark.parametrize("path", [None, 3, b"drive", ["drive"]])
def test_path_of_a_wrong_type(path: Any) -> None:
    with pytest.raises(InputError, match=rf"^path: is a {type(path).__name__}\."):
        open_sequence(path)


@pytest.mark.parametrize("format", [3, ["folder"], Path("folder")])
def test_format_of_a_wrong_type(format: Any, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=rf"^format: is a {type(format).__name__}\."):
        open_sequence(tmp_path, format)


@pytest.mark.parametrize(("format", "what"), [("tracks", "an .npz file"), ("kitty", "kitti-raw")])
def test_format_that_does_not_fit(format: str, what: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=what):
        open_sequence(write_folder_sequence(tmp_path), format)


def test_an_option_of_other_formats_is_refused_with_their_names(tmp_path: Path) -> None:
    path = write_kitti_odometry(tmp_path)
    with pytest.raises(InputError, match="one: euroc, video, folder, rosbag"):
        open_sequence(path, calibration="camchain.yaml")


@pytest.mark.parametrize("format", ["kitti-raw", "kitti-odometry", "euroc", "folder"])
def test_file_where_a_folder_is_needed(format: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"the format {format} needs a folder, but this is a file"):
        open_sequence(write_tracks(tmp_path), format)


def test_named_format_reports_what_it_misses(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"calib_cam_to_cam\.txt: this file is missing"):
        open_sequence(write_folder_sequence(tmp_path / "drive"), "kitti-raw")


class DroneOptions(Settings):
    camera: Literal["front", "down"] = Field("front", description="Stereo camera to read.")
    rate_hz: float = Field(20.0, gt=0, description="Frames a second.")


opened_with: list[dict[str, Any]] = []


def open_drone(path: Path, **options: Any) -> Sequence:
    opened_with.append(options)
    return open_sequence(path / "inner", "folder")


DRONE = SequenceFormat(
    name="drone",
    summary="a made-up format",
    open=open_drone,
    folder_signs=("drone.json",),
    options=DroneOptions,
)
NOT_A_FORMAT = 3


def test_a_folder_with_calibrations_beside_its_images_is_no_kitti_flow(tmp_path: Path) -> None:
    path = write_folder_sequence(tmp_path / "mine")
    (path / "calib").mkdir()
    assert open_sequence(path).format == "folder"
    scene = write_kitti_flow(tmp_path / "training")
    for name in ("flow_occ", "flow_noc"):
        shutil.rmtree(scene / name, ignore_errors=True)
    assert open_sequence(scene).format == "kitti-flow"


def test_endings_in_capitals_are_recognised(tmp_path: Path) -> None:
    """Cameras write them so. Only rosbags insists on small letters, and that is said."""
    tracks = write_tracks(tmp_path)
    assert open_sequence(tracks.rename(tmp_path / "drive.NPZ")).format == "tracks"
    (tmp_path / "a.MP4").write_bytes(b"no video")
    assert_refused(tmp_path / "a.MP4", ["a.MP4", "OpenCV cannot read this as a video"])
    (tmp_path / "drive.MCAP").write_bytes(b"no bag")
    words = ["drive.MCAP", "by its ending", "Rename it: drive.mcap"]
    assert_refused(tmp_path / "drive.MCAP", words)


def test_a_folder_that_must_not_be_looked_into_is_no_recording(tmp_path: Path) -> None:
    """The system's error is not ENOENT; here it is that the name is too long."""
    format = SequenceFormat("long", "a format", open=lambda path: path, folder_signs=("x" * 300,))
    assert not format.recognises(tmp_path)


@pytest.fixture
def drone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A recording in the format ``drone``, which is registered for this test."""
    monkeypatch.setattr(registry, "_registered", dict(registry._registered))
    opened_with.clear()
    register_format(DRONE)
    (tmp_path / "drone.json").touch()
    write_folder_sequence(tmp_path / "inner")
    return tmp_path


@pytest.mark.parametrize("format", [None, "drone"])
def test_registered_format_is_recognised_and_can_be_named(format: str | None, drone: Path) -> None:
    assert "drone" in format_names()
    assert len(open_sequence(drone, format)) == 4


def test_options_reach_the_reader_with_their_defaults(drone: Path) -> None:
    open_sequence(drone)
    open_sequence(drone, camera="down")
    open_sequence(drone, "drone", rate_hz=5)
    assert opened_with == [
        {"camera": "front", "rate_hz": 20.0},
        {"camera": "down", "rate_hz": 20.0},
        {"camera": "front", "rate_hz": 5.0},
    ]


@pytest.mark.parametrize(
    ("options", "fragments"),
    [
        (
            {"colour": "red"},
            ["colour (--colour), for the format drone", "no such", "camera, rate_hz"],
        ),
        (
            {"camera": "up"},
            ["camera (--camera), for the format drone: is 'up'", "Stereo camera to read"],
        ),
        ({"rate_hz": 0.0}, ["rate_hz (--rate-hz)", "is 0.0", "greater than 0", "Frames a second."]),
        ({"rate_hz": float("nan")}, ["rate_hz (--rate-hz)", "nan", "finite"]),
    ],
)
def test_faulty_options_are_named(
    options: dict[str, Any], fragments: list[str], drone: Path
) -> None:
    with pytest.raises(InputError) as caught:
        open_sequence(drone, **options)
    for fragment in fragments:
        assert fragment in str(caught.value)


def test_a_format_without_options_takes_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"for the format kitti-odo(.|\n)*has no option"):
        open_sequence(write_kitti_odometry(tmp_path), camera="front")


def test_an_option_of_the_topics_is_named_as_its_flag(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        open_sequence(write_kitti_odometry(tmp_path), topics_left_info="/left")
    assert "(--topics.left-info), for the format kitti-odometry" in caught.value.where
    assert "rosbag" in caught.value.cure


@pytest.mark.parametrize("name", ["folder", "drone"])
def test_a_name_is_registered_once(name: str, drone: Path) -> None:
    with pytest.raises(InputError, match=f"format {name}: a format of this name is already known"):
        register_format(SequenceFormat(name=name, summary="again", open=open_drone))


def install(monkeypatch: pytest.MonkeyPatch, *entries: tuple[str, str]) -> None:
    """Make it look as if packages with these entry points, (name, value), were installed."""
    points = [EntryPoint(name, value, registry.ENTRY_POINTS) for name, value in entries]
    monkeypatch.setattr(registry, "entry_points", lambda group: points)


def test_format_of_another_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, ("drone", f"{__name__}:DRONE"))
    (tmp_path / "drone.json").touch()
    write_folder_sequence(tmp_path / "inner")
    assert format_names()[-1] == "drone"
    assert sequence_formats()["drone"] is DRONE
    assert len(open_sequence(tmp_path)) == 4


@pytest.mark.parametrize(
    ("entries", "what"),
    [
        ([("drone", "no_such_package:DRONE")], "drone = no_such_package:DRONE .*cannot be loaded"),
        ([("drone", f"{__name__}:CAR")], "drone = .*cannot be loaded .*has no attribute 'CAR'"),
        (
            [("drone", f"{__name__}:NOT_A_FORMAT")],
            "drone = .*it is of type int, not SequenceFormat",
        ),
        ([("car", f"{__name__}:DRONE")], "car = .*its format is called 'drone', not 'car'"),
        ([("euroc", f"{__name__}:DRONE")], "euroc = .*already known"),
        ([("drone", f"{__name__}:DRONE")] * 2, "drone = .*already known"),
    ],
)
def test_faulty_entry_points_are_named(
    entries: list[tuple[str, str]], what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(monkeypatch, *entries)
    with pytest.raises(InputError, match=f"entry point {what}"):
        open_sequence(tmp_path)
