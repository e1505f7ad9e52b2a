"""A test of the claimed covariances that needs no truth: two halves of the features of a recording.

Each half is followed and solved for by an odometry of its own, without an IMU in the solve. As far
as the errors of both motions come from the features, they are independent, so that their difference
has the sum of both covariances. Errors that both halves have in common, such as a wrong baseline,
do not show.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from scipy.special import chdtri

from probevo.arrays import FloatArray, Image
from probevo.errors import InputError
from probevo.estimation.motion_estimate import Status
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.noise import NoiseModel
from probevo.odometry import StereoOdometry
from probevo.predictors import space_for
from probevo.sequences import Sequence
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.sequences.masked import mask_of_array
from probevo.tracking.left_right import LeftRightCheck

SQUARES = 12
"""Squares of the checkerboard along the width of an image: on KITTI they are 100 px wide, ten times
as wide as the window of a feature, which has to lie in one of them."""
SPAN = 8
"""Frames that a motion within the window spans, beside those over one."""
WARM_UP = 5
"""First frames that do not count: nothing is known of the rig yet."""
FEWEST = 10
"""Motions below which nothing can be said."""
DIMENSION = 6
GOLDEN_RATIO = np.uint64(0x9E3779B97F4A7C15)
"""2⁶⁴ over the golden ratio, odd: multiples of it are spread evenly over 64 bits."""


@dataclass(frozen=True)
class Agreement:
    """Agreement of the motions of both halves over a number of frames."""

    frames: int
    """Number of frames that the motions lead over."""
    squared: FloatArray
    """Squared difference of each pair of motions in units of the sum of their covariances, [N]."""

    @property
    def mean(self) -> float:
        """Mean over the 6 dimensions: 1 if the covariances hold, more if they are too small."""
        return float(np.mean(self.squared)) / DIMENSION

    @property
    def standard_error(self) -> float:
        """Standard error of the mean, by the scatter of the differences."""
        return float(np.std(self.squared)) / DIMENSION / float(np.sqrt(self.num_disjoint))

    @property
    def standard_error_if_true(self) -> float:
        """Standard error that the mean has if the covariances hold: χ² of 6 degrees of freedom has
        the variance 12. Their scatter is no measure for the test: it grows with what is tested."""
        return float(np.sqrt(2.0 / (DIMENSION * self.num_disjoint)))

    @property
    def num_disjoint(self) -> float:
        """Number of independent motions: those over several frames overlap, so that their number is
        divided by that of the frames."""
        return max(len(self.squared) / self.frames, 1.0)

    def share_inside(self, level: float) -> float:
        """Return the share of differences inside the region of this probability, 0 to 1."""
        return float(np.mean(self.squared <= chdtri(DIMENSION, 1.0 - level)))


@dataclass(frozen=True)
class HalvesCompared:
    """Both halves of a recording, frame by frame."""

    num_frames: int
    num_solved: int
    """Frames that both halves have solved."""
    agreements: tuple[Agreement, ...]
    """Agreement over one frame, and over ``SPAN`` if the estimator has a window."""


def compare_halves(
    sequence: Sequence,
    noise: NoiseModel,
    config: Mapping[str, Any],
    *,
    max_frames: int | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> HalvesCompared:
    """Run two odometries over the halves of a recording's features, and compare their motions.

    Args:
        sequence: the recording; its IMU is used only for the predictors of the noise.
        noise: model of the features' noise, in both.
        config: settings that differ from the defaults.
        max_frames: frames that are looked at, from the start; all by default.
        on_progress: is called with the number of frames done, and of all.

    Raises:
        InputError: the recording lacks what a predictor of the noise needs, or fewer than
            ``FEWEST`` steps are solved by both halves.
    """
    space_for(noise.columns).check_recording(sequence)
    # The errors of an IMU in the solve would be in common. Predictors are to be as in a run.
    config = {**config, "window": {**config.get("window", {}), "imu": "off"}}
    imu = sequence.imu if noise.columns else None
    total = len(sequence) if max_frames is None else min(max_frames, len(sequence))
    odometry = StereoOdometry(sequence.camera, noise, imu, config=config)
    other_odometry = StereoOdometry(sequence.camera, noise, imu, config=config)
    squared: dict[int, list[float]] = {1: [], SPAN: []}
    num_solved = 0
    left_right = LeftRightCheck(sequence.path, total)
    for done, frame in enumerate(islice(sequence, total)):
        first, second = halves_of(replace(frame, imu=None) if imu is None else frame)
        motion = odometry.step(first)
        left_right.see(frame, odometry.tracks)
        other_motion = other_odometry.step(second)
        if on_progress is not None:
            on_progress(done + 1, total)
        if motion.status is not Status.OK or other_motion.status is not Status.OK:
            continue
        num_solved += 1
        if done < WARM_UP:
            continue
        squared[1].append(
            _difference_squared(
                (motion.T_curr_prev, motion.cov), (other_motion.T_curr_prev, other_motion.cov)
            )
        )
        earlier = frame.index - SPAN
        if earlier >= WARM_UP and _has(odometry, earlier) and _has(other_odometry, earlier):
            squared[SPAN].append(
                _difference_squared(
                    odometry.relative(frame.index, earlier),
                    other_odometry.relative(frame.index, earlier),
                )
            )
    if len(squared[1]) < FEWEST:
        what = (
            f"{len(squared[1])} of its steps count and were solved by both halves of the features;"
            f" {FEWEST} are needed."
        )
        raise InputError(
            sequence.path,
            what,
            f"Take more frames, as the first {WARM_UP} do not count, and heed the warnings of"
            " `probevo info`.",
        )
    agreements = (
        Agreement(frames, np.array(values)) for frames, values in squared.items() if values
    )
    return HalvesCompared(total, num_solved, tuple(agreements))


def halves_of(frame: Frame) -> tuple[Frame, Frame]:
    """Return a frame twice: with the white and with the black squares of a checkerboard over the
    left image, or with half of the features each, by a hash of their identities."""
    if frame.features is not None:
        ids = frame.features.ids
        pixels = frame.features.pixels
        # The highest bit of a multiplicative hash (Knuth 1998, section 6.4): identities may be all
        # even.
        is_first = np.asarray(ids).astype(np.uint64) * GOLDEN_RATIO < np.uint64(2**63)
        return (
            replace(frame, features=StereoFeatures(ids[is_first], pixels[is_first])),
            replace(frame, features=StereoFeatures(ids[~is_first], pixels[~is_first])),
        )
    if frame.left is None:
        return frame, frame
    white = checkerboard(frame.left.shape)
    black = 255 - white
    if frame.left_mask is not None:
        usable = mask_of_array(frame.left_mask, None, "left_mask")
        white = np.minimum(white, usable)
        black = np.minimum(black, usable)
    return replace(frame, left_mask=white), replace(frame, left_mask=black)


def checkerboard(shape: tuple[int, int]) -> Image:
    """Return a board of squares, 0 and 255, [height, width], uint8, for an image of that shape."""
    height, width = shape
    side_px = max(width // SQUARES, 1)
    row = np.arange(height)[:, None] // side_px
    column = np.arange(width)[None, :] // side_px
    return np.where((row + column) % 2 == 0, 255, 0).astype(np.uint8)


def _has(odometry: StereoOdometry, frame: int) -> bool:
    """Return whether a frame is in the window of an odometry."""
    return odometry.window is not None and frame in odometry.window.frames


def _difference_squared(
    motion: tuple[FloatArray, FloatArray], other_motion: tuple[FloatArray, FloatArray]
) -> float:
    """Return the squared difference of two motions with covariances, in units of their sum."""
    T, cov = motion
    T_other, cov_other = other_motion
    return float(normalized_error_squared(T, T_other, cov + cov_other))
