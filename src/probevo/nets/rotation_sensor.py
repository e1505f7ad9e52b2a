"""A network of rotations as a sensor: two frames in, a ``RelativeRotation`` out."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.camera.stereo import StereoCamera
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.sensor import NoMeasurement
from probevo.measurements.variables import pose_of
from probevo.nets.flow_field import check_field_of_view, field_of_images
from probevo.nets.rotation_network import RotationNetwork
from probevo.nets.trained_network import is_beyond_domain
from probevo.sequences.frame import Frame


class RotationSensor:
    """Measures the rotation between two left images by a network.

    Args:
        network: the network.
        camera: the camera of the images, which may be another one than in the training.
        name: by which the sensor is reported.

    Raises:
        InputError: the camera sees too little, or gives no images.
    """

    def __init__(self, network: RotationNetwork, camera: StereoCamera, name: str) -> None:
        check_field_of_view(camera)
        self.network = network
        self.camera = camera
        self.name = name

    @staticmethod
    def load(path: Path, camera: StereoCamera) -> RotationSensor:
        """Return the sensor of a file.

        Raises:
            InputError: the file cannot be read, or the camera is not one for it.
        """
        return RotationSensor(RotationNetwork.load(path), camera, name=path.stem)

    def __call__(self, prev_frame: Frame, frame: Frame) -> list[RelativeRotation] | NoMeasurement:
        """Return the rotation with its covariance, or why there is none."""
        if prev_frame.left is None or frame.left is None:
            return NoMeasurement("no image")
        if np.array_equal(prev_frame.left, frame.left):
            # A frozen image shows no motion, whatever the camera did.
            return NoMeasurement("repeated image")
        field = field_of_images(prev_frame.left, frame.left, self.camera)
        estimates = self.network.estimate(field[None])
        if is_beyond_domain(float(estimates.widening[0])):
            return NoMeasurement("out of its domain")
        measured = RelativeRotation(
            Rotation.from_quat(estimates.q_curr_prev[0], scalar_first=True).as_matrix(),
            estimates.covariance[0],
            curr=pose_of(frame.index),
            prev=pose_of(prev_frame.index),
        )
        return [measured]
