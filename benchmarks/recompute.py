"""Recompute the figures and tables of README.md and docs/, one command after another.

    python benchmarks/recompute.py --list             page, name, command and about how long
    python benchmarks/recompute.py [--out FOLDER]     all of them, in out/recompute by default
    python benchmarks/recompute.py --only NAME …      some of them

What a command prints goes to FOLDER/NAME.txt, and what it writes goes below FOLDER, too. The first
command that fails ends it all. Figures of real recordings need PROBEVO_DATA, or ../shared/data
beside the repository, and are skipped without it.

Nothing is compared with the pages, and no page is changed. Columns of other software (LIBVISO2,
ORB-SLAM2, Basalt), the pictures of reports, and what the pages call measured when it was added have
no command here.
"""

from __future__ import annotations

import argparse
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Figure:
    """A figure or table of the pages, or several that one command makes."""

    name: str
    pages: tuple[str, ...]
    """The pages that show it, relative to the repository."""
    command: str
    """The command as the pages have it, run in the folder of the results."""
    minutes: int
    """About how long it takes on two cores. An estimate of its order, not a measurement."""
    needs_data: bool = False
    """Whether it needs real recordings."""
    pictures: tuple[str, ...] = ()
    """Files of docs/images that it writes."""

    @property
    def words(self) -> list[str]:
        """The command with this Python, and with scripts by their absolute path."""
        first, *others = shlex.split(self.command)
        words = [sys.executable, *(["-m", "probevo"] if first == "probevo" else [])]
        for word in others:
            words.append(str(ROOT / word) if word.startswith("benchmarks/") else word)
        return words


FIGURES = (
    Figure(
        "accuracy",
        ("README.md", "docs/accuracy.md"),
        "python benchmarks/accuracy.py",
        minutes=2,
        needs_data=True,
    ),
    Figure(
        "limits",
        ("docs/accuracy.md",),
        "python benchmarks/limits.py",
        minutes=3,
        needs_data=True,
    ),
    Figure(
        "lens-distortion",
        ("docs/accuracy.md",),
        "python benchmarks/lens_distortion.py",
        minutes=6,
        needs_data=True,
    ),
    Figure(
        "shared-errors",
        ("docs/accuracy.md",),
        "python benchmarks/shared_errors.py",
        minutes=2,
        needs_data=True,
    ),
    Figure(
        "image-halves",
        ("docs/accuracy.md",),
        "python benchmarks/image_halves.py",
        minutes=2,
        needs_data=True,
    ),
    Figure("random-rigs", ("docs/accuracy.md",), "python benchmarks/random_rigs.py", minutes=15),
    Figure(
        "carried-rigs",
        ("docs/accuracy.md",),
        "python benchmarks/random_rigs.py --carried --count 12 --seed 7600",
        minutes=15,
    ),
    Figure(
        "traffic_starts",
        ("docs/tracker.md",),
        "python benchmarks/traffic_starts.py",
        minutes=3,
    ),
    Figure(
        "vehicle-parts",
        ("docs/tracker.md",),
        "python benchmarks/vehicle_parts.py",
        minutes=10,
        needs_data=True,
    ),
    Figure(
        "gaps",
        ("docs/window.md",),
        "python benchmarks/gaps.py",
        minutes=10,
        needs_data=True,
    ),
    Figure(
        "subpixel",
        ("docs/tracker.md",),
        "python benchmarks/subpixel.py",
        minutes=1,
        needs_data=True,
    ),
    Figure(
        "plain-odometry",
        ("docs/accuracy.md",),
        "python benchmarks/plain_odometry.py",
        minutes=2,
        needs_data=True,
    ),
    Figure(
        "window", ("docs/window.md",), "python benchmarks/window.py", minutes=10, needs_data=True
    ),
    Figure(
        "long-drives",
        ("docs/window.md",),
        "python benchmarks/long_drives.py",
        minutes=15,
    ),
    Figure(
        "rolling-shutter",
        ("docs/degradation.md",),
        "python benchmarks/rolling_shutter.py",
        minutes=12,
        needs_data=True,
    ),
    Figure(
        "window-consistency",
        ("docs/window.md",),
        "python benchmarks/window_consistency.py --only points city residential rover"
        " --picture consistency.png",
        minutes=60,
        pictures=("consistency.png",),
    ),
    Figure(
        "window-learning",
        ("docs/window.md",),
        "python benchmarks/window_learning.py",
        minutes=15,
        needs_data=True,
    ),
    Figure(
        "learning-streets",
        ("docs/window.md",),
        "python benchmarks/learning_streets.py",
        minutes=60,
    ),
    Figure(
        "window-imu",
        ("docs/window.md",),
        "python benchmarks/window_imu.py",
        minutes=20,
        needs_data=True,
    ),
    Figure(
        "residual-correlation",
        ("docs/window.md",),
        "python benchmarks/residual_correlation.py",
        minutes=5,
        needs_data=True,
    ),
    Figure(
        "imu-agreement",
        ("docs/window.md",),
        "python benchmarks/imu_agreement.py",
        minutes=1,
        needs_data=True,
    ),
    Figure(
        "flow-truth",
        ("docs/accuracy.md",),
        "python benchmarks/flow_truth.py",
        minutes=5,
        needs_data=True,
    ),
    Figure("loose-rig", ("docs/accuracy.md",), "python benchmarks/loose_rig.py", minutes=2),
    Figure(
        "degradation",
        ("docs/degradation.md",),
        "python benchmarks/degradation.py",
        minutes=15,
        needs_data=True,
    ),
    Figure(
        "other-images",
        ("docs/degradation.md",),
        "python benchmarks/other_images.py",
        minutes=10,
        needs_data=True,
    ),
    Figure(
        "mirrored",
        ("docs/accuracy.md",),
        "python benchmarks/mirrored.py",
        minutes=2,
        needs_data=True,
    ),
    Figure(
        "there-and-back",
        ("docs/accuracy.md",),
        "python benchmarks/there_and_back.py",
        minutes=3,
        needs_data=True,
    ),
    Figure(
        "learning-spoiled",
        ("docs/learning-spoiled.md",),
        "python benchmarks/learning_spoiled.py",
        minutes=40,
        needs_data=True,
    ),
    Figure(
        "focal-length",
        ("docs/degradation.md",),
        "python benchmarks/focal_length.py",
        minutes=5,
    ),
    Figure(
        "ground-height",
        ("docs/degradation.md",),
        "python benchmarks/ground_height.py",
        minutes=5,
    ),
    Figure("faults", ("docs/robustness.md",), "python benchmarks/faults.py --kills 40", minutes=15),
    Figure(
        "soak",
        ("docs/robustness.md",),
        "python benchmarks/soak.py --minutes 7",
        minutes=7,
        needs_data=True,
    ),
    Figure("solve-time", ("docs/accuracy.md",), "python benchmarks/solve_time.py", minutes=1),
    Figure(
        "speed",
        ("README.md", "docs/accuracy.md", "docs/performance.md"),
        "python benchmarks/speed.py",
        minutes=10,
        needs_data=True,
    ),
    Figure(
        "prediction-time",
        ("docs/performance.md", "docs/probe.md"),
        "python benchmarks/prediction_time.py",
        minutes=5,
    ),
    Figure(
        "cold-start",
        ("docs/performance.md",),
        "python benchmarks/cold_start.py",
        minutes=3,
        needs_data=True,
    ),
    Figure(
        "memory",
        ("docs/performance.md",),
        "python benchmarks/memory.py",
        minutes=8,
        needs_data=True,
    ),
    Figure(
        "memory-tracks",
        ("docs/performance.md",),
        "python benchmarks/memory.py --of tracks --frames 5000",
        minutes=2,
        needs_data=True,
    ),
    Figure(
        "memory-live",
        ("docs/performance.md",),
        "python benchmarks/memory.py --of tracks --live",
        minutes=4,
        needs_data=True,
    ),
    Figure(
        "memory-recorded",
        ("docs/performance.md",),
        "python benchmarks/memory.py --of tracks --recorded",
        minutes=4,
        needs_data=True,
    ),
    Figure("points", ("docs/simulation.md",), "python benchmarks/points.py", minutes=3),
    Figure("rendering", ("docs/simulation.md",), "python benchmarks/rendering.py", minutes=15),
    Figure("effects", ("docs/simulation.md",), "python benchmarks/effects.py 2", minutes=40),
    Figure("feature-drift", ("docs/tracker.md",), "python benchmarks/feature_drift.py", minutes=4),
    Figure(
        "feature-errors", ("docs/simulation.md",), "python benchmarks/feature_errors.py", minutes=10
    ),
    Figure(
        "contact-sheets",
        ("README.md", "docs/simulation.md"),
        "python benchmarks/contact_sheets.py .",
        minutes=2,
        pictures=("presets.jpg", "effects.jpg"),
    ),
    Figure("blur", ("docs/simulation.md",), "probevo paper blur --out blur", minutes=2),
    Figure(
        "separation",
        ("docs/predictors.md",),
        "python benchmarks/separation.py 4 .",
        minutes=15,
        pictures=("separation.png", "separation_histograms.png"),
    ),
    Figure("probe-ablation", ("docs/probe.md",), "python benchmarks/probe.py ablation", minutes=60),
    Figure(
        "probe",
        ("docs/probe.md",),
        "python benchmarks/probe.py point city residential road rover",
        minutes=60,
    ),
    Figure("probe-streets", ("docs/probe.md",), "python benchmarks/probe_streets.py", minutes=5),
    Figure(
        "probe-images",
        ("docs/probe.md",),
        "python benchmarks/probe.py kitti",
        minutes=10,
        needs_data=True,
    ),
    Figure(
        "probe-loops",
        ("docs/probe.md", "docs/probe-gk.md"),
        "python benchmarks/probe.py loop",
        minutes=20,
    ),
    Figure(
        "kernel-points",
        ("docs/probe-gk.md",),
        "python benchmarks/kernel_points.py 20 row radius",
        minutes=90,
    ),
    Figure(
        "kernel-points-correlated",
        ("docs/probe-gk.md",),
        "python benchmarks/kernel_points.py 8 correlated",
        minutes=20,
    ),
    Figure(
        "kernel-points-4",
        ("docs/probe-gk.md",),
        "python benchmarks/kernel_points.py 4 disparity column",
        minutes=20,
    ),
    Figure(
        "kernel-points-heavy-tailed",
        ("docs/probe-gk.md",),
        "python benchmarks/kernel_points.py 1 heavy-tailed",
        minutes=3,
    ),
    Figure(
        "kernel-tracks",
        ("docs/probe-gk.md",),
        "python benchmarks/kernel_tracks.py 3",
        minutes=20,
        needs_data=True,
    ),
    Figure(
        "kernel-images",
        ("README.md", "docs/probe-gk.md"),
        "python benchmarks/kernel_streets.py kitti",
        minutes=10,
        needs_data=True,
    ),
    Figure(
        "kernel-streets",
        ("docs/probe-gk.md",),
        "python benchmarks/kernel_streets.py city residential road",
        minutes=120,
    ),
    Figure("hydranet", ("docs/nets.md",), "probevo paper hydranet --out hydranet", minutes=30),
    Figure("sun-streets", ("docs/nets.md",), "python benchmarks/sun_streets.py sun", minutes=60),
    Figure(
        "sun-methods",
        ("docs/nets.md",),
        "python benchmarks/sun_streets.py sun --scenes 240 --methods hydra-sigma dropout ensemble",
        minutes=40,
    ),
    Figure("dpc-net", ("docs/nets.md",), "probevo paper dpc-net --out dpc-net", minutes=15),
    Figure("table-1.3", ("docs/probe-gk.md",), "probevo paper table-1.3 --out t13", minutes=30),
    Figure(
        "training-scale",
        ("docs/scale.md",),
        "python benchmarks/training_scale.py 1e4 1e5 304000 1e6 1e7",
        minutes=15,
    ),
    Figure(
        "training-fitted",
        ("docs/scale.md",),
        "python benchmarks/training_scale.py --fitted",
        minutes=3,
    ),
    Figure(
        "training-workers",
        ("docs/scale.md",),
        "python benchmarks/training_scale.py --workers",
        minutes=3,
    ),
    Figure(
        "window-gtsam",
        ("docs/window.md",),
        "python benchmarks/window_gtsam.py",
        minutes=2,
    ),
    Figure(  # last, since it needs an extra: pip install '.[gtsam]'
        "gtsam-agreement",
        ("docs/other-back-ends.md",),
        "python benchmarks/gtsam_agreement.py",
        minutes=15,
        needs_data=True,
    ),
)


def data_folder() -> Path:
    """Return where the real recordings are, as ``recordings.py`` looks for them."""
    return Path(os.environ.get("PROBEVO_DATA", ROOT.parent / "shared" / "data")).resolve()


def print_list(figures: Sequence[Figure]) -> None:
    """Print page, name, command and time of each figure, page by page."""
    for page in sorted({page for figure in figures for page in figure.pages}):
        print(page)
        for figure in figures:
            if page in figure.pages:
                data = ", needs PROBEVO_DATA" if figure.needs_data else ""
                print(f"  {figure.name:26} {figure.command}  (about {figure.minutes} min{data})")


def recompute(figures: Sequence[Figure], out: Path) -> int:
    """Run the commands of some figures in a folder; return the exit code, 1 if one failed."""
    out.mkdir(parents=True, exist_ok=True)
    data = data_folder()
    environment = os.environ | {"PROBEVO_DATA": str(data)}
    for number, figure in enumerate(figures, start=1):
        name = f"{number} of {len(figures)}, {figure.name}"
        if figure.needs_data and not data.is_dir():
            print(f"{name}: skipped, as it needs real recordings: set PROBEVO_DATA", flush=True)
            continue
        print(f"{name}: {figure.command}", flush=True)
        file = out / f"{figure.name}.txt"
        start = time.monotonic()
        with file.open("w", encoding="utf-8") as stream:
            done = subprocess.run(
                figure.words, cwd=out, env=environment, stdout=stream, check=False
            )
        if done.returncode != 0:
            print(
                f"{figure.name} failed with exit code {done.returncode}: {figure.command}\n"
                f"What it printed is in {file}.",
                file=sys.stderr,
            )
            return 1
        print(f"  {(time.monotonic() - start) / 60:.1f} min, {file}", flush=True)
    return 0


def main(words: Sequence[str] | None = None) -> int:
    """Parse the command line, and list or recompute; return the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--list", action="store_true", help="list the figures, and run nothing")
    parser.add_argument(
        "--only",
        nargs="+",
        metavar="NAME",
        choices=[figure.name for figure in FIGURES],
        help="recompute these figures",
    )
    parser.add_argument("--out", type=Path, default=Path("out/recompute"), help="folder of results")
    arguments = parser.parse_args(words)
    figures = [
        figure for figure in FIGURES if arguments.only is None or figure.name in arguments.only
    ]
    if arguments.list:
        print_list(figures)
        return 0
    return recompute(figures, arguments.out.resolve())


if __name__ == "__main__":
    sys.exit(main())
