"""Features drawn on the image, coloured by a predictor or by their weight (PROBE Figs. 6, 7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from probevo.arrays import AnyArray, BoolArray, FloatArray, Image
from probevo.output.drawing import TRUST_COLORS_BGR
from probevo.output.table import readable

LEGEND_PX = 46
"""Height of the legend below a picture that is ``REFERENCE_PX`` wide."""
REFERENCE_PX = 720
"""Width of a picture at which sizes are stated; dots and legend grow in proportion to it."""
READABLE_PX = 960
"""Smaller images are enlarged, by a whole factor, to about this width."""
_QUANTILE = 0.02
"""Share of the values on either side that has the colour of the end: the colours would else be
spent on a few extreme values."""
_GROUND = 70
_DIMMED = 0.75
_RING = (190, 190, 190)
_OUTLINE = (25, 25, 25)
_MARK = (225, 80, 255)
_DPI = 110
_BAR_FROM_PX = 96
_DARK = "#1f2933"
_BRIGHT = "#f5f7f9"
_SHIFT = 4
"""Fractional bits of the coordinates that are passed to OpenCV."""


@dataclass(frozen=True)
class Shades:
    """The colour of each of N features, and what the legend says of it."""

    place: FloatArray
    """Place of each feature on the bar, [N], from 0 to 1; NaN where it has no value."""
    colors_bgr: FloatArray
    """Colours along the bar, [256, 3]."""
    name: str
    """Meaning of the colours, with its unit."""
    ends: tuple[str, str]
    """Numbers at both ends of the bar."""
    middle: str = ""
    """Number in its middle."""


def value_shades(name: str, unit: str, values: FloatArray, *, logarithmic: bool = False) -> Shades:
    """Colour values from dark blue to yellow, which the colour-blind tell apart, too.

    Args:
        name: name of the values.
        unit: their unit.
        values: [N]; NaN where undefined.
        logarithmic: whether equal ratios, and not differences, look alike.
    """
    low, high, ends = _limits(values)
    if logarithmic and low > 0.0:
        low = float(np.log(low))
        high = float(np.log(high))
        values = np.log(values)
    colors = matplotlib.colormaps["viridis"](np.linspace(0.06, 1.0, 256))[:, 2::-1] * 255.0
    title = f"{name}, {unit}" if unit else name
    if high > low:
        return Shades(np.clip((values - low) / (high - low), 0.0, 1.0), colors, title, ends=ends)
    return Shades(
        np.where(np.isnan(values), np.nan, 0.5), np.tile(colors[128], (256, 1)), title, ends=ends
    )


def weight_shades(beta: FloatArray) -> Shades:
    """Colour weights β, [N], from trusted, blue-green, to distrusted, red.

    The scale is logarithmic, with β = 1 in its middle.
    """
    logs = np.log(beta)
    reach = max(float(np.quantile(np.abs(logs), 1.0 - _QUANTILE)), 0.01) if len(beta) else 1.0
    knots = np.linspace(0.0, 1.0, len(TRUST_COLORS_BGR))
    positions = np.linspace(0.0, 1.0, 256)
    colors = np.stack(
        [np.interp(positions, knots, channel) for channel in TRUST_COLORS_BGR[::-1].T], axis=1
    )
    low, high = np.exp([-reach, reach]).tolist()
    ends = _end_texts(low, high, beta)
    place = np.clip(0.5 + 0.5 * logs / reach, 0.0, 1.0)
    return Shades(
        place,
        colors,
        "β, by which the noise is scaled: trusted … distrusted",
        ends=ends,
        middle="1",
    )


def draw_features(
    left: Image | None,
    size_px: tuple[int, int],
    uv: FloatArray,
    shades: Shades,
    out_of_domain: BoolArray | None = None,
) -> bytes:
    """Draw a dot at each feature of the left image, and the legend below it.

    Features without a value are hollow grey rings.

    Args:
        left: current left image, [height, width], uint8; None draws on a plain ground.
        size_px: its (width, height). The picture is as large, or a whole multiple if it is small
            (``enlargement``); ``legend_height`` comes below.
        uv: places of the features, [N, 2], px.
        shades: their colours.
        out_of_domain: which are out of a model's domain, [N]: they get a magenta ring, and the
            legend counts them.

    Returns:
        A JPEG file.
    """
    # The image, dimmed, so that the features stand out; or a plain ground.
    scale = enlargement(size_px)
    plain = np.full((size_px[1], size_px[0]), _GROUND, np.uint8)
    ground = plain if left is None else cv2.convertScaleAbs(left, None, _DIMMED)
    image = cv2.resize(ground, None, fx=scale, fy=scale, interpolation=cv2.INTER_LINEAR)
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    # The center of a pixel is at a whole number: scale about the corner of the image.
    centers = np.round(((uv + 0.5) * scale - 0.5) * 2**_SHIFT).astype(np.int64)
    unknown = np.isnan(shades.place)
    size = picture.shape[1] / REFERENCE_PX
    for u, v in centers[unknown].tolist():
        _circle(picture, (u, v), 3.0 * size, color=_RING, thickness=max(1, round(size)))
    colors = shades.colors_bgr[np.round(255.0 * shades.place[~unknown]).astype(np.int64)]
    # The rarer, extreme values on top of the others.
    order = np.argsort(np.abs(shades.place[~unknown] - 0.5), kind="stable")
    for (u, v), color in zip(
        centers[~unknown][order].tolist(), colors[order].tolist(), strict=True
    ):
        _circle(picture, (u, v), 3.8 * size, color=_OUTLINE, thickness=cv2.FILLED)
        _circle(picture, (u, v), 3.0 * size, color=color, thickness=cv2.FILLED)
    num_out_of_domain = 0 if out_of_domain is None else int(out_of_domain.sum())
    if out_of_domain is not None:
        for u, v in centers[out_of_domain].tolist():
            _circle(picture, (u, v), 5.6 * size, color=_MARK, thickness=max(1, round(1.4 * size)))
    legend = _legend(
        picture.shape[1], shades, int(unknown.sum()), num_out_of_domain=num_out_of_domain
    )
    return cv2.imencode(".jpg", np.vstack([picture, legend]), [cv2.IMWRITE_JPEG_QUALITY, 85])[
        1
    ].tobytes()


def enlargement(size_px: tuple[int, int]) -> int:
    """Choose the whole factor by which an image is enlarged, so that its features are distinct."""
    return max(1, round(READABLE_PX / size_px[0]))


def legend_height(picture_width_px: int) -> int:
    """Compute the height of the legend below a picture of that width, px."""
    return round(LEGEND_PX * picture_width_px / REFERENCE_PX)


def _limits(values: FloatArray) -> tuple[float, float, tuple[str, str]]:
    """Choose the values at the ends of the bar, and their texts; zeros and "" without a value."""
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return 0.0, 0.0, ("", "")
    low, high = np.quantile(known, [_QUANTILE, 1.0 - _QUANTILE]).tolist()
    return low, high, _end_texts(low, high, known)


def _end_texts(low: float, high: float, values: FloatArray) -> tuple[str, str]:
    """Format the numbers at the ends, and mark those beyond which there are values."""
    low_text = readable(low)
    if (values < low).any():
        low_text = f"≤ {low_text}"
    high_text = readable(high)
    if (values > high).any():
        high_text = f"≥ {high_text}"
    return low_text, high_text


def _circle(
    picture: AnyArray,
    center: tuple[int, int],
    radius: float,
    color: Sequence[float],
    thickness: int,
) -> None:
    """Draw a circle; ``center`` has ``_SHIFT`` fractional bits, ``radius`` is in px."""
    cv2.circle(
        picture,
        center,
        round(radius * 2**_SHIFT),
        color=color,
        thickness=thickness,
        lineType=cv2.LINE_AA,
        shift=_SHIFT,
    )


def _legend(width_px: int, shades: Shades, num_unknown: int, num_out_of_domain: int) -> Image:
    """Draw the legend: what the colours mean, and the bar with its numbers.

    It also counts the features without a value, and those out of domain. Places are those in a
    picture that is ``REFERENCE_PX`` wide.
    """
    dpi = _DPI * width_px / REFERENCE_PX
    width = REFERENCE_PX
    # A hundredth more, so that rounding does not lose a pixel.
    figure = Figure(
        ((width_px + 0.01) / dpi, (legend_height(width_px) + 0.01) / dpi), dpi, facecolor=_DARK
    )
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    words: dict[str, Any] = {"color": _BRIGHT, "fontsize": 8.5, "va": "center"}
    axes.text(12, 14, shades.name, **words)
    if num_unknown:
        axes.text(
            width - 12, 14, f"○ {num_unknown} of {len(shades.place)} undefined", ha="right", **words
        )
    if num_out_of_domain:
        place = width - 12 - 165 * bool(num_unknown)
        color = "#{:02x}{:02x}{:02x}".format(*_MARK[::-1])
        text = f"○ {num_out_of_domain} of {len(shades.place)} out of domain"
        axes.text(place, 14, text, ha="right", **(words | {"color": color}))
    if any(shades.ends):
        start = _BAR_FROM_PX
        end = width - _BAR_FROM_PX
        row = 33
        bar = np.clip(shades.colors_bgr[None, :, ::-1] / 255.0, 0.0, 1.0)
        axes.imshow(
            bar, extent=(start, end, row + 5, row - 5), aspect="auto", interpolation="nearest"
        )
        axes.text(start - 8, row, shades.ends[0], ha="right", **words)
        axes.text(end + 8, row, shades.ends[1], ha="left", **words)
        axes.text(
            0.5 * width,
            row,
            shades.middle,
            ha="center",
            **(words | {"color": _DARK, "fontsize": 7.5}),
        )
    axes.set(xlim=(0, width), ylim=(LEGEND_PX, 0))
    axes.set_axis_off()
    canvas.draw()  # type: ignore[no-untyped-call]
    rgba = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    return np.ascontiguousarray(rgba[:, :, 2::-1])
