"""The errors of a rig's images as a Gaussian estimate, and its prior that is learned."""

from typing import Any

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.camera.distortion_field import NUM_COEFFICIENTS
from probevo.camera.image_errors import (
    DISPARITY_SIGMA_PX,
    FOCAL_SIGMA,
    INITIAL_SIGMA_PX,
    NUM_ERRORS,
    ImageEquations,
    ImageErrors,
    ScalarEquations,
)
from probevo.camera.rolling_shutter import KNOWN_SIGMA_S, READOUT_SIGMA_S


def equations(information: FloatArray, gradient: FloatArray) -> ImageEquations:
    """Of a step that shows nothing of the radial error of the rows, the focal length and the
    readout time."""
    return ImageEquations(
        information,
        gradient,
        with_radial=np.zeros(NUM_ERRORS),
        focal=ScalarEquations.none(),
        readout=ScalarEquations.none(),
    )


def test_two_steps_are_one_least_squares_problem() -> None:
    """Prior and both measurements at once; τ is that before the second step."""
    rng = np.random.default_rng(7)
    truth = rng.normal(scale=0.3, size=NUM_ERRORS)
    errors = ImageErrors.initial()
    total = np.zeros((NUM_ERRORS, NUM_ERRORS))
    moment = np.zeros(NUM_ERRORS)
    for _ in range(2):
        sigma_px = errors.distortion_sigma_px
        root = rng.normal(size=(NUM_ERRORS, 2 * NUM_ERRORS))
        information = root @ root.T
        measured = truth + rng.normal(scale=0.1, size=NUM_ERRORS)
        errors = errors.with_step(equations(information, information @ (measured - errors.mean)))
        total += information
        moment += information @ measured
    prior = np.concatenate([DISPARITY_SIGMA_PX, np.full(NUM_COEFFICIENTS, sigma_px)]) ** -2.0
    information = total + np.diag(prior)
    np.testing.assert_allclose(errors.mean, np.linalg.solve(information, moment), rtol=1e-9)
    np.testing.assert_allclose(errors.cov, np.linalg.inv(information), rtol=1e-9)
    np.testing.assert_array_equal(errors.disparity_cov, errors.cov[:2, :2])


@pytest.mark.parametrize("tau_px", [0.02, 0.1, 0.5])
def test_the_prior_becomes_as_wide_as_the_errors_are(tau_px: float) -> None:
    """Of 45 coefficients, the mean square is known to 21 %: 3 of its σ are 0.34 of τ."""
    rng = np.random.default_rng(int(1000 * tau_px))
    truth = np.concatenate([np.zeros(2), rng.normal(scale=tau_px, size=NUM_COEFFICIENTS)])
    information = np.eye(NUM_ERRORS) / 0.05**2
    errors = ImageErrors.initial()
    for _ in range(100):
        measured = truth + 0.05 * rng.normal(size=NUM_ERRORS)
        errors = errors.with_step(equations(information, information @ (measured - errors.mean)))
    assert abs(errors.distortion_sigma_px / tau_px - 1.0) < 0.34
    np.testing.assert_allclose(errors.mean, truth, atol=0.03)


def test_a_lens_without_distortion_gets_no_field() -> None:
    """What white noise makes of the field vanishes with its prior: a tenth of what is left with the
    prior that is not learned."""
    rng = np.random.default_rng(5)
    information = np.eye(NUM_ERRORS) / 0.5**2
    errors = ImageErrors.initial()
    for _ in range(100):
        measured = 0.5 * rng.normal(size=NUM_ERRORS)
        errors = errors.with_step(equations(information, information @ (measured - errors.mean)))
    prior = np.append(DISPARITY_SIGMA_PX, np.full(NUM_COEFFICIENTS, INITIAL_SIGMA_PX)) ** -2.0
    fixed = np.linalg.solve(errors.seen + np.diag(prior), errors.moment)
    rms = np.sqrt(np.mean(errors.distortion**2))
    assert rms < 0.3 * np.sqrt(np.mean(fixed[2:] ** 2))


def test_nothing_seen_leaves_the_prior() -> None:
    nothing = np.zeros((NUM_ERRORS, NUM_ERRORS))
    errors = ImageErrors.initial().with_step(equations(nothing, np.zeros(NUM_ERRORS)))
    np.testing.assert_array_equal(errors.mean, 0.0)
    assert errors.distortion_sigma_px == pytest.approx(INITIAL_SIGMA_PX, rel=1e-12)
    assert errors.focal_rms == FOCAL_SIGMA


PRIOR_SIGMA = {"focal": FOCAL_SIGMA, "readout": READOUT_SIGMA_S}


def measured_together(
    rng: np.random.Generator, name: str, value: float, sigma: float, steps: int
) -> tuple[ImageErrors, FloatArray, FloatArray]:
    """Return the estimate after steps that measure image errors of 0.1 px and another quantity
    together, each to ``sigma`` of the latter; and the joint information and moment of all, by a
    prior for each.

    The gradients are those at what is corrected, as the tracks of a step are.
    """
    truth = np.append(rng.normal(scale=0.1, size=NUM_ERRORS), value)
    errors = ImageErrors.initial()
    total = np.zeros((NUM_ERRORS + 1, NUM_ERRORS + 1))
    moment = np.zeros(NUM_ERRORS + 1)
    for _ in range(steps):
        tau_px = errors.distortion_sigma_px
        jacobian = rng.normal(size=(2 * NUM_ERRORS, NUM_ERRORS + 1))
        jacobian[:, -1] /= sigma
        information = jacobian.T @ jacobian
        measured = truth + np.linalg.solve(information, jacobian.T @ rng.normal(size=len(jacobian)))
        gradient = information @ (measured - np.append(errors.mean, errors.readout_s))
        of_other: dict[str, Any] = {
            name: ScalarEquations(information[:-1, -1], information[-1, -1], gradient[-1])
        }
        step = equations(information[:-1, :-1], gradient[:-1])
        errors = errors.with_step(step._replace(**of_other))
        total += information
        moment += information @ measured
    prior = np.concatenate(
        [DISPARITY_SIGMA_PX, np.full(NUM_COEFFICIENTS, tau_px), [PRIOR_SIGMA[name]]]
    )
    return errors, total + np.diag(prior**-2.0), moment


def test_images_that_agree_with_the_focal_length_make_it_certain() -> None:
    """As in one least-squares problem of all errors together."""
    errors, information, moment = measured_together(
        np.random.default_rng(8), "focal", 0.0, 0.002, 4
    )
    expected = np.linalg.solve(information, moment)[-1] ** 2 + np.linalg.inv(information)[-1, -1]
    assert errors.focal_rms == pytest.approx(np.sqrt(expected), rel=1e-6)
    assert errors.focal_rms < 0.3 * FOCAL_SIGMA


def test_images_that_contradict_the_focal_length_show_nothing() -> None:
    """It may be the lenses."""
    errors, *_ = measured_together(np.random.default_rng(9), "focal", 0.03, 0.002, 4)
    assert errors.focal_rms == FOCAL_SIGMA


def test_the_estimate_moves_with_the_focal_length_that_is_assumed() -> None:
    """By ∂c/∂ε of the least-squares problem in which ε is given."""
    errors, information, moment = measured_together(
        np.random.default_rng(10), "focal", 0.01, 0.002, 4
    )
    of_image = information[:-1, :-1]
    means = [
        np.linalg.solve(of_image, moment[:-1] - information[:-1, -1] * epsilon)
        for epsilon in (0.0, 0.01)
    ]
    np.testing.assert_allclose(errors.mean, means[0], atol=1e-9)
    np.testing.assert_allclose(0.01 * errors.shift_by_focal, means[1] - means[0], atol=1e-9)


@pytest.mark.parametrize("readout_s", [0.0, 0.02])
def test_the_readout_time_is_that_of_one_least_squares_problem(readout_s: float) -> None:
    """Of all errors together, whether or not it has been corrected in between."""
    errors, information, moment = measured_together(
        np.random.default_rng(10), "readout", readout_s, 0.002, 4
    )
    expected = np.linalg.solve(information, moment)
    assert errors.readout.mean_s == pytest.approx(expected[-1], rel=1e-6)
    sigma_s = np.sqrt(np.linalg.inv(information)[-1, -1])
    assert errors.readout.sigma_s == pytest.approx(sigma_s, rel=1e-6)
    assert (errors.readout_s != 0.0) == (readout_s != 0.0)
    if readout_s:
        np.testing.assert_allclose(errors.mean, expected[:-1], atol=1e-9)
    else:  # the errors of the images, given that the shutter is global
        given = np.linalg.solve(information[:-1, :-1], moment[:-1])
        np.testing.assert_allclose(errors.mean, given, atol=1e-9)


def test_a_readout_that_the_calibration_gives_is_corrected_before_anything_is_seen() -> None:
    errors = ImageErrors.initial(readout_s=0.025)
    assert errors.readout_s == 0.025
    np.testing.assert_allclose(errors.readout, (0.025, KNOWN_SIGMA_S))
    nothing = np.zeros((NUM_ERRORS, NUM_ERRORS))
    after = errors.with_step(equations(nothing, np.zeros(NUM_ERRORS)))
    assert after.readout_s == pytest.approx(0.025, rel=1e-12)
    np.testing.assert_allclose(ImageErrors.initial().readout, (0.0, READOUT_SIGMA_S))


def test_another_radial_error_keeps_the_errors_those_of_the_readout_that_is_corrected() -> None:
    errors, _, _ = measured_together(np.random.default_rng(11), "readout", 0.02, 0.002, 4)
    assert errors.readout_s
    np.testing.assert_allclose(errors.with_radial_moved(0.0).mean, errors.mean, rtol=1e-12)
