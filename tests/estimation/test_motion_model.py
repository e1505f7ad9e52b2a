"""Constant velocity: what it expects, how sure it is, and what it refuses to believe."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.config import MotionModelConfig
from probevo.estimation.motion_model import MotionModel
from probevo.estimation.reprojection import ReprojectionSolution, RotationPrior, solve_reprojection
from probevo.evaluation.consistency import drift_covariances
from probevo.geometry import se3, so3
from probevo.geometry.uncertainty import normalized_error_squared
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


def blind(model: MotionModel, duration_s: float = STEP_S, *, refused: bool = False) -> MotionModel:
    """After a step more that was not solved."""
    return model.after_blind(duration_s, model.expected(duration_s, None), refused=refused)


@pytest.mark.parametrize("duration_s", [0.02, 0.1, 0.13, 1.0])
def test_velocity_is_carried_over_any_duration(duration_s: float) -> None:
    expected = driving().expected(duration_s, None)
    np.testing.assert_allclose(expected.T_curr_prev, se3.exp(duration_s * TWIST_S), atol=1e-12)


def test_two_half_steps_make_a_whole_one() -> None:
    half = driving().expected(0.05, None).T_curr_prev
    whole = driving().expected(0.1, None).T_curr_prev
    np.testing.assert_allclose(half @ half, whole, atol=1e-12)


def test_nothing_is_expected_at_start_and_any_speed_is_possible() -> None:
    expected = MotionModel.at_start(CONFIG).expected(STEP_S, None)
    np.testing.assert_array_equal(expected.T_curr_prev, np.eye(4))
    sigma = np.sqrt(np.diagonal(expected.cov))
    assert (
        sigma >= STEP_S * np.repeat([CONFIG.start_speed_m_s, CONFIG.start_turn_rate_rad_s], 3)
    ).all()


def test_covariance_is_that_of_the_last_motion_of_the_acceleration_and_of_the_stamps() -> None:
    """((σ_v + a T) T)², with σ_v from the solve, and 2 σ_t² v vᵀ for the two stamps."""
    acceleration = np.repeat([CONFIG.acceleration_m_s2, CONFIG.angular_acceleration_rad_s2], 3)
    sigma = np.sqrt(np.diagonal(COV)) / STEP_S + acceleration * 0.2
    stamps = 2.0 * CONFIG.stamp_sigma_s**2 * np.outer(TWIST_S, TWIST_S)
    np.testing.assert_allclose(
        driving().expected(0.2, None).cov, np.diag((sigma * 0.2) ** 2) + stamps, rtol=1e-9
    )


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 60.0])
def test_the_path_of_a_blind_second_is_as_unsure_at_any_frame_rate(rate_hz: float) -> None:
    """One velocity is off for all of it: an acceleration of a leads a/2 m astray, and the stamps a
    little besides.

    At 1 Hz the whole second is one step at the velocity that it ends with.
    """
    model = MotionModel.at_start(CONFIG)
    pace = 1.0 / rate_hz
    model = model.after_solve(pace, se3.exp(pace * TWIST_S), 1e-10 * np.eye(6))
    motions = []
    covs = []
    ties = []
    for _ in range(round(rate_hz)):
        expected = model.expected(pace, None)
        T_curr_prev, cov, tied = model.carried_on(expected, None, refused=False)
        model = model.after_blind(pace, expected)
        motions = [*motions, T_curr_prev]
        covs = [*covs, cov]
        ties = [*ties, tied]
    shared = np.zeros((len(covs), 6, 3))
    drift = drift_covariances(
        np.array(motions), np.array(covs), shared, path_cross_cov=np.array(ties)
    )[-1]
    sigma = np.sqrt(drift[2, 2]) / CONFIG.acceleration_m_s2
    assert 0.5 <= sigma <= 0.6 if rate_hz > 1.0 else 1.0 <= sigma <= 1.05


def solved(T_curr_prev: FloatArray) -> ReprojectionSolution:
    """A solve that says so."""
    tracks = seen_twice(np.random.default_rng(0), 30)
    noise = StudentT().predict(np.zeros((30, 0)))
    return solve_reprojection(
        tracks.prev_px, tracks.curr_px, noise, guess=T_curr_prev, camera=CAMERA, max_iterations=0
    )


def test_a_refused_solve_is_within_the_covariance_of_what_goes_on_instead() -> None:
    model = driving()
    expected = model.expected(STEP_S, None)
    solution = solved(se3.exp(np.array([0.3, 0.0, -4.0, 0.0, 0.1, 0.0])))
    T_curr_prev, cov, _ = model.carried_on(expected, solution, refused=True)
    np.testing.assert_array_equal(T_curr_prev, expected.T_curr_prev)
    assert normalized_error_squared(solution.T_curr_prev, T_curr_prev, cov) < 1.0 + 1e-9
    assert normalized_error_squared(solution.T_curr_prev, T_curr_prev, expected.cov) > 60.0


def test_late_stamps_are_no_absurd_motion() -> None:
    """At 30 m/s and 30 Hz a stamp that is 10 ms late makes a step longer by a third."""
    model = driving()
    for _ in range(5):
        model = model.after_solve(
            1 / 30, se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])), 1e-6 * np.eye(6)
        )
    real = se3.exp(np.array([0.0, 0.0, -1.3, 0.0, 0.0, 0.0]))
    assert not model.expected(1 / 30, None).is_absurd(real, 1e-6 * np.eye(6))


def test_a_gyro_that_is_mounted_askew_refuses_no_solve() -> None:
    """Turning with 0.5 rad/s, 3° askew: a quarter of a degree a step, of which its own noise knows
    nothing."""
    model = driving()
    felt = RotationPrior(so3.exp(np.array([0.0026, 0.05, 0.0])), 1e-10 * np.eye(3))
    seen = se3.from_parts(so3.exp(np.array([0.0, 0.05, 0.0])), STEP_S * TWIST_S[:3])
    assert not model.expected(STEP_S, felt).is_absurd(seen, COV)


def test_covariance_grows_while_blind() -> None:
    model = driving()
    sigmas = []
    for _ in range(6):
        sigmas.append(np.sqrt(np.diagonal(model.expected(STEP_S, None).cov)))
        model = blind(model)
    assert (np.diff(sigmas, axis=0) > 0.0).all()


def test_motion_is_carried_on_while_blind() -> None:
    model = blind(blind(driving()))
    np.testing.assert_allclose(
        model.expected(STEP_S, None).T_curr_prev, se3.exp(STEP_S * TWIST_S), atol=1e-12
    )


def test_seeing_again_restores_the_certainty() -> None:
    model = driving()
    for _ in range(5):
        model = blind(model)
    seen = model.after_solve(STEP_S, se3.exp(STEP_S * TWIST_S), COV)
    np.testing.assert_allclose(
        seen.expected(STEP_S, None).cov, driving().expected(STEP_S, None).cov, rtol=1e-12
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


def test_a_gap_does_not_change_what_is_usual() -> None:
    model = blind(driving(), 5.0)
    assert model.usual_step_s == pytest.approx(STEP_S)


def test_what_is_usual_follows_a_slower_recording() -> None:
    model = driving()
    for _ in range(50):
        model = blind(model, 0.2)
    assert not model.is_gap(0.4)


@pytest.mark.parametrize(
    "surprise",
    [
        [0.0, 0.0, 0.1, 0.0, 0.0, 0.0],
        [0.0, 0.0, -0.15, 0.0, 0.0, 0.01],
        [0.05, 0.05, 0.0, 0.02, -0.02, 0.02],
    ],
    ids=["brakes with 10 m/s²", "accelerates with 15 m/s²", "turns in"],
)
def test_sensible_motions_are_accepted(surprise: list[float]) -> None:
    expected = driving().expected(STEP_S, None)
    assert not expected.is_absurd(se3.exp(np.array(surprise)) @ expected.T_curr_prev, COV)


@pytest.mark.parametrize(
    "surprise",
    [
        [0.0, 0.0, 1.2, 0.0, 0.0, 0.0],
        [0.0, 0.5, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.25, 0.0],
    ],
    ids=["stops at once", "jumps up by half a metre", "turns by 14°"],
)
def test_absurd_motions_are_refused(surprise: list[float]) -> None:
    expected = driving().expected(STEP_S, None)
    assert expected.is_absurd(se3.exp(np.array(surprise)) @ expected.T_curr_prev, COV)


def test_what_is_absurd_by_sight_is_not_if_the_sight_was_poor() -> None:
    expected = driving().expected(STEP_S, None)
    jump = se3.exp(np.array([0.0, 0.5, 0.0, 0.0, 0.0, 0.0])) @ expected.T_curr_prev
    assert not expected.is_absurd(jump, np.diag([1.0, 1.0, 1.0, 1e-4, 1e-4, 1e-4]))


def test_after_long_blindness_a_stop_is_believed() -> None:
    model = driving()
    for _ in range(100):
        model = blind(model)
    assert not model.expected(STEP_S, None).is_absurd(np.eye(4), COV)


def test_the_gyro_gives_the_rotation_and_its_certainty() -> None:
    gyro = RotationPrior(so3.exp(np.array([0.05, -0.2, 0.01])), 1e-6 * np.diag([1.0, 2.0, 3.0]))
    alone = driving().expected(STEP_S, None)
    aided = driving().expected(STEP_S, gyro)
    np.testing.assert_array_equal(aided.T_curr_prev[:3, :3], gyro.C_curr_prev)
    untold_rad = 0.02 * np.linalg.norm(
        [0.05, -0.2, 0.01]
    )  # a degree askew; and six milliseconds late
    untold_rad += 0.006 * np.linalg.norm(np.array([0.05, -0.2, 0.01]) / STEP_S - TWIST_S[3:])
    np.testing.assert_allclose(aided.cov[3:, 3:], gyro.cov + untold_rad**2 * np.eye(3), rtol=1e-9)
    np.testing.assert_array_equal(aided.cov[:3, :3], alone.cov[:3, :3])
    np.testing.assert_array_equal(aided.T_curr_prev[:3, 3], alone.T_curr_prev[:3, 3])


def test_the_model_itself_is_never_changed() -> None:
    """Each step yields a new belief."""
    model = driving()
    before = model.twist_s.copy(), model.twist_sigma_s.copy()
    model.after_solve(STEP_S, np.eye(4), COV)
    model.expected(STEP_S, None).T_curr_prev[:] = 0.0
    np.testing.assert_array_equal(model.twist_s, before[0])
    np.testing.assert_array_equal(model.twist_sigma_s, before[1])


def test_a_belief_that_refuses_three_solves_in_a_row_is_given_up() -> None:
    """A wrong velocity, taken for sure, would otherwise refuse the truth for seconds."""
    start = MotionModel.at_start(MotionModelConfig())
    wrong = start.after_solve(
        0.1, se3.exp(np.array([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])), 1e-8 * np.eye(6)
    )
    truth = se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]))
    cov = 1e-6 * np.eye(6)
    assert wrong.expected(0.1, None).is_absurd(truth, cov)
    model = blind(blind(wrong, refused=True), refused=True)
    assert model.expected(0.1, None).is_absurd(truth, cov)
    model = blind(model, refused=True)
    assert not model.expected(0.1, None).is_absurd(truth, cov)
    assert len(model.starts(0.1, model.expected(0.1, None))) > 1


def test_blind_steps_without_a_solve_do_not_count_as_refusals() -> None:
    start = MotionModel.at_start(MotionModelConfig())
    model = start.after_solve(
        0.1, se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])), 1e-8 * np.eye(6)
    )
    for _ in range(5):
        model = blind(model)
    assert len(model.starts(0.1, model.expected(0.1, None))) == 1


def test_forward_speeds_are_tried_while_none_is_known() -> None:
    start = MotionModel.at_start(MotionModelConfig(start_speed_m_s=20.0))
    tried = [-T[2, 3] for T in start.starts(0.1, start.expected(0.1, None))]
    np.testing.assert_allclose(tried, [0.0, 1.0, 2.0, 3.0])
