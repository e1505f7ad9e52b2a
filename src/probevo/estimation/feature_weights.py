"""How far a feature is trusted after a solve, whatever the tails of its noise."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.reprojection import ReprojectionSolution

DROP_BELOW = 0.1
"""Trust below which a track is no longer followed."""
USUAL_DOF = 5.0
"""Degrees of freedom for which the two bounds hold."""
TRUSTED = 0.5
"""A track with this much trust counts as trusted."""


def weights_of(solution: ReprojectionSolution, dof: FloatArray, loss: str) -> FloatArray:
    """How far each feature is trusted under that loss, [N]: one that is not the noise's own has no
    other measure."""
    return trust(solution, dof) if loss == "noise" else solution.weight


def trust(solution: ReprojectionSolution, dof: FloatArray) -> FloatArray:
    """How far each feature is trusted, [N], 0 to 1, whatever the tails of its noise, dof ν [N].

    Its robust weight against a perfect feature's, y = ν/(ν + s), says how usual a residual is only
    for one ν: half of all good features have less than a third at ν = 1.6. So the trust is the y
    that a residual as rare would have at USUAL_DOF; rarer ones are met with probability y^(ν/2) (1
    + ν (1 − y)/2), the F distribution's tail for d = 4. What is Gaussian by its model, as that of
    ``fixed`` is, has no robust weight, and all is trusted.
    """
    robust = np.isfinite(dof) & (dof != USUAL_DOF) & (solution.weight > 0.0)
    nu = np.where(robust, dof, USUAL_DOF)
    trusted: FloatArray = np.where(
        robust,
        np.interp(_rarity(nu / (nu + solution.squared), nu), _RARITIES, _TRUSTS),
        solution.weight,
    )
    return trusted


def _rarity(share: FloatArray, dof: FloatArray | float) -> FloatArray:
    """Probability of a residual of s or more, from y = ν/(ν + s)."""
    rarity: FloatArray = share ** (0.5 * dof) * (1.0 + 0.5 * dof * (1.0 - share))
    return rarity


_TRUSTS = np.linspace(0.0, 1.0, 4001)
_RARITIES = _rarity(_TRUSTS, USUAL_DOF)
