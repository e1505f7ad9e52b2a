"""The page that holds a report: one self-contained HTML file, no script, nothing to fetch."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from matplotlib.figure import Figure

from probevo.files import write_atomically
from probevo.output.svg import inline_svg


def write_page(path: Path, title: str, facts: Mapping[str, str], sections: Iterable[str]) -> None:
    """Write a page in the style that all reports share.

    Args:
        path: the HTML file.
        title: heading of the page.
        facts: what a reader should know beforehand, by name.
        sections: HTML of what follows, from top to bottom.

    Raises:
        InputError: the file cannot be written.
    """
    template = Template(
        resources.files(__package__).joinpath("page_template.html").read_text("utf-8")
    )
    page = template.substitute(
        title=escape(title),
        facts="".join(
            f"<div><dt>{escape(k)}</dt><dd>{escape(v)}</dd></div>" for k, v in facts.items()
        ),
        sections="\n".join(section for section in sections if section),
    )
    write_atomically(path, page)


def panel(title: str, note: str, figure: Figure, name: str = "") -> str:
    """A figure with its title and what to know about it; ``name`` tells apart those that share a
    title."""
    svg = inline_svg(figure, name or title.lower().replace(" ", "-"), title)
    return f'<section class="panel"><h2>{title}</h2><p class="note">{note}</p>\n{svg}</section>'


def grid(panels: Iterable[str]) -> str:
    """Panels in two columns."""
    return '<div class="grid">\n' + "\n".join(panels) + "\n</div>"


def frames_section(pictures: Iterable[tuple[str, bytes]]) -> str:
    """Caption and JPEG file of some frames with their tracks (``drawing.draw_tracks``); nothing if
    there are none."""
    frames = "\n".join(
        f'<figure><img alt="{escape(caption)}"'
        f' src="data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
        for caption, jpeg in pictures
    )
    if not frames:
        return ""
    note = (
        "Lines lead from the previous to the current place of each point; the colour says how far"
        " it was trusted."
    )
    head = f'<h2>Some frames</h2><p class="note">{note}</p>'
    return f'<section class="panel">{head}\n<div class="frames">{frames}</div></section>'
