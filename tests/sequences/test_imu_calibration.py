"""The calibration of an IMU: what it holds, and what it refuses."""

from typing import Any

import numpy as np
import pytest

from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.imu_calibration import DENSITIES, ImuCalibration

T_CAM_IMU = se3.exp(np.array([0.1, -0.2, 0.3, 1.2, -1.1, 0.9]))
GIVEN = {"T_cam_imu": T_CAM_IMU, "gyro_noise_rad_s_sqrt_hz": 1e-3, "gyro_bias_sigma_rad_s": 0.01}


def with_last_row(row: list[float]) -> Any:
    T = T_CAM_IMU.copy()
    T[3] = row
    return T


def test_the_rotation_is_that_of_the_transform() -> None:
    np.testing.assert_array_equal(ImuCalibration(**GIVEN).C_cam_imu, T_CAM_IMU[:3, :3])


@pytest.mark.parametrize("offset_s", [0.0, 0.0123456789, -1.5])
def test_an_event_has_one_time_on_the_clock_of_the_images(offset_s: float) -> None:
    """Kalibr's timeshift_cam_imu: t_imu = t_cam + offset."""
    t_cam_ns = 1_403_715_273_262_142_976 + 5_000_000 * np.arange(4)
    t_imu_ns = t_cam_ns + round(1e9 * offset_s)
    calibration = ImuCalibration(**GIVEN, time_offset_s=offset_s)
    np.testing.assert_array_equal(calibration.on_image_clock(t_imu_ns), t_cam_ns)


@pytest.mark.parametrize("value", [-1e-9, 1e300, np.nan, np.inf, -np.inf, "0.1", None, 1j])
@pytest.mark.parametrize("name", DENSITIES)
def test_a_noise_figure_is_finite_and_not_negative(name: str, value: Any) -> None:
    with pytest.raises(InputError, match=rf"^{name}: is .*\n +It must be a finite number"):
        ImuCalibration(**(GIVEN | {name: value}))


@pytest.mark.parametrize("name", DENSITIES)
@pytest.mark.parametrize("value", [0, 0.0, np.float32(0.1), 2])
def test_a_noise_figure_may_be_zero_or_of_any_type_of_number(name: str, value: Any) -> None:
    assert getattr(ImuCalibration(**(GIVEN | {name: value})), name) == value


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300, -1e11, "0", None])
def test_a_time_offset_is_finite(value: Any) -> None:
    with pytest.raises(InputError, match=r"^time_offset_s: is .*\n +It must be a finite number"):
        ImuCalibration(**GIVEN, time_offset_s=value)


@pytest.mark.parametrize(
    ("T_cam_imu", "message"),
    [
        (np.eye(3), r"has shape \(3, 3\)(.|\n)*the rotation with the IMU's position"),
        (np.eye(4)[:3], r"shape \(3, 4\)"),
        (None, r"shape \(\)"),
        ("eye", r"shape \(\)"),
        (np.eye(4) * np.nan, "not finite"),
        (T_CAM_IMU + np.diag([np.inf, 0.0, 0.0], k=1), "not finite"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "not a rotation matrix"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "not a rotation matrix"),
        (with_last_row([0.0, 0.0, 0.0, 2.0]), "last row of this transform is not 0 0 0 1"),
        (with_last_row([0.0, 0.1, 0.0, 1.0]), "last row of this transform is not 0 0 0 1"),
    ],
)
def test_a_transform_that_is_not_rigid_is_refused(T_cam_imu: Any, message: str) -> None:
    with pytest.raises(InputError, match=f"^T_cam_imu: (.|\n)*{message}"):
        ImuCalibration(**(GIVEN | {"T_cam_imu": T_cam_imu}))


def test_a_transform_of_lists_becomes_an_array() -> None:
    calibration = ImuCalibration(**(GIVEN | {"T_cam_imu": T_CAM_IMU.tolist()}))
    np.testing.assert_array_equal(calibration.C_cam_imu, T_CAM_IMU[:3, :3])
