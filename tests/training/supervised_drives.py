"""Drives around a circle of landmarks whose noise is known, and recordings to learn from.

Other tests use them: ``from training.supervised_drives import drive_of, point_world``.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.config import SolverConfig
from probevo.estimation.two_frame import TwoFrameEstimator
from probevo.geometry import se3
from probevo.noise import NoiseModel, StudentT
from probevo.sequences.frame import Frame, GroundTruth
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.training.drive import Drive
from probevo.training.probe.subsets import SubsetSampler
from probevo.training.supervised_drive import DriveInMemory
from probevo.training.supervision import Supervision
from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import PointStep, PointWorld, simulate_points
from worlds import CAMERA

FRAME_NS = 100_000_000
START_NS = 1_400_000_000_123_456_789


@dataclass(frozen=True)
class Recording:
    """A ``Sequence`` of which only the stamps and the truth are read."""

    stamps_ns: IntArray
    truth: GroundTruth | None
    path: Path = Path("drive")
    format: str = "tracks"
    camera: StereoCamera = CAMERA
    imu: ImuCalibration | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __iter__(self) -> Iterator[Frame]:
        return iter(())


def recording(
    T_world_cam: FloatArray | None, frames: int = 11, start_ns: int = START_NS
) -> Recording:
    """Return a recording of ten frames a second with this truth."""
    frames = frames if T_world_cam is None else len(T_world_cam)
    stamps_ns = start_ns + FRAME_NS * np.arange(frames)
    return Recording(
        stamps_ns, None if T_world_cam is None else GroundTruth(stamps_ns, T_world_cam)
    )


def point_world(
    law: str = "row",
    *,
    seed: int = 0,
    frames: int = 64,
    landmarks: int = 800,
    sigma_px: tuple[float, float] = (0.05, 1),
) -> PointWorld:
    """Simulate a circle of radius 3 m in 63 frames: about 150 landmarks a frame, no outliers."""
    noise = {"law": law, "sigma_low_px": sigma_px[0], "sigma_high_px": sigma_px[1]}
    config = PointConfig.model_validate(
        {
            "radius_m": 3.0,
            "height_m": 5.0,
            "landmarks": landmarks,
            "noise": noise,
            "outliers": {"fraction": 0.0},
        }
    )
    return simulate_points(config, (frames - 1) / config.rate_hz, np.random.default_rng(seed))


def sigma_of(step: PointStep) -> FloatArray:
    """Return σ of each feature in the current left image, [N], px."""
    sigma: FloatArray = np.sqrt(step.curr_covariance[:, 0, 0])
    return sigma


def drive_of(world: PointWorld, *, base: NoiseModel | None = None, seed: int = 0) -> Drive:
    """Record a drive as the odometry does.

    The two columns of its prediction space are ln σ of each feature and a random number.
    """
    rng = np.random.default_rng([seed, 1])
    base = base or StudentT()
    steps = list(world.steps())
    motions = []
    phi = []
    estimator = TwoFrameEstimator(world.camera, SolverConfig())
    for step in steps:
        noise = base.predict(np.zeros((len(step.tracks), 0)))
        motions.append(estimator.solve(step.tracks, noise, guess=step.T_curr_prev).T_curr_prev)
        phi.append(np.column_stack([np.log(sigma_of(step)), rng.normal(size=len(step.tracks))]))
    counts = [len(step.tracks) for step in steps]
    return Drive(
        T_curr_prev=np.array(motions),
        numbers=np.arange(len(motions)),
        first_of_step=np.cumsum([0, *counts]),
        prev_px=np.concatenate([step.tracks.prev_px for step in steps]),
        curr_px=np.concatenate([step.tracks.curr_px for step in steps]),
        ids=np.concatenate([step.tracks.ids for step in steps]),
        phi=np.concatenate(phi),
        used=np.ones(sum(counts), np.bool_),
    )


def known(world: PointWorld, kind: str = "gt", every: int = 1) -> Supervision:
    """Return the supervision of a drive through this world.

    It is the truth at every so many frames; of a loop, that it closes; of ``none``, nothing.
    """
    if kind == "none":
        unknown = np.full((len(world), 4, 4), np.nan)
        return Supervision("none", np.arange(len(world)), unknown)
    if kind == "loop":
        return Supervision("loop", np.array([0, len(world) - 1]), np.stack([np.eye(4)] * 2))
    frames = np.arange(0, len(world), every)
    return Supervision(kind, frames, world.T_world_cam[frames])  # type: ignore[arg-type]


def sampler_of(
    drive: Drive,
    supervision: Supervision,
    camera: StereoCamera,
    *,
    base: NoiseModel | None = None,
    subset: int = 8,
    contrast: float = 3.0,
    relative: bool = False,
    seed: tuple[int, ...] = (0, 0),
) -> SubsetSampler:
    """Return a sampler whose columns are standardised over the drive."""
    coordinates = (drive.phi - drive.phi.mean(axis=0)) / drive.phi.std(axis=0)
    return SubsetSampler(
        drive=drive,
        coordinates=coordinates,
        supervision=supervision,
        camera=camera,
        base=base or StudentT(),
        solver=SolverConfig(),
        subset=subset,
        contrast=contrast,
        divides_by_predicted=relative,
        seed=seed,
    )


def in_memory(drive: Drive, world: PointWorld, kind: str = "none", every: int = 1) -> DriveInMemory:
    """Return a drive through this world together with its supervision."""
    return DriveInMemory(drive, world.camera, known(world, kind, every))


def true_motions(world: PointWorld) -> FloatArray:
    """Return the true T_curr_prev of each step, [K − 1, 4, 4]."""
    return se3.inverse(world.T_world_cam[1:]) @ world.T_world_cam[:-1]


def rmse_m(T_curr_prev: FloatArray, T_true: FloatArray) -> float:
    """Return the RMS of the translation error of motions, m."""
    return float(np.sqrt(np.mean(np.sum((T_curr_prev - T_true)[:, :3, 3] ** 2, axis=1))))
