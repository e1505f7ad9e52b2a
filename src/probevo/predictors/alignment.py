"""The precision of a feature's place, by how its window matches its anchor patch."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.predictors.base import Needs, Predictor
from probevo.tracking.tracks import Tracks

FLOOR_PX = 1e-2
"""Added to a standard deviation: no alignment is more precise than this."""
MAX_PX = 10.0
"""A larger standard deviation says no more than this: the windows have nothing in common."""


def alignment(tracks: Tracks) -> FloatArray:
    """Compute standard deviations and correlation of a feature's place, by its alignment. Ours.

    The covariance is C = s² A (H⁻¹)ₜₜ Aᵀ. H is the information of the anchor patch about the affine
    map (t, S), s² the variance of the brightness that image and patch do not share, whatever gain
    and offset, and A the map found. Texture along one direction only, blur, noise, and windows that
    look different make C larger, each in its own direction.

    Args:
        tracks: N features.

    Returns:
        ln(0.01 + σ/px) in u and v of the left image, their correlation, and ln(0.01 + σ/px) in u of
        the right image, [N, 4]. NaN where another front end gives the features; the predictor
        is refused there.
    """
    cov_px2 = tracks.alignment_cov_px2
    if cov_px2 is None:
        return np.full((len(tracks), 4), np.nan)
    # Variances of u and v in the left and in the right image, [N, 2 (image), 2 (u, v)]; what has
    # nothing in common has a variance of ∞, which is bounded.
    variance = np.minimum(np.diagonal(cov_px2, axis1=2, axis2=3), MAX_PX**2)
    log_sigma = np.log(FLOOR_PX + np.sqrt(variance))
    # C_uv/√(C_uu C_vv) in the left image; without a finite covariance, or with a perfect match, no
    # direction differs from another, and it is 0.
    product = cov_px2[:, 0, 0, 0] * cov_px2[:, 0, 1, 1]
    has_direction = np.isfinite(product) & (product > 0.0)
    correlation = np.zeros(len(tracks))
    correlation[has_direction] = cov_px2[has_direction, 0, 0, 1] / np.sqrt(product[has_direction])
    return np.column_stack([log_sigma[:, 0], correlation, log_sigma[:, 1, 0]])


ALIGNMENT = Predictor(
    name="alignment",
    columns={
        "alignment_u": "ln(0.01 + px)",
        "alignment_v": "ln(0.01 + px)",
        "alignment_correlation": "−1 … 1",
        "alignment_right": "ln(0.01 + px)",
    },
    source="ours; Nickels & Hutchinson 2002",
    needs=Needs.LEFT | Needs.ALIGNMENT,
    compute=lambda step: alignment(step.tracks),
)
