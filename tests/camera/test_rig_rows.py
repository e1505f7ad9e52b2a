"""Row offsets: what is new in each frame is marginalised as in a joint least squares."""

import numpy as np

from probevo.camera.rig_rows import OffsetsOfFrame, fit_row_offsets
from probevo.camera.rig_rows_numba import RowOffsetNoise

GAUSSIAN = RowOffsetNoise(sigma_px=0.2, dof=1e12, correlated=1.0)


def test_frames_with_offsets_of_their_own_are_a_joint_least_squares() -> None:
    rng = np.random.default_rng(0)
    frames = 5
    effect = rng.normal(size=(3, 2))
    cov = np.array([[0.5, 0.2], [0.2, 0.4]])
    prior = np.diag([1.0, 2.0, 3.0])
    coefficients = np.zeros(3)
    information = prior
    size = 3 + 2 * frames
    joint = np.zeros((size, size))
    joint[:3, :3] = prior
    moment = np.zeros(size)
    for k in range(frames):
        basis = rng.normal(size=(20, 3))
        offsets = rng.normal(size=20)
        coefficients, information = fit_row_offsets(
            basis,
            offsets,
            (coefficients, information),
            noise=GAUSSIAN,
            iterations=2,
            frame_change=OffsetsOfFrame(effect, cov),
        )
        columns = np.zeros((20, size))
        columns[:, :3] = basis
        own = slice(3 + 2 * k, 5 + 2 * k)
        columns[:, own] = basis @ effect
        joint += columns.T @ columns / GAUSSIAN.sigma_px**2
        joint[own, own] += np.linalg.inv(cov)
        moment += columns.T @ offsets / GAUSSIAN.sigma_px**2
    expected = np.linalg.inv(joint)
    np.testing.assert_allclose(np.linalg.inv(information), expected[:3, :3], rtol=1e-6)
    np.testing.assert_allclose(coefficients, (expected @ moment)[:3], rtol=1e-6, atol=1e-9)


def test_without_them_nothing_changes() -> None:
    rng = np.random.default_rng(1)
    basis = rng.normal(size=(20, 3))
    offsets = rng.normal(size=20)
    prior = (np.zeros(3), np.eye(3))
    plain = fit_row_offsets(basis, offsets, prior, noise=GAUSSIAN, iterations=1)
    tiny = OffsetsOfFrame(np.ones((3, 1)), np.array([[1e-18]]))
    held = fit_row_offsets(basis, offsets, prior, noise=GAUSSIAN, iterations=1, frame_change=tiny)
    for found, expected in zip(held, plain, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9)
