"""``probevo info``: describe a recording, check its calibration, and say what will be used."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import islice, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.text import columns
from probevo.run_config import RunConfig
from probevo.sequences.read_settings import ReadSettings

if TYPE_CHECKING:
    from probevo.camera.rectification import PinholeCamera
    from probevo.camera.stereo import StereoCamera
    from probevo.measurements.imu_reason import ImuReason
    from probevo.runs.first_matches import FirstMatches
    from probevo.sequences import Sequence
    from probevo.sequences.frame import Frame
    from probevo.sequences.imu import ImuStream

Row = tuple[str, str]
"""Name and text of a line; the names of warnings start with "!"."""
Rows = list[Row]
USUAL_VIEW_DEG = (20.0, 150.0)
"""Usual horizontal field of view."""
USUAL_BASELINE_M = (0.03, 3.0)
USUAL_RATE_HZ = (0.5, 500.0)
"""Usual rate of frames, from time lapse to high speed."""
USUAL_DEPTH_M = (0.2, 300.0)
"""Usual median distance of what a stereo camera sees."""
MIN_TRACKS = 20
"""Fewer tracks per frame leave the motion uncertain, or none; images that are not rectified have
few, since matches are searched along a row."""
MAX_OFF_CENTER = 0.1
"""Largest usual distance of the principal point from the image centre, as a share of the size."""
MAX_FOCAL_DIFFERENCE = 0.1
"""Largest usual relative difference of the two focal lengths."""
MIN_DISPARITY_PX = 0.25
"""Disparity below which nine of ten matches mean that left and right are probably the same image;
the noise of matching is 0.1 to 0.2 px."""

STEPS_FOR_IMU = 100
"""Steps, from the start, for which it is tried whether the window could use the IMU."""
FRAMES_COMPARED = 60
"""Frames, from the start, whose images are compared with those of their neighbours."""

IMAGE_QUESTIONS = (
    "Are left and right the same image?",
    "Are the images rectified, sharp and textured?",
)
"""Questions if there are next to no disparities, and if there are no matches."""
FEATURE_QUESTIONS = (
    "Are columns 0 and 2 of uv the same?",
    "Do the ids repeat from frame to frame?",
)
"""Both questions for a tracks file."""


@dataclass(frozen=True)
class InfoArguments:
    """Describes a recording, checks its calibration, and tells what will be used.

    Lines that start with ! are warnings.
    """

    sequence: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SEQUENCE")]
    """Folder of the recording, a bag, or a tracks file (.npz)."""
    settings: Annotated[ReadSettings, tyro.conf.arg(name="")] = field(default_factory=ReadSettings)


def main(words: list[str]) -> None:
    """Parse the arguments, open the recording, and print what it is."""
    arguments = parse(InfoArguments, words, "info")
    settings = checked(arguments.settings)
    from probevo.cli.first_use import say_if_compiling
    from probevo.sequences import open_sequence
    from probevo.tracking.left_right import FRAMES_TO_SEE

    sequence = open_sequence(arguments.sequence, settings.format, **settings.format_options())
    say_if_compiling()
    rows = describe(sequence)
    try:
        frames = list(islice(sequence, FRAMES_TO_SEE + 1))
        rows += examine(frames, sequence)
        rows += _order_warnings(sequence)
        rows += _exposure_warnings(frames)
        rows += _mosaic_warnings(frames)
        rows += _imu_warnings(sequence)
    finally:  # a damaged image must not hide what is known without it
        print(columns(rows), flush=True)


def describe(sequence: Sequence) -> Rows:
    """Describe what the files say, without looking at the images."""
    from probevo.measurements.imu_reason import ImuFault
    from probevo.output.run_facts import (
        camera_text,
        frames_text,
        imu_use_text,
        mask_text,
        truth_text,
    )
    from probevo.sequences.base import imu_stream_of
    from probevo.sequences.masked import MaskedRecording
    from probevo.sequences.recording import ImageRecording

    is_rectified = isinstance(sequence, ImageRecording) and sequence.rectification is not None
    camera = camera_text(sequence.camera)
    if is_rectified:
        camera += ", rectified on the fly"
    rows = [
        ("recording", str(sequence.path)),
        ("format", sequence.format),
        ("frames", frames_text(sequence.stamps_ns)),
        *rate_warnings(sequence),
        *_gaps(sequence),
        ("camera", camera),
        *camera_warnings(sequence),
    ]
    if isinstance(sequence, ImageRecording):
        rows += sequence.notes
    stream = imu_stream_of(sequence)
    if stream is not None:
        rows += _imu(sequence, stream)
    rows.append(("truth", truth_text(sequence.truth)))
    if isinstance(sequence, MaskedRecording):
        rows.append(("masks", mask_text(sequence)))
    config = RunConfig()
    reason = _reason_against_window(sequence)
    if reason is not None:
        # An IMU without an accelerometer is no fault, and nobody expects the window to use it.
        if reason.fault is not ImuFault.NO_ACCELEROMETER:
            text = f"it {reason.text}: the window does without it, and its path is by images alone"
            rows.append(("! IMU", text))
        config = RunConfig.model_validate({"window": {"imu": "off"}})
    rows.append(("use of IMU", imu_use_text(sequence, config)))
    return rows


def print_reader_warnings(sequence: Sequence) -> None:
    """Print what the reader could not use of a recording, such as its IMU, and what is unusual
    about its camera and its rate, a line each."""
    notes: Iterable[tuple[str, str]] = getattr(sequence, "notes", ())
    warnings = [(name, text) for name, text in notes if name.startswith("!")]
    warnings += camera_warnings(sequence)
    warnings += rate_warnings(sequence)
    for name, text in warnings:
        print(f"probevo: warning: {name[1:].strip()}: {text}", file=sys.stderr)


def rate_warnings(sequence: Sequence) -> Rows:
    """Return what is unusual about the rate of the frames."""
    import numpy as np

    if len(sequence) < 2:
        return []
    rate_hz = 1e9 / float(np.median(np.diff(sequence.stamps_ns)))
    if USUAL_RATE_HZ[0] <= rate_hz <= USUAL_RATE_HZ[1]:
        return []
    text = f"{rate_hz:g} Hz is unusual. Are the stamps in the unit that the format asks for?"
    return [("! rate", text)]


def _gaps(sequence: Sequence) -> Rows:
    import numpy as np

    from probevo.sequences.stamps import GAP_FACTOR

    steps_s = np.diff(sequence.stamps_ns) * 1e-9
    if len(steps_s) == 0:
        return [("! gaps", "a single frame has no motion")]
    num_gaps = int((steps_s > GAP_FACTOR * np.median(steps_s)).sum())
    if num_gaps == 0:
        shortest_ms = 1e3 * steps_s.min()
        longest_ms = 1e3 * steps_s.max()
        return [("gaps", f"none: steps of {shortest_ms:.1f} to {longest_ms:.1f} ms")]
    longest = int(steps_s.argmax())
    text = f"{num_gaps}; the longest, {steps_s[longest]:.3f} s, is after frame {longest}"
    return [("! gaps", text)]


def camera_warnings(sequence: Sequence) -> Rows:
    """Return what is unusual about a camera, and what may be wrong with it."""
    from probevo.output.run_facts import field_of_view_deg

    camera = sequence.camera
    rows = []
    baseline_m = camera.baseline_m
    if not (USUAL_BASELINE_M[0] <= baseline_m <= USUAL_BASELINE_M[1]):
        rows.append(("! baseline", f"{baseline_m:g} m is unusual. Is it in metres?"))

    view_deg = field_of_view_deg(camera)
    if camera.size_px and not (USUAL_VIEW_DEG[0] <= view_deg <= USUAL_VIEW_DEG[1]):
        text = f"{view_deg:.0f}° is unusual. Do focal length and image size belong together?"
        rows.append(("! view", text))

    # A rectification moves the centre; that of the calibration is the raw cameras'.
    rectification = getattr(sequence, "rectification", None)
    calibrated = (camera,) if rectification is None else (rectification.left, rectification.right)
    off_center = [one for one in calibrated if _is_off_center(one)]
    if off_center:
        first = off_center[0]
        text = (
            f"({first.cu_px:.0f}, {first.cv_px:.0f}) is the centre of an image of"
            f" {2 * first.cu_px:.0f}×{2 * first.cv_px:.0f} px."
            " Was the camera calibrated at another resolution?"
        )
        rows.append(("! center", text))

    if abs(camera.fu_px / camera.fv_px - 1.0) > MAX_FOCAL_DIFFERENCE:
        text = (
            f"fu is {camera.fu_px:.1f} px, fv {camera.fv_px:.1f} px; pixels are usually square."
            " Was the image scaled in one direction?"
        )
        rows.append(("! focal length", text))
    return rows


def _is_off_center(camera: StereoCamera | PinholeCamera) -> bool:
    """Return whether the principal point is unusually far from the centre of the image."""
    centers = zip((camera.cu_px, camera.cv_px), camera.size_px or (), strict=False)
    return any(abs(center_px / side_px - 0.5) > MAX_OFF_CENTER for center_px, side_px in centers)


def _imu(sequence: Sequence, stream: ImuStream) -> Rows:
    """Describe the rate and the noise of the IMU, and how its samples lie between the frames."""
    import numpy as np

    from probevo.sequences.imu import HELD_NS

    # The stamps of all packets. A packet that holds a mean has two samples, 1 ns after the packet
    # before and at its own stamp.
    stamps_ns = stream.stamps_ns[1:-1]
    stamps_ns = stamps_ns[np.r_[np.diff(stamps_ns) > HELD_NS, True]]
    rate_hz = 1e9 / float(np.median(np.diff(stamps_ns)))

    # The nearest sample is the one before the frame or the one after it.
    next_index = np.clip(np.searchsorted(stamps_ns, sequence.stamps_ns), 1, len(stamps_ns) - 1)
    both_ms = (stamps_ns[np.stack([next_index - 1, next_index])] - sequence.stamps_ns) * 1e-6
    offset_ms = both_ms[np.abs(both_ms).argmin(axis=0), np.arange(len(next_index))]
    offset_ms = np.round(offset_ms, 1) + 0.0  # so that no -0.0 is shown
    offset = (
        f"the nearest sample is {offset_ms.min():+.1f} to {offset_ms.max():+.1f} ms from a frame"
    )
    rows = [
        ("IMU", f"{len(stamps_ns):,} samples, {rate_hz:.1f} Hz; {_noise_text(sequence)}"),
        ("IMU to frames", offset),
    ]

    steps = list(pairwise(sequence.stamps_ns.tolist()))
    num_uncovered = sum(stream.between(start_ns, end_ns) is None for start_ns, end_ns in steps)
    if num_uncovered:
        text = f"does not cover {num_uncovered} of {len(steps)} steps, which do without it"
        rows.append(("! IMU", text))
    return rows


def _reason_against_window(sequence: Sequence) -> ImuReason | None:
    """Return why the window can use the IMU in hardly any step; None if it can, or without an
    IMU."""
    from probevo.measurements.preintegration import NoPreintegration, preintegrate
    from probevo.sequences.base import imu_stream_of

    stream = imu_stream_of(sequence)
    if sequence.imu is None or stream is None:
        return None
    reasons = []
    covered = 0
    for start_ns, end_ns in islice(pairwise(sequence.stamps_ns.tolist()), STEPS_FOR_IMU):
        samples = stream.between(start_ns, end_ns)
        if samples is None:
            continue  # counted among the steps that the IMU does not cover
        covered += 1
        preintegrated = preintegrate(samples, start_ns, end_ns, sequence.imu)
        if isinstance(preintegrated, NoPreintegration):
            reasons.append(preintegrated.reason)
    return reasons[0] if 2 * len(reasons) > covered else None


def _noise_text(sequence: Sequence) -> str:
    if sequence.imu is None:
        return ""
    noise = sequence.imu.gyro_noise_rad_s_sqrt_hz
    bias = sequence.imu.gyro_bias_sigma_rad_s
    return f"gyro noise {noise:.2g} rad/s/√Hz, bias within {bias:.2g} rad/s (1σ)"


def _imu_warnings(sequence: Sequence) -> Rows:
    """Look for implausible samples, and compare the gyro with the images."""
    from probevo.runs.imu_check import ImageRotations, imu_warning, sample_warnings
    from probevo.sequences.base import imu_stream_of

    stream = imu_stream_of(sequence)
    if sequence.imu is None or stream is None:
        return []
    warnings = sample_warnings(stream, sequence.stamps_ns)
    rows = [("! IMU samples", text) for text in warnings]
    warning = imu_warning(ImageRotations.of(sequence), stream, sequence.imu)
    return [*rows, ("! gyro", warning)] if warning else rows


def _order_warnings(sequence: Sequence) -> Rows:
    """Warn of images that repeat, of right ones that belong to other frames than the left, and of
    rows of two times."""
    from probevo.output.run_warnings import (
        interlacing_warning,
        repetition_warning,
        timing_warning,
    )
    from probevo.tracking.interlacing import Interlacing
    from probevo.tracking.pair_timing import PairTiming
    from probevo.tracking.repeated_images import are_repeated, shows_nothing

    timing = PairTiming(RunConfig().tracking)
    interlacing = Interlacing()
    num_frames = 0
    num_repeated = 0
    prev = None
    for frame in islice(sequence, FRAMES_COMPARED):
        if not timing.is_decided:
            timing.add(frame)
        interlacing.add(frame)
        num_frames += 1
        repeats = prev is not None and are_repeated(prev, frame)
        num_repeated += repeats and not shows_nothing(frame)
        prev = frame
    warnings = {
        "! timing": timing_warning(timing.right_late_frames),
        "! interlacing": interlacing_warning(interlacing.is_found),
        "! repetition": repetition_warning(num_repeated, num_frames),
    }
    return [(name, text) for name, text in warnings.items() if text]


def _exposure_warnings(frames: list[Frame]) -> Rows:
    """Warn of cameras whose exposures differ, by the contrast of the first images."""
    import numpy as np

    from probevo.tracking.contrast import MIN_GAIN_IN_STEREO, symmetric_gain
    from probevo.tracking.preparation import right_contrast

    config = RunConfig().tracking
    ratios = [
        right_contrast(frame.left, frame.right, config)
        for frame in frames
        if frame.left is not None and frame.right is not None
    ]
    ratio = float(np.median(ratios)) if ratios else np.nan
    if not symmetric_gain(ratio) > MIN_GAIN_IN_STEREO:
        return []
    text = (
        f"right images have {ratio:.2g} times the contrast of left ones. It is adapted, but what is"
        " lost in noise or in white stays lost. Give both cameras the same exposure."
    )
    return [("! exposure", text)]


def _mosaic_warnings(frames: list[Frame]) -> Rows:
    """Warn of raw images of colour cameras."""
    from probevo.tracking.color_mosaic import MIN_DIFFERENCE, mosaic_difference

    differences = [
        max(mosaic_difference(frame.left), mosaic_difference(frame.right))
        for frame in frames
        if frame.left is not None and frame.right is not None
    ]
    # A mosaic is in every image; in a single one, a pattern of the scene may look like it.
    difference = min(differences, default=0.0)
    if difference < MIN_DIFFERENCE:
        return []
    text = (
        f"pixels of even and odd rows and columns differ by {100.0 * difference:.0f} % in the mean."
        " Are these the raw images of a colour camera? Convert them to grey first, as by OpenCV's"
        " cvtColor: their mosaic costs up to two thirds of the features."
    )
    return [("! mosaic", text)]


def examine(frames: list[Frame], sequence: Sequence) -> Rows:
    """Describe the stereo matches of the first frames of a recording.

    They show the disparity, the row offset, and whether left and right are swapped or the same.
    """
    from probevo.runs.first_matches import first_matches
    from probevo.tracking.left_right import are_identical, how_to_swap, looks_swapped

    if frames and all(are_identical(frame) for frame in frames):
        text = (
            f"left and right are identical in the first {len(frames)} frames: no depth, no motion"
        )
        return [("! images", text)]
    if len(frames) < 2:
        return []
    matches = first_matches(frames, sequence.camera)
    num_matches = matches.num_positive + matches.num_negative
    has_images = frames[0].features is None
    ask_if_same, ask_if_poor = IMAGE_QUESTIONS if has_images else FEATURE_QUESTIONS
    # This check comes first: noise makes most disparities of an image with itself negative, which
    # would look as if left and right were swapped.
    if len(matches.pixels) > 0.1 * num_matches and _is_without_disparity(matches):
        text = f"nine of ten are under {MIN_DISPARITY_PX} px. {ask_if_same}"
        return [("! disparity", text)]
    if looks_swapped(matches.num_positive, matches.num_negative):
        text = (
            f"{matches.num_negative} of {num_matches} have negative disparity. Are left and right"
            f" swapped? {how_to_swap(sequence.path)}"
        )
        return [("! matches", text)]
    if len(matches.pixels) < 2:
        text = f"{len(matches.pixels)} in the first {matches.num_frames} frames. {ask_if_poor}"
        return [("! matches", text)]
    min_tracks = MIN_TRACKS if has_images else 0
    return [
        _tracks_row(matches, min_tracks, ask_if_few=ask_if_poor),
        _disparity_row(matches, sequence.camera),
        _rows_row(matches),
    ]


def _is_without_disparity(matches: FirstMatches) -> bool:
    import numpy as np

    return bool(np.percentile(np.abs(matches.disparity_px), 90) < MIN_DISPARITY_PX)


def _tracks_row(matches: FirstMatches, min_tracks: int, ask_if_few: str) -> Row:
    text = (
        f"{matches.num_per_frame:.0f} tracks per frame in the first {matches.num_frames};"
        " left and right are not swapped"
    )
    if matches.num_per_frame < min_tracks:
        return ("! matches", f"{text}. These are few. {ask_if_few}")
    return ("matches", text)


def _disparity_row(matches: FirstMatches, camera: StereoCamera) -> Row:
    """Say how far away the tracks are."""
    import numpy as np

    low_px, high_px = np.percentile(matches.disparity_px, [10, 90])
    median_px = float(np.median(matches.disparity_px))
    depth_m = camera.fu_px * camera.baseline_m / max(median_px, 1e-9)
    text = (
        f"{low_px:.1f} to {high_px:.1f} px (10 to 90 %), median {median_px:.1f} px, which is"
        f" {depth_m:.1f} m away"
    )
    if USUAL_DEPTH_M[0] <= depth_m <= USUAL_DEPTH_M[1]:
        return ("disparity", text)
    question = "Are the baseline in metres and the focal length in pixels of these images?"
    return ("! disparity", f"{text}. {question}")


def _rows_row(matches: FirstMatches) -> Row:
    """Say how far apart the rows of a feature are in the two images."""
    import numpy as np

    low_px, median_px, high_px = np.percentile(matches.row_offset_px, [10, 50, 90])
    text = (
        f"right minus left: median {median_px:+.2f} px,"
        f" {low_px:+.2f} to {high_px:+.2f} px (10 to 90 %)"
    )
    is_level = max(abs(low_px), abs(high_px)) <= RunConfig().tracking.max_row_offset_px / 2
    return ("rows" if is_level else "! rows", text)
