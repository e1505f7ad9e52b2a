"""A camera with an IMU on a smooth path among random points: what both measure.

Other tests use them: ``from inertial_worlds import CALIBRATION, inertial_drive``.
"""

from dataclasses import dataclass, replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import se3, so3
from probevo.sequences.frame import Frame, ImuSamples
from probevo.sequences.imu_calibration import ImuCalibration
from worlds import FRAME_NS, START_NS, drive

GRAVITY = np.array([0.3, 9.8, -0.2]) * (9.81 / np.linalg.norm([0.3, 9.8, -0.2]))
"""In the world, the first camera's axes."""
CALIBRATION = ImuCalibration(
    se3.from_parts(so3.exp(np.array([0.3, -1.2, 0.4])), np.array([0.2, -0.1, 0.3])),
    gyro_noise_rad_s_sqrt_hz=2e-4,
    gyro_bias_sigma_rad_s=0.02,
    gyro_bias_walk_rad_s2_sqrt_hz=2e-5,
    accel_noise_m_s2_sqrt_hz=2e-3,
    accel_bias_sigma_m_s2=0.05,
    accel_bias_walk_m_s3_sqrt_hz=3e-4,
)
PERIOD_NS = 5_000_000
_H = 1e-4


@dataclass(frozen=True)
class SmoothPath:
    """A path whose speed and attitude swing; random amplitudes and phases."""

    speed_m_s: float
    amplitude_m: FloatArray
    amplitude_rad: FloatArray
    phase: FloatArray

    @staticmethod
    def drawn(
        rng: np.random.Generator, *, speed_m_s: float = 8.0, swing: float = 1.0
    ) -> "SmoothPath":
        return SmoothPath(
            speed_m_s,
            amplitude_m=swing * rng.uniform(0.1, 0.4, 3),
            amplitude_rad=swing * rng.uniform(0.03, 0.12, 3),
            phase=rng.uniform(0.0, 2.0 * np.pi, (2, 3)),
        )

    def rotation(self, t_s: FloatArray) -> FloatArray:
        """C_world_cam, [N, 3, 3]; the identity at 0."""
        angles = self._swing(t_s, self.amplitude_rad, 1.7, phase=self.phase[0])
        return np.asarray(so3.exp(angles))

    def position(self, t_s: FloatArray) -> FloatArray:
        """Of the camera, [N, 3], m; zero at 0."""
        ahead = np.array([0.0, 0.0, self.speed_m_s])
        swing = self._swing(t_s, self.amplitude_m, 2.3, phase=self.phase[1])
        return np.asarray(t_s[:, None] * ahead + swing)

    def poses(self, t_s: FloatArray) -> FloatArray:
        """T_world_cam, [N, 4, 4]."""
        poses = np.tile(np.eye(4), (len(t_s), 1, 1))
        poses[:, :3, :3] = self.rotation(t_s)
        poses[:, :3, 3] = self.position(t_s)
        return poses

    def samples(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rates, rad/s, and specific forces, m/s², along the IMU's axes, [N, 3] each."""
        C = self.rotation(t_s)
        rate = so3.log(self.rotation(t_s - _H).mT @ self.rotation(t_s + _H)) / (2.0 * _H)
        lever = CALIBRATION.T_cam_imu[:3, 3]
        ahead = self.position(t_s + _H) + self.rotation(t_s + _H) @ lever
        here = self.position(t_s) + C @ lever
        behind = self.position(t_s - _H) + self.rotation(t_s - _H) @ lever
        acceleration = (ahead - 2.0 * here + behind) / _H**2
        force = (C.mT @ (acceleration - GRAVITY)[..., None])[..., 0]
        return rate @ CALIBRATION.C_cam_imu, force @ CALIBRATION.C_cam_imu

    def _swing(
        self, t_s: FloatArray, amplitude: FloatArray, rate: float, phase: FloatArray
    ) -> FloatArray:
        return np.asarray(amplitude * (np.sin(rate * t_s[:, None] + phase) - np.sin(phase)))


def inertial_drive(
    rng: np.random.Generator,
    frames: int,
    path: SmoothPath,
    *,
    points: int = 80,
    sigma_px: float = 0.3,
) -> tuple[list[Frame], FloatArray]:
    """Return frames with features and samples, and the true poses T_world_cam, [frames, 4, 4]."""
    times_s = 1e-9 * FRAME_NS * np.arange(frames, dtype=np.float64)
    truth = path.poses(times_s)
    motions = np.concatenate([np.eye(4)[None], se3.inverse(truth[1:]) @ truth[:-1]])
    seen = drive(rng, frames, motions, points=points, sigma_px=sigma_px)
    stamps_ns = np.arange(-2 * PERIOD_NS, frames * FRAME_NS, PERIOD_NS)
    rates, forces = path.samples(1e-9 * stamps_ns.astype(np.float64))
    dt = 1e-9 * PERIOD_NS
    rates += _errors(
        rng,
        len(rates),
        CALIBRATION.gyro_noise_rad_s_sqrt_hz / np.sqrt(dt),
        sigma=CALIBRATION.gyro_bias_sigma_rad_s,
        walk=CALIBRATION.gyro_bias_walk_rad_s2_sqrt_hz * np.sqrt(dt),
    )
    forces += _errors(
        rng,
        len(forces),
        CALIBRATION.accel_noise_m_s2_sqrt_hz / np.sqrt(dt),
        sigma=CALIBRATION.accel_bias_sigma_m_s2,
        walk=CALIBRATION.accel_bias_walk_m_s3_sqrt_hz * np.sqrt(dt),
    )
    found = []
    for frame in seen:
        end = frame.index * FRAME_NS
        inside = (stamps_ns >= end - FRAME_NS - PERIOD_NS) & (stamps_ns <= end + PERIOD_NS)
        samples = ImuSamples(START_NS + stamps_ns[inside], rates[inside], forces[inside])
        found.append(replace(frame, imu=samples if frame.index else None))
    return found, truth


def _errors(
    rng: np.random.Generator, count: int, white: float, *, sigma: float, walk: float
) -> FloatArray:
    """White noise, and a bias that walks, [count, 3]."""
    bias = sigma * rng.normal(size=3) + np.cumsum(walk * rng.normal(size=(count, 3)), axis=0)
    return bias + white * rng.normal(size=(count, 3))
