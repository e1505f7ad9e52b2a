"""The page that holds a report: one self-contained HTML file, no script, nothing to fetch."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from markupsafe import Markup
from matplotlib.figure import Figure

from probevo.output.svg import inline_svg
from probevo.output.table import Table
from probevo.output.templating import rendered
from probevo.storage.files import write_atomically

_TRUST_NOTE = (
    "Lines lead from the previous to the current place of each point; the colour says how far it"
    " was trusted. In the legend: the number of points of each colour."
)


def write_page(
    path: Path, title: str, facts: Mapping[str, str], sections: Iterable[str | Markup]
) -> None:
    """Write a page in the style that all reports share.

    Args:
        path: the HTML file.
        title: heading of the page.
        facts: what a reader should know beforehand, by name.
        sections: what follows, from top to bottom: HTML that the functions below have made. Empty
            ones are left out; plain text is escaped.

    Raises:
        InputError: the file cannot be written.
    """
    write_atomically(path, rendered("page", title=title, facts=facts, sections=list(sections)))


def panel(title: str, note: str, figure: Figure, name: str = "") -> Markup:
    """Show a figure below its title and a note.

    Args:
        title: heading.
        note: what to know about the figure; empty for none.
        figure: the figure.
        name: prefix of the ids in the figure, distinct on a page; by default from the title.
    """
    svg = inline_svg(figure, name or title.lower().replace(" ", "-"), title)
    return body_panel(title, [note], svg)


def row_panel(
    title: str, note: str, figures: Sequence[Figure], name: str = "", *, style: str = ""
) -> Markup:
    """Show figures of half the page's width side by side, on a narrow screen below each other.

    Args:
        title: heading.
        note: what to know about the figures; empty for none.
        figures: the figures, from left to right.
        name: prefix of the ids in the figures, distinct on a page; by default from the title.
        style: "narrow" for figures of a third of the page's width.
    """
    prefix = name or title.lower().replace(" ", "-")
    drawn = [inline_svg(figure, f"{prefix}-{k}", title) for k, figure in enumerate(figures)]
    return body_panel(title, [note], rendered("row", bodies=drawn, style=style))


def body_panel(title: str, notes: Iterable[str], body: str | Markup, style: str = "") -> Markup:
    """Show HTML, or plain text, below a title and notes.

    Args:
        title: heading.
        notes: one a line; empty ones are left out.
        body: what follows.
        style: a class of ``style.css`` for the panel, such as "warning".
    """
    shown = [note for note in notes if note]
    return rendered("panel", title=title, notes=shown, body=body, style=style)


def table_panel(title: str, notes: Iterable[str], table: Table, style: str = "figures") -> Markup:
    """Show a table below a title and notes; ``style`` is a class of ``style.css``."""
    return body_panel(title, notes, table.as_html(style))


def grid(panels: Iterable[str | Markup]) -> Markup:
    """Show panels in two columns."""
    return rendered("grid", panels=[shown for shown in panels if shown])


def heading(title: str, aside: str = "") -> Markup:
    """Head several sections; ``aside`` stands beside the title in small print."""
    return rendered("heading", title=title, aside=aside)


def details(title: str, text: str) -> Markup:
    """Show text that is folded away until the reader opens it; nothing if it is empty."""
    return rendered("details", title=title, text=text) if text else Markup("")


def pictures(captioned: Iterable[tuple[str, bytes]], style: str = "") -> Markup:
    """Show pictures side by side: caption and JPEG file of each."""
    encoded = [(caption, base64.b64encode(jpeg).decode()) for caption, jpeg in captioned]
    return rendered("frames", pictures=encoded, style=style)


def frames_section(captioned: Sequence[tuple[str, bytes]]) -> Markup:
    """Show caption and JPEG file of some frames with their tracks (``drawing.draw_tracks``).

    Without any, nothing is shown.
    """
    if not captioned:
        return Markup("")
    return body_panel("Some frames", [_TRUST_NOTE], pictures(captioned))
