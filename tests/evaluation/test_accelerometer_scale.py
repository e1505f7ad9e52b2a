"""The scale of a path against the accelerometer: right within its σ, and silent without a cause."""

from __future__ import annotations

import re
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from inertial_worlds import CALIBRATION, SmoothPath, inertial_drive
from probevo.arrays import FloatArray, IntArray
from probevo.cli.main import main
from probevo.evaluation.accelerometer_scale import AccelerometerScale, accelerometer_scale
from probevo.geometry import se3
from probevo.output.run_warnings import accelerometer_warning
from probevo.sequences.imu import ImuStream, hold_over_interval
from worlds import FRAME_NS, START_NS

FRAMES = 150


@cache
def drive_of(
    seed: int, frames: int = FRAMES, *, swing: float = 1.0
) -> tuple[ImuStream, FloatArray]:
    """The samples of a drive, and its true poses."""
    rng = np.random.default_rng([90, seed])
    path = SmoothPath.drawn(rng, swing=swing)
    seen, truth = inertial_drive(rng, frames, path, points=1)
    parts = [frame.imu for frame in seen if frame.imu is not None]
    stamps_ns = np.concatenate([part.stamps_ns for part in parts])
    _, first = np.unique(stamps_ns, return_index=True)
    stream = ImuStream(
        stamps_ns[first],
        np.concatenate([part.gyro_rad_s for part in parts])[first],
        np.concatenate([part.accel_m_s2 for part in parts])[first],
        longest_gap_ns=20_000_000,
    )
    return stream, truth


def stamps(frames: int = FRAMES) -> IntArray:
    return START_NS + FRAME_NS * np.arange(frames)


def as_seen(
    truth: FloatArray, scale: float, seed: int, sigma_m: float = 3e-3, sigma_rad: float = 2e-4
) -> FloatArray:
    """Poses that compound noisy motions, all of them too long by a factor."""
    rng = np.random.default_rng([91, seed])
    motions = se3.inverse(truth[1:]) @ truth[:-1]
    motions[:, :3, 3] *= scale
    noise = rng.normal(size=(len(motions), 6)) * np.repeat([sigma_m, sigma_rad], 3)
    return se3.chain_motions(se3.exp(noise) @ motions)


def found(
    stream: ImuStream, poses: FloatArray, is_ok: FloatArray | None = None
) -> AccelerometerScale | None:
    frames = len(poses)
    ok = np.ones(frames - 1, np.bool_) if is_ok is None else is_ok.astype(np.bool_)
    return accelerometer_scale(stamps(frames), poses, ok, stream=stream, calibration=CALIBRATION)


@pytest.mark.parametrize("scale", [0.95, 1.0, 1.05])
def test_the_ratio_is_right_within_its_standard_deviation(scale: float) -> None:
    """Over 40 drives, the mean of z² lies in the 99.9 % interval of χ²(40)/40, widened for the
    Student's t that z follows; and 5 % are seen in each."""
    z = []
    sigma = []
    for seed in range(40):
        stream, truth = drive_of(seed)
        result = found(stream, as_seen(truth, scale, seed))
        assert result is not None
        z.append((result.ratio - scale) / result.sigma)
        sigma.append(result.sigma)
    assert 0.4 < np.mean(np.square(z)) < 2.0
    assert abs(np.mean(z)) < 0.6
    assert max(sigma) < 0.05 / 3.0


@pytest.mark.parametrize("phase_ms", [0.5, 2.0, 5.0, 8.0])
def test_held_samples_are_no_holes(phase_ms: float) -> None:
    """OXTS's packets are held over their interval, which gives two stamps 1 ns apart: wherever the
    frames lie between them, as many intervals count as with the samples themselves."""
    stream, truth = drive_of(0)
    shifted = stream.stamps_ns + round(1e6 * phase_ms)
    force = np.hstack([stream.gyro_rad_s, stream.accel_m_s2])
    stamps_ns, held = hold_over_interval(shifted, force)
    of_packets = ImuStream(stamps_ns, held[:, :3], held[:, 3:], longest_gap_ns=20_000_000)
    poses = as_seen(truth, 1.0, 0)
    plain = found(stream, poses)
    result = found(of_packets, poses)
    assert plain is not None
    assert result is not None
    assert result.count >= 0.95 * plain.count


def test_who_hardly_accelerates_learns_nothing() -> None:
    """Neither at rest nor at a constant velocity: no ratio, or one that says so by its σ."""
    stream, truth = drive_of(0, swing=0.0)
    assert found(stream, as_seen(truth, 1.05, 0)) is None


def test_slow_samples_missing_steps_and_short_runs_say_nothing() -> None:
    stream, truth = drive_of(1)
    poses = as_seen(truth, 1.05, 1)
    slow = replace(
        stream,
        stamps_ns=stream.stamps_ns[::20],
        gyro_rad_s=stream.gyro_rad_s[::20],
        accel_m_s2=stream.accel_m_s2[::20],
    )
    assert found(slow, poses) is None
    assert found(stream, poses[:30]) is None
    failing = np.arange(FRAMES - 1) % 5 > 0
    assert found(stream, poses, failing) is None


def test_broken_samples_and_dead_reckoned_steps_are_left_out() -> None:
    stream, truth = drive_of(2)
    poses = as_seen(truth, 1.05, 2)
    accel = stream.accel_m_s2.copy()
    accel[300] = np.nan
    accel[800] = 1e300
    is_ok = np.ones(FRAMES - 1, np.bool_)
    is_ok[60] = False
    poses[61:, :3, 3] += 5.0  # what a dead-reckoned step may do
    result = found(replace(stream, accel_m_s2=accel), poses, is_ok)
    assert result is not None
    assert abs(result.ratio - 1.05) < 4.0 * result.sigma


@pytest.mark.parametrize(
    ("ratio", "sigma", "warns"),
    [(1.05, 0.005, True), (0.95, 0.005, True), (1.02, 0.001, False), (1.05, 0.02, False)],
)
def test_the_warning_needs_three_percent_and_three_sigma(
    ratio: float, sigma: float, warns: bool
) -> None:
    text = accelerometer_warning(AccelerometerScale(ratio, sigma, 20))
    assert (text is not None) == warns
    if text is not None:
        assert f"divide baseline_m by {ratio:.3f}" in text


@pytest.mark.slow
@pytest.mark.usefixtures("coarsely_rendered")
def test_a_wrong_baseline_of_a_rendered_drive_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """5 % too long: `run` warns and names it, within 2 %; the right one is silent. Reports are left
    out."""
    monkeypatch.setattr(
        "probevo.output.report.report.write_report", lambda path, *_, **__: path.touch()
    )
    street = tmp_path / "street"
    rig = ["--rig.width-px", "310", "--rig.height-px", "94", "--rig.focal-px", "180"]
    words = ["simulate", "scene", "--preset", "residential", "--distance-m", "50", "--jobs", "1"]
    assert main([*words, *rig, "--out", str(street)]) == 0
    text = (street / "calib.yaml").read_text()
    for factor in (1.0, 1.05):
        copy = shutil.copytree(street, tmp_path / f"street_{factor}")
        (copy / "poses.txt").unlink()  # which would tell it, too
        changed = text.replace("baseline_m: 0.54", f"baseline_m: {0.54 * factor:.6g}")
        assert (changed == text) == (factor == 1.0)
        (copy / "calib.yaml").write_text(changed)
        capsys.readouterr()
        assert main(["run", str(copy), "--out", str(tmp_path / f"out_{factor}")]) == 0
        warning = capsys.readouterr().err
        if factor == 1.0:
            assert "accelerometer" not in warning
        else:
            named = re.search(r"The path is ([0-9.]+) ", warning)
            assert named is not None
            assert abs(float(named[1]) - factor) < 0.02
