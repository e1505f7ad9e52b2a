"""The page on a learned sensor: a consistent one lies on the grey lines, others do not."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probevo.output.inspection.sensor import (
    SHARES,
    claimed_and_actual,
    coverage_of,
    write_sensor_inspection,
)
from probevo.sensor_kinds import SensorErrors, is_sensor_file


def errors_of(factor: float) -> SensorErrors:
    """Errors with σ between 0.1 and 1 mrad, times a factor."""
    rng = np.random.default_rng(0)
    sigma = rng.uniform(1e-4, 1e-3, (4000, 3))
    errors = factor * sigma * rng.normal(size=(4000, 3))
    covariances = sigma[:, :, None] ** 2 * np.eye(3)
    return SensorErrors(errors, covariances, num_out_of_domain=7, num_silent=3)


def test_a_consistent_sensor_lies_on_the_lines() -> None:
    errors = errors_of(1.0)
    np.testing.assert_allclose(coverage_of(errors), SHARES, atol=0.03)
    claimed, actual = claimed_and_actual(errors)
    np.testing.assert_allclose(actual, claimed, rtol=0.05)
    assert (np.diff(claimed) > 0.0).all()


def test_an_overconfident_one_does_not() -> None:
    errors = errors_of(2.0)
    assert (coverage_of(errors) < SHARES).all()
    claimed, actual = claimed_and_actual(errors)
    np.testing.assert_allclose(actual, 2.0 * claimed, rtol=0.05)


@pytest.mark.usefixtures("undrawn")
def test_the_page_and_the_terminal_say_the_same(tmp_path: Path) -> None:
    lines = write_sensor_inspection(tmp_path, "turn", "drive", errors=errors_of(2.0))
    page = (tmp_path / "inspection.html").read_text()
    for text in ("What turn measures", "7 of 4,000 widened", "1 is consistent"):
        assert text in page
    assert "Kept" not in page
    assert "Learned" not in page
    assert "7 of 4,000 widened" in "\n".join(lines)
    assert "Silent: 3 more inputs" in "\n".join(lines)
    (mean,) = [line for line in lines if "mean" in line]
    assert float(mean.partition(": ")[2].split()[0]) == pytest.approx(4.0, abs=0.2)


@pytest.mark.usefixtures("undrawn")
def test_it_says_which_epoch_was_kept(tmp_path: Path) -> None:
    errors = replace(errors_of(1.0), kept="the network after 3 epochs, the last")
    lines = write_sensor_inspection(tmp_path, "turn", "drive", errors=errors)
    assert "Kept: the network after 3 epochs, the last" in lines
    assert "the network after 3 epochs, the last" in (tmp_path / "inspection.html").read_text()


@pytest.mark.usefixtures("undrawn")
def test_it_says_that_the_sensor_has_seen_the_recording(tmp_path: Path) -> None:
    errors = errors_of(1.0)
    lines = write_sensor_inspection(tmp_path, "turn", "drive", errors=errors, learned_from_it=True)
    assert "Learned: from this recording, and so this is no test of it" in lines
    assert "from this recording" in (tmp_path / "inspection.html").read_text()


@pytest.mark.usefixtures("undrawn")
def test_lengths_and_angles_have_units_of_their_own(tmp_path: Path) -> None:
    angles = errors_of(1.0)
    lengths = 10.0 * angles.errors
    both = SensorErrors(
        np.hstack([lengths, angles.errors]),
        np.tile(np.eye(6), (len(lengths), 1, 1)),
        num_out_of_domain=0,
        num_silent=0,
        num_lengths=3,
    )
    lines = write_sensor_inspection(tmp_path, "correction", "drive", errors=both)
    (of_lengths,) = [line for line in lines if line.startswith("RMS error along")]
    (of_angles,) = [line for line in lines if line.startswith("RMS error about")]
    first_mm = float(of_lengths.partition(": ")[2].split(" mm")[0])
    first_deg = float(of_angles.partition(": ")[2].split("°")[0])
    assert first_mm == pytest.approx(1e4 * np.radians(first_deg), rel=0.05)
    assert "Error of lengths against claimed" in (tmp_path / "inspection.html").read_text()


def test_other_files_are_no_sensors(tmp_path: Path) -> None:
    file = tmp_path / "text.safetensors"
    file.write_bytes(b"nothing of the kind")
    assert not is_sensor_file(file)
    assert not is_sensor_file(tmp_path / "missing.safetensors")
