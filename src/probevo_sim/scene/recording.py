"""A drive through a scene as a ``Sequence`` that is rendered while it is iterated over."""

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
from probevo.sequences.frame import Frame, GroundTruth, ImuSamples
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.poses import ground_truth
from probevo.sequences.read_ahead import read_ahead
from probevo.sequences.stamps import NS_PER_S
from probevo_sim.scene.config import RigConfig, SceneConfig
from probevo_sim.scene.drive import Trajectory
from probevo_sim.scene.imu import C_CAM_IMU, simulate_imu
from probevo_sim.scene.presets import PRESETS
from probevo_sim.scene.renderer import FloatImage, PixelTruth, Renderer
from probevo_sim.scene.sensor import expose, exposures

START_NS = 1_600_000_000 * NS_PER_S
"""Stamp of the first frame of every drive."""

# Every part of a drive draws from a random generator of its own, keyed by (seed, drive, part), so
# that a setting of one part leaves the others as they are.
_MOTION_KEY = 1
_IMU_KEY = 2
_EXPOSURE_KEY = 3
_NOISE_KEY = 4


@dataclass(frozen=True, eq=False)
class SceneRecording:
    """A ``Sequence`` of rendered stereo images with IMU and truth; ``open_scene`` builds it.

    The same settings give the same bytes.
    """

    config: SceneConfig
    camera: StereoCamera
    renderer: Renderer
    stamps_ns: IntArray
    """Middle of the exposure of each frame, [K]."""
    exposure: FloatArray
    """Gain of each frame, [K]."""
    imu: ImuCalibration
    imu_samples: ImuSamples
    """All samples of the drive."""
    truth: GroundTruth | None
    to_sun: FloatArray
    """Unit vector towards the sun in the first camera, [3]."""
    path: Path = Path("scene")
    format: str = "scene"

    def __len__(self) -> int:
        """Return the number of frames, K."""
        return len(self.stamps_ns)

    def __iter__(self) -> Iterator[Frame]:
        """Iterate over the frames, from the first."""
        return read_ahead(self._frame, range(len(self)))

    def images(self, index: int) -> tuple[Image, Image]:
        """Return the left and right image of a frame, [height, width], uint8."""
        left, right = self.renderer.pair(self._time_s(index))
        return self._expose(left, index, side=0), self._expose(right, index, side=1)

    def pixel_truth(self, index: int) -> PixelTruth:
        """Return the truth about each pixel of the left image of a frame.

        Its flow leads to the time of the next frame.
        """
        time_s = self._time_s(index)
        return self.renderer.pixel_truth(time_s, time_s + 1.0 / self.config.rig.rate_hz)

    def _time_s(self, index: int) -> float:
        return index / self.config.rig.rate_hz

    def _expose(self, radiance: FloatImage, index: int, side: int) -> Image:
        key = [self.config.seed, self.config.drive, _NOISE_KEY, index, side]
        return expose(
            radiance,
            self.exposure[index],
            self.config.effects.noise,
            rng=np.random.default_rng(key),
        )

    def _frame(self, index: int) -> Frame:
        """Render a frame, with the IMU samples since the previous one."""
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
        return ImuStream.checked(
            self.imu_samples.stamps_ns,
            self.imu_samples.gyro_rad_s,
            self.imu_samples.accel_m_s2,
            frames_ns=self.stamps_ns,
            where=self.path,
        )


def open_scene(config: SceneConfig) -> SceneRecording:
    """Open the drive that the settings describe; nothing is rendered yet.

    Raises:
        InputError: the camera is not valid, the drive is too short for two frames, or the truth of
            a loop is asked for and the drive is no loop.
    """
    # The place, and the rig's motion through it.
    rig = config.rig
    place = PRESETS[config.preset](config)
    camera = StereoCamera.centered(rig.focal_px, rig.baseline_m, (rig.width_px, rig.height_px))
    check_camera(camera, "rig")
    key = [config.seed, config.drive]
    route = place.world.ground.route
    trajectory = Trajectory.along(route, place.plan, np.random.default_rng([*key, _MOTION_KEY]))

    # The times of the frames.
    count = int(trajectory.duration_s * rig.rate_hz) + 1
    if count < 2:
        raise InputError(
            "distance_m", f"the drive lasts only {trajectory.duration_s:.2g} s.", "Drive further."
        )
    times_s = np.arange(count) / rig.rate_hz
    stamps_ns = START_NS + np.round(times_s * NS_PER_S).astype(np.int64)

    # What the sensors record along it.
    imu_rng = np.random.default_rng([*key, _IMU_KEY])
    exposure_rng = np.random.default_rng([*key, _EXPOSURE_KEY])
    T_world_cam = trajectory.T_world_cam(times_s)
    return SceneRecording(
        config=config,
        camera=camera,
        renderer=Renderer(place.world, trajectory, camera, effects=config.effects),
        stamps_ns=stamps_ns,
        exposure=exposures(count, config.effects.exposure, exposure_rng),
        imu=_imu_calibration(rig),
        imu_samples=simulate_imu(trajectory, stamps_ns, rig, rng=imu_rng),
        truth=_given_truth(config, route.closed, stamps_ns, T_world_cam=T_world_cam),
        to_sun=T_world_cam[0, :3, :3].T @ place.world.to_sun,
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
    """Return the part of the true poses that the settings give away.

    Args:
        config: its ``truth`` decides.
        is_loop: whether the drive ends where it began.
        stamps_ns: stamps of the frames, [K].
        T_world_cam: true poses of the left camera, [K, 4, 4], m.

    Raises:
        InputError: the truth of a loop is asked for and the drive is no loop.
    """
    if config.truth == "none":
        return None
    given = T_world_cam.copy()
    if config.truth == "loop":
        if not is_loop:
            what = f"the preset {config.preset} drives no loop."
            raise InputError("truth loop", what, "Take the preset rover, or the truth all or none.")
        given[1:-1] = np.nan
    return ground_truth(stamps_ns, given, "scene")
