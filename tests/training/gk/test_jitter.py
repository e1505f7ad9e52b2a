"""The covariance of the rig's jitter is learned by EM, from drives through worlds where it is
known."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.camera.rig_jitter import jitter_offsets
from probevo.config import OdometryConfig, SolverConfig
from probevo.config.training import KernelSettings, TrainSettings
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.two_frame import TwoFrameEstimator
from probevo.noise import StudentT
from probevo.noise.metric import Metric
from probevo.training.gk.expectation_maximization import learn_kernel, learn_student_t
from probevo.training.gk.jitter import CommonUnknowns, initial_covariance, learned_covariance
from probevo.training.progress import TrainingProgress
from probevo.training.supervised_drive import DriveInMemory
from probevo.training.trainer import TrainingContext
from probevo_sim.point_world import PointWorld
from training.supervised_drives import drive_of, in_memory, point_world

SIGMA_PX = np.array([0.3, 0.5, 0.2])
"""Of pitch, yaw and roll, times the focal length."""
NOISE_PX = 0.25
"""σ of each coordinate in a world of law ``constant``: the middle of its range."""


@pytest.fixture(autouse=True)
def fewer_held_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare hyperparameters by a quarter of the features, and save most of the time of it."""
    monkeypatch.setattr("probevo.noise.gk.folds.MAX_HELD_OUT", 150)


def angles_px(frames: int, sigma_px: FloatArray) -> FloatArray:
    """Return the angles by which the right camera is turned in each frame, times f, [K, 3], px."""
    angles: FloatArray = sigma_px * np.random.default_rng(7).normal(size=(frames, 3))
    return angles


def drawn_sigma_px(frames: int = 120) -> FloatArray:
    """Return what these happen to scatter by, from frame to frame, [3], px."""
    changes = np.diff(angles_px(frames, SIGMA_PX), axis=0)
    sigma_px: FloatArray = np.sqrt(0.5 * np.mean(changes**2, axis=0))
    return sigma_px


def loose_rig(world: PointWorld, sigma_px: FloatArray) -> PointWorld:
    """Turn the right camera in each frame."""
    pixels = world.pixels.copy()
    for frame, angle_px in enumerate(angles_px(len(world), sigma_px)):
        rows = slice(world.first_of_frame[frame], world.first_of_frame[frame + 1])
        offsets = jitter_offsets(pixels[rows], world.camera)
        pixels[rows, 2:] += offsets @ (angle_px / world.camera.fu_px)
    return replace(world, pixels=pixels)


def drive_through(
    law: str, sigma_px: FloatArray, *, kind: str = "none", frames: int = 120
) -> DriveInMemory:
    world = point_world(law, frames=frames, sigma_px=(0.1, 0.4))
    world = loose_rig(world, sigma_px)
    base = StudentT(jitter_cov=initial_covariance())
    return in_memory(drive_of(world, base=base), world, kind)


def context_of(drive: DriveInMemory, settings: TrainSettings) -> TrainingContext:
    return TrainingContext(
        drives=[drive],
        metric=Metric.fitted(drive.drive.phi, ("ln_sigma", "random")),
        settings=settings,
        recordings=[{"name": "circle", "frames": 120}],
        progress=TrainingProgress(),
    )


def sigma_px_of(model: StudentT, drive: DriveInMemory) -> FloatArray:
    assert model.jitter_cov is not None
    sigma_px: FloatArray = drive.camera.fu_px * np.sqrt(np.diagonal(model.jitter_cov))
    return sigma_px


@pytest.mark.parametrize("kind", ["none", "gt"])
def test_a_known_covariance_is_recovered(kind: str) -> None:
    """Within 15 % of what was drawn, though EM starts with an eighth of the yaw; and the noise of
    the features within 5 %."""
    drive = drive_through("constant", SIGMA_PX, kind=kind)
    settings = TrainSettings(kind="student-t", gk=KernelSettings(time_correlation=kind == "none"))
    model = learn_student_t(context_of(drive, settings))
    np.testing.assert_allclose(sigma_px_of(model, drive), drawn_sigma_px(), rtol=0.15)
    np.testing.assert_allclose(np.sqrt(np.diagonal(model.scale_)), NOISE_PX, rtol=0.05)


def test_of_a_rigid_rig_little_is_learned() -> None:
    """Less than an eighth of the noise of a feature, though EM starts with 0.06 px of yaw."""
    drive = drive_through("constant", np.zeros(3))
    settings = TrainSettings(kind="student-t", gk=KernelSettings(time_correlation=False))
    model = learn_student_t(context_of(drive, settings))
    assert (sigma_px_of(model, drive) < 0.13 * NOISE_PX).sum() >= 2
    assert (sigma_px_of(model, drive) < 0.25 * NOISE_PX).all()


def test_the_kernel_learns_it_as_well() -> None:
    """Beside noise that differs from row to row."""
    drive = drive_through("row", SIGMA_PX)
    settings = TrainSettings(
        kind="gk",
        gk=KernelSettings(
            neighbors=150, prior_counts=8.0, iterations=2, centers=200, time_correlation=False
        ),
    )
    model = learn_kernel(context_of(drive, settings))
    assert model.jitter_cov is not None
    sigma_px = drive.camera.fu_px * np.sqrt(np.diagonal(model.jitter_cov))
    np.testing.assert_allclose(sigma_px, drawn_sigma_px(), rtol=0.15)
    np.testing.assert_array_equal(model.predict(drive.drive.phi).jitter_cov, model.jitter_cov)


@pytest.mark.parametrize(
    "settings",
    [
        TrainSettings(odometry=OdometryConfig(self_calibration=False)),
        TrainSettings(odometry=OdometryConfig(solver=SolverConfig(method="alignment"))),
        TrainSettings(gk=KernelSettings(bias=True)),
        TrainSettings(kind="gk", gk=KernelSettings(variant="published", refers_to="residual")),
    ],
    ids=["taken as calibrated", "alignment", "a bias of all features", "as published"],
)
def test_a_rig_without_jitter_learns_none(settings: TrainSettings) -> None:
    drive = drive_through("constant", np.zeros(3), frames=20)
    assert learn_student_t(context_of(drive, settings)).jitter_cov is None


def test_errors_at_a_known_motion_leave_the_jitter_uncertain() -> None:
    """Beside a known motion, η still has a covariance, which is that of the solve given ξ."""
    drive = drive_through("constant", SIGMA_PX, frames=4)
    noise = StudentT(jitter_cov=initial_covariance()).predict(drive.drive.phi)
    rows = drive.drive.rows(0)
    estimate = TwoFrameEstimator(drive.camera, SolverConfig()).estimate(
        drive.drive.tracks(0),
        noise.subset(np.arange(rows.start, rows.stop)),
        DisparityFilter.none(),
        guess=drive.drive.T_curr_prev[0],
    )
    solution = estimate.solution
    known = CommonUnknowns.of(estimate, np.zeros((6, 6)))
    assert not known.cov[:6].any()
    information = np.linalg.inv(solution.full_cov)
    np.testing.assert_allclose(known.cov[6:, 6:], np.linalg.inv(information[6:, 6:]), rtol=1e-6)
    # With the motion's own covariance, the two have the covariance of the solve.
    both = CommonUnknowns.of(estimate, solution.cov)
    np.testing.assert_allclose(both.cov, solution.full_cov, rtol=1e-6, atol=1e-12)


def test_changes_that_are_as_expected_hold_the_covariance() -> None:
    cov = np.diag([1e-8, 4e-8, 2e-8])
    moments = np.stack([2.0 * cov] * 5)
    np.testing.assert_allclose(learned_covariance(moments), cov, atol=1e-11)
