"""A network of the sun as a sensor: one image in, a ``Direction`` out."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.measurements.direction import Direction
from probevo.measurements.sensor import NoMeasurement
from probevo.measurements.variables import Variable, pose_of
from probevo.nets.flow_field import check_field_of_view
from probevo.nets.sun_network import SunNetwork
from probevo.nets.sun_views import begins_period, read_sun, sun_field
from probevo.nets.trained_network import is_beyond_domain
from probevo.sequences.base import Sequence
from probevo.sequences.frame import Frame


class SunFromImages:
    """Measures the direction of the sun by a network, twice a second.

    Args:
        network: the network.
        camera: the camera of the images, which may be another one than in the training.
        known: where the sun stands at a stamp in ns, [3]: in the world, which is the first camera,
            or with ``north`` in east, north and up, as ``sun_in_enu`` gives it.
        name: by which the sensor is reported.
        north: ``NORTH`` if ``known`` is in east, north and up.

    Raises:
        InputError: the camera sees too little, or gives no images.
    """

    def __init__(
        self,
        network: SunNetwork,
        camera: StereoCamera,
        known: Callable[[int], FloatArray],
        *,
        name: str = "sun",
        north: Variable | None = None,
    ) -> None:
        check_field_of_view(camera)
        self.network = network
        self.camera = camera
        self.known = known
        self.name = name
        self.north = north

    @staticmethod
    def load(path: Path, sequence: Sequence) -> SunFromImages:
        """Return the sensor of a file, for a recording whose ``sun.txt`` says where the sun stands.

        Raises:
            InputError: a file cannot be read, or the camera is not one for it.
        """
        sun_world = read_sun(sequence.path)
        network = SunNetwork.load(path)
        return SunFromImages(network, sequence.camera, lambda _: sun_world, name=path.stem)

    def __call__(self, prev_frame: Frame, frame: Frame) -> list[Direction] | NoMeasurement:
        """Return the direction of the sun with its covariance, or why there is none."""
        if not begins_period(prev_frame, frame):
            return NoMeasurement("measured less than half a second ago")
        if frame.left is None:
            return NoMeasurement("no image")
        # An image that is repeated is of an earlier pose; behind several, the previous frame has
        # none.
        if prev_frame.left is None or np.array_equal(prev_frame.left, frame.left):
            return NoMeasurement("repeated image")
        estimates = self.network.estimate(sun_field(frame.left, self.camera)[None])
        if is_beyond_domain(float(estimates.widening[0])):
            return NoMeasurement("out of its domain")
        measured = Direction(
            pose_of(frame.index),
            estimates.directions[0],
            self.known(frame.stamp_ns),
            self.network.correlation * estimates.covariance[0],
            north=self.north,
        )
        return [measured]
