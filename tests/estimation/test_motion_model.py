"""Constant velocity: its prediction, the covariance of that, and the gate on solves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import chdtri

from probevo.arrays import FloatArray
from probevo.config import MotionModelConfig
from probevo.estimation.motion_model import INNOVATION_GATE, MIN_PREDICTED_SIGMA, MotionModel
from probevo.estimation.reprojection import ReprojectionSolution, solve_reprojection
from probevo.evaluation.consistency import drift_covariances
from probevo.geometry import se3, so3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.stereo_observations import StereoObservations
from probevo.measurements.variables import MOTION
from probevo.noise import StudentT
from worlds import CAMERA, seen_twice

CONFIG = MotionModelConfig()
STEP_S = 0.1
TWIST_S = np.array([0.2, 0.1, -12.0, 0.03, 0.1, -0.02])
"""Twelve metres a second ahead, in a slight bend."""
COV = np.diag([1e-4, 1e-4, 4e-4, 1e-8, 1e-8, 1e-8])


def driving(steps: int = 5) -> MotionModel:
    """After some steps of constant velocity."""
    model = MotionModel.at_start(CONFIG)
    for _ in range(steps):
        model = model.after_solve(STEP_S, se3.exp(STEP_S * TWIST_S), COV)
    return model


def reckoned(
    model: MotionModel, duration_s: float = STEP_S, *, is_rejected: bool = False
) -> MotionModel:
    """After one more step, which is dead-reckoned."""
    prediction = model.predict(duration_s, None)
    return model.after_dead_reckoning(
        duration_s, prediction, prediction.T_curr_prev, is_rejected=is_rejected
    )


@pytest.mark.parametrize("duration_s", [0.02, 0.1, 0.13, 1.0])
def test_velocity_is_extrapolated_over_any_duration(duration_s: float) -> None:
    prediction = driving().predict(duration_s, None)
    np.testing.assert_allclose(prediction.T_curr_prev, se3.exp(duration_s * TWIST_S), atol=1e-12)


def test_two_half_steps_make_a_whole_one() -> None:
    half = driving().predict(0.05, None).T_curr_prev
    whole = driving().predict(0.1, None).T_curr_prev
    np.testing.assert_allclose(half @ half, whole, atol=1e-12)


def test_at_the_start_no_motion_is_predicted_and_any_speed_is_possible() -> None:
    prediction = MotionModel.at_start(CONFIG).predict(STEP_S, None)
    np.testing.assert_array_equal(prediction.T_curr_prev, np.eye(4))
    sigma = np.sqrt(np.diagonal(prediction.cov))
    assert (
        sigma >= STEP_S * np.repeat([CONFIG.start_speed_m_s, CONFIG.start_turn_rate_rad_s], 3)
    ).all()


def test_covariance_is_that_of_the_last_motion_of_the_acceleration_and_of_the_stamps() -> None:
    """((σ_v + a T) T)², with σ_v from the solve, 2 σ_t² v vᵀ for the two stamps, and the least."""
    acceleration = np.repeat([CONFIG.acceleration_m_s2, CONFIG.angular_acceleration_rad_s2], 3)
    sigma = np.sqrt(np.diagonal(COV)) / STEP_S + acceleration * 0.2
    stamps = 2.0 * CONFIG.stamp_sigma_s**2 * np.outer(TWIST_S, TWIST_S)
    expected = np.diag((sigma * 0.2) ** 2) + stamps + MIN_PREDICTED_SIGMA**2 * np.eye(6)
    np.testing.assert_allclose(driving().predict(0.2, None).cov, expected, rtol=1e-9)


def test_a_motion_within_a_microsecond_tells_nothing_of_the_velocity() -> None:
    """Its features know the motion to a centimetre, which would be 10 km/s."""
    model = driving().after_solve(1e-6, np.eye(4), COV)
    at_start = MotionModel.at_start(CONFIG)
    np.testing.assert_array_equal(model.twist, at_start.twist)
    np.testing.assert_array_equal(model.twist_sigma, at_start.twist_sigma)


def test_a_rejected_solve_over_a_microsecond_leaves_a_covariance() -> None:
    """Which spans from nothing, as predicted, to the metre that the solve has moved."""
    model = driving()
    prediction = model.predict(1e-6, None)
    solution = solved(se3.exp(np.array([0.1, 0.0, 1.0, 0.0, 0.0, 0.0])))
    step = model.dead_reckoned(prediction, solution, is_rejected=True)
    motion = RelativePose(step.T_curr_prev, step.cov, curr=MOTION)
    information = motion.information({MOTION: step.T_curr_prev})
    scale = np.sqrt(np.diagonal(information))
    assert np.linalg.eigvalsh(information / scale[:, None] / scale)[0] > 0.0


def test_a_path_that_rejected_solves_lead_along_has_a_covariance() -> None:
    """While the speed is unknown, they stand in for the prediction, and the velocity's error acts
    along their axes, as well in the path before as in the next steps."""
    rng = np.random.default_rng(0)
    model = MotionModel.at_start(CONFIG)
    path_cov = np.zeros((6, 6))
    for _ in range(5):
        prediction = model.predict(10.0, None)
        guess = se3.exp(np.concatenate([20.0 * rng.normal(size=3), rng.normal(size=3)]))
        step = model.dead_reckoned(prediction, solved(guess), is_rejected=False)
        np.testing.assert_array_equal(step.T_curr_prev, guess)
        model = model.after_dead_reckoning(10.0, prediction, step.T_curr_prev)
        adjoint = se3.adjoint(step.T_curr_prev)
        cross = step.path_cross_cov
        path_cov = adjoint @ path_cov @ adjoint.T + step.cov + cross + cross.T
        # The velocity's error is a part of the path's.
        rest = path_cov - model.path_sensitivity @ model.path_sensitivity.T
        scale = np.sqrt(np.diagonal(path_cov))
        assert np.linalg.eigvalsh(rest / scale[:, None] / scale)[0] > -1e-9


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 20.0, 60.0, 200.0])
def test_images_that_stand_still_contradict_a_drive_at_any_frame_rate(rate_hz: float) -> None:
    """And a stamp that is late by a third of the interval does not."""
    prediction = driving().predict(1.0 / rate_hz, None)
    assert prediction.squared_distance(np.eye(4), 1e-8 * np.eye(6)) > INNOVATION_GATE
    for share in (0.67, 1.33):
        late = se3.exp(share / rate_hz * TWIST_S)
        assert prediction.squared_distance(late, 1e-8 * np.eye(6)) < INNOVATION_GATE


def test_gaps_in_a_row_are_another_frame_rate() -> None:
    """30 frames a second, and then 10."""
    model = MotionModel.at_start(CONFIG)
    for duration_s in [1.0 / 30.0] * 20 + [0.1] * 3:
        model = model.after_solve(duration_s, se3.exp(duration_s * TWIST_S), COV)
    assert model.is_gap(0.1)
    for _ in range(20):
        model = model.after_solve(0.1, se3.exp(0.1 * TWIST_S), COV)
    assert not model.is_gap(0.1)
    assert model.frames_of(0.1) == pytest.approx(1.0)


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 60.0])
def test_the_covariance_of_a_dead_reckoned_path_does_not_depend_on_the_frame_rate(
    rate_hz: float,
) -> None:
    """One velocity is off for all of it: an acceleration of a moves the path by a/2 m in a second,
    and the stamps move it a little besides.

    At 1 Hz the whole second is one step at the velocity that it ends with.
    """
    model = MotionModel.at_start(CONFIG)
    step_s = 1.0 / rate_hz
    model = model.after_solve(step_s, se3.exp(step_s * TWIST_S), 1e-10 * np.eye(6))
    motions = []
    covs = []
    cross_covs = []
    for _ in range(round(rate_hz)):
        prediction = model.predict(step_s, None)
        step = model.dead_reckoned(prediction, None, is_rejected=False)
        model = model.after_dead_reckoning(step_s, prediction, prediction.T_curr_prev)
        motions.append(step.T_curr_prev)
        covs.append(step.cov)
        cross_covs.append(step.path_cross_cov)
    drift = drift_covariances(
        np.array(motions),
        np.array(covs),
        common_mode=np.zeros((len(covs), 6, 3)),
        path_cross_cov=np.array(cross_covs),
    )
    sigma = np.sqrt(drift[-1, 2, 2]) / CONFIG.acceleration_m_s2
    assert 0.5 <= sigma <= 0.6 if rate_hz > 1.0 else 1.0 <= sigma <= 1.05


def solved(T_curr_prev: FloatArray) -> ReprojectionSolution:
    """A solve with that motion."""
    tracks = seen_twice(np.random.default_rng(0), 30)
    noise = StudentT().predict(np.zeros((30, 0)))
    return solve_reprojection(
        StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=CAMERA),
        guess=T_curr_prev,
        max_iterations=0,
    )


def test_a_refused_solve_is_within_the_covariance_of_the_dead_reckoned_step() -> None:
    model = driving()
    prediction = model.predict(STEP_S, None)
    solution = solved(se3.exp(np.array([0.3, 0.0, -4.0, 0.0, 0.1, 0.0])))
    step = model.dead_reckoned(prediction, solution, is_rejected=True)
    np.testing.assert_array_equal(step.T_curr_prev, prediction.T_curr_prev)
    squared = normalized_error_squared(solution.T_curr_prev, step.T_curr_prev, step.cov)
    assert squared < 1.0 + 1e-9
    squared = normalized_error_squared(solution.T_curr_prev, step.T_curr_prev, prediction.cov)
    assert squared > 60.0


def test_a_determined_solve_is_taken_only_while_the_speed_is_unknown() -> None:
    """Not accepted, it is still better than a prediction of no motion at all."""
    solution = solved(se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])))
    for model, is_taken in ((MotionModel.at_start(CONFIG), True), (driving(), False)):
        prediction = model.predict(STEP_S, None)
        step = model.dead_reckoned(prediction, solution, is_rejected=False)
        expected = solution.T_curr_prev if is_taken else prediction.T_curr_prev
        np.testing.assert_array_equal(step.T_curr_prev, expected)
        np.testing.assert_array_equal(step.cov, prediction.cov)


def test_innovation_is_the_left_perturbation_from_the_prediction() -> None:
    prediction = driving().predict(STEP_S, None)
    xi = np.array([0.1, -0.2, 0.3, 0.02, -0.01, 0.03])
    T_curr_prev = se3.exp(xi) @ prediction.T_curr_prev
    np.testing.assert_allclose(prediction.innovation(T_curr_prev), xi, atol=1e-12)


def test_late_stamps_pass_the_gate() -> None:
    """At 30 m/s and 30 Hz a stamp that is 10 ms late makes a step longer by a third."""
    model = driving()
    for _ in range(5):
        model = model.after_solve(
            1 / 30, se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])), 1e-6 * np.eye(6)
        )
    real = se3.exp(np.array([0.0, 0.0, -1.3, 0.0, 0.0, 0.0]))
    assert not model.predict(1 / 30, None).fails_gate(real, 1e-6 * np.eye(6))


def test_a_gyro_that_is_mounted_askew_refuses_no_solve() -> None:
    """Turning with 0.5 rad/s, 3° askew: a quarter of a degree a step, of which its own noise knows
    nothing."""
    model = driving()
    gyro = RelativeRotation(so3.exp(np.array([0.0026, 0.05, 0.0])), 1e-10 * np.eye(3), curr=MOTION)
    seen = se3.from_parts(so3.exp(np.array([0.0, 0.05, 0.0])), STEP_S * TWIST_S[:3])
    assert not model.predict(STEP_S, gyro).fails_gate(seen, COV)


def test_covariance_grows_while_dead_reckoning() -> None:
    model = driving()
    sigmas = []
    for _ in range(6):
        sigmas.append(np.sqrt(np.diagonal(model.predict(STEP_S, None).cov)))
        model = reckoned(model)
    assert (np.diff(sigmas, axis=0) > 0.0).all()


def test_dead_reckoning_keeps_the_velocity() -> None:
    model = reckoned(reckoned(driving()))
    np.testing.assert_allclose(
        model.predict(STEP_S, None).T_curr_prev, se3.exp(STEP_S * TWIST_S), atol=1e-12
    )


def test_a_solve_after_dead_reckoning_restores_the_covariance() -> None:
    model = driving()
    for _ in range(5):
        model = reckoned(model)
    seen = model.after_solve(STEP_S, se3.exp(STEP_S * TWIST_S), COV)
    np.testing.assert_allclose(
        seen.predict(STEP_S, None).cov, driving().predict(STEP_S, None).cov, rtol=1e-12
    )


@pytest.mark.parametrize(
    ("duration_s", "is_gap"), [(0.1, False), (0.2, False), (0.24, False), (0.26, True), (5, True)]
)
def test_a_step_of_more_than_two_and_a_half_usual_ones_is_a_gap(
    duration_s: float, is_gap: bool
) -> None:
    assert driving().is_gap(duration_s) is is_gap


def test_the_second_frame_is_never_a_gap() -> None:
    assert not MotionModel.at_start(CONFIG).is_gap(100.0)


@pytest.mark.parametrize("gap_s", [0.5, 2.0])
def test_a_step_over_missing_frames_gives_a_mean_velocity(gap_s: float) -> None:
    """The vehicle brakes by one standard deviation all the while: the velocity at the end, and the
    next motion, are within what is claimed, as after a recovery over the same time."""
    model = driving(30)
    brakes = np.zeros(6)
    brakes[2] = CONFIG.acceleration_m_s2
    path = se3.exp(gap_s * TWIST_S + 0.5 * gap_s**2 * brakes)
    after = model.after_solve(gap_s, path, COV)
    recovered = model.after_recovery(STEP_S, gap_s, path, cov=COV)
    np.testing.assert_array_equal(after.twist_sigma, recovered.twist_sigma)
    velocity = TWIST_S + gap_s * brakes
    assert abs(after.twist[2] - velocity[2]) < 1.05 * after.twist_sigma[2]
    following = se3.exp(STEP_S * (velocity + 0.5 * STEP_S * brakes))
    assert not after.predict(STEP_S, None).fails_gate(following, COV)


def test_a_gap_does_not_change_what_is_usual() -> None:
    model = reckoned(driving(), 5.0)
    assert model.usual_step_s == pytest.approx(STEP_S)


def test_what_is_usual_follows_a_slower_recording() -> None:
    model = driving()
    for _ in range(50):
        model = reckoned(model, 0.2)
    assert not model.is_gap(0.4)


@pytest.mark.parametrize(
    "innovation",
    [
        [0.0, 0.0, 0.1, 0.0, 0.0, 0.0],
        [0.0, 0.0, -0.15, 0.0, 0.0, 0.01],
        [0.05, 0.05, 0.0, 0.02, -0.02, 0.02],
        [0.0, 0.0, 0.0, 0.1, 0.25, -0.2],
    ],
    ids=["brakes with 10 m/s²", "accelerates with 15 m/s²", "turns in", "is turned by a hand"],
)
def test_sensible_motions_pass_the_gate(innovation: list[float]) -> None:
    prediction = driving().predict(STEP_S, None)
    assert not prediction.fails_gate(se3.exp(np.array(innovation)) @ prediction.T_curr_prev, COV)


@pytest.mark.parametrize(
    "innovation",
    [
        [0.0, 0.0, 1.2, 0.0, 0.0, 0.0],
        [0.0, 0.5, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 1.8, 0.0],
    ],
    ids=["stops at once", "jumps up by half a metre", "turns by 103°"],
)
def test_implausible_motions_fail_the_gate(innovation: list[float]) -> None:
    prediction = driving().predict(STEP_S, None)
    assert prediction.fails_gate(se3.exp(np.array(innovation)) @ prediction.T_curr_prev, COV)


def test_the_gate_is_a_quantile_and_a_gyro_s_is_wider() -> None:
    assert chdtri(6, 1e-4) == pytest.approx(INNOVATION_GATE, abs=0.01)
    gyro = RelativeRotation(so3.exp(STEP_S * TWIST_S[3:]), 1e-8 * np.eye(3), curr=MOTION)
    for rotation, passes in ((None, False), (gyro, True)):
        prediction = driving().predict(STEP_S, rotation)
        sigma_m = np.sqrt(prediction.cov[0, 0])
        sideways = se3.exp(np.array([6.0 * sigma_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
        cov = 1e-12 * np.eye(6)
        assert prediction.fails_gate(sideways @ prediction.T_curr_prev, cov) is not passes


def test_a_gyro_would_have_seen_a_sudden_turn() -> None:
    gyro = RelativeRotation(so3.exp(STEP_S * TWIST_S[3:]), 1e-8 * np.eye(3), curr=MOTION)
    prediction = driving().predict(STEP_S, gyro)
    turned = se3.exp(np.array([0.0, 0.0, 0.0, 0.1, 0.25, -0.2])) @ prediction.T_curr_prev
    assert prediction.fails_gate(turned, COV)


def test_a_motion_that_agrees_with_either_prediction_passes_the_gate() -> None:
    """Of velocity and gyro, either may be wrong."""
    turned = so3.exp(np.array([0.1, 0.25, -0.2]))
    gyro = RelativeRotation(turned, 1e-8 * np.eye(3), curr=MOTION)
    by_velocity = driving().predict(STEP_S, None)
    by_gyro = driving().predict(STEP_S, gyro)
    either = replace(by_gyro, alternative=by_velocity)
    assert by_gyro.fails_gate(by_velocity.T_curr_prev, COV)
    assert not either.fails_gate(by_velocity.T_curr_prev, COV)
    assert not either.fails_gate(by_gyro.T_curr_prev, COV)
    backwards = se3.exp(np.array([0.0, 0.0, 2.4, 0.0, 0.0, 0.0])) @ by_gyro.T_curr_prev
    assert either.fails_gate(backwards, COV)


def test_a_rig_that_is_shaken_widens_its_own_prediction() -> None:
    """And dead-reckons with a covariance that covers it."""
    rng = np.random.default_rng(0)
    model = driving()
    rate = np.zeros(3)
    for _ in range(40):
        rate = rate + 10.0 * STEP_S * rng.normal(size=3)  # 10 rad/s² instead of 2
        twist = np.concatenate([TWIST_S[:3], rate])
        model = model.after_solve(STEP_S, se3.exp(STEP_S * twist), COV)
    for shaken, evenly in ((model, driving()), (reckoned(model), reckoned(driving()))):
        sigma = np.sqrt(np.diagonal(shaken.predict(STEP_S, None).cov))
        usual = np.sqrt(np.diagonal(evenly.predict(STEP_S, None).cov))
        assert (sigma[3:] > 3.0 * usual[3:]).all()
        assert (sigma[3:] < 7.0 * usual[3:]).all()


def test_the_gate_is_wider_for_an_uncertain_solve() -> None:
    prediction = driving().predict(STEP_S, None)
    jump = se3.exp(np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])) @ prediction.T_curr_prev
    assert not prediction.fails_gate(jump, np.diag([1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4]))


def test_after_long_dead_reckoning_a_stop_passes_the_gate() -> None:
    model = driving()
    for _ in range(100):
        model = reckoned(model)
    assert not model.predict(STEP_S, None).fails_gate(np.eye(4), COV)


def test_the_gyro_gives_the_rotation_and_its_covariance() -> None:
    angle = np.array([0.05, -0.2, 0.01])
    gyro = RelativeRotation(so3.exp(angle), 1e-6 * np.diag([1.0, 2.0, 3.0]), curr=MOTION)
    unaided = driving().predict(STEP_S, None)
    aided = driving().predict(STEP_S, gyro)
    np.testing.assert_array_equal(aided.T_curr_prev[:3, :3], gyro.C_curr_prev)
    # A degree askew, and six milliseconds late.
    unmodelled_rad = 0.02 * np.linalg.norm(angle)
    unmodelled_rad += 0.006 * np.linalg.norm(angle / STEP_S - TWIST_S[3:])
    expected_cov = gyro.covariance + (unmodelled_rad**2 + MIN_PREDICTED_SIGMA**2) * np.eye(3)
    np.testing.assert_allclose(aided.cov[3:, 3:], expected_cov, rtol=1e-9)
    np.testing.assert_array_equal(aided.cov[:3, :3], unaided.cov[:3, :3])
    np.testing.assert_array_equal(aided.T_curr_prev[:3, 3], unaided.T_curr_prev[:3, 3])


def test_the_error_of_the_gyro_bias_adds_up_over_dead_reckoned_steps() -> None:
    """It is the same in each of them, so that its σ is n J σ_b after n steps, while white noise
    grows with √n."""
    noise_rad = 1e-4
    bias_rad_s = np.array([1e-3, 2e-3, 3e-3])
    own_cov = noise_rad**2 * np.eye(3) + np.diag((STEP_S * bias_rad_s) ** 2)
    gyro = RelativeRotation(np.eye(3), own_cov, curr=MOTION)
    at_rest = np.concatenate([TWIST_S[:3], np.zeros(3)])
    model = MotionModel.at_start(CONFIG).after_solve(STEP_S, se3.exp(STEP_S * at_rest), COV)
    path_cov = np.zeros((6, 6))
    for _ in range(20):
        prediction = model.predict(STEP_S, gyro, STEP_S * np.diag(bias_rad_s))
        step = model.dead_reckoned(prediction, None, is_rejected=False)
        model = model.after_dead_reckoning(STEP_S, prediction, step.T_curr_prev)
        adjoint = se3.adjoint(step.T_curr_prev)
        cross = step.path_cross_cov
        path_cov = adjoint @ path_cov @ adjoint.T + step.cov + cross + cross.T
    expected = (20.0 * STEP_S * bias_rad_s) ** 2 + 20.0 * (noise_rad**2 + MIN_PREDICTED_SIGMA**2)
    np.testing.assert_allclose(np.diag(path_cov)[3:], expected, rtol=1e-3)


def test_the_model_itself_is_never_changed() -> None:
    """Each step yields a new one."""
    model = driving()
    twist = model.twist.copy()
    twist_sigma = model.twist_sigma.copy()
    model.after_solve(STEP_S, np.eye(4), COV)
    model.predict(STEP_S, None).T_curr_prev[:] = 0.0
    np.testing.assert_array_equal(model.twist, twist)
    np.testing.assert_array_equal(model.twist_sigma, twist_sigma)


def test_a_model_that_refuses_three_solves_in_a_row_is_given_up() -> None:
    """A wrong velocity with a small covariance would otherwise refuse the truth for seconds."""
    start = MotionModel.at_start(MotionModelConfig())
    wrong = start.after_solve(
        0.1, se3.exp(np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])), 1e-8 * np.eye(6)
    )
    truth = se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]))
    cov = 1e-6 * np.eye(6)
    assert wrong.predict(0.1, None).fails_gate(truth, cov)
    model = reckoned(reckoned(wrong, is_rejected=True), is_rejected=True)
    assert model.predict(0.1, None).fails_gate(truth, cov)
    model = reckoned(model, is_rejected=True)
    assert not model.predict(0.1, None).fails_gate(truth, cov)
    assert len(model.starts(0.1, model.predict(0.1, None))) > 1


def test_steps_without_a_solve_do_not_count_as_rejections() -> None:
    start = MotionModel.at_start(MotionModelConfig())
    model = start.after_solve(
        0.1, se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])), 1e-8 * np.eye(6)
    )
    for _ in range(5):
        model = reckoned(model)
    assert len(model.starts(0.1, model.predict(0.1, None))) == 1


def test_forward_speeds_are_tried_while_none_is_known() -> None:
    start = MotionModel.at_start(MotionModelConfig(start_speed_m_s=20.0))
    tried = [-T[2, 3] for T in start.starts(0.1, start.predict(0.1, None))]
    np.testing.assert_allclose(tried, [0.0, 1.0, 2.0, 3.0])


def test_behind_repeated_images_the_velocity_is_between_that_of_one_step_and_of_all() -> None:
    """The camera may have rested while the images repeated, or have moved on."""
    model = MotionModel.at_start(MotionModelConfig())
    for _ in range(3):
        model = model.after_repetition(0.1)
    assert model.speed_is_unknown
    forward = se3.exp(np.array([0.01, 0.0, -1.2, 0.0, 0.01, 0.0]))
    model = model.after_solve(0.1, forward, 1e-6 * np.eye(6))
    fast = se3.log(forward) / 0.1
    np.testing.assert_allclose(model.twist, 0.625 * fast, atol=1e-9)
    np.testing.assert_allclose(model.twist_sigma[2], 0.375 * abs(fast[2]), rtol=1e-3)
    after = model.after_solve(0.1, forward, 1e-6 * np.eye(6))
    np.testing.assert_allclose(after.twist, fast, atol=1e-9)


def test_agreement_by_information_is_that_by_covariance() -> None:
    """Where the information has an inverse."""
    prediction = driving().predict(STEP_S, None)
    rng = np.random.default_rng(0)
    root = rng.normal(size=(6, 6)) * np.repeat([0.1, 0.02], 3)[:, None]
    cov = root @ root.T
    agreed = set()
    for scale in np.geomspace(0.1, 100.0, 40):
        T_curr_prev = (
            se3.exp(scale * rng.normal(size=6) * np.repeat([0.1, 0.3], 3)) @ prediction.T_curr_prev
        )
        agrees = prediction.agrees(T_curr_prev, np.linalg.inv(cov))
        assert agrees is not prediction.fails_gate(T_curr_prev, cov)
        agreed.add(agrees)
    assert agreed == {True, False}


def test_a_direction_without_information_contradicts_nothing() -> None:
    prediction = driving().predict(STEP_S, None)
    rotation_only = np.diag([0.0, 0.0, 0.0, 1e8, 1e8, 1e8])
    far_off = se3.exp(np.array([50.0, 0.0, 0.0, 0.0, 0.0, 0.0])) @ prediction.T_curr_prev
    assert prediction.agrees(far_off, rotation_only)
    turned = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 2.5, 0.0])) @ prediction.T_curr_prev
    assert not prediction.agrees(turned, rotation_only)


def test_the_change_of_a_motion_is_its_prediction_without_the_error_of_the_velocity() -> None:
    known = replace(driving(), twist_sigma=np.full(6, 1e-9))
    expected = known.predict(STEP_S, None).cov
    np.testing.assert_allclose(known.change_cov(STEP_S), expected, rtol=1e-6)
    np.testing.assert_allclose(driving().change_cov(STEP_S), expected, rtol=1e-6)


def test_the_velocity_changes_by_as_much_as_it_usually_does_and_both_means_are_noisy() -> None:
    """A hundred steps that change at random, by half of what the settings say, each solved with the
    same noise."""
    rng = np.random.default_rng(4)
    model = driving()
    configured = model.accelerations / model.acceleration_scale.factors
    sigma = np.repeat([2e-3, 1e-3], 3)
    twist = model.twist.copy()
    for _ in range(100):
        twist = twist + 0.5 * configured * STEP_S * rng.normal(size=6)
        T_curr_prev = se3.exp(STEP_S * twist + sigma * rng.normal(size=6))
        model = model.after_solve(STEP_S, T_curr_prev, np.diag(sigma**2))
    expected = (0.5 * configured * STEP_S) ** 2 + 2.0 * (sigma / STEP_S) ** 2
    found = np.diagonal(model.twist_change_cov(STEP_S))
    np.testing.assert_allclose(np.sqrt(found), np.sqrt(expected), rtol=0.25)
