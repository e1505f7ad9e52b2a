"""``probevo info``: what a recording is, whether its calibration is sane, and what will be used."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import parse
from probevo.cli.text import columns
from probevo.run_config import FORMAT_HELP, RunConfig

if TYPE_CHECKING:
    from probevo.sequences import Sequence
    from probevo.sequences.imu import ImuStream

Rows = list[tuple[str, str]]
GAP_FACTOR = 1.5
"""A step longer than this many median ones is called a gap."""
USUAL_VIEW_DEG = (20.0, 150.0)
USUAL_BASELINE_M = (0.03, 3.0)
USUAL_RATE_HZ = (0.5, 500.0)
MOST_OFF_CENTER = 0.1
"""Share of width or height by which the principal point may miss the middle of the image."""
MOST_UNSQUARE = 0.1
"""By how much the two focal lengths may differ."""
LEAST_DISPARITY_PX = 0.25
"""If nine matches of ten have less, left and right are taken for the same picture; noise of
matching is 0.1 to 0.2."""

IMAGE_DOUBTS = ("Are left and right the same picture?", "Is the picture sharp and textured?")
"""What to ask where disparities are next to nothing, and where there are no matches."""
FEATURE_DOUBTS = ("Are columns 0 and 2 of uv the same?", "Do the ids repeat from frame to frame?")
"""The same of a tracks file."""


@dataclass(frozen=True)
class InfoArguments:
    """What a recording is, whether its calibration is sane, and what will be used. Lines with a !
    need a look."""

    sequence: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SEQUENCE")]
    """Folder of the recording, or a tracks file (.npz)."""
    format: Annotated[str | None, tyro.conf.arg(help=FORMAT_HELP, help_behavior_hint="")] = None


def main(words: list[str]) -> None:
    """Parse, open, print."""
    arguments = parse(InfoArguments, words, "info")
    from probevo.sequences import open_sequence

    sequence = open_sequence(arguments.sequence, arguments.format)
    rows = describe(sequence)
    try:
        rows += examine(sequence)
        rows += _turns(sequence)
    finally:  # a damaged image should not hide what is known without it
        print(columns(rows), flush=True)


def describe(sequence: Sequence) -> Rows:
    """What the files say."""
    from probevo.output.run_facts import camera_text, frames_text, imu_use_text, truth_text
    from probevo.sequences.recording import StereoRecording
    from probevo.sequences.tracks_file import TracksRecording

    rectified = isinstance(sequence, StereoRecording) and sequence.rectification is not None
    rows = [
        ("recording", str(sequence.path)),
        ("format", sequence.format),
        ("frames", frames_text(sequence.stamps_ns)),
        *_odd_rate(sequence),
        *_gaps(sequence),
        ("camera", camera_text(sequence.camera) + (", rectified on the fly" if rectified else "")),
        *_odd_camera(sequence),
    ]
    if isinstance(sequence, StereoRecording | TracksRecording) and sequence.imu_stream is not None:
        rows += _imu(sequence, sequence.imu_stream)
    rows += [("truth", truth_text(sequence.truth))]
    return [*rows, ("IMU is used", imu_use_text(sequence, RunConfig()))]


def _odd_rate(sequence: Sequence) -> Rows:
    import numpy as np

    rate_hz = (
        1e9 / float(np.median(np.diff(sequence.stamps_ns)))
        if len(sequence) > 1
        else USUAL_RATE_HZ[0]
    )
    if USUAL_RATE_HZ[0] <= rate_hz <= USUAL_RATE_HZ[1]:
        return []
    return [
        (
            "! rate",
            f"{rate_hz:g} Hz is unusual. Are the stamps in the unit that the format asks for?",
        )
    ]


def _gaps(sequence: Sequence) -> Rows:
    import numpy as np

    steps_s = np.diff(sequence.stamps_ns) * 1e-9
    if len(steps_s) == 0:
        return [("! gaps", "a single frame has no motion")]
    gaps = np.flatnonzero(steps_s > GAP_FACTOR * np.median(steps_s))
    if len(gaps) == 0:
        return [
            ("gaps", f"none: steps of {1e3 * steps_s.min():.1f} to {1e3 * steps_s.max():.1f} ms")
        ]
    longest = int(steps_s.argmax())
    return [
        ("! gaps", f"{len(gaps)}; the longest, {steps_s[longest]:.3f} s, after frame {longest}")
    ]


def _odd_camera(sequence: Sequence) -> Rows:
    from probevo.output.run_facts import field_of_view_deg

    camera = sequence.camera
    view_deg = field_of_view_deg(camera)
    baseline_m = camera.baseline_m
    rows = []
    if not (USUAL_BASELINE_M[0] <= baseline_m <= USUAL_BASELINE_M[1]):
        rows.append(("! baseline", f"{baseline_m:g} m is unusual. Is it in metres?"))
    if camera.size_px and not (USUAL_VIEW_DEG[0] <= view_deg <= USUAL_VIEW_DEG[1]):
        rows.append(
            (
                "! view",
                f"{view_deg:.0f}° is unusual. Do focal length and image size belong together?",
            )
        )
    centers = zip((camera.cu_px, camera.cv_px), camera.size_px or (), strict=False)
    if any(abs(center_px / length_px - 0.5) > MOST_OFF_CENTER for center_px, length_px in centers):
        middle = (
            f"({camera.cu_px:.0f}, {camera.cv_px:.0f}) is the middle of {2 * camera.cu_px:.0f}×"
        )
        rows.append(
            ("! center", f"{middle}{2 * camera.cv_px:.0f} px. Calibrated at another resolution?")
        )
    if abs(camera.fu_px / camera.fv_px - 1.0) > MOST_UNSQUARE:
        unlike = (
            f"fu is {camera.fu_px:.1f} px, fv {camera.fv_px:.1f} px; pixels are usually square."
        )
        rows.append(("! focal length", f"{unlike} Was the image scaled in one direction?"))
    return rows


def _imu(sequence: Sequence, stream: ImuStream) -> Rows:
    """Rate, noise, and how its samples lie to the frames."""
    import numpy as np

    # A mean over an interval is held as two samples, 1 ns after its start and at its end; only the
    # end was recorded.
    stamps_ns = stream.stamps_ns[1:-1]
    stamps_ns = stamps_ns[np.r_[np.diff(stamps_ns) > 1_000, True]]
    after = np.clip(np.searchsorted(stamps_ns, sequence.stamps_ns), 1, len(stamps_ns) - 1)
    pair_ms = (stamps_ns[np.stack([after - 1, after])] - sequence.stamps_ns) * 1e-6
    offset_ms = pair_ms[np.abs(pair_ms).argmin(axis=0), np.arange(len(after))]
    frames_ns = sequence.stamps_ns.tolist()
    uncovered = sum(stream.between(a, b) is None for a, b in pairwise(frames_ns))
    rate_hz = 1e9 / float(np.median(np.diff(stamps_ns)))
    rows = [("IMU", f"{len(stamps_ns):,} samples, {rate_hz:.1f} Hz; {_noise_text(sequence)}")]
    rows += [
        (
            "IMU to frames",
            (
                f"the nearest sample is {offset_ms.min():+.1f} to {offset_ms.max():+.1f} ms from a"
                " frame"
            ),
        )
    ]
    if uncovered:
        rows.append(
            ("! IMU", f"does not cover {uncovered} of {len(after) - 1} steps, which go without it")
        )
    return rows


def _turns(sequence: Sequence) -> Rows:
    """Whether the gyro goes with the pictures; nothing where it does."""
    from probevo.cli.info_imu import Turns, imu_doubt
    from probevo.sequences.recording import StereoRecording
    from probevo.sequences.tracks_file import TracksRecording

    if not isinstance(sequence, StereoRecording | TracksRecording):
        return []
    if sequence.imu is None or sequence.imu_stream is None:
        return []
    doubt = imu_doubt(Turns.of(sequence), sequence.imu_stream, sequence.imu)
    return [("! IMU turns", doubt)] if doubt else []


def _noise_text(sequence: Sequence) -> str:
    if sequence.imu is None:
        return ""
    noise = sequence.imu.gyro_noise_rad_s_sqrt_hz
    bias = sequence.imu.gyro_bias_sigma_rad_s
    return f"gyro noise {noise:.2g} rad/s/√Hz, bias within {bias:.2g} rad/s (1σ)"


def examine(sequence: Sequence) -> Rows:
    """What the first frames say: stereo matches, row offset, disparity, and whether left and right
    are swapped."""
    import numpy as np

    from probevo.tracking import TrackingState, Tracks, tracker_for
    from probevo.tracking.left_right import FRAMES_TO_SEE, count_matches, exchange, looks_swapped

    config = RunConfig().tracking
    frames = list(islice(sequence, FRAMES_TO_SEE + 1))
    pictures = [
        (frame.left, frame.right)
        for frame in frames
        if frame.left is not None and frame.right is not None
    ]
    if pictures and all(np.array_equal(left, right) for left, right in pictures):
        return [
            (
                "! images",
                (
                    f"left and right are identical in the first {len(frames)} frames: no depth, no"
                    " motion"
                ),
            )
        ]
    if len(frames) < 2:
        return []
    same, sharp = FEATURE_DOUBTS if frames[0].features is not None else IMAGE_DOUBTS
    tracker = tracker_for(frames[0], sequence.camera, config)
    state = TrackingState.none()
    seen: list[Tracks] = []
    for frame in frames:
        tracked = tracker.track(state, frame, np.eye(4))
        state = tracked.state
        seen.append(tracked.tracks)
    ahead, behind = np.sum([count_matches(tracks) for tracks in seen], axis=0).tolist()
    pixels = np.concatenate([tracks.curr_px for tracks in seen])
    # First, as noise drives most matches of a picture with itself below zero, and so out of the
    # tracks.
    disparity_px = pixels[:, 0] - pixels[:, 2]
    if (
        len(pixels) > 0.1 * (ahead + behind)
        and np.percentile(np.abs(disparity_px), 90) < LEAST_DISPARITY_PX
    ):
        return [("! disparity", f"nine in ten are under {LEAST_DISPARITY_PX} px. {same}")]
    if looks_swapped(ahead, behind):
        negative = (
            f"{behind} of {ahead + behind} have negative disparity. Are left and right swapped?"
        )
        return [("! matches", f"{negative} {exchange(sequence.path)}")]
    if len(pixels) < 2:
        return [("! matches", f"{len(pixels)} in the first {len(frames)} frames. {sharp}")]
    rows_px = pixels[:, 3] - pixels[:, 1]
    depth_m = (
        sequence.camera.fu_px
        * sequence.camera.baseline_m
        / max(float(np.median(disparity_px)), 1e-9)
    )
    tenth, half, most = np.percentile(disparity_px, [10, 50, 90])
    low, row, high = np.percentile(rows_px, [10, 50, 90])
    per_frame = len(pixels) / (len(frames) - 1)
    matches = (
        f"{per_frame:.0f} tracks a frame in the first {len(frames)}; left and right are not swapped"
    )
    disparity = (
        f"{tenth:.1f} to {most:.1f} px (10 to 90 %), median {half:.1f} px, which is {depth_m:.1f} m"
        " away"
    )
    offset = f"right minus left: median {row:+.2f} px, {low:+.2f} to {high:+.2f} px (10 to 90 %)"
    level = max(abs(low), abs(high)) <= config.max_row_offset_px / 2
    return [("matches", matches), ("disparity", disparity), ("rows" if level else "! rows", offset)]
