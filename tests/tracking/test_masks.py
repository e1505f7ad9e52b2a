"""No feature is found, followed or matched where a mask is black."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import BoolArray, FloatArray
from probevo.config import TrackingConfig
from probevo.geometry import se3
from probevo.sequences.frame import Frame
from probevo.tracking import ImageTracker, TrackingState
from probevo.tracking.preparation import prepare_images, usable_places
from tracking.test_image_tracker import CAMERA, HEIGHT_PX, STEP, WIDTH_PX, pose, render

CONFIG = TrackingConfig(num_features=150)


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Of a plane that comes nearer."""
    T_right_left = se3.exp(np.array([-CAMERA.baseline_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
    return [
        Frame(k, 100_000_000 * k, render(pose(k)), right=render(T_right_left @ pose(k)))
        for k in range(4)
    ]


def left_half() -> BoolArray:
    """Wanted are features left of the middle."""
    wanted: BoolArray = np.broadcast_to(np.arange(WIDTH_PX) < WIDTH_PX // 2, (HEIGHT_PX, WIDTH_PX))
    return wanted.copy()


def test_a_window_does_not_reach_into_the_mask() -> None:
    usable = usable_places(left_half(), TrackingConfig(window_px=11))
    assert usable is not None
    np.testing.assert_array_equal(usable, np.broadcast_to(usable[0], usable.shape))
    # The last column that is wanted, minus half a window of 11 px; the border of the image is none.
    np.testing.assert_array_equal(usable[0], np.arange(WIDTH_PX) < WIDTH_PX // 2 - 5)
    as_grey = np.where(left_half(), 128, 127).astype(np.uint8)
    np.testing.assert_array_equal(usable_places(as_grey, TrackingConfig(window_px=11)), usable)
    assert usable_places(None, CONFIG) is None


def test_corners_are_those_of_the_whole_image_that_are_not_masked(frames: list[Frame]) -> None:
    """The mask makes no corner of its own, and each cell outside of it keeps its strongest ones."""
    frame = frames[0]
    everywhere = prepare_images(frame, CONFIG).corners
    masked = prepare_images(replace(frame, left_mask=left_half()), CONFIG).corners
    cells = np.isfinite(masked[..., 0]).any(axis=-1)
    assert cells.any()
    assert not cells.all()
    assert np.nanmax(masked[..., 0]) < WIDTH_PX // 2 - 5
    whole = np.isfinite(everywhere[..., 0]).all(axis=-1)
    whole &= np.nan_to_num(everywhere[..., 0], nan=np.inf).max(axis=-1) < WIDTH_PX // 2 - 20
    np.testing.assert_array_equal(masked[whole], everywhere[whole])


@pytest.mark.parametrize("side", ["left_mask", "right_mask"])
def test_no_feature_is_followed_into_the_mask(side: str, frames: list[Frame]) -> None:
    """With a mask that comes and goes, features are lost there, and found anew afterwards."""
    tracker = ImageTracker(CAMERA, CONFIG)
    state = TrackingState.none()
    column = 0 if side == "left_mask" else 2
    seen: list[FloatArray] = []
    rejected = []
    for k, frame in enumerate(frames):
        shown: Frame = replace(frame, **{side: left_half()}) if k in (1, 2) else frame
        tracked = tracker.track(state, shown, se3.exp(STEP))
        state = tracked.state
        seen.append(state.pixels[:, column])
        rejected.append(tracked.tracks.rejected.get("masked", 0))
    middle = WIDTH_PX // 2
    assert max(seen[0]) > middle
    assert max(seen[1]) < middle - 4
    assert max(seen[2]) < middle - 4
    assert max(seen[3]) > middle
    assert len(seen[1]) > 10
    assert rejected[0] == rejected[3] == 0
    assert rejected[1] > 10
