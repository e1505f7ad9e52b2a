"""The pictures of a frame as a generalized kernel sees it: its features coloured by their σ, ν, and
used predictors."""

from __future__ import annotations

import numpy as np

from probevo.output.feature_pictures import draw_features, value_shades
from probevo.output.inspection_data import FrameView
from probevo.output.inspection_kernel_data import KernelView, size_px


def kernel_pictures(view: KernelView, frame: FrameView) -> dict[str, tuple[str, bytes]]:
    """Caption and JPEG file of each picture, by the name of its file: σ, ν, and the used columns in
    their order.

    Features out of the model's domain are marked in all of them.

    Raises:
        ValueError: the frame does not hold what the model predicts.
    """
    if frame.noise is None:
        raise ValueError("the frame holds no noise")
    out_of_domain = frame.noise.out_of_domain
    size = size_px(frame.noise.scale)
    dof = frame.noise.dof
    shown = {
        "sigma": (
            "σ, as predicted",
            value_shades("σ, geometric mean, logarithmic", "px", size, logarithmic=True),
        ),
        "dof": (
            "ν, as predicted: small where outliers are to be expected",
            value_shades("ν, degrees of freedom, logarithmic", "", dof, logarithmic=True),
        ),
    }
    for column in view.used:
        values = frame.phi[:, column.index]
        unknown = int(np.isnan(values).sum())
        caption = column.name + (f": undefined for {unknown} of {len(values)}" if unknown else "")
        shown[column.name] = (
            caption,
            value_shades(column.name, frame.columns[column.name], values),
        )
    return {
        name: (
            caption,
            draw_features(
                frame.left, frame.size_px, frame.uv, shades=shades, out_of_domain=out_of_domain
            ),
        )
        for name, (caption, shades) in shown.items()
    }
