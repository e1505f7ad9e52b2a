"""HydraNet on images: the rotation from one image to the next, with its covariance (thesis 7)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from probevo.arrays import FloatArray
from probevo.nets.field_network import FEATURES, empty_field_networks
from probevo.nets.flow_field import CHANNELS
from probevo.nets.methods import Method
from probevo.nets.target_space import SmallRotationTargets
from probevo.nets.trained_network import (
    TrainedNetwork,
    facts_of_kind,
    read_arrays,
)

KIND = "rotation"
SPACE = SmallRotationTargets()


class RotationEstimates(NamedTuple):
    """The output of a network for N pairs of images."""

    q_curr_prev: FloatArray
    """Rotations as unit quaternions, scalar first, [N, 4]."""
    covariance: FloatArray
    """Covariances of their left perturbations, calibrated and widened, [N, 3, 3], rad²."""
    widening: FloatArray
    """Factor by which the covariance was widened because the input is unlike the training data,
    [N]."""


@dataclass(frozen=True, eq=False)
class RotationNetwork(TrainedNetwork):
    """A trained network of rotations."""

    def estimate(self, fields: FloatArray) -> RotationEstimates:
        """Return rotations and covariances of N pairs of images.

        Args:
            fields: as ``flow_field`` gives them, [N, 4, rows, columns].
        """
        predicted, widening = self.evaluate(SPACE, fields)
        factor = float(self.facts["scale"]) * widening
        return RotationEstimates(
            predicted.mean, factor[:, None, None] * predicted.covariance, widening
        )

    @staticmethod
    def load(path: Path) -> RotationNetwork:
        """Read one. A file holds data only; nothing in it is ever executed.

        Raises:
            InputError: the file cannot be read, is damaged, or holds something else.
        """
        facts = facts_of_kind(path, KIND)
        method = Method(**facts["method"])
        networks, domain = read_arrays(
            path, empty_field_networks(method, SPACE, CHANNELS), SPACE.num_outputs + FEATURES
        )
        return RotationNetwork(networks, domain, facts)


def method_of(num_heads: int) -> Method:
    """Return the method: hydra-sigma without noise on its targets, as the authors had on KITTI."""
    return Method("hydra-sigma", heads=num_heads, learns_covariance=True)
