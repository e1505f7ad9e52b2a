"""What a frame must be before a step uses it: refused, or with its unusable samples left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probevo.arrays import BoolArray
from probevo.camera.stereo import StereoCamera
from probevo.sequences.frame import Frame, ImuSamples, check_frame, check_order


def validated(
    frame: Frame, camera: StereoCamera, prev_frame: Frame | None
) -> tuple[Frame, tuple[str, ...]]:
    """Check a frame, and treat its unusable IMU samples as missing.

    A sample without a finite angular rate is left out; whether the rest still covers the interval
    is for the gyro's integration to say. A sample without a finite specific force keeps its angular
    rate.

    Args:
        frame: as it was handed in.
        camera: the camera that it should fit.
        prev_frame: the frame before it, if there was one.

    Returns:
        The frame to work with, and what is missing from it, in words.

    Raises:
        InputError: the frame cannot be used at all; see ``check_frame`` and ``check_order``.
    """
    missing: list[str] = []
    imu = frame.imu
    if imu is not None and _has_rows(imu):
        has_gyro: BoolArray = np.asarray(np.isfinite(imu.gyro_rad_s).all(axis=1))
        if not has_gyro.all():
            missing.append(
                f"{_samples(int((~has_gyro).sum()), len(has_gyro))} without a finite angular rate"
            )
            imu = ImuSamples(
                stamps_ns=imu.stamps_ns[has_gyro],
                gyro_rad_s=imu.gyro_rad_s[has_gyro],
                accel_m_s2=imu.accel_m_s2[has_gyro],
            )
            frame = replace(frame, imu=imu)
        has_accel: BoolArray = np.asarray(np.isfinite(imu.accel_m_s2).all(axis=1))
        if has_accel.any() and not has_accel.all():
            missing.append(
                f"{_samples(int((~has_accel).sum()), len(has_accel))} without a finite"
                " specific force"
            )
    check_frame(frame, camera)
    if prev_frame is not None:
        check_order(prev_frame, frame)
    return frame, tuple(missing)


def usable_imu(frame: Frame) -> ImuSamples | None:
    """Return the usable IMU samples of a refused frame, for the next one; None if faulty."""
    imu = frame.imu
    if imu is None or not _has_rows(imu) or not (np.diff(imu.stamps_ns) > 0).all():
        return None
    has_gyro: BoolArray = np.asarray(np.isfinite(imu.gyro_rad_s).all(axis=1))
    return ImuSamples(
        stamps_ns=imu.stamps_ns[has_gyro],
        gyro_rad_s=imu.gyro_rad_s[has_gyro],
        accel_m_s2=imu.accel_m_s2[has_gyro],
    )


def _has_rows(imu: ImuSamples) -> bool:
    """Return whether the arrays have the shapes that ``check_frame`` will ask for."""
    shape = (len(imu.stamps_ns), 3)
    return np.shape(imu.gyro_rad_s) == shape and np.shape(imu.accel_m_s2) == shape


def _samples(count: int, total: int) -> str:
    return f"{count} of {total} IMU samples"
