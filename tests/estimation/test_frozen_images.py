"""Images that repeat mean a hanging camera only if it cannot have come to rest."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.config import MotionModelConfig
from probevo.estimation.frozen_images import Repetition, repetition_of
from probevo.estimation.motion_model import MotionModel
from probevo.sequences.frame import Frame
from worlds import FORWARD, FRAME_NS, START_NS

IMAGE = np.kron(
    np.random.default_rng(0).integers(0, 256, (30, 40), dtype=np.uint8), np.ones((8, 8), np.uint8)
)
NOISY = np.clip(IMAGE + np.random.default_rng(1).normal(0.0, 3.0, IMAGE.shape), 0, 255).astype(
    np.uint8
)
OTHER = np.roll(IMAGE, 30, axis=1)
CREEPING = np.eye(4)
CREEPING[2, 3] = -0.03


def frames_of(before: Image, now: Image) -> tuple[Frame, Frame]:
    return (
        Frame(0, START_NS, before, right=np.roll(before, -8, axis=1)),
        Frame(1, START_NS + FRAME_NS, now, right=np.roll(now, -8, axis=1)),
    )


@pytest.mark.parametrize(
    ("T_last", "image", "were_frozen", "expected"),
    [
        (FORWARD, IMAGE, False, True),
        (FORWARD, NOISY, False, True),
        (FORWARD, OTHER, True, False),
        (CREEPING, IMAGE, False, True),
        (CREEPING, NOISY, False, False),
        (CREEPING, NOISY, True, True),
        (np.eye(4), IMAGE, False, False),
        (np.eye(4), NOISY, True, False),
    ],
    ids=[
        "the same bytes at 12 m/s",
        "the same but for noise at 12 m/s",
        "others",
        "the same bytes at 0.3 m/s, which noise would make differ",
        "the same but for noise at 0.3 m/s, as of a car that has stopped",
        "the same but for noise, after frozen ones",
        "the same bytes at rest",
        "the same but for noise at rest",
    ],
)
def test_repeated_images_of_a_moving_camera_are_frozen(
    T_last: FloatArray, image: Image, *, were_frozen: bool, expected: bool
) -> None:
    model = MotionModel.at_start(MotionModelConfig()).after_solve(0.1, T_last, 1e-6 * np.eye(6))
    prev_frame, frame = frames_of(IMAGE, image)
    prediction = model.predict(0.1, None)
    repetition = repetition_of(prev_frame, frame, model, prediction, were_frozen=were_frozen)
    assert (repetition is Repetition.FROZEN) is expected


@pytest.mark.parametrize(
    ("image", "rejections", "is_after_repetition", "expected"),
    [
        (IMAGE, 0, False, True),
        (NOISY, 0, False, False),
        (NOISY, 1, False, True),
        (NOISY, 0, True, True),
        (OTHER, 1, True, False),
    ],
    ids=[
        "the same bytes",
        "the same but for noise",
        "the same but for noise, after a motion that was refused",
        "the same but for noise, after a motion behind others that repeated",
        "others",
    ],
)
def test_repeated_images_of_a_camera_at_rest_are_ambiguous(
    image: Image, rejections: int, *, is_after_repetition: bool, expected: bool
) -> None:
    rest = MotionModel.at_start(MotionModelConfig()).after_solve(0.1, np.eye(4), 1e-6 * np.eye(6))
    model = replace(rest, rejections=rejections, is_after_repetition=is_after_repetition)
    prediction = model.predict(0.1, None)
    repetition = repetition_of(*frames_of(IMAGE, image), model, prediction, were_frozen=False)
    assert repetition is (Repetition.AMBIGUOUS if expected else Repetition.NONE)
