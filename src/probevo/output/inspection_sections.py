"""What the pages on all kinds of noise models have in common: pictures, tables, and where a model
comes from."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import Any

import yaml

from probevo.output.inspection_data import ColumnSummary, FrameView, is_the_same
from probevo.output.metrics_table import readable

SUMMARY_HEAD = ("column", "unit", "training", "this frame", "undefined")
CARDS = (
    '<div class="frames"'
    ' style="grid-template-columns:repeat(auto-fill,minmax(min(100%,360px),1fr));gap:0 14px">'
)
_PICTURES = (
    '<div class="frames"'
    ' style="grid-template-columns:repeat(auto-fill,minmax(min(100%,560px),1fr))">'
)
_SHORT_HASH = 12


def summary_rows(summaries: Sequence[ColumnSummary]) -> list[tuple[str, ...]]:
    """A row for each column, under ``SUMMARY_HEAD``."""
    return [
        (
            column.name,
            column.unit,
            "–" if column.training is None else "{} ± {}".format(*map(readable, column.training)),
            "–" if column.frame_mean is None else readable(column.frame_mean),
            percent(column.undefined) if column.undefined > 0.0 else "–",
        )
        for column in summaries
    ]


def percent(share: float) -> str:
    """A share in words; what is more than nothing never reads as nothing."""
    return "0 %" if share == 0.0 else "< 0.1 %" if share < 0.001 else f"{100.0 * share:.1f} %"


def page_title(name: str | None, frame: FrameView | None) -> str:
    """Of a page on the model of that name, on a frame, or on both."""
    if frame is None:
        return f"What {name} learned" if name else ""
    return f"{frame.recording}, frame {frame.index}" + (f", as {name} sees it" if name else "")


def frame_facts(frame: FrameView | None) -> dict[str, str]:
    """What a reader should know of the frame."""
    if frame is None:
        return {}
    image = ("none; area of " if frame.left is None else "") + "{}×{} px".format(*frame.size_px)
    return {"Features": f"{len(frame.uv):,}", "Image": image}


def origin(training: Mapping[str, Any]) -> str:
    """Where samples come from; empty if that is not known."""
    recordings = training.get("recordings", [])
    frames = sum(recording["frames"] for recording in recordings)
    plural = "s" * (len(recordings) != 1)
    return f" from {frames:,} frames of {len(recordings)} recording{plural}" if recordings else ""


def pictures_section(
    frame: FrameView, pictures: Mapping[str, tuple[str, bytes]], more: str = ""
) -> str:
    """The pictures of a frame; ``more`` is said before them."""
    others = []
    columns = zip(frame.columns, frame.phi.T, strict=True)
    constant = [name for name, values in columns if name in pictures and is_the_same(values)]
    if constant:
        others.append(f" The same for all features, and so not drawn: {', '.join(constant)}.")
    figures = "\n".join(
        f'<figure><img alt="{escape(caption)}"'
        f' src="data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
        for name, (caption, jpeg) in pictures.items()
        if name not in constant
    )
    note = (
        "The ends of each bar are the 2 % and 98 % quantiles of this frame; ≤ and ≥ say that there"
        " are values beyond, in the same colour. Hollow grey rings: the predictor is"
        f" undefined.{''.join(others)}{more}"
    )
    return (
        '<section class="panel"><h2>Its features</h2><p'
        f' class="note">{note}</p>\n{_PICTURES}{figures}</div></section>'
    )


def table_section(title: str, note: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A panel with a table, of which the first cell of each row may hold HTML; all others are text."""
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "\n".join(
        f"<tr><th>{first}</th>{''.join(f'<td>{escape(cell)}</td>' for cell in cells)}</tr>"
        for first, *cells in rows
    )
    said = f'<p class="note">{note}</p>\n' if note else ""
    return (
        f'<section class="panel"><h2>{title}</h2>{said}<table'
        f' class="figures"><thead><tr>{top}</tr></thead><tbody>\n{body}\n</tbody></table></section>'
    )


def named_with_unit(name: str, unit: str) -> str:
    """A column and its unit as the first cell of a row."""
    return f'{escape(name)} <small style="color:var(--muted)">{escape(unit)}</small>'


def summary_section(summaries: Sequence[ColumnSummary], *, trained: bool, has_frame: bool) -> str:
    """The columns of φ in figures."""
    wanted = (trained, has_frame, True)
    name, _, *titles = SUMMARY_HEAD
    head = [name, *(title for title, want in zip(titles, wanted, strict=True) if want)]
    rows = [
        (
            named_with_unit(column, unit),
            *(cell for cell, want in zip(cells, wanted, strict=True) if want),
        )
        for column, unit, *cells in summary_rows(summaries)
    ]
    whose = "the frame’s features" if has_frame else "the training samples"
    training = "Training: mean ± standard deviation of all features. " if trained else ""
    return table_section(
        "The predictors in figures", f"{training}Undefined: share of {whose}.", head, rows=rows
    )


def training_section(training: Mapping[str, Any]) -> str:
    """Which recordings a model was trained on; empty if that is not known."""
    rows = [
        (
            escape(str(recording["name"])),
            f"{recording['frames']:,}",
            f"{str(recording['sha256'])[:_SHORT_HASH]}…",
        )
        for recording in training.get("recordings", [])
    ]
    return (
        table_section("Trained on", "", ("recording", "frames", "SHA-256"), rows=rows)
        if rows
        else ""
    )


def settings_section(training: Mapping[str, Any]) -> str:
    """With what settings a model was trained; empty if that is not known."""
    settings = training.get("settings")
    if not settings:
        return ""
    text = yaml.safe_dump(settings, sort_keys=True, allow_unicode=True)
    return (
        '<details class="panel"><summary>Settings of the'
        f" training</summary><pre>{escape(text)}</pre></details>"
    )
