"""Matplotlib figures as SVG inside an HTML page, in one style.

An SVG holds no fonts, links, dates or random ids: the same figure gives the same bytes.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
from markupsafe import Markup, escape
from matplotlib.figure import Figure

INK = "#1f2933"
MUTED = "#66717d"
RULE = "#e4e7eb"
BLUE = "#1769aa"
BAND = "#bcdcf5"
GREY = "#8a949e"
CYCLE = ("#1769aa", "#e08a1e", "#2a9d8f", "#b5446e", "#7a6fd0", "#7d8b3a", "#4fb3d9", "#9a6a4b")

ORANGE = CYCLE[1]

WIDTH_IN = 5.8
LEGEND_ABOVE: dict[str, Any] = {
    "loc": "lower left",
    "bbox_to_anchor": (0, 1),
    "borderaxespad": 0.2,
    "columnspacing": 1.2,
}

_STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "text.color": INK,
    "axes.labelcolor": MUTED,
    "axes.labelsize": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.edgecolor": GREY,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": RULE,
    "grid.linewidth": 0.7,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.major.size": 0.0,
    "ytick.major.size": 0.0,
    "xtick.major.pad": 5.5,  # below the 0 of the y axis, also where the x axis says 0.00
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.constrained_layout.use": True,
    "figure.facecolor": "none",
    "axes.facecolor": "none",
    "savefig.facecolor": "none",
    "svg.fonttype": "none",
    "svg.hashsalt": "probevo",
}
_RASTER_DPI = 170


@contextmanager
def figure_style() -> Iterator[None]:
    """Make figures in the style of the report within this context; Matplotlib stays as it was."""
    with matplotlib.rc_context(_STYLE):
        yield


def inline_svg(figure: Figure, name: str, description: str) -> Markup:
    """Draw a figure as an ``<svg>`` element.

    This is the one place where text is marked as safe HTML: Matplotlib escapes the texts of a
    figure itself.

    Args:
        figure: the figure.
        name: prefix of its ids, which keeps them apart from those of other figures on the page.
        description: what it shows, for readers who do not see it.
    """
    buffer = io.StringIO()
    no_metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(buffer, format="svg", dpi=_RASTER_DPI, metadata=no_metadata)
    svg = buffer.getvalue()
    # Leave out the XML declaration and the document type before the element.
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>", "", svg, flags=re.DOTALL)
    # HTML knows the namespaces by itself, and the size is for the page to decide.
    svg = re.sub(r' xmlns(:\w+)?="[^"]*"| (?:width|height)="[\d.]+pt"', "", svg)
    # Ids are local to a figure; a page holds several.
    svg = re.sub(r'(\bid="|url\(#|href="#)', rf"\g<1>{name}-", svg)
    svg = svg.replace("<svg", f'<svg role="img" aria-label="{escape(description)}"', 1)
    return Markup(svg.strip())
