"""Whether a motion is determined well enough to be used."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.config import SolverConfig


def is_determined(cov: FloatArray, config: SolverConfig) -> bool:
    """Return whether a motion is known to the limits of the settings in all directions.

    Args:
        cov: covariance of its left perturbation [ρ; φ], [6, 6], m and rad; it may not be finite.
        config: limits of the standard deviation of translation and rotation.
    """
    if not np.isfinite(cov).all():
        return False
    # Eigenvalues, not the diagonal: the direction that is not known may lie across the axes.
    translation = np.linalg.eigvalsh(cov[:3, :3])
    rotation = np.linalg.eigvalsh(cov[3:, 3:])
    return bool(
        translation[0] > 0.0
        and rotation[0] > 0.0
        and translation[-1] <= config.max_translation_sigma_m**2
        and rotation[-1] <= config.max_rotation_sigma_rad**2
    )
