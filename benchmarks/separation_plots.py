"""The figures of ``separation.py``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from separation import FIXED, OF_A_STEP, REQUIRED, ROWS, SPACE, Row, signed

from probevo.arrays import FloatArray
from probevo.output.svg import BLUE, CYCLE, INK, LEGEND_ABOVE, MUTED, figure_style
from probevo.predictors import PREDICTORS


def heat_map(aucs: FloatArray, path: Path) -> None:
    """AUC of each column and row, [M, R], with the numbers in the cells; what is one value a step is at the bottom."""
    shared = [column for name in OF_A_STEP for column in PREDICTORS[name].columns]
    order = sorted(range(len(SPACE.columns)), key=lambda k: SPACE.columns[k] in shared)
    broken = {"textureless": "texture-\nless", "rectification": "rectifi-\ncation", FIXED: FIXED.replace(", ", ",\n")}
    heads = [broken.get(row, row) for row in ROWS]
    with figure_style():
        figure = Figure(figsize=(8.0, 7.8), facecolor="white")
        axes = figure.add_subplot()
        shown = axes.imshow(aucs[order], cmap="RdBu_r", vmin=0.0, vmax=1.0, aspect="auto")
        for (i, j), value in np.ndenumerate(aucs[order]):
            color = "white" if abs(value - 0.5) > 0.36 else INK if abs(value - 0.5) > 0.15 else MUTED
            axes.text(j, i, signed(value), ha="center", va="center", color=color, fontsize=8.0)
        axes.set_xticks(range(len(heads)), heads)
        axes.set_yticks(range(len(order)), [SPACE.columns[k] for k in order])
        axes.set_xticks(np.arange(len(heads) + 1) - 0.5, minor=True)
        axes.set_yticks(np.arange(len(order) + 1) - 0.5, minor=True)
        axes.tick_params(which="both", length=0, labelcolor=INK, labeltop=True, labelbottom=False)
        axes.grid(visible=False)
        axes.grid(visible=True, which="minor", color="white", lw=1.2)
        axes.spines[:].set_visible(False)
        axes.axhline(len(order) - len(shared) - 0.5, color=INK, lw=1.2)
        middle = len(order) - 0.5 * len(shared) - 0.5
        axes.text(len(heads) - 0.4, middle, "one value a step", rotation=270, va="center", color=MUTED)
        bar = figure.colorbar(shown, location="bottom", aspect=60, fraction=0.02, pad=0.01, ticks=[0, 0.5, 1])
        bar.ax.set_xticklabels(["lower where affected", "chance", "higher where affected"])
        bar.outline.set_visible(False)
        figure.savefig(path, dpi=110)


def histograms(found: dict[str, list[Row]], mean: dict[str, FloatArray], path: Path) -> None:
    """The two distributions of each required pair, all places together."""
    units = {column: unit for predictor in SPACE.predictors for column, unit in predictor.columns.items()}
    with figure_style():
        figure = Figure(figsize=(9.0, 2.8), facecolor="white")
        for axes, (*labels, name, column) in zip(figure.subplots(1, len(REQUIRED)), REQUIRED, strict=True):
            k = found[name][0].columns.index(column)
            clean = np.concatenate([row.clean[:, k] for row in found[name]])
            affected = np.concatenate([row.affected[:, k] for row in found[name]])
            low, high = np.nanquantile(np.concatenate([clean, affected]), [0.001, 0.999])
            bins = [float(edge) for edge in np.linspace(low, high, 46)]
            for values, color, label in zip((clean, affected), (BLUE, CYCLE[1]), labels, strict=True):
                axes.hist(values, bins, density=True, histtype="stepfilled", alpha=0.25, color=color)
                axes.hist(values, bins, density=True, histtype="step", color=color, lw=1.3, label=label)
            axes.set(xlabel=f"{column}, {units[column]}", yticks=[], xlim=(bins[0], bins[-1]))
            text = f"AUC {signed(float(mean[name][SPACE.columns.index(column)]))}"
            axes.text(0.98, 0.96, text, transform=axes.transAxes, ha="right", va="top", weight="bold")
            axes.margins(y=0.15)
            axes.spines["left"].set_visible(False)
            axes.legend(ncols=2, **LEGEND_ABOVE)
        figure.savefig(path, dpi=120)
