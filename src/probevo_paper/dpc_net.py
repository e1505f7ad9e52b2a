"""Corrections of an odometry with right and with wrong calibration (thesis sections 6.5, 6.6.2).

Rendered drives are seen as they are, and with a focal length and a distortion that the calibration
does not know of. On both, networks learn how far the motions are off, and correct drives that they
have not seen. Beside them: the mean correction of the training, and a linear regression on the
motion.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.config import OdometryConfig
from probevo.evaluation.metrics import evaluate
from probevo.geometry import se3
from probevo.measurements.correction import MotionCorrection
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.variables import pose_of
from probevo.nets.correction_network import CorrectionNetwork, inputs_of
from probevo.nets.correction_sensor import CorrectionSensor
from probevo.nets.estimated_steps import stereo_field, view_pair
from probevo.nets.flow_field import virtual_view
from probevo.nets.image_pairs import true_poses
from probevo.odometry import StereoOdometry
from probevo.sequences.base import Sequence
from probevo.sequences.frame import Frame

UNCORRECTED = "uncorrected"
CONSTANT = "mean correction"
LINEAR = "linear regression"
ROTATION = "network, SO(3) only"
NETWORK = "network"
METHODS = (UNCORRECTED, CONSTANT, LINEAR, ROTATION, NETWORK)


class Drift(NamedTuple):
    """Errors of one method on one drive."""

    translation_percent: float | None
    """Over segments of 10 to 50 m; None where there is none."""
    rotation_deg_per_m: float | None
    anees: float | None
    """Average NEES of the steps; 6 is consistent."""


class BaselineCorrection(MotionCorrection):
    """A correction that is a function of the motion; its covariance is the odometry's.

    Args:
        network: trained on the same drives; gives the inputs.
        correction: of inputs, [1, i], and the network, ξ, [6].
        sequence: the recording.
        name: of the baseline.
    """

    def __init__(
        self,
        network: CorrectionNetwork,
        correction: Callable[[CorrectionNetwork, FloatArray], FloatArray],
        sequence: Sequence,
        name: str,
    ) -> None:
        self.network = network
        self.correction = correction
        self.camera = sequence.camera
        self.name = name

    def correct(
        self, prev_frame: Frame, frame: Frame, T_curr_prev: FloatArray, *, cov: FloatArray
    ) -> RelativePose:
        """Return the corrected motion."""
        prev_left, left, right = (
            np.asarray(image) for image in (prev_frame.left, frame.left, frame.right)
        )
        prev_view = virtual_view(prev_left, self.camera)
        field = stereo_field(prev_view, *view_pair(left, right, self.camera))
        motion = se3.log(T_curr_prev)
        xi = self.correction(self.network, inputs_of(field[None], motion[None], cov[None]))
        return RelativePose(
            se3.exp(xi) @ T_curr_prev,
            cov,
            curr=pose_of(frame.index),
            prev=pose_of(prev_frame.index),
        )


def drifts(
    sequence: Sequence, networks: Mapping[str, Path], config: OdometryConfig
) -> dict[str, Drift]:
    """Return the drift of each method on a drive with truth.

    Args:
        sequence: the drive.
        networks: files of the networks of all axes and of the rotation, by method.
        config: of the odometry.
    """
    network = CorrectionNetwork.load(networks[NETWORK])
    corrections: dict[str, MotionCorrection | None] = {
        UNCORRECTED: None,
        CONSTANT: BaselineCorrection(network, _constant, sequence, CONSTANT),
        LINEAR: BaselineCorrection(network, _linear, sequence, LINEAR),
        ROTATION: CorrectionSensor.load(networks[ROTATION], sequence.camera),
        NETWORK: CorrectionSensor.load(networks[NETWORK], sequence.camera),
    }
    return {name: drift(sequence, config, correction) for name, correction in corrections.items()}


def drift(sequence: Sequence, config: OdometryConfig, correction: MotionCorrection | None) -> Drift:
    """Return the drift of the odometry with a correction."""
    sensors = () if correction is None else (correction,)
    odometry = StereoOdometry(sequence.camera, imu=sequence.imu, config=config, sensors=sensors)
    motions = []
    covariances = []
    path = []
    for frame in sequence:
        motion = odometry.step(frame)
        motions.append(motion.T_curr_prev)
        covariances.append(motion.cov)
        path.append(motion.T_world_cam)
    metrics = evaluate(
        np.array(path), true_poses(sequence), np.array(motions[1:]), cov=np.array(covariances[1:])
    )
    return Drift(metrics.short_t_percent, metrics.short_r_deg_per_m, metrics.anees)


def _constant(network: CorrectionNetwork, inputs: FloatArray) -> FloatArray:
    xi = np.zeros(6)
    xi[list(network.space.axes)] = network.facts["constant"]
    return xi


def _linear(network: CorrectionNetwork, inputs: FloatArray) -> FloatArray:
    xi: FloatArray = network.linear(inputs)[0]
    return xi
