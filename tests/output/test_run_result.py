from collections.abc import Callable

import numpy as np
import pytest

from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.geometry import se3
from probevo.output.run_result import RunRecorder, RunResult
from probevo.sequences.missing_data import Defect, MissingData


@pytest.mark.parametrize("count", [0, 1, 2, 30])
def test_shapes_hold_for_any_number_of_frames(
    make_run: Callable[..., RunResult], count: int
) -> None:
    run = make_run(count)
    steps = max(count - 1, 0)
    assert len(run) == count
    assert run.T_world_cam.shape == (count, 4, 4)
    assert run.T_curr_prev.shape == (steps, 4, 4)
    assert run.cov.shape == (steps, 6, 6)
    assert run.status.shape == run.num_tracks.shape == run.total_ms.shape == (steps,)
    assert all(ms.shape == (steps,) for ms in run.stage_ms.values())


def test_trajectory_chains_the_motions(make_run: Callable[..., RunResult]) -> None:
    run = make_run(10)
    np.testing.assert_array_equal(run.T_world_cam[0], np.eye(4))
    for k, T_curr_prev in enumerate(run.T_curr_prev):
        np.testing.assert_allclose(
            se3.inverse(run.T_world_cam[k + 1]) @ run.T_world_cam[k], T_curr_prev, atol=1e-12
        )


def test_moving_forward_moves_the_camera_forward() -> None:
    """Points come closer by 1 m a step: p_curr = p_prev − z."""
    T_curr_prev = np.tile(np.eye(4), (3, 1, 1))
    T_curr_prev[:, 2, 3] = -1.0
    np.testing.assert_array_equal(
        se3.chain_motions(T_curr_prev)[:, :3, 3], np.outer(np.arange(4.0), [0, 0, 1])
    )


@pytest.mark.parametrize(
    ("steps", "out_of_domain", "share"),
    [
        ([(100, 10), (300, 70)], [10, 70], 0.2),
        ([(100, 10), (0, None), (100, 0)], [10, 0, 0], 0.05),  # nothing was solved at the second
        ([(100, 0), (100, 0)], [0, 0], 0.0),
        ([(100, None), (100, None)], None, None),  # a model without a domain
        ([(0, None)], None, None),
        ([], None, None),
    ],
)
def test_the_share_out_of_domain_is_that_of_all_features_used(
    steps: list[tuple[int, int | None]], out_of_domain: list[int] | None, share: float | None
) -> None:
    recorder = RunRecorder()
    for k, (used, count) in enumerate([(0, None), *steps]):
        recorder.add(
            k,
            MotionEstimate(
                np.eye(4),
                np.eye(6),
                Status.OK,
                num_tracks=400,
                num_used=used,
                num_out_of_domain=count,
            ),
        )
    run = recorder.result()
    assert run.num_used is not None
    assert run.num_used.tolist() == [used for used, _ in steps]
    assert (
        None if run.num_out_of_domain is None else run.num_out_of_domain.tolist()
    ) == out_of_domain
    assert run.out_of_domain == pytest.approx(share)


def test_the_running_factors_of_the_noise_are_kept() -> None:
    recorder = RunRecorder()
    for k, factor in enumerate([1.0, 1.0, 0.5, 0.25]):
        motion = MotionEstimate(np.eye(4), np.eye(6), Status.OK, num_tracks=9, noise_factor=factor)
        recorder.add(k, motion, total_ms=7.0)
    result = recorder.result()
    assert result.noise_factor is not None
    assert result.noise_factor.tolist() == [1.0, 0.5, 0.25]
    assert result.total_ms.tolist() == [7.0] * 3


def test_totals_and_stages_that_come_and_go() -> None:
    recorder = RunRecorder()
    for k, stages in enumerate([{}, {"track": 5.0}, {"track": 4.0, "solve": 1.0}]):
        motion = MotionEstimate(np.eye(4), np.eye(6), Status.OK, num_tracks=10, stage_ms=stages)
        recorder.add(k, motion, total_ms=7.5 if k == 2 else None, rejected={"flow": k})
    run = recorder.result()
    assert {name: ms.tolist() for name, ms in run.stage_ms.items()} == {
        "track": [5.0, 4.0],
        "solve": [0.0, 1.0],
    }
    assert run.total_ms.tolist() == [5.0, 7.5]
    assert run.rejected == {"flow": 3}


def test_long_runs_with_a_stage_that_comes_late() -> None:
    """Several blocks of rows, and one filled to the last."""
    recorder = RunRecorder()
    for k in range(2048):
        stages = {"track": float(k)} | ({"solve": -float(k)} if k >= 1500 else {})
        T_curr_prev = se3.exp(np.array([0.0, 0.0, 1e-3 * k, 0.0, 0.0, 0.0]))
        recorder.add(
            k, MotionEstimate(T_curr_prev, k * np.eye(6), Status.OK, num_tracks=k, stage_ms=stages)
        )
    run = recorder.result()
    numbers = np.arange(1, 2048)
    assert len(run) == len(run.T_world_cam) == 2048
    np.testing.assert_array_equal(run.stamps_ns, np.arange(2048))
    np.testing.assert_array_equal(run.num_tracks, numbers)
    np.testing.assert_array_equal(run.T_curr_prev[:, 2, 3], 1e-3 * numbers)
    np.testing.assert_array_equal(run.cov[:, 5, 5], numbers)
    np.testing.assert_array_equal(run.stage_ms["track"], numbers)
    np.testing.assert_array_equal(run.stage_ms["solve"], np.where(numbers < 1500, 0, -numbers))


def test_faults_are_counted_by_name() -> None:
    """Two frames lost, a step that was not solved, and samples that could not be used."""
    recorder = RunRecorder()
    cov = np.eye(6)
    rates = MissingData(Defect.RATE_NOT_FINITE, 3, 20)
    missing = (rates, MissingData(Defect.PIXEL_TOO_LARGE, 1, 9))
    motions = [
        MotionEstimate(np.eye(4), np.zeros((6, 6)), Status.FIRST, num_tracks=0),
        MotionEstimate(np.eye(4), cov, Status.OK, num_tracks=9, missing=missing),
        MotionEstimate(np.eye(4), cov, Status.OK, num_tracks=9, missing=(rates,)),
        MotionEstimate(np.eye(4), cov, Status.OK, num_tracks=9),
        MotionEstimate(np.eye(4), cov, Status.TOO_FEW_TRACKS, num_tracks=0),
    ]
    for stamp_ns, motion in zip((0, 100, 201, 500, 600), motions, strict=True):
        recorder.add(stamp_ns, motion)
    assert recorder.result().faults == {
        "lost_frames": 2,
        "steps_too_few_tracks": 1,
        "imu_samples_without_a_finite_angular_rate": 6,
        "features_with_implausible_pixels": 1,
    }


def test_a_run_without_faults_counts_none(make_run: Callable[..., RunResult]) -> None:
    assert make_run(20).faults == {}
    assert make_run(1).faults == {}
