"""Points are tracked as before where the exposure jumps, and where each camera has its own."""

import cv2
import numpy as np
import pytest

import probevo as pv
from probevo.arrays import Image
from probevo.config import TrackingConfig
from probevo.sequences.frame import Frame
from probevo.sequences.prepared_images import Pyramid
from probevo.tracking.contrast import with_contrast_of
from probevo.tracking.image_tracker import ImageTracker
from probevo.tracking.lucas_kanade import build_pyramid
from probevo.tracking.preparation import high_pass, prepare_images
from probevo.tracking.tracker import TrackingState

CONFIG = TrackingConfig()
SIZE_PX = (480, 240)
DISPARITY_PX = 16


def textured(seed: int = 0) -> Image:
    """Smooth random texture, wider than the camera sees."""
    width, height = SIZE_PX
    noise = np.random.default_rng(seed).normal(size=(height, width + 64))
    smooth = cv2.GaussianBlur(noise, (0, 0), 2.0)
    return np.clip(110.0 + 40.0 * smooth / smooth.std(), 0.0, 255.0).astype(np.uint8)


def exposed(image: Image, gain: float) -> Image:
    return np.clip(np.rint(gain * image), 0.0, 255.0).astype(np.uint8)


def pyramid(image: Image) -> Pyramid:
    return build_pyramid(image, CONFIG)


@pytest.mark.parametrize("gain", [0.3, 0.6, 2.0])
def test_the_contrast_becomes_that_of_the_other_image(gain: float) -> None:
    """Where none of the grey levels is clipped: mean and standard deviation of all levels."""
    image = pyramid(exposed(textured(), min(gain, 1.0)))
    template = pyramid(exposed(textured(), min(1.0, 1.0 / gain)))
    for level, wanted in zip(with_contrast_of(template, image), image, strict=True):
        assert abs(level.mean() - wanted.mean()) < 1.0
        assert abs(level.std() - wanted.std()) < 1.0


@pytest.mark.parametrize("gain", [0.9, 1.1])
def test_usual_changes_leave_an_image_as_it_is(gain: float) -> None:
    template = pyramid(textured())
    assert with_contrast_of(template, pyramid(exposed(textured(), gain))) is template


def test_without_contrast_there_is_nothing_to_adapt() -> None:
    """An empty pyramid, as before the first frame; a black image on either side."""
    black = pyramid(np.zeros_like(textured()))
    image = pyramid(textured())
    assert with_contrast_of((), image) == ()
    assert with_contrast_of(image, black) is image
    assert with_contrast_of(black, image) is black


@pytest.mark.parametrize("share", [0.2, 0.4, 0.6])
@pytest.mark.parametrize("gain", [1.0, 0.5])
def test_what_covers_a_part_of_an_image_is_no_exposure(share: float, gain: float) -> None:
    """A finger on one of the lenses, whichever of the images is adapted to the other."""
    image = exposed(textured(), gain)
    covered = image.copy()
    covered[:, : round(share * image.shape[1])] = 20
    template = pyramid(textured())
    for one, other in ((template, pyramid(covered)), (pyramid(covered), template)):
        adapted = with_contrast_of(one, other)
        if gain == 1.0:
            assert adapted is one
            continue
        # The part that both show becomes alike.
        seen = np.s_[:, -round(0.3 * image.shape[1]) :]
        np.testing.assert_allclose(adapted[0][seen].std(), other[0][seen].std(), rtol=0.15)


@pytest.mark.parametrize("gain", [0.3, 0.5])
def test_tracks_survive_a_jump_of_the_exposure(gain: float) -> None:
    """Down and up again, a camera that moves by three pixels keeps nine tenths of the tracks that
    it keeps in constant light."""
    steady = num_tracks([1.0, 1.0, 1.0])
    flickering = num_tracks([1.0, gain, 1.0])
    assert min(steady) > 100
    for count, usual in zip(flickering, steady, strict=True):
        assert count > 0.9 * usual


@pytest.mark.parametrize("gain", [0.2, 0.35, 0.5, 0.8, 1.5])
def test_cameras_with_exposures_of_their_own_have_as_many_tracks(gain: float) -> None:
    """Nine tenths of those of two cameras that are exposed alike."""
    left = min(1.0, 1.0 / gain)  # where the right image has the gain, nothing is white
    alike = num_tracks([left, left, left])
    different = num_tracks([left, left, left], right_gain=gain)
    assert min(alike) > 100
    for count, usual in zip(different, alike, strict=True):
        assert count > 0.9 * usual


def test_a_pair_that_is_exposed_alike_is_prepared_as_it_is() -> None:
    """What only one camera sees is no other exposure."""
    left = exposed(textured(), 1.0)
    right = exposed(textured(), 0.9)
    prepared = prepare_images(Frame(0, 0, left=left, right=right), CONFIG)
    wanted = high_pass(right, CONFIG)
    np.testing.assert_array_equal(prepared.right[0], wanted)


def num_tracks(gains: list[float], right_gain: float = 1.0) -> list[int]:
    """Return how many tracks each frame but the first has, of a camera that moves by three pixels.

    Args:
        gains: of both images of each frame.
        right_gain: further gain of the right images.
    """
    width, _ = SIZE_PX
    camera = pv.StereoCamera.centered(400.0, 0.2, SIZE_PX)
    texture = textured()
    tracker = ImageTracker(camera, CONFIG)
    state = TrackingState.none()
    counts = []
    for index, gain in enumerate(gains):
        left = exposed(texture[:, 3 * index : 3 * index + width], gain)
        right = texture[:, 3 * index + DISPARITY_PX :][:, :width]
        right = exposed(right, gain * right_gain)
        frame = Frame(index, 100_000_000 * index, left=left, right=right)
        tracked = tracker.track(state, frame, np.eye(4))
        state = tracked.state
        counts.append(len(tracked.tracks))
    return counts[1:]
