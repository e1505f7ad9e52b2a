"""Measure how well each predictor separates features that an effect affects from clean ones.

    python benchmarks/separation.py [number of places, 4 by default] [folder of the figures]

The same drive is rendered without effects and with one. Prints and draws the ROC AUC of each column
between the features of the two drives: 0.5 is chance; +.90 says that of two features the affected
one has the higher value nine times in ten, −.90 that it has the lower one.
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from separation_measures import FIXED, OF_A_STEP, ROWS, SPACE, STRENGTHS, Row, place

from probevo.arrays import FloatArray
from probevo.output.svg import BLUE, CYCLE, INK, LEGEND_ABOVE, MUTED, figure_style
from probevo.predictors import PREDICTORS

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images"
HEADS = {
    "textureless": "texture-\nless",
    "rectification": "rectifi-\ncation",
    "rolling_shutter": "rolling\nshutter",
    FIXED: "textureless,\nfixed\nplaces",
}
"""Heads of the heat map that are broken into lines."""


class Pair(NamedTuple):
    """A pair of distributions to draw: those of one column over the features of one row."""

    clean: str
    """Label of the clean features."""
    affected: str
    """Label of the affected features."""
    row: str
    column: str

    @property
    def index(self) -> int:
        """Index of the column in the space."""
        return SPACE.columns.index(self.column)


PAIRS = (
    Pair("sharp", "blurred", row="blur 1", column="blur"),
    Pair("on what stands", "on what moves", row="traffic 1", column="residual_flow"),
    Pair(
        "with texture",
        "texture taken away",
        row=f"{FIXED} 1, faint noise",
        column="high_frequency",
    ),
)
"""The histograms. Without noise, the third would be a spike."""


def signed(value: float) -> str:
    """Return an AUC with its sign: +.93 is high where affected, −.93 low; empty if undefined."""
    if np.isnan(value):
        return ""
    return ("+" if value >= 0.5 else "−") + f"{max(value, 1.0 - value):.2f}".removeprefix("0")


def print_table(title: str, cells: dict[str, list[str]]) -> None:
    """Print a table in Markdown with a line for each column of the space that has any cell."""
    print(f"\n{title}\n\n| column | {' | '.join(cells)} |\n|---{'|---' * len(cells)}|")
    for column, line in zip(SPACE.columns, zip(*cells.values(), strict=True), strict=True):
        if any(line):
            print(f"| {column} | {' | '.join(line)} |")


def print_aucs(mean: dict[str, FloatArray]) -> None:
    """Print the AUC of each row and column, [M] each, in a table for each strength."""
    texts = {name: [signed(float(value)) for value in values] for name, values in mean.items()}
    for strength in STRENGTHS:
        print_table(
            f"Strength {strength:g}",
            {effect: texts.pop(f"{effect} {strength:g}") for effect in ROWS},
        )
    print_table("Against other features, with other settings", texts)


def print_undefined(found: dict[str, list[Row]]) -> None:
    """Print the shares of NaN among affected and clean features."""
    shares = {}
    for effect in ROWS[:-1]:
        group = found[f"{effect} 1"]
        affected = np.concatenate([row.affected for row in group])
        clean = np.concatenate([row.clean for row in group])
        affected_percent = 100.0 * np.isnan(affected).mean(axis=0)
        clean_percent = 100.0 * np.isnan(clean).mean(axis=0)
        shares[effect] = [
            f"{a:.1f} / {c:.1f}" if a + c > 0 else ""
            for a, c in zip(affected_percent, clean_percent, strict=True)
        ]
    print_table("Undefined among affected / clean features, %", shares)


def print_counts(found: dict[str, list[Row]]) -> None:
    """Print the numbers of features, and the AUC of each pair in each place."""
    print("\n| | affected | clean |\n|---|---|---|")
    for name, group in found.items():
        affected = sum(len(row.affected) for row in group)
        clean = sum(len(row.clean) for row in group)
        print(f"| {name} | {affected} | {clean} |")
    for pair in PAIRS:
        of_places = sorted(float(row.aucs[pair.index]) for row in found[pair.row])
        print(f"{pair.row}, {pair.column}: " + ", ".join(f"{value:.3f}" for value in of_places))


def heat_map(aucs: FloatArray, path: Path) -> None:
    """Draw the AUC of each column and row, [M, R], as a heat map with numbers in its cells.

    Columns that have one value a step are at the bottom.
    """
    of_a_step = [column for name in OF_A_STEP for column in PREDICTORS[name].columns]
    order = sorted(range(len(SPACE.columns)), key=lambda k: SPACE.columns[k] in of_a_step)
    heads = [HEADS.get(row, row) for row in ROWS]
    with figure_style():
        figure = Figure(figsize=(8.8, 7.8), facecolor="white")
        axes = figure.add_subplot()
        shown = axes.imshow(aucs[order], cmap="RdBu_r", vmin=0.0, vmax=1.0, aspect="auto")
        for (i, j), value in np.ndenumerate(aucs[order]):
            distance = abs(value - 0.5)
            color = "white" if distance > 0.36 else INK if distance > 0.15 else MUTED
            axes.text(j, i, signed(value), ha="center", va="center", color=color, fontsize=8.0)
        # Labels at the middle of the cells, a white grid between them.
        axes.set_xticks(range(len(heads)), heads)
        axes.set_yticks(range(len(order)), [SPACE.columns[k] for k in order])
        axes.set_xticks(np.arange(len(heads) + 1) - 0.5, minor=True)
        axes.set_yticks(np.arange(len(order) + 1) - 0.5, minor=True)
        axes.tick_params(which="both", length=0, labelcolor=INK, labeltop=True, labelbottom=False)
        axes.grid(visible=False)
        axes.grid(visible=True, which="minor", color="white", lw=1.2)
        axes.spines[:].set_visible(False)
        # A line above the columns of a step, and the scale below all.
        axes.axhline(len(order) - len(of_a_step) - 0.5, color=INK, lw=1.2)
        middle = len(order) - 0.5 * len(of_a_step) - 0.5
        axes.text(
            len(heads) - 0.4, middle, "one value a step", rotation=270, va="center", color=MUTED
        )
        bar = figure.colorbar(
            shown, location="bottom", aspect=60, fraction=0.02, pad=0.01, ticks=[0, 0.5, 1]
        )
        bar.ax.set_xticklabels(["lower where affected", "chance", "higher where affected"])
        bar.outline.set_visible(False)
        figure.savefig(path, dpi=110)


def histograms(found: dict[str, list[Row]], mean: dict[str, FloatArray], path: Path) -> None:
    """Draw the two distributions of each pair, all places together."""
    with figure_style():
        figure = Figure(figsize=(9.0, 2.8), facecolor="white")
        for axes, pair in zip(figure.subplots(1, len(PAIRS)), PAIRS, strict=True):
            draw_pair(axes, pair, found[pair.row], auc=float(mean[pair.row][pair.index]))
        figure.savefig(path, dpi=120)


def draw_pair(axes: Axes, pair: Pair, group: list[Row], auc: float) -> None:
    """Draw the distributions of clean and affected features over each other."""
    k = group[0].columns.index(pair.column)
    clean = np.concatenate([row.clean[:, k] for row in group])
    affected = np.concatenate([row.affected[:, k] for row in group])
    low, high = np.nanquantile(np.concatenate([clean, affected]), [0.001, 0.999])
    bins = [float(edge) for edge in np.linspace(low, high, 46)]
    for values, color, label in (
        (clean, BLUE, pair.clean),
        (affected, CYCLE[1], pair.affected),
    ):
        axes.hist(values, bins, density=True, histtype="stepfilled", alpha=0.25, color=color)
        axes.hist(values, bins, density=True, histtype="step", color=color, lw=1.3, label=label)
    units = {
        column: unit for predictor in SPACE.predictors for column, unit in predictor.columns.items()
    }
    axes.set(xlabel=f"{pair.column}, {units[pair.column]}", yticks=[], xlim=(bins[0], bins[-1]))
    text = f"AUC {signed(auc)}"
    axes.text(0.98, 0.96, text, transform=axes.transAxes, ha="right", va="top", weight="bold")
    axes.margins(y=0.15)
    axes.spines["left"].set_visible(False)
    axes.legend(ncols=2, **LEGEND_ABOVE)


def report(found: dict[str, list[Row]], folder: Path) -> None:
    """Print all tables, and draw the figures into a folder."""
    mean = {name: np.mean([row.aucs for row in group], axis=0) for name, group in found.items()}
    print_aucs(mean)
    print_undefined(found)
    print_counts(found)
    heat_map(np.transpose([mean[f"{row} 1"] for row in ROWS]), folder / "separation.png")
    histograms(found, mean, folder / "separation_histograms.png")


def main() -> None:
    """Measure in each place, two at a time, and report all."""
    places = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    folder = Path(sys.argv[2]) if len(sys.argv) > 2 else FOLDER
    with ProcessPoolExecutor(2) as pool:
        of_places = list(pool.map(place, range(places)))
    report({group[0].name: list(group) for group in zip(*of_places, strict=True)}, folder)


if __name__ == "__main__":
    main()
