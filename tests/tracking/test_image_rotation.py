"""The rotation of matched descriptors: any angle, about any axis; none where nothing matches."""

import cv2
import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.geometry import so3
from probevo.tracking.image_rotation import matched_rotation

CAMERA = StereoCamera.centered(400.0, 0.1, (480, 360))
K = np.array([[400.0, 0.0, CAMERA.cu_px], [0.0, 400.0, CAMERA.cv_px], [0.0, 0.0, 1.0]])


def scene(seed: int = 0) -> Image:
    """Blobs of all sizes, with noise of a sensor."""
    rng = np.random.default_rng(seed)
    levels = [
        cv2.resize(rng.normal(size=(360 // s, 480 // s)), (480, 360), interpolation=cv2.INTER_CUBIC)
        for s in (4, 12, 40)
    ]
    return cv2.normalize(sum(levels), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def turned(image: Image, C_curr_prev: FloatArray) -> Image:
    """What the camera sees after that rotation: a homography."""
    return cv2.warpPerspective(image, K @ C_curr_prev @ np.linalg.inv(K), (480, 360))


@pytest.mark.parametrize(
    "angles_deg",
    [(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (-5.0, 12.0, 0.0), (3.0, -4.0, 40.0), (0.0, 0.0, 170.0)],
)
def test_any_turn_is_found_to_half_a_degree(angles_deg: tuple[float, float, float]) -> None:
    truth = so3.exp(np.deg2rad(angles_deg))
    found = matched_rotation(scene(), turned(scene(), truth), CAMERA)
    assert found is not None
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found) == pytest.approx(1.0)
    assert np.rad2deg(np.linalg.norm(so3.log(found @ truth.T))) < 0.5


def test_wide_images_are_reduced_and_give_the_same_turn() -> None:
    """Three times as wide: the same directions."""
    truth = so3.exp(np.deg2rad([3.0, -4.0, 20.0]))
    wide = StereoCamera.centered(1200.0, 0.1, (1440, 1080))
    prev, curr = (
        cv2.resize(image, (1440, 1080), interpolation=cv2.INTER_CUBIC)
        for image in (scene(), turned(scene(), truth))
    )
    found = matched_rotation(prev, curr, wide)
    assert found is not None
    assert np.rad2deg(np.linalg.norm(so3.log(found @ truth.T))) < 0.7


def test_the_turn_of_most_of_the_image_counts() -> None:
    """A third of it is covered by something else."""
    truth = so3.exp(np.deg2rad([4.0, -6.0, 10.0]))
    image = turned(scene(), truth)
    image[:, :160] = scene(1)[:, :160]
    found = matched_rotation(scene(), image, CAMERA)
    assert found is not None
    assert np.rad2deg(np.linalg.norm(so3.log(found @ truth.T))) < 0.5


@pytest.mark.parametrize(
    "image", [scene(2), np.zeros((360, 480), np.uint8)], ids=["another scene", "black"]
)
def test_nothing_is_found_where_nothing_matches(image: Image) -> None:
    assert matched_rotation(scene(), image, CAMERA) is None
    assert matched_rotation(image, scene(), CAMERA) is None


@pytest.mark.parametrize("shape", [(1, 1), (20, 20), (2, 300), (63, 64)])
def test_small_images_have_no_descriptors(shape: tuple[int, int]) -> None:
    image = scene()[: shape[0], : shape[1]]
    assert matched_rotation(image, image, CAMERA) is None


def test_the_same_images_give_the_same_bytes() -> None:
    image = turned(scene(), so3.exp(np.array([0.1, 0.1, 0.1])))
    first, second = (matched_rotation(scene(), image, CAMERA) for _ in range(2))
    assert first is not None
    np.testing.assert_array_equal(first, second)
