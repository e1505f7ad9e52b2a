"""A drive through a scene as a ``Sequence`` that is rendered while it is walked through."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from time import perf_counter

import numpy as np

from probevo.arrays import FloatArray, Image, IntArray
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.frame import Frame, GroundTruth
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.poses import ground_truth
from probevo.sequences.read_ahead import read_ahead
from probevo.sequences.stamps import NS_PER_S
from probevo_sim.scene.config import RigConfig, SceneConfig
from probevo_sim.scene.drive import Trajectory
from probevo_sim.scene.imu import C_CAM_IMU, simulate_imu
from probevo_sim.scene.presets import PRESETS
from probevo_sim.scene.renderer import PixelTruth, Renderer
from probevo_sim.scene.sensor import expose, exposures

START_NS = 1_600_000_000 * NS_PER_S


@dataclass(frozen=True, eq=False)
class SceneRecording:
    """A ``Sequence`` of rendered stereo images; ``open_scene`` builds it. The same settings give
    the same bytes."""

    config: SceneConfig
    camera: StereoCamera
    renderer: Renderer
    stamps_ns: IntArray
    exposure: FloatArray
    """Gain of each frame, [K]."""
    imu: ImuCalibration
    imu_samples: tuple[IntArray, FloatArray, FloatArray]
    """Stamps [J], ns; angular rates [J, 3], rad/s; specific force [J, 3], m/s²."""
    truth: GroundTruth | None
    path: Path = Path("scene")
    format: str = "scene"

    def __len__(self) -> int:
        """Number of frames, K."""
        return len(self.stamps_ns)

    def __iter__(self) -> Iterator[Frame]:
        """The frames, from the first."""
        return read_ahead(self._frame, range(len(self)))

    def images(self, index: int) -> tuple[Image, Image]:
        """The left and right image of a frame, [height, width], uint8."""
        pair = self.renderer.pair(self._time_s(index))
        keys = [self.config.seed, self.config.drive, 4, index]
        left, right = (
            expose(
                radiance,
                self.exposure[index],
                self.config.effects.noise,
                rng=np.random.default_rng([*keys, side]),
            )
            for side, radiance in enumerate(pair)
        )
        return left, right

    def pixel_truth(self, index: int) -> PixelTruth:
        """Truth about each pixel of the left image of a frame; its flow leads to the next frame's
        time."""
        return self.renderer.pixel_truth(
            self._time_s(index), self._time_s(index) + 1.0 / self.config.rig.rate_hz
        )

    def _time_s(self, index: int) -> float:
        return index / self.config.rig.rate_hz

    def _frame(self, index: int) -> Frame:
        start = perf_counter()
        left, right = self.images(index)
        imu = None
        if index > 0:
            imu = self._imu_stream.between(
                int(self.stamps_ns[index - 1]), int(self.stamps_ns[index])
            )
        return Frame(
            index,
            int(self.stamps_ns[index]),
            left,
            right=right,
            imu=imu,
            decode_ms=1e3 * (perf_counter() - start),
        )

    @cached_property
    def _imu_stream(self) -> ImuStream:
        return ImuStream.checked(*self.imu_samples, self.stamps_ns, self.path)


def open_scene(config: SceneConfig) -> SceneRecording:
    """The drive that the settings describe; nothing is rendered yet.

    Raises:
        InputError: the camera is not valid, the drive is too short for two frames, or the truth of
            a loop is asked for and the drive is no loop.
    """
    rig = config.rig
    place = PRESETS[config.preset](config)
    camera = StereoCamera.centered(rig.focal_px, rig.baseline_m, (rig.width_px, rig.height_px))
    check_camera(camera, "rig")
    key = [config.seed, config.drive]
    trajectory = Trajectory.along(
        place.world.ground.route, place.plan, np.random.default_rng([*key, 1])
    )
    count = int(trajectory.duration_s * rig.rate_hz) + 1
    if count < 2:
        raise InputError(
            "distance_m", f"the drive lasts only {trajectory.duration_s:.2g} s.", "Drive further."
        )
    times_s = np.arange(count) / rig.rate_hz
    stamps_ns = START_NS + np.round(times_s * NS_PER_S).astype(np.int64)
    return SceneRecording(
        config=config,
        camera=camera,
        renderer=Renderer(place.world, trajectory, camera, effects=config.effects),
        stamps_ns=stamps_ns,
        exposure=exposures(count, config.effects.exposure, np.random.default_rng([*key, 3])),
        imu=_imu_calibration(rig),
        imu_samples=simulate_imu(trajectory, stamps_ns, rig, rng=np.random.default_rng([*key, 2])),
        truth=_given_truth(
            config,
            place.world.ground.route.closed,
            stamps_ns,
            T_world_cam=trajectory.T_world_cam(times_s),
        ),
    )


def _imu_calibration(rig: RigConfig) -> ImuCalibration:
    return ImuCalibration(
        T_cam_imu=se3.from_parts(C_CAM_IMU, np.zeros(3)),
        gyro_noise_rad_s_sqrt_hz=rig.gyro_noise_rad_s_sqrt_hz,
        gyro_bias_sigma_rad_s=rig.gyro_bias_sigma_rad_s,
        gyro_bias_walk_rad_s2_sqrt_hz=rig.gyro_bias_walk_rad_s2_sqrt_hz,
        accel_noise_m_s2_sqrt_hz=rig.accel_noise_m_s2_sqrt_hz,
        accel_bias_sigma_m_s2=rig.accel_bias_sigma_m_s2,
        accel_bias_walk_m_s3_sqrt_hz=rig.accel_bias_walk_m_s3_sqrt_hz,
    )


def _given_truth(
    config: SceneConfig, is_loop: bool, stamps_ns: IntArray, T_world_cam: FloatArray
) -> GroundTruth | None:
    if config.truth == "none":
        return None
    given = T_world_cam.copy()
    if config.truth == "loop":
        if not is_loop:
            what = f"the preset {config.preset} drives no loop."
            raise InputError("truth loop", what, "Take the preset rover, or the truth all or none.")
        given[1:-1] = np.nan
    return ground_truth(stamps_ns, given, "scene")
