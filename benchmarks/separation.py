"""How well each predictor tells features that an effect spoils from clean ones: the figures of
docs/predictors.md.

The same drive is rendered without effects and with one. ROC AUC, by ranks, of each column between
the features of the two: 0.5 is chance, +.90 says that of two features the affected one is higher
nine times in ten, −.90 that it is lower.

python benchmarks/separation.py [number of places, 4 by default] [folder of the figures]
"""

from __future__ import annotations

import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from separation_measures import FIXED, OF_A_STEP, ROWS, SPACE, STRENGTHS, Row, place

from probevo.arrays import FloatArray
from probevo.output.svg import BLUE, CYCLE, INK, LEGEND_ABOVE, MUTED, figure_style
from probevo.predictors import PREDICTORS

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "images"
REQUIRED = (
    ("sharp", "blurred", "blur 1", "blur"),
    ("on what stands", "on what moves", "traffic 1", "residual_flow"),
    ("with texture", "texture taken away", f"{FIXED} 1, faint noise", "high_frequency"),
)
"""What clean and affected features are, row and column: the histograms. Without noise, the third
would be a spike."""


def signed(value: float) -> str:
    """+.93 is high where affected, −.93 low; empty if not asked."""
    if np.isnan(value):
        return ""
    return ("+" if value >= 0.5 else "−") + f"{max(value, 1.0 - value):.2f}".removeprefix("0")


def print_table(title: str, cells: dict[str, list[str]]) -> None:
    """A line for each column of the space that has any cell, in Markdown."""
    print(f"\n{title}\n\n| column | {' | '.join(cells)} |\n|---{'|---' * len(cells)}|")
    for column, line in zip(SPACE.columns, zip(*cells.values(), strict=True), strict=True):
        if any(line):
            print(f"| {column} | {' | '.join(line)} |")


def tables(found: dict[str, list[Row]], mean: dict[str, FloatArray]) -> None:
    """AUCs, shares of NaN and numbers of features."""
    texts = {name: [signed(float(value)) for value in values] for name, values in mean.items()}
    for strength in STRENGTHS:
        print_table(
            f"Strength {strength:g}",
            {effect: texts.pop(f"{effect} {strength:g}") for effect in ROWS},
        )
    print_table("Against other features, with other settings", texts)
    shares = {}
    for effect in ROWS[:-1]:
        of_row = [
            np.concatenate(phis)
            for phis in zip(*((r.affected, r.clean) for r in found[f"{effect} 1"]), strict=True)
        ]
        percent = [100.0 * np.isnan(phi).mean(axis=0) for phi in of_row]
        shares[effect] = [
            f"{a:.1f} / {c:.1f}" if a + c > 0 else "" for a, c in zip(*percent, strict=True)
        ]
    print_table("Undefined among affected / clean features, %", shares)
    print("\n| | affected | clean |\n|---|---|---|")
    for name, group in found.items():
        print(
            f"| {name} | {sum(len(row.affected) for row in group)} |"
            f" {sum(len(row.clean) for row in group)} |"
        )
    for *_, name, column in REQUIRED:
        of_places = sorted(float(row.aucs[SPACE.columns.index(column)]) for row in found[name])
        print(f"{name}, {column}: " + ", ".join(f"{value:.3f}" for value in of_places))


def heat_map(aucs: FloatArray, path: Path) -> None:
    """AUC of each column and row, [M, R], with the numbers in the cells; what is one value a step
    is at the bottom."""
    shared = [column for name in OF_A_STEP for column in PREDICTORS[name].columns]
    order = sorted(range(len(SPACE.columns)), key=lambda k: SPACE.columns[k] in shared)
    broken = {
        "textureless": "texture-\nless",
        "rectification": "rectifi-\ncation",
        FIXED: FIXED.replace(", ", ",\n"),
    }
    heads = [broken.get(row, row) for row in ROWS]
    with figure_style():
        figure = Figure(figsize=(8.0, 7.8), facecolor="white")
        axes = figure.add_subplot()
        shown = axes.imshow(aucs[order], cmap="RdBu_r", vmin=0.0, vmax=1.0, aspect="auto")
        for (i, j), value in np.ndenumerate(aucs[order]):
            color = (
                "white" if abs(value - 0.5) > 0.36 else INK if abs(value - 0.5) > 0.15 else MUTED
            )
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
    """The two distributions of each required pair, all places together."""
    units = {
        column: unit for predictor in SPACE.predictors for column, unit in predictor.columns.items()
    }
    with figure_style():
        figure = Figure(figsize=(9.0, 2.8), facecolor="white")
        for axes, (*labels, name, column) in zip(
            figure.subplots(1, len(REQUIRED)), REQUIRED, strict=True
        ):
            k = found[name][0].columns.index(column)
            clean = np.concatenate([row.clean[:, k] for row in found[name]])
            affected = np.concatenate([row.affected[:, k] for row in found[name]])
            low, high = np.nanquantile(np.concatenate([clean, affected]), [0.001, 0.999])
            bins = [float(edge) for edge in np.linspace(low, high, 46)]
            for values, color, label in zip(
                (clean, affected), (BLUE, CYCLE[1]), labels, strict=True
            ):
                axes.hist(
                    values, bins, density=True, histtype="stepfilled", alpha=0.25, color=color
                )
                axes.hist(
                    values, bins, density=True, histtype="step", color=color, lw=1.3, label=label
                )
            axes.set(xlabel=f"{column}, {units[column]}", yticks=[], xlim=(bins[0], bins[-1]))
            text = f"AUC {signed(float(mean[name][SPACE.columns.index(column)]))}"
            axes.text(
                0.98, 0.96, text, transform=axes.transAxes, ha="right", va="top", weight="bold"
            )
            axes.margins(y=0.15)
            axes.spines["left"].set_visible(False)
            axes.legend(ncols=2, **LEGEND_ABOVE)
        figure.savefig(path, dpi=120)


def report(found: dict[str, list[Row]], folder: Path) -> None:
    mean = {name: np.mean([row.aucs for row in group], axis=0) for name, group in found.items()}
    tables(found, mean)
    heat_map(np.transpose([mean[f"{row} 1"] for row in ROWS]), folder / "separation.png")
    histograms(found, mean, folder / "separation_histograms.png")


def main() -> None:
    places = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    folder = Path(sys.argv[2]) if len(sys.argv) > 2 else FOLDER
    with ProcessPoolExecutor(2) as pool:
        of_places = list(pool.map(place, range(places)))
    report({group[0].name: list(group) for group in zip(*of_places, strict=True)}, folder)


if __name__ == "__main__":
    main()
