"""Quantities of a calibration, and when they are far from zero."""

from dataclasses import replace

import numpy as np
import pytest

from inertial_worlds import CALIBRATION
from probevo.arrays import FloatArray
from probevo.cli.calibrate_check import _is_marked, _largest_z
from probevo.evaluation.calibration_quantities import (
    Quantity,
    gravity_quantity,
    scale_quantity,
)
from probevo.evaluation.clustered_regression import two_sided_p
from probevo.sequences.imu import ImuStream


def quantity(value: float, dof: float) -> Quantity:
    return Quantity("roll", value, 0.5, "px", p_value=two_sided_p(value / 0.5, dof), cure="Turn.")


@pytest.mark.parametrize("dof", [3.0, 10.0, np.inf])
def test_what_is_marked_is_what_is_beyond_the_band(dof: float) -> None:
    """Whether σ is from few frames or many; the picture draws one band for all."""
    for value in np.linspace(-6.0, 6.0, 41):
        one = quantity(value, dof)
        assert _is_marked(one, 12) == (abs(one.z) > _largest_z(12))
        assert np.sign(one.z) == np.sign(value)


def test_with_a_known_sigma_z_is_the_value_in_sigma() -> None:
    assert quantity(-1.3, np.inf).z == pytest.approx(-2.6)
    assert quantity(500.0, np.inf).z == pytest.approx(1000.0)
    assert quantity(1.3, 4.0).z < 2.6


def standing(seconds: float, factor: float, vibration_m_s2: float) -> ImuStream:
    """Samples at 100 Hz of an IMU at rest whose accelerometer is a factor too large."""
    count = round(100 * seconds)
    force = np.tile(factor * np.array([0.0, -9.81, 0.0]), (count, 1))
    force += vibration_m_s2 * np.random.default_rng(0).normal(size=force.shape)
    stamps_ns = 10_000_000 * np.arange(count)
    return ImuStream(stamps_ns, np.zeros_like(force), force, longest_gap_ns=20_000_000)


@pytest.mark.parametrize(
    ("factor", "vibration_m_s2", "is_wrong"),
    [(1.0, 0.05, False), (1.0, 2.0, False), (1.1, 0.05, True), (0.9, 0.5, True)],
)
def test_gravity_tells_the_scale_of_the_accelerometer(
    factor: float, vibration_m_s2: float, is_wrong: bool
) -> None:
    """Of 0.98 m/s² against a bias of 0.2; vibrations, which lengthen each sample, are none."""
    calibration = replace(CALIBRATION, accel_bias_sigma_m_s2=0.2)
    found = gravity_quantity(standing(60.0, factor, vibration_m_s2), calibration)
    assert found is not None
    assert found.value == pytest.approx(9.81 * (factor - 1.0), abs=0.03)
    assert _is_marked(found, 12) == is_wrong


def poses_of(positions_m: FloatArray) -> FloatArray:
    poses = np.tile(np.eye(4), (len(positions_m), 1, 1))
    poses[:, :3, 3] = positions_m
    return poses


@pytest.mark.parametrize(
    ("step_m", "factor", "is_wrong"), [(0.0, 1.0, False), (0.5, 1.0, False), (0.5, 1.05, True)]
)
def test_scale_of_a_path_against_the_truth(step_m: float, factor: float, is_wrong: bool) -> None:
    """Both have noise, of 1 and 5 mm: at rest, their lengths compare nothing but that."""
    rng = np.random.default_rng(1)
    true = np.arange(100)[:, None] * np.array([0.0, 0.0, step_m])
    found = scale_quantity(
        poses_of(factor * true + 1e-3 * rng.normal(size=true.shape)),
        poses_of(true + 5e-3 * rng.normal(size=true.shape)),
    )
    assert is_wrong == (found is not None and _is_marked(found, 12))
    if found is not None and step_m:
        assert found.value == pytest.approx(100.0 * (factor - 1.0), abs=0.2)
        assert found.sigma < 0.5
