"""``probevo paper blur``: PROBE Fig. 5 from the first image to the last file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probevo.cli.progress import progress_bar
from probevo.cli.text import table
from probevo_paper.figure_5 import BlurObservations, blur_views
from probevo_paper.figure_5_config import BlurConfig
from probevo_paper.figure_5_page import (
    TABLE_HEAD,
    counts_text,
    table_rows,
    write_blur_page,
    write_csv,
)
from probevo_paper.figure_5_statistics import findings, verdicts


def repeat_figure(settings: BlurConfig, out: Path) -> list[str]:
    """Repeat the figure; return the lines to print.

    Raises:
        InputError: a file cannot be written.

    """
    views = []
    with progress_bar(
        "looking at the board", "starting (compiling, if this is the first time)"
    ) as show:
        for view in blur_views(settings.instants, settings.seed):
            views.append(view)
            show(len(views), settings.instants)
    observations = BlurObservations.of(views)
    results = findings(observations, np.random.default_rng([settings.seed, 2]))
    write_csv(out / "blur.csv", observations)
    write_blur_page(out / "blur.html", views, observations, results=results, seed=settings.seed)
    return [
        table(TABLE_HEAD, table_rows(results)),
        "",
        *verdicts(results),
        counts_text(views, observations),
        str(out / "blur.html"),
    ]
