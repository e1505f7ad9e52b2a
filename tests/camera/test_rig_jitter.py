"""The rig's jitter moves the right observations as a turned camera does, and is estimated."""

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.rig_jitter import RigJitter, jitter_offsets
from probevo.geometry import so3
from worlds import CAMERA, random_pixels


def turned(pixels: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """What a right camera sees that is turned by an angle, (u_r, v_r), [N, 2], px."""
    x, y = CAMERA.normalized(pixels[:, 2], pixels[:, 3])
    rays = np.column_stack([x, y, np.ones_like(x)]) @ so3.exp(angle_rad).T
    u = CAMERA.fu_px * rays[:, 0] / rays[:, 2] + CAMERA.cu_px
    v = CAMERA.fv_px * rays[:, 1] / rays[:, 2] + CAMERA.cv_px
    return np.column_stack([u, v])


def test_offsets_against_central_differences() -> None:
    pixels = random_pixels(np.random.default_rng(0), 50)
    offsets = jitter_offsets(pixels, CAMERA)
    for axis, step in enumerate(1e-6 * np.eye(3)):
        change = (turned(pixels, step) - turned(pixels, -step)) / 2e-6
        np.testing.assert_allclose(offsets[:, :, axis], change, rtol=1e-6, atol=1e-3)


def test_covariance_converges_to_that_of_known_changes() -> None:
    rng = np.random.default_rng(1)
    root = np.diag([1e-4, 8e-4, 2e-4])
    omega = rng.normal(size=(400, 3)) @ root
    jitter = RigJitter.initial()
    for change in np.diff(omega, axis=0):
        jitter = jitter.with_change(np.outer(change, change))
    np.testing.assert_allclose(jitter.sigma_rad, np.diagonal(root), rtol=0.2)


def test_a_step_that_shows_nothing_leaves_it() -> None:
    jitter = RigJitter.initial()
    after = jitter.with_change(2.0 * jitter.cov)
    np.testing.assert_allclose(after.cov, jitter.cov, atol=1e-12)


def test_a_covariance_is_exceeded_by_a_variance_that_is_noticeably_larger() -> None:
    jitter = RigJitter.initial(np.diag([1e-8, 4e-8, 2e-8]))
    assert not jitter.exceeds(jitter.cov)
    assert not jitter.exceeds(2.0 * jitter.cov)
    assert not jitter.exceeds(None)
    assert jitter.exceeds(np.diag([1e-8, 1e-8, 2e-8]))
