"""``probevo demo``: the noise models side by side, on the recordings at hand."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, get_args

import tyro

from probevo.cli.arguments import parse
from probevo.cli.text import table
from probevo.errors import InputError
from probevo.run_config import NoiseName, RunConfig

if TYPE_CHECKING:
    from probevo.runner import Run

VARIABLE = "PROBEVO_DATA"
PREFERRED = ("kitti_odometry/sequences/06", "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync")
OTHERS = ("kitti_odometry/sequences/*", "kitti_raw/*/*_sync", "euroc/*")
MAX_FRAMES = 300
HEAD = ("recording, noise model", "ARMSE m", "end error m", "drift %", "drift °/m", "ms/frame")


@dataclass(frozen=True)
class DemoArguments:
    """Runs each noise model over one or two recordings and compares them.

    The recordings come from the folder that PROBEVO_DATA names, or from ../shared/data: kitti_odometry/sequences/06
    and kitti_raw/2011_09_26/2011_09_26_drive_0005_sync if they are there, else the first that is.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("out/demo")
    """Folder for the results, one folder a run."""


def main(words: list[str]) -> None:
    """Parse, run everything, compare."""
    arguments = parse(DemoArguments, words, "demo")
    from probevo.cli.run import run_with_progress

    rows, reports = [], []
    for path in recordings():
        for noise in get_args(NoiseName):
            out = arguments.out / f"{path.name}-{noise}"
            run = run_with_progress(RunConfig(sequence=path, noise=noise, max_frames=MAX_FRAMES), out, threads=1)
            rows.append((f"{path.name}, {noise}", *figures(run)))
            reports.append(out / "report.html")
    print(table(HEAD, rows))
    print("\nDrift: over pieces of 10 to 50 m. Reports:")
    print("\n".join(f"  {report}" for report in reports))


def figures(run: Run) -> tuple[str, ...]:
    """One row of the table."""
    import numpy as np

    from probevo.output.metrics_table import readable

    metrics = run.metrics
    values = [metrics.armse_m, metrics.final_error_m] if metrics else [None, None]
    values += [metrics.short_t_percent, metrics.short_r_deg_per_m] if metrics else [None, None]
    texts = ["–" if value is None else readable(value) for value in values]
    return (*texts, readable(float(np.median(run.result.total_ms))))


def recordings() -> list[Path]:
    """The preferred recordings that are there, or else the first one that is.

    Raises:
        InputError: there is none; says where it was looked for.
    """
    roots = _roots()
    for root in roots:
        preferred = [root / name for name in PREFERRED if (root / name).is_dir()]
        others = [path for pattern in OTHERS for path in sorted(root.glob(pattern)) if path.is_dir()]
        if preferred or others:
            return preferred or others[:1]
    looked = " and ".join(str(root) for root in roots)
    cure = f"Set {VARIABLE} to a folder that holds KITTI or EuRoC recordings, e.g. {PREFERRED[0]}."
    raise InputError(VARIABLE, f"no recording to show; looked in {looked}.", cure)


def _roots() -> list[Path]:
    if os.environ.get(VARIABLE):
        return [Path(os.environ[VARIABLE])]
    checkout = Path(__file__).resolve().parents[3]
    return list(dict.fromkeys([Path("../shared/data"), checkout.parent / "shared" / "data"]))
