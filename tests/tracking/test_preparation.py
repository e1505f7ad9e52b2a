"""Frames prepared ahead are the same frames, in the same order, with the same errors."""

from collections.abc import Iterator

import numpy as np
import pytest

from probevo.config import OdometryConfig, TrackingConfig
from probevo.errors import InputError
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.tracking.preparation import prepare_ahead, prepare_images, with_prepared_images

CONFIG = TrackingConfig()


def frames(count: int, fails_at: int | None = None) -> Iterator[Frame]:
    rng = np.random.default_rng(0)
    for index in range(count):
        if index == fails_at:
            raise InputError(f"frame {index}", "it is damaged.")
        yield Frame(index, index, *rng.integers(0, 256, (2, 90, 120), dtype=np.uint8))


def test_all_frames_come_in_order_with_their_images_prepared() -> None:
    found = list(prepare_ahead(frames(7), CONFIG))
    assert [frame.index for frame in found] == list(range(7))
    for ahead, frame in zip(found, frames(7), strict=True):
        expected = prepare_images(frame, CONFIG)
        assert ahead.prepared is not None
        np.testing.assert_array_equal(ahead.prepared.left[-1], expected.left[-1])
        np.testing.assert_array_equal(ahead.prepared.corners, expected.corners)


@pytest.mark.parametrize("fails_at", [0, 1, 4])
def test_what_reading_a_frame_raises_comes_after_the_frames_before(fails_at: int) -> None:
    found = []
    with pytest.raises(InputError, match=f"frame {fails_at}"):
        found.extend(frame.index for frame in prepare_ahead(frames(7, fails_at), CONFIG))
    assert found == list(range(fails_at))


def test_stopping_early_leaves_no_thread_behind() -> None:
    source = frames(1000)
    for frame in prepare_ahead(source, CONFIG):
        if frame.index == 3:
            break
    assert next(source).index < 10


def test_images_prepared_with_other_settings_are_prepared_again() -> None:
    frame = with_prepared_images(next(frames(1)), CONFIG)
    other = TrackingConfig(high_pass_px=0)
    assert prepare_images(frame, CONFIG) is frame.prepared
    assert prepare_images(frame, other).left[0] is frame.left


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_images_prepared_ahead_serve_either_estimator(estimator: str) -> None:
    config = OdometryConfig.model_validate({"estimator": estimator})
    frame = with_prepared_images(next(frames(1)), config.tracking)
    assert prepare_images(frame, config.tracking_of_estimator) is frame.prepared


def test_features_need_no_preparation() -> None:
    frame = Frame(0, 0, features=StereoFeatures(np.zeros(0, np.int64), np.zeros((0, 4))))
    assert list(prepare_ahead([frame], CONFIG)) == [frame]


@pytest.mark.parametrize("side_px", [1, 2])
def test_a_box_that_leaves_nothing_of_the_image_is_refused(side_px: int) -> None:
    with pytest.raises(ValueError, match="leaves nothing"):
        TrackingConfig(high_pass_px=side_px)
