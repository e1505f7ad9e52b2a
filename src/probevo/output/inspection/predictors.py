"""The predictors of a frame's features, without a noise model or with one that takes none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.output.inspection.common_sections import percent, pictures_section
from probevo.output.inspection.feature_pictures import Shades, draw_features, value_shades
from probevo.output.inspection.subject import Findings, FrameView, Picture, Subject
from probevo.output.inspection.terms import column_notes
from probevo.output.page import table_panel
from probevo.output.table import UNKNOWN_TEXT, Cell, Column, Row, Table, readable


def sections(subject: Subject, remark: str = "") -> Findings:
    """Show the predictors of a frame, in pictures and in figures.

    Args:
        subject: what is inspected; only its frame is looked at.
        remark: what else the note above the pictures says.

    Raises:
        ValueError: there is no frame.
    """
    frame = subject.frame
    if frame is None:
        raise ValueError("an inspection needs a model or a frame")
    pictures = drawn(frame, {name: column_shades(frame, name) for name in frame.columns})
    table = column_table(column_summaries(frame.columns, frame.phi))
    table = table.without("training")
    notes = column_notes(table.heads, has_frame=True, samples="")
    return Findings(
        sections=(
            pictures_section(frame, pictures, remark),
            table_panel("The predictors in figures", [" ".join(notes)], table.without("unit")),
        ),
        text=table.as_text(),
        notes=notes,
        pictures=pictures,
    )


def column_shades(frame: FrameView, name: str) -> tuple[str, Shades]:
    """Colour the features of a frame by one column of φ; returns the caption, too."""
    values = frame.phi[:, list(frame.columns).index(name)]
    undefined = int(np.isnan(values).sum())
    caption = f"{name}: undefined for {undefined} of {len(values)}" if undefined else name
    return caption, value_shades(name, frame.columns[name], values)


def drawn(
    frame: FrameView,
    shades: Mapping[str, tuple[str, Shades]],
    out_of_domain: BoolArray | None = None,
) -> dict[str, Picture]:
    """Draw the features of a frame in several sets of colours, each with its caption.

    Args:
        frame: the frame, with N features.
        shades: caption and colours of each picture, by its name.
        out_of_domain: which features are out of a model's domain, [N]: all pictures mark them.
    """
    pictures = {}
    for name, (caption, colors) in shades.items():
        jpeg = draw_features(
            frame.left, frame.size_px, frame.uv, shades=colors, out_of_domain=out_of_domain
        )
        pictures[name] = (caption, jpeg)
    return pictures


@dataclass(frozen=True)
class ColumnSummary:
    """Figures on a column of φ; None where unknown."""

    name: str
    unit: str
    training: tuple[float, float] | None
    """Mean and standard deviation over the training data; None without a model."""
    frame_mean: float | None
    """Mean over the features of the frame; None without a frame, or a feature with a value."""
    undefined: float
    """Share of the frame's features, or else of the training samples, where it is undefined."""


def column_summaries(
    columns: Mapping[str, str],
    phi: FloatArray,
    training: tuple[FloatArray, FloatArray] | None = None,
    *,
    is_of_frame: bool = True,
) -> list[ColumnSummary]:
    """Summarise each column of φ.

    Args:
        columns: name and unit of the M columns.
        phi: points of the frame's features, or else of the training samples, [N, M]; NaN where
            undefined.
        training: mean and standard deviation of each column over the training data, [M] each.
        is_of_frame: whether ``phi`` is that of a frame.
    """
    summaries = []
    for m, (name, unit) in enumerate(columns.items()):
        known = phi[np.isfinite(phi[:, m]), m]
        mean_and_spread = None
        if training is not None:
            mean_and_spread = (float(training[0][m]), float(training[1][m]))
        summaries.append(
            ColumnSummary(
                name=name,
                unit=unit,
                training=mean_and_spread,
                frame_mean=float(known.mean()) if is_of_frame and len(known) else None,
                undefined=1.0 - len(known) / max(len(phi), 1),
            )
        )
    return summaries


def column_table(
    summaries: Sequence[ColumnSummary],
    further: Mapping[Column, Sequence[float | None]] | None = None,
) -> Table:
    """Make a table with a row for each of the M columns of φ.

    Args:
        summaries: summary of each column, [M].
        further: columns of the table that follow the unit, with their values, [M] each.
    """
    further = further or {}
    return Table(
        columns=(
            Column("column", format=str, align="left"),
            Column("unit", format=str),
            *further,
            Column("training", format=spread_text),
            Column("this frame"),
            Column("undefined", format=undefined_text),
        ),
        rows=tuple(
            Row(
                (
                    Cell(column.name, unit=column.unit),
                    Cell(column.unit),
                    *(Cell(values[m]) for values in further.values()),
                    Cell(column.training),
                    Cell(column.frame_mean),
                    Cell(column.undefined),
                )
            )
            for m, column in enumerate(summaries)
        ),
    )


def spread_text(mean_and_spread: tuple[float, float] | None) -> str:
    """Format a mean and a standard deviation; a dash where unknown."""
    if mean_and_spread is None:
        return UNKNOWN_TEXT
    mean, spread = mean_and_spread
    return f"{readable(mean)} ± {readable(spread)}"


def undefined_text(share: float) -> str:
    """Format the share of undefined values; a dash if all are defined."""
    return percent(share) if share > 0.0 else UNKNOWN_TEXT
