"""Features of the rig are told from those of the scene by the motion of the camera."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.tracking.fixed_features import (
    FixedFeatureCount,
    FixedFeatures,
    StepsAtRest,
    are_still,
    shifts_px,
)
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, at_infinity, both, random_pixels, seen_twice, tracks_of

SIGMA_PX = 0.1


def on_the_rig(rng: np.random.Generator, count: int) -> Tracks:
    """Return features that stay where they are, but for noise."""
    pixels = random_pixels(rng, count, (2.0, 4.0))
    noise_px = SIGMA_PX * rng.normal(size=(2, count, 4))
    return tracks_of(pixels + noise_px[0], pixels + noise_px[1])


def counted(tracks: Tracks, T_curr_prev: FloatArray) -> FixedFeatures | None:
    count = FixedFeatureCount(CAMERA)
    count.add(tracks, T_curr_prev)
    return count.total()


def test_features_of_the_rig_are_counted() -> None:
    rng = np.random.default_rng(0)
    rig = on_the_rig(rng, 40)
    found = counted(both(seen_twice(rng, 100), rig), FORWARD)
    assert found is not None
    # Some of either are next to the focus of expansion, where the motion shifts nothing far.
    assert 30 <= found.num_fixed <= 40
    assert 100 <= found.num_moving <= 140
    assert found.share == found.num_fixed / found.num_moving
    is_shifted = shifts_px(rig, FORWARD, CAMERA) > 3.0
    places_px = rig.curr_px[is_shifted & are_still(rig), :2]
    np.testing.assert_allclose(found.center_px, places_px.mean(axis=0))
    np.testing.assert_allclose(found.spread_px, places_px.std(axis=0))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_scene_has_none(seed: int) -> None:
    """Neither one that moves by, nor one far away before a camera that does not turn, nor any
    before a camera at rest."""
    rng = np.random.default_rng(seed)
    ahead = FORWARD.copy()
    ahead[:3, :3] = np.eye(3)
    assert counted(seen_twice(rng, 200), FORWARD) is None
    assert counted(at_infinity(rng, 200, ahead), ahead) is None
    assert counted(on_the_rig(rng, 200), np.eye(4)) is None
    assert counted(Tracks.none(), FORWARD) is None


def test_what_passes_while_the_path_stands_still_is_counted() -> None:
    """Of steps at rest only; none passes before a camera that is."""
    rng = np.random.default_rng(8)
    rig = on_the_rig(rng, 60)
    passing = seen_twice(rng, 40)
    num_passing = int((shifts_px(passing, FORWARD, CAMERA) >= 3.0).sum())
    count = FixedFeatureCount(CAMERA)
    count.add(both(rig, passing), np.eye(4))
    count.add(rig, np.eye(4))
    count.add(both(rig, passing), FORWARD)
    count.add(Tracks.none(), np.eye(4))
    steps = count.steps_at_rest
    assert steps == StepsAtRest(3, 2, num_features=160, num_passing=steps.num_passing)
    assert num_passing > 30
    assert abs(steps.num_passing - num_passing) <= 2  # on the very threshold, by their rows


def test_an_overlay_without_disparity_is_fixed_where_the_camera_turns() -> None:
    rng = np.random.default_rng(4)
    overlay = on_the_rig(rng, 50)
    for pixels in (overlay.prev_px, overlay.curr_px):
        pixels[:, 2] = pixels[:, 0]
    turn = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.02, 0.0]))
    found = counted(overlay, turn)
    assert found is not None
    assert found.num_fixed >= 45
    np.testing.assert_allclose(
        shifts_px(at_infinity(rng, 50, turn), turn, CAMERA), 0.02 * CAMERA.fu_px, rtol=0.8
    )


def test_what_a_motion_takes_behind_the_camera_is_not_shifted() -> None:
    beyond = np.eye(4)
    beyond[2, 3] = -1e4
    assert not shifts_px(seen_twice(np.random.default_rng(5), 50), beyond, CAMERA).any()
