"""Tracks drawn on the image, coloured by how far each is trusted."""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import AnyArray, FloatArray, Image, IntArray

TRUST_COLORS_BGR = np.array(
    [[60, 60, 225], [50, 130, 245], [70, 205, 245], [140, 205, 110], [200, 170, 40]]
)
"""Colours of the classes of weights, from distrusted (red) to trusted (blue-green); the
colour-blind tell them apart, too."""
WIDTH_PX = 960
"""Width of a picture."""
_FONT_SCALE = 0.72
"""Size of the letters of the legend, which can still be read at half the width of the picture."""
_FONT_PX = 2
"""Thickness of their strokes."""
_SHIFT = 4
"""Fractional bits of the coordinates that are passed to OpenCV."""


def draw_tracks(
    left: Image, prev_px: FloatArray, curr_px: FloatArray, weights: FloatArray
) -> bytes:
    """Draw a line from the previous to the current place of each point, and a dot at its end.

    Args:
        left: current left image, [height, width], uint8.
        prev_px: (u_l, v_l, u_r, v_r) of each point in the previous frame, [N, 4], px.
        curr_px: the same points in the current frame, [N, 4], px.
        weights: robust weight of each in the solve, 0 (an outlier) … 1, [N].

    Returns:
        A JPEG file, ``WIDTH_PX`` wide.
    """
    scale = WIDTH_PX / left.shape[1]
    image = cv2.resize(left, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    picture = cv2.convertScaleAbs(picture, alpha=0.8)
    # The center of a pixel is at a whole number: scale about the corner of the image.
    ends = np.stack([prev_px[:, :2], curr_px[:, :2]], axis=1)
    ends = np.round(((ends + 0.5) * scale - 0.5) * 2**_SHIFT).astype(np.int32)
    num_classes = len(TRUST_COLORS_BGR)
    classes = np.clip(weights * num_classes, 0, num_classes - 1).astype(np.int64)
    # The trusted ones are drawn last, on top.
    for k, color in enumerate(TRUST_COLORS_BGR.tolist()):
        chosen = ends[classes == k]
        cv2.polylines(
            picture,
            list(chosen),
            isClosed=False,
            color=color,
            thickness=1,
            lineType=cv2.LINE_AA,
            shift=_SHIFT,
        )
        for u, v in chosen[:, 1].tolist():
            cv2.circle(
                picture,
                (u, v),
                int(2.2 * 2**_SHIFT),
                color=color,
                thickness=cv2.FILLED,
                lineType=cv2.LINE_AA,
                shift=_SHIFT,
            )
    _draw_legend(picture, np.bincount(classes, minlength=num_classes))
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 82])[1].tobytes()


def _draw_legend(picture: AnyArray, counts: IntArray) -> None:
    """Draw one box for each class, with its number of tracks, at the lower left."""
    box_w = 54
    box_h = 26
    margin = 8
    top = picture.shape[0] - margin - box_h
    x = _put_text(picture, "distrusted", margin + 4, top=top, height=box_h)
    for color, count in zip(TRUST_COLORS_BGR.tolist(), counts.tolist(), strict=True):
        cv2.rectangle(picture, (x, top), (x + box_w, top + box_h), color, cv2.FILLED)
        _write(picture, str(count), x + 6, y=top + box_h - 7, color=(20, 20, 20))
        x += box_w
    _put_text(picture, "trusted", x + 6, top=top, height=box_h)


def _put_text(picture: AnyArray, text: str, x: int, top: int, height: int) -> int:
    """Write on a dark ground; returns the column at which the text ends, px."""
    (width, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _FONT_SCALE, _FONT_PX)
    cv2.rectangle(picture, (x - 4, top), (x + width + 4, top + height), (30, 30, 30), cv2.FILLED)
    _write(picture, text, x, y=top + height - 7, color=(240, 240, 240))
    return x + width + 6


def _write(picture: AnyArray, text: str, x: int, y: int, color: tuple[int, int, int]) -> None:
    """Write text whose lower left corner is at (x, y), px."""
    cv2.putText(
        picture,
        text,
        (x, y),
        fontFace=cv2.FONT_HERSHEY_SIMPLEX,
        fontScale=_FONT_SCALE,
        color=color,
        thickness=_FONT_PX,
        lineType=cv2.LINE_AA,
    )
