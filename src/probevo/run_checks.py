"""Checks of a recording, its settings and its noise model, made before any long work begins."""

from __future__ import annotations

import numpy as np

from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.noise import NoiseModel
from probevo.noise.named import check_model_camera
from probevo.predictors import space_for
from probevo.run_config import RunConfig
from probevo.sequences import Sequence
from probevo.sequences.pose_files import FARTHEST_M


def check_run(sequence: Sequence, config: RunConfig, noise: NoiseModel) -> None:
    """Refuse a run whose faults would otherwise only show at its end, or not at all.

    Raises:
        InputError: the noise model needs unknown predictors or was learned with another camera, the
            settings need an IMU that the recording does not have, or a true position is out of
            bounds.
    """
    space_for(noise.columns).check_recording(sequence)
    if not config.any_camera:
        check_model_camera(
            config.noise,
            noise,
            sequence.camera,
            or_else="Or take it all the same, with --any-camera, and look how far it holds.",
        )
    check_imu(sequence, config)
    truth = sequence.truth
    if truth is not None and (np.abs(truth.T_world_cam[:, :3, 3]) > FARTHEST_M).any():
        raise InputError(
            sequence.path,
            f"a true position is over {FARTHEST_M:g} m from the first.",
            "Correct the ground truth; positions are in metres.",
        )


def check_imu(sequence: Sequence, config: OdometryConfig) -> None:
    """Refuse settings that need an IMU if the recording has none.

    Raises:
        InputError: names the settings.
    """
    if sequence.imu is not None:
        return
    needing = []
    if config.gyro.prior:
        needing.append("--gyro.prior")
    if config.ransac.rotation_from == "gyro":
        needing.append("--ransac.rotation-from gyro")
    if needing:
        raise InputError(
            " and ".join(needing),
            f"the recording {sequence.path} has no IMU.",
            "Remove the flag, or change the setting in the file given by --config.",
        )
