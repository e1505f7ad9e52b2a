"""The whole pipeline on rendered scenes: a small drift in clean scenes, more in degraded ones."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import probevo as pv
from probevo.estimation.motion_estimate import MotionEstimate
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.geometry import se3
from probevo_sim.scene.config import Effects, RigConfig, SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene

RIG = RigConfig(width_px=620, height_px=188, focal_px=360.0)
"""Half of KITTI's resolution."""


def drive(scene: SceneRecording) -> tuple[Metrics, list[MotionEstimate]]:
    """Run the odometry with the shipped defaults, and evaluate it."""
    odometry = pv.StereoOdometry(scene.camera, imu=scene.imu)
    motions = [odometry.step(frame) for frame in scene][1:]
    T_curr_prev = np.array([m.T_curr_prev for m in motions])
    cov = np.array([m.cov for m in motions])
    assert scene.truth is not None
    T_world_cam = se3.chain_motions(T_curr_prev)
    return evaluate(T_world_cam, scene.truth.T_world_cam, T_curr_prev, cov=cov), motions


@pytest.mark.slow
@pytest.mark.usefixtures("coarsely_rendered")
def test_a_clean_drive_drifts_little_and_noise_increases_the_error() -> None:
    """Drift is below 0.5 % without effects; with sensor noise, steps are half as wrong again.

    The drive is 18 m through the city. Noise is added after rendering, so that both drives can use
    the same renderings.
    """
    scene = open_scene(SceneConfig(preset="city", seed=1, distance_m=18.0, rig=RIG))
    scene.renderer.pair = cache(scene.renderer.pair)  # type: ignore[method-assign]
    noisy_scene = replace(
        scene, config=scene.config.model_copy(update={"effects": Effects(noise=1.0)})
    )
    clean, motions = drive(scene)
    assert clean.short_t_percent is not None
    assert clean.short_t_percent < 0.5
    assert all(motion.status is pv.Status.OK for motion in motions)
    noisy, _ = drive(noisy_scene)
    assert clean.rpe_t_m is not None
    assert noisy.rpe_t_m is not None
    assert noisy.rpe_t_m > 1.5 * clean.rpe_t_m
