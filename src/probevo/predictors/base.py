"""What a predictor is, what it may look at, and the prediction space that several of them span."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Flag, auto
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.sequences.base import Sequence
from probevo.sequences.frame import Frame, ImuSamples
from probevo.tracking.last_residuals import LastResiduals
from probevo.tracking.tracks import Tracks


class Needs(Flag):
    """What a predictor looks at, beside the tracks, their last residuals, and the motion expected
    from gyro and last velocity."""

    TRACKS = 0
    LEFT = auto()
    """The current left image."""
    PREVIOUS_LEFT = auto()
    """The left image before."""
    ACCELEROMETER = auto()


@dataclass(frozen=True)
class Step:
    """All that is known of a step before its motion is solved."""

    tracks: Tracks
    """N features."""
    camera: StereoCamera
    expected: FloatArray
    """T_curr_prev that gyro and last velocity let one expect, [4, 4]."""
    before: Frame
    """The frame before."""
    now: Frame
    """The current frame, with the IMU samples of the interval."""
    last_residuals: LastResiduals = field(default_factory=LastResiduals.none)
    """What the features of the step before left of its motion, if that was solved."""

    @property
    def duration_s(self) -> float:
        """Time since the frame before."""
        return 1e-9 * (self.now.stamp_ns - self.before.stamp_ns)

    @property
    def imu(self) -> ImuSamples:
        """Samples of the interval; none at all where they leave a part of it uncovered."""
        return self.now.imu or ImuSamples(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3)))

    @property
    def left(self) -> Image:
        """Current left image, [height, width]; [0, 0] without images."""
        return np.zeros((0, 0), np.uint8) if self.now.left is None else self.now.left

    @property
    def previous_left(self) -> Image:
        """The left image before, [height, width]; [0, 0] without images."""
        return np.zeros((0, 0), np.uint8) if self.before.left is None else self.before.left

    @property
    def uv(self) -> FloatArray:
        """Where the features are in the current left image, [N, 2], px."""
        return self.tracks.curr_px[:, :2]

    @property
    def previous_uv(self) -> FloatArray:
        """Where they were in the left image before, [N, 2], px."""
        return self.tracks.prev_px[:, :2]

    @property
    def last_residual_px(self) -> FloatArray:
        """How large their residuals were in the step before, [N], px; NaN where that is not known."""
        return self.last_residuals.of(self.tracks.ids)


@dataclass(frozen=True)
class Predictor:
    """One idea of what tells a good feature from a bad one, as one or more columns of the
    prediction space.

    ``compute`` maps a step with N features to [N], or to [N, C] with C columns. NaN says that a
    value is undefined there, and is refused unless ``undefined`` says where that may be.
    """

    name: str
    columns: Mapping[str, str]
    """Name and unit of each column; a predictor with one column gives it its own name."""
    source: str
    """Where it comes from: paper and section."""
    needs: Needs
    compute: Callable[[Step], FloatArray]
    undefined: str = ""
    """Where it has no value, e.g. "where the patch leaves the image"; empty if it always has one.
    """


@dataclass(frozen=True)
class PredictionSpace:
    """The space φ whose M coordinates are the columns of some predictors, in their order."""

    predictors: tuple[Predictor, ...]

    def __post_init__(self) -> None:
        """Refuse two columns of one name: a model knows its predictors by their columns alone.

        Raises:
            InputError: names the second predictor.
        """
        seen: set[str] = set()
        for predictor in self.predictors:
            if not seen.isdisjoint(predictor.columns):
                what = f"{predictor.name} has a column that an earlier one has too."
                raise InputError(
                    "predictors", what, "Name each predictor once, and give your own other columns."
                )
            seen |= set(predictor.columns)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the predictors."""
        return tuple(predictor.name for predictor in self.predictors)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the M columns."""
        return tuple(column for predictor in self.predictors for column in predictor.columns)

    @property
    def may_be_undefined(self) -> tuple[bool, ...]:
        """Whether each of the M columns may hold NaN."""
        return tuple(
            bool(predictor.undefined) for predictor in self.predictors for _ in predictor.columns
        )

    def __call__(self, step: Step) -> FloatArray:
        """Where the N features of a step lie, [N, M]; NaN where a predictor is undefined.

        Raises:
            InputError: the recording lacks what a predictor needs.
        """
        self._check(step)
        count = len(step.tracks)
        parts = [
            predictor.compute(step).reshape(count, len(predictor.columns))
            for predictor in self.predictors
        ]
        return np.concatenate([np.zeros((count, 0)), *parts], axis=1)

    def check_recording(self, sequence: Sequence) -> None:
        """Refuse a recording that lacks what a predictor needs.

        Raises:
            InputError: names the predictor.
        """
        images = sequence.camera.size_px is not None
        imu = sequence.imu is not None
        self._refuse(
            {Needs.LEFT: not images, Needs.PREVIOUS_LEFT: not images, Needs.ACCELEROMETER: not imu},
            sequence.path,
        )

    def _check(self, step: Step) -> None:
        lacking = {
            Needs.LEFT: step.now.left is None,
            Needs.PREVIOUS_LEFT: step.before.left is None,
            Needs.ACCELEROMETER: not np.isfinite(step.imu.accel_m_s2).all(),
        }
        self._refuse(lacking, f"frame {step.now.index}")

    def _refuse(self, lacking: Mapping[Needs, bool], where: str | Path) -> None:
        names = {
            Needs.LEFT: "images",
            Needs.PREVIOUS_LEFT: "images",
            Needs.ACCELEROMETER: "accelerometer",
        }
        for predictor in self.predictors:
            for need, is_lacking in lacking.items():
                if is_lacking and need in predictor.needs:
                    what = f"it has no {names[need]}, which the predictor {predictor.name} needs."
                    raise InputError(
                        where,
                        what,
                        "Train a model without it: name others with `train --predictors`.",
                    )
