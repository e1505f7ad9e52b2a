"""The pictures of a frame: its features coloured by their weight, and by each predictor."""

from __future__ import annotations

import numpy as np

from probevo.output.feature_pictures import draw_features, value_shades, weight_shades
from probevo.output.inspection_data import FrameView, ModelView


def frame_pictures(model: ModelView | None, frame: FrameView) -> dict[str, tuple[str, bytes]]:
    """Caption and JPEG file of each picture, by the name of its file: weights first, then the
    columns of φ.

    With a model, the columns come in the order in which α varies with them, and after the weights
    the distance from the training data, in units of the median one of the training samples.
    """
    shown = {}
    if frame.beta is not None:
        shown["weight"] = ("Weight", weight_shades(frame.beta))
    if frame.radius is not None and model is not None:
        far = int(np.sum(frame.radius > model.far_radius))
        relative = frame.radius / max(float(np.median(model.radius)), 1e-9)
        caption = f"Distance from the training data: {far} of {len(relative)} features are far"
        shown["distance"] = (
            caption,
            value_shades("distance to the K-th nearest training sample", "1 is usual", relative),
        )
    names = list(frame.columns)
    for m in model.order if model is not None else range(len(names)):
        values = frame.phi[:, m]
        unknown = int(np.isnan(values).sum())
        caption = names[m] + (f": undefined for {unknown} of {len(values)}" if unknown else "")
        shown[names[m]] = (caption, value_shades(names[m], frame.columns[names[m]], values))
    return {
        name: (caption, draw_features(frame.left, frame.size_px, frame.uv, shades=shades))
        for name, (caption, shades) in shown.items()
    }
