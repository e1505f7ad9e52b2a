"""A network of corrections in the odometry: images and a motion in, the corrected motion out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.geometry import se3
from probevo.measurements.correction import MotionCorrection
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.sensor import NoMeasurement
from probevo.measurements.variables import pose_of
from probevo.nets.correction_network import CorrectionNetwork, inputs_of
from probevo.nets.estimated_steps import stereo_field, view_pair
from probevo.nets.flow_field import check_field_of_view, virtual_view
from probevo.nets.trained_network import is_beyond_domain
from probevo.sequences.frame import Frame


class CorrectionSensor(MotionCorrection):
    """Corrects motions by a network.

    Args:
        network: the network.
        camera: the camera of the images, with the same errors as in the training.
        name: by which the correction is reported.

    Raises:
        InputError: the camera sees too little, or gives no images.
    """

    def __init__(self, network: CorrectionNetwork, camera: StereoCamera, name: str) -> None:
        check_field_of_view(camera)
        self.network = network
        self.camera = camera
        self.name = name

    @staticmethod
    def load(path: Path, camera: StereoCamera) -> CorrectionSensor:
        """Return the correction of a file.

        Raises:
            InputError: the file cannot be read, or the camera is not one for it.
        """
        return CorrectionSensor(CorrectionNetwork.load(path), camera, name=path.stem)

    def correct(
        self, prev_frame: Frame, frame: Frame, T_curr_prev: FloatArray, *, cov: FloatArray
    ) -> RelativePose | NoMeasurement:
        """Return T_corr T_curr_prev with the covariance of its error, or why there is none.

        Where the network corrects the rotation alone, the translation keeps its covariance.
        """
        if prev_frame.left is None or frame.left is None or frame.right is None:
            return NoMeasurement("no image")
        views = view_pair(frame.left, frame.right, self.camera)
        field = stereo_field(virtual_view(prev_frame.left, self.camera), *views)
        # The same inputs as in training: fields of three views, the motion, and its covariance
        motion = se3.log(T_curr_prev)
        estimates = self.network.estimate(inputs_of(field[None], motion[None], cov[None]))
        if is_beyond_domain(float(estimates.widening[0])):
            return NoMeasurement("out of its domain")
        # Corrected axes have the covariance of what remains of their error; their correlation with
        # the other axes is unknown after the correction, and set to zero.
        covariance = cov.copy()
        covariance[3:, :3] = 0.0
        covariance[:3, 3:] = 0.0
        axes = np.array(self.network.space.axes)
        covariance[np.ix_(axes, axes)] = estimates.covariance[0]
        return RelativePose(
            se3.exp(estimates.xi[0]) @ T_curr_prev,
            0.5 * (covariance + covariance.T),
            curr=pose_of(frame.index),
            prev=pose_of(prev_frame.index),
        )
