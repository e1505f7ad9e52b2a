"""The prediction space that several predictors span (PROBE IV-A)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.errors import InputError
from probevo.predictors.base import Needs, Predictor, Step
from probevo.sequences.base import Sequence

NAMES = {
    Needs.LEFT: "images",
    Needs.RIGHT: "images",
    Needs.PREVIOUS_LEFT: "images",
    Needs.PREVIOUS_RIGHT: "images",
    Needs.ALIGNMENT: "features of our own front end",
    Needs.ACCELEROMETER: "accelerometer",
}
"""What a recording or a frame lacks, for the message."""


@dataclass(frozen=True)
class PredictionSpace:
    """The space of φ, whose M coordinates are the columns of some predictors, in their order."""

    predictors: tuple[Predictor, ...]

    def __post_init__(self) -> None:
        """Refuse two columns of one name: a model knows its predictors only by their columns.

        Raises:
            InputError: names the second predictor.
        """
        seen: set[str] = set()
        for predictor in self.predictors:
            if not seen.isdisjoint(predictor.columns):
                raise InputError(
                    "predictors",
                    f"{predictor.name} has a column that an earlier one has too.",
                    "Name each predictor once, and give your own other columns.",
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

    @property
    def depends_on_previous_motion(self) -> bool:
        """Whether a column depends on motions that earlier steps have estimated."""
        return any(predictor.depends_on_previous_motion for predictor in self.predictors)

    def __call__(self, step: Step) -> FloatArray:
        """Compute φ for the N features of a step, [N, M]; NaN where a predictor is undefined.

        Raises:
            InputError: the frames lack what a predictor needs, or a predictor gives an array of
                another shape.
        """
        self._check_step(step)
        count = len(step.tracks)
        # Without any predictor φ is [N, 0].
        parts = [np.zeros((count, 0))]
        parts += [_columns_of(predictor, step) for predictor in self.predictors]
        return np.concatenate(parts, axis=1)

    def check_recording(self, sequence: Sequence) -> None:
        """Refuse a recording that lacks what a predictor needs.

        Raises:
            InputError: names the predictor.
        """
        lacks_images = sequence.camera.size_px is None
        lacking = {
            Needs.LEFT: lacks_images,
            Needs.RIGHT: lacks_images,
            Needs.PREVIOUS_LEFT: lacks_images,
            Needs.PREVIOUS_RIGHT: lacks_images,
            Needs.ALIGNMENT: lacks_images,
            Needs.ACCELEROMETER: sequence.imu is None,
        }
        self._refuse_lacking(lacking, sequence.path)

    def _check_step(self, step: Step) -> None:
        # An accelerometer is lacking where no sample of the interval is finite. A gap of the IMU,
        # without any sample, leaves its predictors undefined, as single missing samples do not.
        has_force: BoolArray = np.asarray(np.isfinite(step.imu.accel_m_s2).all(axis=1))
        lacking = {
            Needs.LEFT: step.curr_frame.left is None,
            Needs.RIGHT: step.curr_frame.right is None,
            Needs.PREVIOUS_LEFT: step.prev_frame.left is None,
            Needs.PREVIOUS_RIGHT: step.prev_frame.right is None,
            Needs.ALIGNMENT: step.curr_frame.features is not None,
            Needs.ACCELEROMETER: len(has_force) > 0 and not bool(has_force.any()),
        }
        self._refuse_lacking(lacking, f"frame {step.curr_frame.index}")

    def _refuse_lacking(self, lacking: Mapping[Needs, bool], where: str | Path) -> None:
        for predictor in self.predictors:
            for need, is_lacking in lacking.items():
                if is_lacking and need in predictor.needs:
                    raise InputError(
                        where,
                        f"it has no {NAMES[need]}, which the predictor {predictor.name} needs.",
                        "Train a model without it: name others with `train --predictors`.",
                    )


def _columns_of(predictor: Predictor, step: Step) -> FloatArray:
    """Return what a predictor makes of the N features of a step, [N, C].

    Raises:
        InputError: it gives an array of another shape.
    """
    values = np.asarray(predictor.compute(step), np.float64)
    count = len(step.tracks)
    num_columns = len(predictor.columns)
    if values.shape == (count,) and num_columns == 1:
        return values[:, None]
    if values.shape != (count, num_columns):
        what = f"it gives an array of shape {values.shape} for {count} features."
        raise InputError(f"predictor {predictor.name}", what, f"Return [{count}, {num_columns}].")
    return values
