"""``probevo covariance-check``: test the claimed covariances on a recording, without any truth."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.info import print_reader_warnings
from probevo.cli.text import table
from probevo.errors import InputError
from probevo.sequences.read_settings import ReadSettings

if TYPE_CHECKING:
    from probevo.runs.feature_halves import Agreement

LEVELS = (0.5, 0.9, 0.99)
"""Regions whose coverage is printed."""
SURE = 3.0
"""Standard errors beyond which a mean differs from 1 by more than chance."""
MAX_MARGIN = 0.5
"""Largest margin of chance at which a mean that does not differ from 1 confirms the claim."""
COLUMNS = (
    "NEES / 6 is 1 if the claimed covariances hold, more if they are too small; ± is one standard"
    " error of it. The last columns are shares of the motions inside the claimed regions."
)
LIMITS = (
    "What both halves have in common does not show: a wrong baseline or focal length, what moves"
    " with the camera, an IMU, which is not used here."
)


@dataclass(frozen=True)
class CovarianceCheckArguments:
    """Tests the covariances that the odometry claims, on a recording without any true pose.

    The features are divided into two halves: those on the white and those on the black squares of a
    checkerboard. Each half is solved for by itself, and the difference of both motions is compared
    with the sum of both covariances: 1 if these hold, more if they are too small.
    """

    sequence: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SEQUENCE")]
    """Folder of the recording, a bag, or a tracks file (.npz)."""
    noise: str = "student-t"
    """Kind of noise model, or file of a learned one."""
    estimator: Literal["window", "two-frame"] = "window"
    """The sliding window, or two frames at a time."""
    any_camera: bool = False
    """Use a noise model that was learned with another camera."""
    max_frames: int | None = None
    """Frames that are looked at, from the start; all by default."""
    settings: Annotated[ReadSettings, tyro.conf.arg(name="")] = field(default_factory=ReadSettings)


def main(words: list[str]) -> None:
    """Parse the arguments, run both halves, and print how they agree."""
    arguments = parse(CovarianceCheckArguments, words, "covariance-check")
    settings = checked(arguments.settings)
    if arguments.max_frames is not None and arguments.max_frames < 1:
        raise InputError("--max-frames", f"is {arguments.max_frames}.", "It must be at least 1.")
    from probevo.cli.first_use import getting_ready
    from probevo.cli.progress import progress_bar
    from probevo.python_arguments import as_noise
    from probevo.runs.feature_halves import compare_halves
    from probevo.sequences import open_sequence

    noise = as_noise(arguments.noise)
    sequence = open_sequence(arguments.sequence, settings.format, **settings.format_options())
    print_reader_warnings(sequence)
    config = {"estimator": arguments.estimator, "any_camera": arguments.any_camera}
    with progress_bar(sequence.path.resolve().name, getting_ready()) as show:
        halves = compare_halves(
            sequence, noise, config, max_frames=arguments.max_frames, on_progress=show
        )
    print(
        f"recording: {sequence.path}, {halves.num_frames} frames, {halves.num_solved} solved twice"
    )
    print(f"\n{agreement_table(halves.agreements)}\n{COLUMNS}\n")
    for agreement in halves.agreements:
        print(verdict(agreement))
    print(LIMITS)


def agreement_table(agreements: tuple[Agreement, ...]) -> str:
    """Return a table with a row for each number of frames that motions lead over."""
    head = ("motions over", "compared", "NEES / 6", "±", *(f"in {level:.0%}" for level in LEVELS))
    rows = []
    for agreement in agreements:
        shares = (f"{agreement.share_inside(level):.0%}" for level in LEVELS)
        rows.append(
            (
                _span(agreement),
                str(len(agreement.squared)),
                f"{agreement.mean:.2f}",
                f"{agreement.standard_error:.2f}",
                *shares,
            )
        )
    return table(head, rows)


def verdict(agreement: Agreement) -> str:
    """Say in words whether the claimed covariances hold."""
    span = _span(agreement)
    factor = agreement.mean**0.5
    margin = SURE * agreement.standard_error_if_true
    if agreement.mean > 1.0 + margin:
        return (
            f"! Over {span}: σ is claimed {factor:.2f} times too small. Learn the noise from this"
            " rig: probevo train."
        )
    if agreement.mean < 1.0 - margin:
        return (
            f"Over {span}: the halves differ by {factor:.2f} of the σ that is claimed. The rest"
            " covers errors that both have in common, or is conservative."
        )
    if margin > MAX_MARGIN:
        return (
            f"Over {span}: too few motions to tell. If the claim holds, chance moves NEES / 6 by up"
            f" to {margin:.1f}. Give a longer recording."
        )
    return f"Over {span}: the claim holds."


def _span(agreement: Agreement) -> str:
    return "1 frame" if agreement.frames == 1 else f"{agreement.frames} frames"
