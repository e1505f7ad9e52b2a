"""``probevo calibrate-check``: errors that were put in are marked with their cure, no others."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.cli.calibrate_check import report_lines
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.output.calibration_picture import write_calibration_picture
from probevo.runs.calibration_check import CalibrationCheck, check_calibration
from probevo.sequences.frame import Frame, GroundTruth, StereoFeatures
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration
from sequences.recordings import write_tracks
from worlds import CAMERA, FRAME_NS, START_NS, drive

FRAMES = 48
CALIBRATION = ImuCalibration(se3.exp(np.array([0.1, 0.2, -0.3, 0.3, -1.2, 0.5])), 1e-4, 0.02)


@dataclass(frozen=True)
class World:
    """A recording of features, with an IMU and the truth."""

    frames: list[Frame]
    truth: GroundTruth
    imu: ImuCalibration
    imu_stream: ImuStream
    path: Path = Path("world")
    format: str = "tracks"
    camera: StereoCamera = CAMERA

    @property
    def stamps_ns(self) -> IntArray:
        return np.array([frame.stamp_ns for frame in self.frames])

    def __len__(self) -> int:
        return len(self.frames)

    def __iter__(self) -> Iterator[Frame]:
        return iter(self.frames)


@pytest.fixture(scope="module")
def world() -> World:
    """A car that nods and turns about all axes, its gyro at 100 Hz, and gravity."""
    rng = np.random.default_rng(3)
    time_s = np.arange(-20, 10 * FRAMES + 20) * 0.01
    # Rate of the camera along its own axes at each sample, rad/s.
    rates = np.column_stack(
        [
            0.06 * np.sin(9.0 * time_s),
            0.10 * np.sin(5.0 * time_s + 1.0),
            0.05 * np.sin(7.0 * time_s + 2.0),
        ]
    )
    C_world_cam = [np.eye(3)]
    for before, after in pairwise(rates):
        C_world_cam.append(C_world_cam[-1] @ so3.exp(0.005 * (before + after)))
    at_frames = np.array(C_world_cam)[20 : 20 + 10 * FRAMES : 10]
    C_curr_prev = np.concatenate([np.eye(3)[None], at_frames[1:].mT @ at_frames[:-1]])
    motions = se3.from_parts(C_curr_prev, np.tile([0.0, 0.0, -1.0], (FRAMES, 1)))
    frames = drive(rng, FRAMES, motions)
    gyro = rates @ CALIBRATION.C_cam_imu + [0.01, -0.02, 0.005]
    force = np.tile([0.0, 0.0, 9.81], (len(gyro), 1)) + 0.05 * rng.normal(size=gyro.shape)
    stamps_ns = START_NS + np.round(1e9 * time_s).astype(np.int64)
    frames_ns = START_NS + FRAME_NS * np.arange(FRAMES)
    stream = ImuStream.checked(stamps_ns, gyro, force, frames_ns=frames_ns, where="imu.csv")
    truth = GroundTruth(frames_ns, se3.chain_motions(motions[1:]))
    return World(frames, truth, CALIBRATION, stream)


def changed(world: World, change: Any) -> World:
    """The world with other pixels: ``change`` maps those of a frame, [N, 4], and its index."""
    frames = [
        replace(
            frame, features=StereoFeatures(frame.features.ids, change(frame.features.pixels, k))
        )
        for k, frame in enumerate(world.frames)
        if frame.features is not None
    ]
    return replace(world, frames=frames)


def marked(lines: list[str]) -> set[str]:
    """Names of the quantities that are marked."""
    return {line[2:].split("  ")[0] for line in lines if re.match(r"! .*  ", line)}


def report(recording: World) -> list[str]:
    """Lines that the command prints."""
    return report_lines(recording.path, check_calibration(recording, FRAMES))


def test_a_flawless_recording_has_nothing_marked(world: World) -> None:
    lines = report(world)
    assert marked(lines) == set()
    assert lines[-1] == "Nothing is further from zero than chance would have it."
    text = "\n".join(lines)
    for name in ("rows, all", "right image is late", "disparity, bend", "scale", "gyro, scale"):
        assert name in text
    assert "accelerometer, gravity" in text


def test_rows_and_their_angle(world: World) -> None:
    """A right camera pitched by a milliradian."""
    shift = np.array([0.0, 0.0, 0.0, 1e-3 * CAMERA.fv_px])
    lines = report(changed(world, lambda pixels, k: pixels + shift))
    assert "rows, all" in marked(lines)
    assert any("pitched by +0.057°" in line for line in lines)
    assert any("odometry corrects these errors by itself" in line for line in lines)


def test_a_late_right_image(world: World) -> None:
    """Each point is moved in the right image by how it moves in a frame, a tenth of that."""
    later = {
        frame.index: dict(zip(frame.features.ids.tolist(), frame.features.pixels, strict=True))
        for frame in world.frames
        if frame.features is not None
    }

    def late(pixels: FloatArray, k: int) -> FloatArray:
        moved = pixels.copy()
        features = world.frames[k].features
        assert features is not None
        for row, landmark in enumerate(features.ids.tolist()):
            after = later.get(k + 1, {}).get(landmark)
            if after is not None:
                moved[row, 2:] += 0.1 * (after - pixels[row])[2:]
        return moved

    lines = report(changed(world, late))
    assert "right image is late" in marked(lines)
    (cure,) = [line for line in lines if line.startswith("! right image is late: ")]
    late_ms = re.search(r"exposed ([0-9.]+) ms later", cure)
    assert late_ms is not None
    assert float(late_ms[1]) == pytest.approx(10.0, abs=2.0)


def test_scale(world: World) -> None:
    truth = world.truth.T_world_cam.copy()
    truth[:, :3, 3] *= 0.9
    lines = report(replace(world, truth=GroundTruth(world.stamps_ns, truth)))
    assert marked(lines) == {"scale against the truth"}
    assert any("divide baseline_m by 1.11" in line for line in lines)


def test_the_gyro_is_turned_late_in_degrees_and_its_force_in_g(world: World) -> None:
    stream = world.imu_stream
    late = replace(stream, stamps_ns=stream.stamps_ns + 30_000_000)
    lines = report(replace(world, imu_stream=late))
    assert "IMU's clock is late" in marked(lines)
    assert any("time_offset_s (Kalibr: timeshift_cam_imu) to 0.03" in line for line in lines)

    degrees = replace(
        stream, gyro_rad_s=np.rad2deg(stream.gyro_rad_s), accel_m_s2=stream.accel_m_s2 / 9.81
    )
    lines = report(replace(world, imu_stream=degrees))
    assert {"gyro, scale", "accelerometer, gravity"} <= marked(lines)
    assert any("degrees per second" in line for line in lines)
    assert any("in g: multiply by 9.81" in line for line in lines)

    turned = CALIBRATION.T_cam_imu.copy()
    turned[:3, :3] = so3.exp(np.array([0.1, 0.0, 0.0])) @ turned[:3, :3]
    lines = report(replace(world, imu=replace(CALIBRATION, T_cam_imu=turned)))
    assert marked(lines) == {"gyro, mounting about x"}
    (matrix,) = [line for line in lines if line.startswith("The rotation in T_cam_imu")]
    numbers = [float(text) for text in re.findall(r"[+-][0-9.]+\b", matrix)]
    np.testing.assert_allclose(np.reshape(numbers, (3, 3)), CALIBRATION.C_cam_imu, atol=0.02)


@pytest.mark.parametrize(("rate_rad_s", "force_m_s2"), [(50.0, 1e7), (1e6, np.inf)])
def test_a_single_spike_of_the_imu_changes_no_verdict(
    world: World, rate_rad_s: float, force_m_s2: float
) -> None:
    """It was integrated: it hid a scale, or marked a mounting that is right."""
    stream = world.imu_stream
    gyro = 1.3 * stream.gyro_rad_s
    force = stream.accel_m_s2 / 9.81
    gyro[len(gyro) // 2, 0] = rate_rad_s
    force[len(force) // 3, 1] = force_m_s2
    wrong = replace(stream, gyro_rad_s=gyro, accel_m_s2=force)
    lines = report(replace(world, imu_stream=wrong))
    assert marked(lines) == {"gyro, scale", "accelerometer, gravity"}


def test_swapped_images_and_short_recordings_are_refused(world: World) -> None:
    swapped = changed(world, lambda pixels, k: pixels[:, [2, 3, 0, 1]])
    with pytest.raises(InputError, match="Are left and right swapped"):
        check_calibration(swapped, FRAMES)
    with pytest.raises(InputError, match="it has 5 frames; 12 at least are needed"):
        check_calibration(world, 5)


def test_the_command_names_what_is_wrong(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_tracks(tmp_path)
    assert main(["calibrate-check", str(path)]) == 2
    assert "at least are needed" in capsys.readouterr().err
    assert main(["calibrate-check", str(path), "--max-frames", "2"]) == 2
    assert "--max-frames: is 2" in capsys.readouterr().err


@pytest.fixture(scope="module")
def found(world: World) -> CalibrationCheck:
    return check_calibration(world, 20)


@pytest.mark.parametrize("ending", [".png", ".svg", ".pdf"])
def test_the_picture_is_the_same_bytes_each_time(
    world: World, found: CalibrationCheck, tmp_path: Path, ending: str
) -> None:
    files = [tmp_path / f"{name}{ending}" for name in ("first", "second")]
    for file in files:
        write_calibration_picture(
            file,
            found.rig,
            found.quantities,
            marked=found.marked,
            camera=world.camera,
            largest_z=3.0,
        )
    assert files[0].read_bytes() == files[1].read_bytes()
    assert len(files[0].read_bytes()) > 5_000


@pytest.mark.parametrize(
    ("out", "what"),
    [
        ("errors.txt", "errors.txt is not a picture format that can be written"),
        ("file/errors.png", "file is a file"),
        ("folder.png", "folder.png is a folder"),
    ],
)
def test_a_picture_that_cannot_be_written_is_refused_before_the_recording_is_read(
    out: str, what: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder.png").mkdir()
    words = ["calibrate-check", str(tmp_path / "missing"), "--out", str(tmp_path / out)]
    assert main(words) == 2
    shown = capsys.readouterr().err
    assert "--out" in shown
    assert what in " ".join(shown.split())
