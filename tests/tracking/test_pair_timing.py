"""Right images of other frames are found, and others are not called so."""

from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from probevo.arrays import Image
from probevo.config import TrackingConfig
from probevo.sequences import Frame, open_sequence
from probevo.sequences.frame import StereoFeatures
from probevo.tracking.pair_timing import (
    EVERY_FRAMES,
    MAX_COMPARISONS,
    MIN_VOTES,
    OFFSETS,
    PairTiming,
    match_rows,
)
from probevo.tracking.preparation import prepare_images
from strips import FRAME_NS, strip_pairs

ENOUGH_FRAMES = len(OFFSETS) + EVERY_FRAMES * MIN_VOTES


def frames_of(count: int, *, right_late: int = 0, px_per_disparity: float = 0.25) -> list[Frame]:
    pairs = strip_pairs(count, right_late=right_late, px_per_disparity=px_per_disparity)
    return [
        Frame(index=k, stamp_ns=k * FRAME_NS, left=left, right=right)
        for k, (left, right) in enumerate(pairs)
    ]


def timing_of(frames: list[Frame]) -> PairTiming:
    timing = PairTiming(TrackingConfig())
    for frame in frames:
        timing.add(frame)
    return timing


@pytest.mark.parametrize("late", [-2, -1, 0, 1, 2])
def test_right_images_of_other_frames_are_found(late: int) -> None:
    assert timing_of(frames_of(ENOUGH_FRAMES, right_late=late)).right_late_frames == late


def test_nothing_is_decided_by_few_frames_or_at_rest() -> None:
    few = timing_of(frames_of(ENOUGH_FRAMES - 3 * EVERY_FRAMES, right_late=1))
    assert few.right_late_frames == 0
    assert not few.is_decided
    at_rest = timing_of(frames_of(ENOUGH_FRAMES, right_late=1, px_per_disparity=0.0))
    assert at_rest.right_late_frames == 0


def test_a_camera_that_stays_at_rest_is_looked_at_for_a_while_only() -> None:
    frame = frames_of(1)[0]
    timing = timing_of([frame] * (EVERY_FRAMES * (MAX_COMPARISONS + len(OFFSETS))))
    assert timing.is_decided
    assert timing.right_late_frames == 0


@pytest.mark.parametrize("frames", [1, 2])
def test_a_camera_that_moves_along_its_baseline_moves_no_rows(frames: int) -> None:
    """Its left image shows again what the right one has shown one or two frames before, and hardly
    any match is as good as theirs."""
    rng = np.random.default_rng(3)
    smooth = cv2.GaussianBlur(rng.uniform(0, 255, (160, 800)), (0, 0), 1.5)
    scene = np.clip(128.0 + 4.0 * (smooth - smooth.mean()), 0, 255).astype(np.float32)
    u, v = np.meshgrid(np.arange(320.0), np.arange(160.0))
    ground_px = 4.0 + 0.1 * v  # disparity of a plane below the camera

    def seen(baselines: float) -> Image:
        """Return what is seen so many baselines along, with noise."""
        columns = (u + 100.0 + baselines * ground_px).astype(np.float32)
        image = cv2.remap(scene, columns, v.astype(np.float32), cv2.INTER_LINEAR)
        noisy = image + rng.normal(0.0, 1.0, image.shape)
        return np.clip(noisy, 0, 255).astype(np.uint8)

    along = [
        Frame(k, k * FRAME_NS, seen(k / frames), right=seen(k / frames + 1.0))
        for k in range(ENOUGH_FRAMES)
    ]
    assert timing_of(along).right_late_frames == 0


def test_frames_without_images_say_nothing() -> None:
    features = StereoFeatures(np.arange(3), np.zeros((3, 4)))
    timing = timing_of([Frame(index=k, stamp_ns=k, features=features) for k in range(30)])
    assert timing.right_late_frames == 0


def test_rows_of_a_pair_agree_but_for_an_affine_map() -> None:
    """A right image that sits lower, as by a pitch of its camera, is no later one."""
    frame = frames_of(1)[0]
    assert frame.right is not None
    images = prepare_images(frame, TrackingConfig())
    lower = Frame(index=0, stamp_ns=0, left=frame.left, right=np.roll(frame.right, 3, axis=0))
    for right in (images.right, prepare_images(lower, TrackingConfig()).right):
        assert match_rows(images, right, TrackingConfig()).scatter_px < 0.1
    bare = np.full_like(frame.right, 100)
    empty = prepare_images(Frame(index=0, stamp_ns=0, left=bare, right=bare), TrackingConfig())
    assert match_rows(images, empty.right, TrackingConfig()).scatter_px == np.inf


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize(
    "place",
    [
        "kitti_odometry/sequences/06",
        "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync",
        "kitti_0039/sequences/39",
        "karlsruhe_2010/sequences/19",
        "euroc/MH_01_micro",
        "euroc/V1_01_micro",
    ],
)
def test_real_recordings(place: str, data_root: Path) -> None:
    """None is called late as it is; all are with the right images of other frames, but for V1_01,
    which is at rest."""
    frames = list(islice(open_sequence(data_root / place), 60))
    assert timing_of(frames).right_late_frames == 0
    for late in (-1, 1, 2):
        shifted = [
            Frame(
                index=k,
                stamp_ns=frame.stamp_ns,
                left=frame.left,
                right=frames[(k - late) % len(frames)].right,
            )
            for k, frame in enumerate(frames)
        ]
        expected = 0 if "V1_01" in place else late
        assert timing_of(shifted[2:-1]).right_late_frames == expected
