"""TUM-VI in its exported EuRoC layout: ``mav0`` with images, IMU, truth; ``dso`` with calibration.

Schubert et al., "The TUM VI benchmark for evaluating visual-inertial odometry", IROS 2018.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probevo.geometry import se3
from probevo.sequences.calibrations.calibration_files import read_stereo_calibration
from probevo.sequences.calibrations.imu_noise_file import with_noise_of
from probevo.sequences.format_options import PAIR_TOLERANCE_MS
from probevo.sequences.formats.euroc import notes_without_body, pair_images, read_truth
from probevo.sequences.images import range_of_files
from probevo.sequences.imu import ImuStream
from probevo.sequences.recording import StereoRecording
from probevo.sequences.text import read_stamped_csv

TRUTH = "mocap0"
"""Folder of the true poses."""


def open_tum_vi(path: Path, *, pair_tolerance_ms: float = PAIR_TOLERANCE_MS) -> StereoRecording:
    """Open cam0 and cam1, which are rectified on the fly, and IMU and ground truth if present.

    The lenses are fisheye lenses of 195°. The rectified pair keeps the focal length at the centre,
    and with it 107° of the view. Images of 16 bits are reduced to 8. The truth of the motion
    capture is the IMU's; outside of its room it is unknown.

    Args:
        path: the folder that holds ``mav0`` and ``dso``.
        pair_tolerance_ms: largest time between the images of a pair, ms.

    Raises:
        InputError: a file or field is missing, few images have a partner, or a value is impossible.
    """
    mav = path / "mav0"
    calibration = read_stereo_calibration(path / "dso" / "camchain.yaml")
    rectification = calibration.rectification()
    pairs = pair_images(mav, pair_tolerance_ms)
    stamps_ns = pairs.stamps_ns
    notes = (pairs.note, *calibration.notes)
    noise = path / "dso" / "imu_config.yaml"
    imu = with_noise_of(
        calibration.imu(rectification.C_rect_left), noise if noise.exists() else None
    )
    imu_stream = None
    truth = None
    if imu is None:
        cure = "Kalibr's file has it as T_cam_imu."
        notes += notes_without_body(mav, TRUTH, calibration.where, cure=cure)
    else:
        T_imu_cam = se3.inverse(imu.T_cam_imu)
        truth = read_truth(mav / TRUTH, T_imu_cam, stamps_ns)
        samples = mav / "imu0" / "data.csv"
        if samples.exists():
            imu_ns, values = read_stamped_csv(samples, 6, is_imu=True)
            imu_stream = ImuStream.checked(
                stamps_ns=imu.on_image_clock(imu_ns),
                gyro_rad_s=np.ascontiguousarray(values[:, :3]),
                accel_m_s2=np.ascontiguousarray(values[:, 3:]),
                frames_ns=stamps_ns,
                where=samples,
            )
    return StereoRecording(
        path=path,
        format="tum-vi",
        camera=rectification.camera,
        stamps_ns=stamps_ns,
        left_files=pairs.left_files,
        right_files=pairs.right_files,
        imu=imu if imu_stream is not None else None,
        imu_stream=imu_stream,
        truth=truth,
        rectification=rectification,
        gray_range=range_of_files(pairs.left_files, pairs.right_files),
        notes=notes,
    )
