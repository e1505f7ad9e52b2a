"""``probevo paper sun``: its simulated drives, its bound, and what it writes."""

import csv
import json
import math
from pathlib import Path

import numpy as np
import pytest

from probevo.cli.main import main
from probevo.geometry import se3
from probevo.measurements.sensor import NoMeasurement
from probevo.measurements.variables import pose_of
from probevo_paper import sun
from probevo_paper.command_sun import cells
from probevo_paper.sun import SunDrive, SunPath, attitude_bound, fused_path, row_of, simulate_drive
from probevo_paper.sun_config import SunConfig
from probevo_sim.sun_sensor import SunSensor


def test_the_sensor_measures_what_it_says() -> None:
    """Its residual at the truth is white noise of σ, in the frames that it measures in."""
    drive = simulate_drive(SunConfig(frames=12, points=8), 0)
    frame = drive.frames[1]
    residuals = []
    for seed in range(400):
        sensor = SunSensor(drive.T_world_cam, drive.sun, sigma_rad=0.1, seed=seed)
        answer = sensor(drive.frames[0], frame)
        assert not isinstance(answer, NoMeasurement)
        T_cam_world = se3.inverse(drive.T_world_cam[1])
        residuals.append(answer[0].residual({pose_of(1): T_cam_world}))
        again = sensor(drive.frames[0], frame)
        assert not isinstance(again, NoMeasurement)
        np.testing.assert_array_equal(again[0].in_camera, answer[0].in_camera)
    cov = np.cov(np.transpose(residuals))
    np.testing.assert_allclose(cov, 0.01 * np.eye(2), atol=0.0025)
    np.testing.assert_allclose(np.mean(residuals, axis=0), 0.0, atol=0.02)
    sensor = SunSensor(drive.T_world_cam, drive.sun, sigma_rad=0.1, every=5)
    assert sensor(drive.frames[0], frame) == NoMeasurement("between sightings")


@pytest.mark.slow
def test_ten_degrees_every_tenth_frame_bound_the_heading() -> None:
    """The claimed covariance is the Cramér–Rao bound within 10 %; the error within 20 % of it; and
    each way to lie is found out, with a path as good as without the sensor."""
    settings = SunConfig(frames=301)
    drives = [simulate_drive(settings, index) for index in range(3)]
    sensors = {
        fault: [
            SunSensor(
                drive.T_world_cam,
                drive.sun,
                sigma_rad=math.radians(10.0),
                every=10,
                seed=index,
                fault=fault,
            )
            for index, drive in enumerate(drives)
        ]
        for fault in (None, "offset", "inverted", "stuck")
    }
    without = row_of("without", drives, [fused_path(drive, None) for drive in drives])
    bounds = [attitude_bound(drive, math.radians(10.0), 10) for drive in drives]
    for fault, of_drives in sensors.items():
        paths = [fused_path(drive, one) for drive, one in zip(drives, of_drives, strict=True)]
        row = row_of("sun", drives, paths, bounds=bounds, every=10)
        assert row.heading_bound_deg is not None
        if fault is None:
            assert all(path.excluded_at is None for path in paths)
            assert row.claimed_deg == pytest.approx(row.heading_bound_deg, rel=0.1)
            assert row.claimed_deg < without.claimed_deg
        else:
            assert all(path.excluded_at is not None for path in paths)
            assert row.heading_rms_deg <= 1.05 * without.heading_rms_deg


def at_rest(frames: int = 20) -> SunDrive:
    return SunDrive(
        frames=(),
        T_world_cam=np.tile(np.eye(4), (frames, 1, 1)),
        motions=(),
        sun=np.array([0.0, 0.0, 1.0]),
    )


@pytest.mark.parametrize(
    ("excluded_at", "text"),
    [
        ((None, None, None), ""),
        ((None, None, 10), "1, in 1 of 3 drives"),
        ((10, 20, 30), "2"),
    ],
)
def test_a_row_says_in_how_many_drives_the_sensor_was_excluded(
    excluded_at: tuple[int | None, ...], text: str
) -> None:
    drive = at_rest()
    paths = []
    for frame in excluded_at:
        T_world_cam = drive.T_world_cam @ se3.exp(np.full(6, 0.01))
        cov = np.tile(np.eye(6), (20, 1, 1))
        paths.append(SunPath(T_world_cam=T_world_cam, cov=cov, excluded_at=frame))
    row = row_of("sun", [drive] * 3, paths, every=10)
    assert cells(row, row)[-1] == text


def test_the_noise_of_each_drive_and_seed_is_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drive 1 of seed 0 shares none with drive 0 of seed 1."""
    drive = at_rest()
    measured: list[bytes] = []

    def keep(drive: SunDrive, sensor: SunSensor) -> SunPath:
        measured.append(sensor.measured(1).tobytes())
        return SunPath(T_world_cam=drive.T_world_cam, cov=np.zeros((20, 6, 6)), excluded_at=None)

    monkeypatch.setattr(sun, "fused_path", keep)
    monkeypatch.setattr(sun, "attitude_bound", lambda *_: np.zeros((20, 6, 6)))
    for seed in range(3):
        sun._row_with([drive] * 3, 10.0, 1, seed=seed)
    assert len(set(measured)) == len(measured) == 9


def test_it_writes_a_row_for_each_sensor_and_the_same_bytes_again(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--frames", "21", "--drives", "1"]
    for name in "ab":
        assert main(["paper", "sun", "--out", str(tmp_path / name), *words]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("sun sensor")
    assert {path.name for path in (tmp_path / "a").iterdir()} == {"sun.csv", "sun.json", "sun.txt"}
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()
    rows = list(csv.DictReader((tmp_path / "a" / "sun.csv").open()))
    assert [row["name"] for row in rows[:2]] == ["without", "σ 0°, every 1"]
    assert len(rows) == 1 + 12 + 3
    saved = json.loads((tmp_path / "a" / "sun.json").read_text())
    assert saved["settings"]["frames"] == 21
    assert len(saved["rows"]) == len(rows)
