"""Ask an IMU which path is right: that of the images, or the ground truth.

    python benchmarks/imu_agreement.py [RECORDING …]

The window runs on the images alone. What gyro and accelerometer say of the motion is fitted to its
path, and to the ground truth, by least squares: attitude and velocity at the start, gravity, the
place of the path, and constant biases are free, all else is the IMU's. What is left are the errors
of the path, since over two seconds an IMU is good to a tenth of a millimetre, but for what those
eighteen numbers can imitate. By default EuRoC MH_01. One line for each path: RMS of the position,
mm, over all frames and without the first one, RMS of the attitude, mrad, and the gravity found.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from recordings import ROOT
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation, Slerp

import probevo as pv
from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.sequences.frame import ImuSamples

MH_01 = ROOT / "euroc" / "MH_01_micro"
SIGMA_M = 1e-3
SIGMA_RAD = 1e-3
"""Errors that count as much, of position and attitude."""
ACCEL_BIAS_M_S2 = 0.1
"""Standard deviation of the accelerometer's bias, which gravity nearly imitates."""
FREE = {"turn": 3, "gyro_bias": 3, "velocity": 3, "gravity": 3, "accel_bias": 3, "offset": 3}
"""Unknowns, and how many numbers each is."""


@dataclass(frozen=True)
class Imu:
    """The samples of a recording, at times since its first frame."""

    times_s: FloatArray
    """[J]."""
    samples: ImuSamples
    T_cam_imu: FloatArray
    """[4, 4], m."""
    frame_times_s: FloatArray
    """[K]."""

    @staticmethod
    def of(sequence: pv.sequences.Sequence, frames: list[pv.Frame]) -> Imu:
        """Join the samples of all frames."""
        samples = frames[1].imu
        for frame in frames[2:]:
            samples = samples.followed_by(frame.imu)
        stamps_ns = np.array([frame.stamp_ns for frame in frames])
        return Imu(
            times_s=1e-9 * (samples.stamps_ns - stamps_ns[0]),
            samples=samples,
            T_cam_imu=sequence.imu.T_cam_imu,
            frame_times_s=1e-9 * (stamps_ns - stamps_ns[0]),
        )

    def path(self, unknowns: dict[str, FloatArray]) -> FloatArray:
        """Integrate the samples; the poses of the camera at the frames, [K, 4, 4], m."""
        # Attitude, from the gyro
        steps_s = np.diff(self.times_s)
        rate = self.samples.gyro_rad_s - unknowns["gyro_bias"]
        turns = Rotation.from_rotvec(0.5 * (rate[1:] + rate[:-1]) * steps_s[:, None])
        attitudes = [
            Rotation.from_matrix(self.T_cam_imu[:3, :3]) * Rotation.from_rotvec(unknowns["turn"])
        ]
        for turn in turns:
            attitudes.append(attitudes[-1] * turn)
        C_world_imu = Rotation.concatenate(attitudes)
        # Acceleration, velocity and position; the acceleration is linear between samples
        force = self.samples.accel_m_s2 - unknowns["accel_bias"]
        acceleration = C_world_imu.apply(force) + unknowns["gravity"]
        mean = 0.5 * (acceleration[1:] + acceleration[:-1])
        velocity = unknowns["velocity"] + _summed(mean * steps_s[:, None])
        of_acceleration = (2.0 * acceleration[:-1] + acceleration[1:]) / 6.0
        position = _summed(
            velocity[:-1] * steps_s[:, None] + of_acceleration * steps_s[:, None] ** 2
        )
        # At the frames, and of the camera
        T_world_imu = np.tile(np.eye(4), (len(self.frame_times_s), 1, 1))
        T_world_imu[:, :3, :3] = Slerp(self.times_s, C_world_imu)(self.frame_times_s).as_matrix()
        for axis in range(3):
            T_world_imu[:, axis, 3] = np.interp(self.frame_times_s, self.times_s, position[:, axis])
        T_world_cam = T_world_imu @ se3.inverse(self.T_cam_imu)
        T_world_cam[:, :3, 3] += unknowns["offset"] - T_world_cam[0, :3, 3]
        return T_world_cam


def _summed(steps: FloatArray) -> FloatArray:
    """Return the sums of the first 0, 1, 2, … steps, [J, 3] to [J + 1, 3]."""
    return np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])


def _named(numbers: FloatArray) -> dict[str, FloatArray]:
    """Return the unknowns by name."""
    ends = np.cumsum(list(FREE.values()))
    return dict(zip(FREE, np.split(numbers, ends[:-1]), strict=True))


def disagreement(imu: Imu, T_world_cam: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Fit the IMU to a path, [K, 4, 4].

    Returns:
        What is left of the positions, [K, 3], m, and of the attitudes, [K, 3], rad, and the length
        of the gravity that was found, m/s².
    """

    def left_over(numbers: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return path minus IMU."""
        found = imu.path(_named(numbers))
        of_attitude = found[:, :3, :3].mT @ T_world_cam[:, :3, :3]
        return (
            T_world_cam[:, :3, 3] - found[:, :3, 3],
            Rotation.from_matrix(of_attitude).as_rotvec(),
        )

    def residuals(numbers: FloatArray) -> FloatArray:
        """Return all that is to be small, in standard deviations."""
        position, attitude = left_over(numbers)
        bias = _named(numbers)["accel_bias"] / ACCEL_BIAS_M_S2
        return np.concatenate([position.ravel() / SIGMA_M, attitude.ravel() / SIGMA_RAD, bias])

    start = np.zeros(sum(FREE.values()))
    start[9:12] = [0.0, 9.81, 0.0]  # the camera's y axis points down, roughly
    solved = least_squares(residuals, start, x_scale="jac")
    gravity = float(np.linalg.norm(_named(solved.x)["gravity"]))
    return *left_over(solved.x), gravity


def path_of_images(sequence: pv.sequences.Sequence, frames: list[pv.Frame]) -> FloatArray:
    """Run the window on the images alone, and return the poses, [K, 4, 4]."""
    odometry = pv.StereoOdometry(sequence.camera)
    return np.array([odometry.step(replace(frame, imu=None)).T_world_cam for frame in frames])


def rms(errors: FloatArray) -> float:
    """Return the root of the mean squared length of errors, [K, 3]."""
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))


def main() -> None:
    """Print two lines for each recording."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recordings", nargs="*", type=Path, default=[MH_01])
    cv2.setNumThreads(1)
    for path in parser.parse_args().recordings:
        sequence = pv.open_sequence(path)
        frames = list(sequence)
        imu = Imu.of(sequence, frames)
        truth = se3.inverse(sequence.truth.T_world_cam[0]) @ sequence.truth.T_world_cam
        print(f"{path.name}, {len(frames)} frames")
        for name, poses in (("images", path_of_images(sequence, frames)), ("truth", truth)):
            position, attitude, gravity = disagreement(imu, poses)
            print(
                f"{name:8} {1e3 * rms(position):6.2f} mm,"
                f" {1e3 * rms(position[1:]):6.2f} without the first frame;"
                f" {1e3 * rms(attitude):6.2f} mrad; gravity {gravity:.2f} m/s²"
            )


if __name__ == "__main__":
    main()
