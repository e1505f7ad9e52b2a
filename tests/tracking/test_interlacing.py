"""Interlaced images are found, and others are not called so."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from probevo.arrays import Image
from probevo.sequences import Frame, open_sequence
from probevo.tracking.interlacing import (
    COMBED_FROM,
    EVERY_FRAMES,
    MIN_COMBED,
    Interlacing,
    combing,
)


def is_found(frames: list[Frame]) -> bool:
    interlacing = Interlacing()
    for frame in frames:
        interlacing.add(frame)
    return interlacing.is_found


def woven(even: Image | None, odd: Image | None) -> Image:
    """Return an image with the even rows of one and the odd rows of another."""
    assert even is not None
    assert odd is not None
    image = even.copy()
    image[1::2] = odd[1::2]
    return image


def interlaced(frames: list[Frame]) -> list[Frame]:
    """Return one frame of each two."""
    return [
        replace(curr, left=woven(curr.left, prev.left), right=woven(curr.right, prev.right))
        for prev, curr in zip(frames[::2], frames[1::2], strict=False)
    ]


def test_rows_of_noise_differ_alike_and_of_anything_smoother_less() -> None:
    noise = np.random.default_rng(0).uniform(0, 255, (200, 400))
    assert combing(noise.astype(np.uint8)) == pytest.approx(1.0, abs=0.02)
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0).astype(np.uint8)
    assert combing(smooth) < 0.8
    assert combing(woven(smooth, np.roll(smooth, 6, axis=1))) > COMBED_FROM
    # Odd rows brighter than even ones, as of a sensor that reads them by two amplifiers
    dark = (cv2.GaussianBlur(noise, (0, 0), 8.0) - 90.0).astype(np.uint8)
    brighter = dark.copy()
    brighter[1::2] += 5
    assert combing(brighter) < COMBED_FROM
    assert combing(np.full((200, 400), 7, np.uint8)) == 0.0
    assert combing(smooth[:2]) == 0.0


def test_neither_a_few_combed_images_nor_mosaics_are_interlaced() -> None:
    noise = np.random.default_rng(0).uniform(0, 255, (200, 400))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    combed = woven(smooth.astype(np.uint8), np.roll(smooth, 6, axis=1).astype(np.uint8))
    mosaic = smooth.copy()
    mosaic[1::2, ::2] *= 0.3
    mosaic[1::2, 1::2] *= 0.5
    frames = [Frame(k, k, combed, right=combed) for k in range(EVERY_FRAMES * MIN_COMBED)]
    assert is_found(frames)
    assert not is_found(frames[:-1])
    assert combing(mosaic.astype(np.uint8)) > COMBED_FROM
    raw = mosaic.astype(np.uint8)
    assert not is_found([replace(frame, left=raw, right=raw) for frame in frames])


@pytest.mark.data
@pytest.mark.parametrize(
    ("place", "moves"),
    [
        ("kitti_odometry/sequences/06", True),
        ("kitti_raw/2011_09_26/2011_09_26_drive_0005_sync", True),
        ("kitti_0039/sequences/39", True),
        ("karlsruhe_2010/sequences/19", True),
        ("euroc/MH_01_micro", True),
        ("euroc/V1_01_micro", False),
    ],
)
def test_real_recordings(place: str, moves: bool, data_root: Path) -> None:
    """None is called interlaced as it is; all that move are with rows woven from two frames."""
    frames = list(islice(open_sequence(data_root / place), 2 * EVERY_FRAMES * MIN_COMBED))
    assert not is_found(frames)
    assert is_found(interlaced(frames)) == moves
