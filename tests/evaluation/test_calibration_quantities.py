"""Quantities of a calibration, and when they are far from zero."""

import numpy as np
import pytest

from inertial_worlds import CALIBRATION, SmoothPath, inertial_drive
from probevo.arrays import FloatArray
from probevo.evaluation.calibration_quantities import (
    Quantity,
    gravity_quantity,
    is_marked,
    largest_z,
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
        assert is_marked(one, 12) == (abs(one.z) > largest_z(12))
        assert np.sign(one.z) == np.sign(value)


def test_with_a_known_sigma_z_is_the_value_in_sigma() -> None:
    assert quantity(-1.3, np.inf).z == pytest.approx(-2.6)
    assert quantity(500.0, np.inf).z == pytest.approx(1000.0)
    assert quantity(1.3, 4.0).z < 2.6


@pytest.mark.parametrize("swing", [0.0, 3.0])
@pytest.mark.parametrize(
    ("factor", "vibration_m_s2", "is_wrong"),
    [(1.0, 0.0, False), (1.0, 2.0, False), (1.1, 0.0, True), (0.9, 2.0, True)],
)
def test_gravity_tells_the_scale_of_the_accelerometer(
    swing: float, factor: float, vibration_m_s2: float, is_wrong: bool
) -> None:
    """Of 0.98 m/s² against a bias of 0.2; neither vibrations nor accelerations of some m/s², which
    lengthen each sample, look like more gravity."""
    rng = np.random.default_rng([7, round(swing)])
    frames, poses = inertial_drive(rng, 100, SmoothPath.drawn(rng, swing=swing), points=1)
    parts = [frame.imu for frame in frames if frame.imu is not None]
    stamps_ns = np.concatenate([part.stamps_ns for part in parts])
    force = np.concatenate([part.accel_m_s2 for part in parts])
    force = factor * force + vibration_m_s2 * rng.normal(size=force.shape)
    stream = ImuStream(stamps_ns, np.zeros_like(force), force, longest_gap_ns=20_000_000)
    found = gravity_quantity(
        np.array([frame.stamp_ns for frame in frames]),
        poses,
        np.ones(len(frames) - 1, np.bool_),
        stream=stream,
        T_cam_imu=CALIBRATION.T_cam_imu,
        bias_sigma_m_s2=0.2,
    )
    assert found is not None
    # The bias of these samples is of 0.05 m/s² along each axis.
    assert found.value == pytest.approx(9.81 * (factor - 1.0), abs=0.2)
    assert is_marked(found, 12) == is_wrong
    assert found.cure.startswith(
        "the mean specific force, less the mean acceleration by the images, is"
        f" {found.value + 9.81:.3g} m/s² long."
    )


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
    assert is_wrong == (found is not None and is_marked(found, 12))
    if found is not None and step_m:
        assert found.value == pytest.approx(100.0 * (factor - 1.0), abs=0.2)
        assert found.sigma < 0.5


@pytest.mark.parametrize("every", [2, 3, 7, 20])
def test_truth_of_some_frames_tells_the_scale(every: int) -> None:
    true = poses_of(np.arange(200)[:, None] * np.array([0.0, 0.0, 0.5]))
    noise_m = 1e-3 * np.random.default_rng(1).normal(size=(200, 3))
    partly = np.full_like(true, np.nan)
    partly[5::every] = true[5::every]
    found = scale_quantity(poses_of(2.0 * true[:, :3, 3] + noise_m), partly)
    assert found is not None
    assert found.value == pytest.approx(100.0, abs=0.5)
    assert is_marked(found, 12)
    partly[20:] = np.nan
    assert scale_quantity(true, partly) is None
    assert scale_quantity(true, np.full_like(true, np.nan)) is None


def test_a_hole_in_the_truth_is_no_segment() -> None:
    """Its length would count as much as those of all others together."""
    true = poses_of(np.arange(200)[:, None] * np.array([0.0, 0.0, 0.5]))
    estimated = true.copy()
    estimated[100:, 2, 3] -= 20.0
    true[60:140] = np.nan
    found = scale_quantity(estimated, true)
    assert found is not None
    assert found.value == pytest.approx(0.0, abs=1e-6)
