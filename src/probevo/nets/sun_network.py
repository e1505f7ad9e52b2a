"""Sun-BCNN, small: the direction of the sun from one image, with its covariance (thesis 5)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from probevo.arrays import FloatArray
from probevo.config.networks import NetworkSettings
from probevo.nets.field_network import empty_field_networks
from probevo.nets.methods import Method
from probevo.nets.sun_space import SunTargets
from probevo.nets.sun_views import CHANNELS, NUM_STATISTICS, image_statistics
from probevo.nets.trained_network import (
    TrainedNetwork,
    facts_of_kind,
    read_arrays,
)

KIND = "sun"
SPACE = SunTargets()


class SunEstimates(NamedTuple):
    """The output of a network for N images."""

    directions: FloatArray
    """Unit vectors towards the sun in the camera, [N, 3]."""
    covariance: FloatArray
    """Covariances in the tangent plane, along azimuth and zenith angle, calibrated and widened,
    [N, 2, 2]."""
    widening: FloatArray
    """Factor by which the covariance was widened because the input is unlike the training data,
    [N]."""


@dataclass(frozen=True, eq=False)
class SunNetwork(TrainedNetwork):
    """A trained network of the sun."""

    @property
    def correlation(self) -> float:
        """Factor on the covariance of each measurement of a run.

        Errors of successive ones are alike, and their sum has to be consistent.
        """
        return float(self.facts["correlation"])

    def estimate(self, fields: FloatArray) -> SunEstimates:
        """Return directions and covariances of N images.

        Args:
            fields: as ``sun_field`` gives them, [N, 4, rows, columns].
        """
        predicted, widening = self.evaluate(SPACE, fields)
        factor = float(self.facts["scale"]) * widening
        return SunEstimates(predicted.mean, factor[:, None, None] * predicted.covariance, widening)

    def domain_features(self, inputs: FloatArray, trunk_output: FloatArray) -> FloatArray:
        """Return statistics of the images, [N, 7].

        The trunk is made to see nothing but the sun: to it, night, fog and an even grey may look
        like any other image.
        """
        return image_statistics(inputs)

    @staticmethod
    def load(path: Path) -> SunNetwork:
        """Read one. A file holds data only; nothing in it is ever executed.

        Raises:
            InputError: the file cannot be read, is damaged, or holds something else.
        """
        facts = facts_of_kind(path, KIND, numbers=("correlation",))
        method = Method(**facts["method"])
        networks, domain = read_arrays(
            path, empty_field_networks(method, SPACE, CHANNELS), NUM_STATISTICS
        )
        return SunNetwork(networks, domain, facts)


def method_of(settings: NetworkSettings) -> Method:
    """Return the method: hydra-sigma, or one of the baselines whose covariance is a spread."""
    if settings.method == "dropout":
        return Method("dropout", passes=settings.passes, dropout=settings.dropout)
    if settings.method == "ensemble":
        return Method("ensemble", networks=settings.networks, bootstrap=True)
    return Method(
        "hydra-sigma", networks=settings.networks, heads=settings.heads, learns_covariance=True
    )


def method_text(method: Method) -> str:
    """Return the method and the number of estimates of one image, in words."""
    if method.passes > 1:
        return f"{method.name} of {100.0 * method.dropout:g} %, {method.passes} passes"
    parts = [method.name]
    if method.networks > 1:
        parts.append(f"{method.networks} networks")
    if method.heads > 1:
        parts.append(f"{method.heads} heads")
    return ", ".join(parts)
