"""Fields of flow: what a rotation does to them, and what a network sees of other cameras."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.geometry import so3
from probevo.nets.flow_field import (
    _FLOW_ESTIMATOR,
    CELLS,
    FOCAL_PX,
    SIZE_PX,
    cell_rays,
    flow_field,
    mirrored,
    rotated,
    virtual_view,
)

PHI = np.array([0.004, -0.012, 0.006])


def far_scene(camera: StereoCamera, C_curr_prev: FloatArray) -> Image:
    """A scene at infinity, as a camera sees it that has turned: a texture on the unit sphere."""
    width_px, height_px = camera.size_px or (0, 0)
    columns, rows = np.meshgrid(np.arange(width_px), np.arange(height_px))
    x, y = camera.normalized(columns.astype(float), rows.astype(float))
    first = np.einsum("ji,jrc->irc", C_curr_prev, np.stack([x, y, np.ones_like(x)]))
    azimuth = np.arctan2(first[0], first[2])
    elevation = np.arctan2(first[1], np.hypot(first[0], first[2]))
    rng = np.random.default_rng(3)
    levels = np.zeros_like(x)
    for _ in range(60):
        along, across = rng.normal(0.0, 30.0, 2)
        levels += np.sin(along * azimuth + across * elevation + rng.uniform(0.0, 6.3))
    return np.clip(128.0 + 12.0 * levels, 0, 255).astype(np.uint8)


def camera_of(focal_px: float) -> StereoCamera:
    """KITTI's field of view at any resolution."""
    size_px = (round(1.75 * focal_px), round(0.53 * focal_px))
    return StereoCamera.centered(focal_px, 0.5, size_px)


@pytest.mark.parametrize("focal_px", [360.0, 720.0])
def test_the_flow_of_a_rotation_is_that_of_its_rays(focal_px: float) -> None:
    """For any focal length; to a twentieth of a pixel of the virtual camera, in the median."""
    camera = camera_of(focal_px)
    C = so3.exp(PHI)
    views = [virtual_view(far_scene(camera, turn), camera) for turn in (np.eye(3), C)]
    found = flow_field(*views)
    assert found.shape == (4, *CELLS)
    assert found.dtype == np.float32
    expected = rotated(np.zeros((1, 4, *CELLS)), C[None])[0]
    assert np.median(np.abs(found[:2] - expected[:2])) < 0.05 / FOCAL_PX


def test_each_thread_has_a_flow_estimator_of_its_own() -> None:
    """OpenCV's keeps the images and buffers of a call: two threads on one get wrong flow, or
    crash."""
    both_are_there = threading.Barrier(2)

    def estimator() -> object:
        both_are_there.wait()
        assert _FLOW_ESTIMATOR.dis is _FLOW_ESTIMATOR.dis
        return _FLOW_ESTIMATOR.dis

    with ThreadPoolExecutor(2) as threads:
        first, second = [one.result() for one in [threads.submit(estimator) for _ in range(2)]]
    assert first is not second


def test_rotating_twice_is_rotating_by_the_product() -> None:
    rng = np.random.default_rng(0)
    fields = rng.normal(0.0, 0.02, (5, 4, *CELLS))
    first = so3.exp(rng.normal(0.0, 0.02, (5, 3)))
    second = so3.exp(rng.normal(0.0, 0.02, (5, 3)))
    twice = rotated(rotated(fields, first), second)
    np.testing.assert_allclose(twice, rotated(fields, second @ first), atol=1e-12)
    np.testing.assert_array_equal(twice[:, 2:], fields[:, 2:])


def test_the_mirror_image_of_a_rotation_has_the_mirrored_field() -> None:
    still = np.zeros((1, 4, *CELLS))
    turned = rotated(still, so3.exp(PHI)[None])
    in_mirror = rotated(still, so3.exp(PHI * [1.0, -1.0, -1.0])[None])
    np.testing.assert_allclose(mirrored(turned), in_mirror, atol=1e-12)


def test_rays_are_those_of_the_virtual_camera() -> None:
    x, y = cell_rays()
    assert x.shape == CELLS
    np.testing.assert_allclose(x[0, -1], (0.5 * SIZE_PX[0] - 2.0) / FOCAL_PX, atol=1e-6)
    np.testing.assert_allclose(x, -x[:, ::-1], atol=1e-6)
    np.testing.assert_allclose(y, -y[::-1], atol=1e-6)


def test_a_mismatch_is_seen() -> None:
    """Two images of other scenes differ more, after the flow is taken back, than one and itself."""
    camera = camera_of(360.0)
    view = virtual_view(far_scene(camera, np.eye(3)), camera)
    other = cv2.flip(view, 1)
    same_mismatch = flow_field(view, view)[2]
    other_mismatch = flow_field(view, other)[2]
    assert np.median(other_mismatch) > np.median(same_mismatch) + 1.0


@pytest.mark.parametrize("size_px", [(400, 191), (630, 120), None])
def test_a_camera_that_sees_too_little_is_refused(size_px: tuple[int, int] | None) -> None:
    camera = StereoCamera(360.0, 360.0, 200.0, 60.0, baseline_m=0.5, size_px=size_px)
    with pytest.raises(InputError, match="camera"):
        virtual_view(np.zeros((120, 400), np.uint8), camera)
