"""Images that repeat mean a hanging camera only if it cannot have come to rest."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.config import MotionModelConfig
from probevo.estimation.frozen_images import Repetition, Shown, repetition_of
from probevo.estimation.motion_model import MotionModel, MotionPrediction
from probevo.sequences.frame import Frame
from probevo.tracking import TrackingState
from probevo.tracking.repeated_images import look_repeated
from worlds import CAMERA, FORWARD, FRAME_NS, START_NS

IMAGE = np.kron(
    np.random.default_rng(0).integers(0, 256, (30, 40), dtype=np.uint8), np.ones((8, 8), np.uint8)
)
NOISY = np.clip(IMAGE + np.random.default_rng(1).normal(0.0, 3.0, IMAGE.shape), 0, 255).astype(
    np.uint8
)
SKY_TO_GROUND = np.linspace(60.0, -60.0, len(IMAGE))[:, None]
SMOOTH = (100.0 + SKY_TO_GROUND + 0.3 * (cv2.GaussianBlur(IMAGE, (0, 0), 2.0) - 128.0)).astype(
    np.uint8
)
OTHER = np.roll(IMAGE, 30, axis=1)
CREEPING = np.eye(4)
CREEPING[2, 3] = -0.03
DISPARITY_PX = 8.0


def frames_of(before: Image, now: Image) -> tuple[Frame, Frame]:
    return (
        Frame(0, START_NS, before, right=np.roll(before, -8, axis=1)),
        Frame(1, START_NS + FRAME_NS, now, right=np.roll(now, -8, axis=1)),
    )


def features_of(image: Image) -> TrackingState:
    """Return features at corners of blocks, all in one plane that faces the camera."""
    u, v = np.meshgrid(np.arange(24, 300, 16), np.arange(24, 220, 16))
    left_px = np.column_stack([u.reshape(-1), v.reshape(-1)]).astype(np.float64)
    return replace(
        TrackingState.none(),
        ids=np.arange(len(left_px)),
        pixels=np.hstack([left_px, left_px - [DISPARITY_PX, 0.0]]),
    )


def shown_by(frame: Frame, prediction: MotionPrediction, *, is_frozen: bool = False) -> Shown:
    return Shown(frame, features_of(IMAGE), prediction, is_frozen=is_frozen)


def magnified(image: Image, factor: float) -> Image:
    """Return the image of a plane after the camera has come nearer to it."""
    at_axis = np.array([[factor, 0.0, 0.0], [0.0, factor, 0.0]])
    at_axis[:, 2] = (1.0 - factor) * np.array([CAMERA.cu_px, CAMERA.cv_px])
    height, width = image.shape
    larger = cv2.warpAffine(
        image, at_axis, (width, height), flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(larger, dtype=np.uint8)


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
        "the same but for noise at 0.3 m/s, after frozen ones: it has not stopped from one to next",
        "the same bytes at rest",
        "the same but for noise at rest",
    ],
)
def test_repeated_images_of_a_moving_camera_are_frozen(
    T_last: FloatArray, image: Image, *, were_frozen: bool, expected: bool
) -> None:
    model = MotionModel.at_start(MotionModelConfig()).after_solve(0.1, T_last, 1e-6 * np.eye(6))
    prev_frame, frame = frames_of(IMAGE, image)
    shown = shown_by(prev_frame, model.predict(0.1, None), is_frozen=were_frozen)
    repetition = repetition_of(prev_frame, frame, model, shown, CAMERA)
    assert (repetition is Repetition.FROZEN) is expected


@pytest.mark.parametrize(("frozen_s", "expected"), [(0.2, True), (2.9, True), (3.1, False)])
def test_images_that_stay_frozen_show_a_rest_once_nothing_can_jump_back(
    frozen_s: float, *, expected: bool
) -> None:
    """A hang with noise of 0.3 s at 2 m/s was released as a rest: the pose went back by 0.6 m, to
    where the images had frozen, and claimed a centimetre."""
    motion = np.eye(4)
    motion[2, 3] = -0.2
    start = MotionModel.at_start(MotionModelConfig())
    model = replace(start.after_solve(0.1, motion, 1e-6 * np.eye(6)), since_solve_s=frozen_s)
    prev_frame, frame = frames_of(IMAGE, NOISY)
    shown = shown_by(prev_frame, model.predict(0.1, None), is_frozen=True)
    repetition = repetition_of(prev_frame, frame, model, shown, CAMERA)
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
    prev_frame, frame = frames_of(IMAGE, image)
    shown = shown_by(prev_frame, model.predict(0.1, None))
    repetition = repetition_of(prev_frame, frame, model, shown, CAMERA)
    assert repetition is (Repetition.AMBIGUOUS if expected else Repetition.NONE)


def with_noise(image: Image, seed: int) -> Image:
    """Return the image after one grey level more or less."""
    noise = np.random.default_rng(seed).integers(-1, 2, image.shape)
    return np.clip(image.astype(int) + noise, 0, 255).astype(np.uint8)


def driven(duration_s: float) -> tuple[MotionModel, Image]:
    """Return the model of a camera at 1.5 m/s, and the image of a plane after so long a step."""
    T_step = np.eye(4)
    T_step[2, 3] = -1.5 * duration_s
    start = MotionModel.at_start(MotionModelConfig())
    depth_m = CAMERA.fu_px * CAMERA.baseline_m / DISPARITY_PX
    nearer = magnified(SMOOTH, depth_m / (depth_m + T_step[2, 3]))
    return start.after_solve(duration_s, T_step, 1e-8 * np.eye(6)), nearer


@pytest.mark.parametrize("rate_hz", [60, 120])
def test_a_camera_that_hardly_moves_within_a_step_is_not_frozen(rate_hz: int) -> None:
    """Its image looks the same, but features move as far as they should, a fraction of a pixel; of
    frozen images, they do not."""
    model, nearer = driven(1.0 / rate_hz)
    for image, expected in ((nearer, Repetition.NONE), (SMOOTH, Repetition.FROZEN)):
        prev_frame, frame = frames_of(with_noise(SMOOTH, 1), with_noise(image, 2))
        assert look_repeated(prev_frame, frame)
        shown = shown_by(prev_frame, model.predict(1.0 / rate_hz, None))
        assert repetition_of(prev_frame, frame, model, shown, CAMERA) is expected


def test_a_camera_that_hardly_moves_is_followed_after_a_motion_that_was_refused() -> None:
    model, nearer = driven(1.0 / 60.0)
    refused = replace(model, rejections=1, twist=np.zeros(6))
    prev_frame, frame = frames_of(with_noise(SMOOTH, 1), with_noise(nearer, 2))
    shown = shown_by(prev_frame, refused.predict(1.0 / 60.0, None))
    assert repetition_of(prev_frame, frame, refused, shown, CAMERA) is Repetition.NONE


def test_frozen_images_are_compared_with_the_last_ones_before_them() -> None:
    """So that a camera that was taken to be frozen, and creeps on, is noticed."""
    model, nearer = driven(1.0 / 60.0)
    prev_frame, frame = frames_of(with_noise(nearer, 1), with_noise(nearer, 2))
    before, _ = frames_of(with_noise(SMOOTH, 3), SMOOTH)
    prediction = model.predict(1.0 / 60.0, None)
    for last, expected in ((before, Repetition.NONE), (prev_frame, Repetition.FROZEN)):
        shown = shown_by(last, prediction, is_frozen=True)
        assert repetition_of(prev_frame, frame, model, shown, CAMERA) is expected
