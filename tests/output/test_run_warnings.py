"""The warnings of a run: which steps count, and what is said of them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.focal_length import FocalLengthError
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.geometry import se3
from probevo.measurements import pose_of
from probevo.measurements.heading import Heading
from probevo.measurements.imu_reason import ImuFault, ImuReason
from probevo.measurements.sensor import NoMeasurement
from probevo.output.run_facts import unused_imu_text
from probevo.output.run_result import RunRecorder, RunResult
from probevo.output.run_warnings import (
    camera_warning,
    fixed_warning,
    focal_warning,
    imu_warning,
    noise_warning,
    repetition_warning,
    rest_warning,
    rows_warning,
    run_warnings,
    scale_warning,
    status_warning,
    step_length_warning,
    timing_warning,
    truth_warning,
    unsolved_warning,
)
from probevo.runs.runner import run_sequence
from probevo.sequences.missing_data import Defect, MissingData
from probevo.tracking.fixed_features import FixedFeatures, StepsAtRest
from probevo.tracking.tracks import OTHER_ROW
from sequences.recordings import write_tracks
from worlds import CAMERA, FORWARD, drive, random_pixels


@pytest.mark.parametrize("status", [s for s in Status if s not in (Status.FIRST, Status.OK)])
def test_the_status_that_prevails_is_named(status: Status) -> None:
    other = Status.GAP if status is not Status.GAP else Status.DEGENERATE
    said = status_warning(np.array([Status.OK, other, status, status]))
    assert said is not None
    assert said.startswith("Only 1 of 4 steps are OK")
    assert f"Most that are not OK have the status {status.name}," in said


def test_a_tenth_of_steps_without_a_solve_is_said() -> None:
    lost = Status.TOO_FEW_TRACKS
    assert unsolved_warning(np.array([], np.int64)) is None
    assert unsolved_warning(np.array([Status.OK] * 19 + [lost])) is None
    assert unsolved_warning(np.array([Status.OK] * 9 + [Status.RECOVERED])) is None
    assert unsolved_warning(np.array([Status.OK] * 4 + [lost] * 6)) is None  # said otherwise
    said = unsolved_warning(np.array([Status.OK] * 8 + [lost] * 2))
    assert said is not None
    assert said.startswith("2 of 10 steps are dead-reckoned")
    assert "TOO_FEW_TRACKS" in said


ALL_OK = np.ones(29, np.bool_)


def _winding(rng: np.random.Generator, length_m: float) -> FloatArray:
    """Return true poses of a drive whose steps have a length of their own each, [30, 4, 4]."""
    steps = np.tile(np.eye(4), (29, 1, 1))
    steps[:, 2, 3] = -length_m * rng.uniform(0.5, 1.5, 29)
    return se3.chain_motions(steps)


def test_the_truth_of_another_recording_is_warned_of() -> None:
    ours = _winding(np.random.default_rng(1), 1.0)
    other = _winding(np.random.default_rng(2), 1.0)
    steps = relative_motions(ours)
    assert truth_warning(steps, ALL_OK, ours) is None
    said = truth_warning(steps, ALL_OK, other)
    assert said is not None
    assert "Is it the truth of this recording" in said
    # A wrong scale is another warning, and a truth may be coarse where the camera hardly moves.
    twice = steps.copy()
    twice[:, :3, 3] *= 2.0
    assert truth_warning(twice, ALL_OK, ours) is None
    slow, noisy = (_winding(np.random.default_rng(seed), 0.03) for seed in (1, 2))
    assert truth_warning(relative_motions(slow), ALL_OK, noisy) is None
    assert truth_warning(steps, ALL_OK, np.full_like(ours, np.nan)) is None
    assert truth_warning(steps, ALL_OK, None) is None


def _wandering(seed: int, step_m: float) -> FloatArray:
    """Return true poses of a drive that turns by some 6° a step, [100, 4, 4]."""
    rng = np.random.default_rng(seed)
    steps = np.tile(np.eye(4), (99, 1, 1))
    steps[:, 2, 3] = -step_m
    turns = np.zeros((99, 6))
    turns[:, 4] = np.cumsum(0.03 * rng.normal(size=99))
    return se3.chain_motions(se3.exp(turns) @ steps)


def test_the_truth_of_another_slow_recording_is_warned_of() -> None:
    """Each of its steps is shorter than what a coarse truth may be wrong by."""
    ours = _wandering(1, 0.024)
    steps = relative_motions(ours)
    is_ok = np.ones(99, np.bool_)
    assert truth_warning(steps, is_ok, ours) is None
    coarse = ours.copy()
    coarse[:, :3, 3] += 0.01 * np.random.default_rng(0).normal(size=(100, 3))
    assert truth_warning(steps, is_ok, coarse) is None
    said = truth_warning(steps, is_ok, _wandering(2, 0.024))
    assert said is not None
    assert said.startswith("Motions over 16 steps are off the true ones by")
    said = truth_warning(steps, is_ok, se3.inverse(ours))
    assert said is not None
    assert "is the truth T_cam_world" in said


def test_only_steps_that_are_ok_are_compared_with_the_truth() -> None:
    """The dead reckoning across a pause was once compared, and set the scale of all others."""
    ours = _winding(np.random.default_rng(1), 1.0)
    steps = relative_motions(ours)
    steps[12, 2, 3] -= 100.0
    is_ok = ALL_OK.copy()
    is_ok[12] = False
    assert truth_warning(steps, is_ok, ours) is None
    assert truth_warning(steps, ALL_OK, ours) is None  # as of a file, which does not say it
    steps[:, :3, 3] = 5.0
    assert truth_warning(steps, ALL_OK, ours) is not None
    assert truth_warning(steps, ~ALL_OK, ours) is None


@pytest.mark.parametrize(("every", "num_steps"), [(2, 16), (3, 12), (4, 16)])
def test_truth_of_some_frames_is_compared(every: int, num_steps: int) -> None:
    def partly(truth: FloatArray) -> FloatArray:
        known = np.full_like(truth, np.nan)
        known[1::every] = truth[1::every]
        return known

    ours = partly(_wandering(1, 0.024))
    steps = relative_motions(_wandering(1, 0.024))
    is_ok = np.ones(99, np.bool_)
    assert truth_warning(steps, is_ok, ours) is None
    assert step_length_warning(steps, is_ok, ours) is None
    said = truth_warning(steps, is_ok, partly(_wandering(2, 0.024)))
    assert said is not None
    assert said.startswith(f"Motions over {num_steps} steps are off the true ones by")
    # Motions over a step that is not OK do not count.
    steps[7, 2, 3] -= 100.0
    is_ok[7] = False
    assert truth_warning(steps, is_ok, ours) is None
    steps[:, :3, 3] *= 2.0
    said = step_length_warning(steps, is_ok, ours)
    assert said is not None
    assert said.startswith("The steps are 2 times as long as the true ones")
    is_ok[1::every] = False
    assert step_length_warning(steps, is_ok, ours) is None


def _turning(turn_rad: float) -> FloatArray:
    """Return motions T_curr_prev of a drive whose steps turn by a random angle of this σ each,
    [29, 4, 4]."""
    rng = np.random.default_rng(1)
    steps = relative_motions(_winding(rng, 1.0))
    turns = np.zeros((29, 6))
    turns[:, 4] = turn_rad * rng.normal(size=29)
    return se3.exp(turns) @ steps


@pytest.mark.parametrize("turn_rad", [0.0, 0.1])
def test_inverse_poses_of_the_truth_are_named(turn_rad: float) -> None:
    """On a straight road, which they seem to drive backwards, and on a winding one."""
    steps = _turning(turn_rad)
    said = truth_warning(steps, ALL_OK, se3.inverse(se3.chain_motions(steps)))
    assert said is not None
    assert "is the truth T_cam_world" in said


def test_a_truth_whose_axes_point_backwards_does_not_fit() -> None:
    steps = _turning(0.1)
    about_y = np.diag([-1.0, 1.0, -1.0, 1.0])
    said = truth_warning(steps, ALL_OK, about_y @ se3.chain_motions(steps) @ about_y)
    assert said is not None
    assert "Is it the truth of this recording" in said


def _scale_said(true_m: FloatArray, steps_m: FloatArray) -> str | None:
    """Return the warning of a run with steps along the optical axis, [N], m, beside true
    positions, [N, 3], m."""
    recorder = RunRecorder()
    truth = np.tile(np.eye(4), (len(true_m), 1, 1))
    truth[:, :3, 3] = true_m
    for frame, step_m in enumerate(steps_m):
        T_curr_prev = np.eye(4)
        T_curr_prev[2, 3] = -step_m
        status = Status.OK if frame else Status.FIRST
        recorder.add(frame, pv.MotionEstimate(T_curr_prev, np.eye(6), status, 0))
    return scale_warning(recorder.result(), truth)


def test_steps_twice_as_long_as_the_true_ones_are_warned_of() -> None:
    rng = np.random.default_rng(3)
    true_m = 1e-4 * rng.normal(size=(30, 3))
    true_m[:, 2] += 0.1 * np.arange(30)
    said = _scale_said(true_m, np.full(30, 0.2))
    assert said is not None
    assert "The steps are 2 times as long" in said
    assert _scale_said(true_m, np.full(30, 0.1)) is None


@pytest.mark.parametrize("smooth", [1, 5])
@pytest.mark.parametrize("step_m", [0.0, 1e-5, 1e-4])
def test_a_camera_at_rest_has_no_scale(step_m: float, smooth: int) -> None:
    """Its true steps are the noise of the truth, which no estimate has; where the truth is
    smoothed, they go on in one direction for some frames."""
    rng = np.random.default_rng(3)
    noise = 1e-3 * rng.normal(size=(60 + smooth, 3))
    true_m = np.mean([noise[k : k + 60] for k in range(smooth)], axis=0)
    true_m[:, 2] += step_m * np.arange(60)
    assert _scale_said(true_m, np.full(60, step_m)) is None
    assert _scale_said(true_m, step_m + 1e-4 * rng.normal(size=60)) is None


def test_a_sensor_that_lies_is_named_with_its_frame() -> None:
    """In the warnings, the facts of the report, and among the faults of metrics.json; the path that
    is written is the corrected one, as long as the sensor was used."""
    frames = drive(np.random.default_rng(0), 30, points=60)
    true = [np.linalg.matrix_power(FORWARD, index) for index in range(30)]
    recorder = RunRecorder()

    def compass(prev_frame: pv.Frame, frame: pv.Frame) -> list[Heading] | NoMeasurement:
        if frame.index == 3:
            return NoMeasurement("no fix")
        east = true[frame.index].T[:3, :3] @ [0.0, 0.0, 1.0]
        heading = np.arctan2(east[0], east[2]) + (1.0 if frame.index > 10 else 0.0)
        return [Heading(pose_of(frame.index), heading, 0.05)]

    odometry = pv.StereoOdometry(CAMERA, sensors=[compass])
    for frame in frames:
        recorder.add(frame.stamp_ns, odometry.step(frame))
    result = recorder.result()
    use = result.sensors["compass"]
    assert (use.used, use.silent) == (9, {"no fix": 1})
    assert use.gated + use.excluded == 19
    assert use.excluded_at is not None
    assert use.excluded_at >= 11
    warning = run_warnings(result)["A sensor is faulty"]
    assert f"compass is excluded from frame {use.excluded_at} on: " in warning
    assert result.faults["steps_without_compass"] == use.excluded
    assert "9 steps used it, " in str(use)
    assert not np.array_equal(result.T_world_cam[10], se3.chain_motions(result.T_curr_prev)[10])
    np.testing.assert_allclose(
        result.T_world_cam[29], se3.chain_motions(result.T_curr_prev)[29], atol=1e-9
    )


def test_half_of_the_steps_are_enough() -> None:
    assert status_warning(np.array([Status.OK, Status.GAP])) is None
    assert status_warning(np.zeros(0, np.int64)) is None


def test_a_noise_model_of_another_camera_is_named_with_the_difference() -> None:
    assert camera_warning(None) is None
    said = camera_warning("it was trained with another camera: this one's baseline is 1 m.")
    assert said is not None
    assert said.startswith("Of the noise model: it was trained with another camera: this one's")


@pytest.mark.parametrize(("sigma", "said"), [(2.0, None), (0.5, None), (3.0, "3"), (0.3, "0.3")])
def test_errors_unlike_those_of_the_training_are_warned_of(
    sigma: float, said: str | None, make_run: Callable[..., RunResult]
) -> None:
    run = replace(make_run(30), noise_factor=np.full(29, sigma**2))
    assert noise_warning(run) is None  # an untrained model knows no size
    warning = noise_warning(replace(run, noise_is_learned=True))
    if said is None:
        assert warning is None
    else:
        assert warning is not None
        assert warning.startswith(f"The errors of the features are {said} times as large (σ)")


def test_an_imu_that_was_left_out_is_named_with_the_reason() -> None:
    assert imu_warning(None) is None
    said = imu_warning("contradicts the images")
    assert said is not None
    assert said.startswith("The IMU contradicts the images.")


def test_where_the_shutter_rolls_the_imu_may_be_right() -> None:
    reason = "contradicts the images"
    said = imu_warning(reason, ImuFault.CONTRADICTION, shutter_rolls=True)
    assert said is not None
    assert "The IMU may be right: the shutter rolls" in said
    assert "readout_s" in said
    usual = imu_warning(reason, ImuFault.CONTRADICTION)
    assert usual is not None
    assert "shutter" not in usual


@pytest.mark.parametrize("fault", [fault for fault in ImuFault if fault is not ImuFault.TESTING])
def test_a_calibration_is_not_blamed_for_what_the_samples_are_like(fault: ImuFault) -> None:
    said = imu_warning("is at fault", fault)
    assert said is not None
    assert ("calibrate-check" in said) == (not fault.is_of_samples)


NO_SAMPLES = ImuReason(ImuFault.NO_SAMPLES, "has no samples")


def _recorded(reasons: list[ImuReason | None], first_used: int | None = None) -> RunRecorder:
    """Return the record of a run whose steps said why the IMU was not used, where they did; from
    one step on, it was in the window where they did not."""
    recorder = RunRecorder()
    for frame, reason in enumerate([None, *reasons]):
        motion = pv.MotionEstimate(
            np.eye(4), np.eye(6), Status.OK if frame else Status.FIRST, 0, imu_reason=reason
        )
        is_used = first_used is not None and frame >= first_used and reason is None
        recorder.add(frame, motion, imu_is_in_window=is_used)
    return recorder


def _imu_said(reasons: list[ImuReason | None], first_used: int | None = None) -> str:
    """Return the warning of such a run."""
    return run_warnings(_recorded(reasons, first_used).result()).get("IMU", "")


def test_the_reason_of_most_steps_is_named() -> None:
    """Whatever the numbers in it, and whatever the last step said."""
    wrong_clock = [
        ImuReason(ImuFault.CONTRADICTION, f"contradicts the images: χ² is {k}.5 for 34 degrees")
        for k in range(20)
    ]
    said = _imu_said([None, None, *wrong_clock, *[NO_SAMPLES] * 3])
    assert said.startswith(f"The IMU {wrong_clock[-1].text}. The path is by images alone.")
    assert "calibrate-check" in said
    for_good = wrong_clock[-1].for_good()
    said = _imu_said([*wrong_clock, NO_SAMPLES, for_good])
    assert said.startswith("The IMU is left out for good: it contradicts the images: χ² is 19.5")


def test_an_imu_that_ends_is_said_to_be_unused_from_then_on() -> None:
    gated = ImuReason(ImuFault.GATED, "contradicts the images in this step")
    reasons = [None, None, *[gated] * 5, None, *[NO_SAMPLES] * 3]
    said = _imu_said(reasons, first_used=3)
    assert said == "The IMU has no samples. From frame 9 on, the path is by images alone."
    assert _imu_said([*reasons, None], first_used=3) == ""
    assert _imu_said([None] * 4) == ""


def test_the_test_of_an_imu_is_no_cause_for_a_warning() -> None:
    testing = ImuReason(ImuFault.TESTING, "is being tested: its samples connect 4 of the 6 frames")
    recorder = _recorded([*[testing] * 5, None, None], first_used=6)
    assert "IMU" not in run_warnings(recorder.result())
    assert unused_imu_text(recorder.result()) == ""
    assert _imu_said([*[testing] * 4, NO_SAMPLES, testing]).startswith("The IMU has no samples.")
    recorder = _recorded([testing] * 4)
    result = recorder.result()
    assert result.imu_left_out == testing.text
    assert "IMU" not in run_warnings(result)
    assert unused_imu_text(result) == "not used in 4 of 4 steps (4 being tested)"


def test_images_that_repeat_are_counted() -> None:
    assert repetition_warning(2, 30) is None
    found = repetition_warning(15, 30)
    assert found is not None
    assert found.startswith("The images of 15 of 30 frames are those of the frame before")
    recorder = RunRecorder()
    frames = drive(np.random.default_rng(0), 2)
    odometry = pv.StereoOdometry(CAMERA)
    for k, frame in enumerate(frames):
        motion = odometry.step(frame)
        lacking = (MissingData(Defect.REPEATED_IMAGES, 1, 1),) if k else ()
        recorder.add(frame.stamp_ns, replace(motion, missing=lacking))
    assert recorder.result().unusable[Defect.REPEATED_IMAGES.value] == 1


def test_images_of_other_frames_are_named_with_the_cure() -> None:
    assert timing_warning(0) is None
    right = timing_warning(1)
    left = timing_warning(-2)
    assert right is not None
    assert left is not None
    assert right.startswith("The right images are one frame late")
    assert right.endswith(
        "leave out the first image of the right camera, give each later one the name or place of"
        " the one before, and leave out the last image of the left camera, with times and poses."
    )
    assert left.startswith("The left images are 2 frames late")
    assert "2 frames earlier" in left
    assert left.endswith(
        "leave out the first 2 images of the left camera, give each later one the name or place of"
        " the one 2 before, and leave out the last 2 images of the right camera, with times and"
        " poses."
    )


def _rolled(roll_rad: float, num_elsewhere: int = 0) -> RunResult:
    """Return a run over features whose right camera is rolled, and matches that look alike in other
    rows in its last step."""
    recorder = RunRecorder()
    odometry = pv.StereoOdometry(CAMERA)
    for frame in drive(np.random.default_rng(0), 12, points=150):
        assert frame.features is not None
        pixels = frame.features.pixels.copy()
        right = pixels[:, 2:] - [CAMERA.cu_px, CAMERA.cv_px]
        pixels[:, 2:] += roll_rad * np.column_stack([-right[:, 1], right[:, 0]])
        features = replace(frame.features, pixels=pixels)
        motion = odometry.step(replace(frame, features=features))
        recorder.add(frame.stamp_ns, motion, rejected={OTHER_ROW: num_elsewhere})
    assert odometry.rig is not None
    return replace(recorder.result(), row_errors=odometry.rig.row_errors(CAMERA))


@pytest.mark.parametrize(("roll_deg", "warned"), [(0.0, False), (0.1, False), (1.0, True)])
def test_rows_that_no_rectification_leaves_are_warned_of(roll_deg: float, warned: bool) -> None:
    said = run_warnings(_rolled(np.radians(roll_deg))).get("Rows of left and right images differ")
    assert (said is not None) == warned
    if said is not None:
        assert said.startswith("Rows of right images are off by up to ")
        assert "probevo calibrate-check SEQUENCE" in said


def test_matches_that_are_mostly_in_other_rows_are_warned_of() -> None:
    """Beyond the rows in which matches are looked for, the estimate of the rows knows of no error;
    right images of other frames have a warning of their own."""
    result = _rolled(0.0, num_elsewhere=1000)
    said = rows_warning(result)
    assert said is not None
    assert said.startswith("12,000 stereo matches look alike in other rows; ")
    assert rows_warning(replace(result, right_late_frames=1)) is None
    assert rows_warning(replace(result, row_errors=None, rejected={})) is None


@pytest.mark.parametrize(("num_fixed", "warned"), [(0, False), (40, True)])
def test_a_part_of_the_vehicle_in_view_is_warned_of(
    num_fixed: int, warned: bool, tmp_path: Path
) -> None:
    """Features of its own stay where they are in both images, while the others pass by."""
    rng = np.random.default_rng(6)
    fixed_px = random_pixels(rng, num_fixed, (2.0, 4.0))
    path = _write_features(tmp_path, drive(rng, 8, points=120), fixed_px)
    run = run_sequence(pv.open_sequence(path), {}, tmp_path / "out")
    said = run_warnings(run.result).get("A part of the vehicle in view")
    assert (said is not None) == warned
    if said is not None:
        assert "stayed within 0.5 px in both images, around (u, v) = (" in said
        assert said.endswith("Mask it: --mask-left.")
    assert fixed_warning(FixedFeatures(40_000, 39, (0.0, 0.0), (1.0, 1.0))) is None
    assert fixed_warning(FixedFeatures(100, 29, (0.0, 0.0), (1.0, 1.0))) is None


@pytest.mark.parametrize(
    ("steps", "warned"),
    [
        (StepsAtRest(39, 37, 9_000, 2_200), True),
        (StepsAtRest(39, 37, 9_000, 4), False),  # rest
        (StepsAtRest(39, 18, 3_000, 1_000), False),  # waiting
        (StepsAtRest(0, 0, 0, 0), False),
        (None, False),
    ],
)
def test_a_path_at_rest_in_a_scene_that_moves_is_warned_of(
    steps: StepsAtRest | None, warned: bool
) -> None:
    said = rest_warning(steps)
    assert (said is not None) == warned
    if said is not None:
        assert said.startswith("The path stands still in 37 of 39 steps, in which 24 % of")


def test_a_vehicle_that_fills_the_view_is_warned_of(tmp_path: Path) -> None:
    """It has five times as many features as the scene, whose motion is found none the less."""
    rng = np.random.default_rng(6)
    fixed_px = random_pixels(rng, 300, (2.0, 4.0))
    path = _write_features(tmp_path, drive(rng, 8, points=60), fixed_px)
    run = run_sequence(pv.open_sequence(path), {}, tmp_path / "out")
    assert 8.3 < np.linalg.norm(run.result.T_world_cam[-1, :3, 3]) < 8.5
    fixed = run.result.fixed_features
    assert fixed is not None
    assert fixed.share > 0.7
    assert "A part of the vehicle in view" in run_warnings(run.result)


def _write_features(folder: Path, frames: list[pv.Frame], fixed_px: FloatArray) -> Path:
    """Write a tracks file of the features of frames, and of others that stay where they are but for
    noise, [M, 4], px."""
    rng = np.random.default_rng(7)
    rows = []
    for frame in frames:
        features = frame.features
        assert features is not None
        fixed = fixed_px + 0.1 * rng.normal(size=fixed_px.shape)
        ids = np.r_[features.ids, 10_000 + np.arange(len(fixed))]
        pixels = np.vstack([features.pixels, fixed])
        rows.append(np.column_stack([np.full(len(ids), frame.index), ids, pixels]))
    table = np.concatenate(rows)
    intrinsics = [CAMERA.fu_px, CAMERA.fv_px, CAMERA.cu_px, CAMERA.cv_px, CAMERA.baseline_m]
    return write_tracks(
        folder,
        len(frames),
        frame=table[:, 0].astype(np.int32),
        track=table[:, 1].astype(np.int32),
        uv=table[:, 2:].astype(np.float32),
        camera=np.array(intrinsics),
        omega=None,
        C_cam_imu=None,
        p_imu_cam=None,
        velocity=None,
        T_world_cam=None,
    )


@pytest.mark.parametrize(
    ("log_ratio", "sigma", "warned"),
    [
        (-0.05, 0.004, True),
        (-0.05, 0.006, False),
        (-0.045, 0.015, False),  # found after 15 frames of KITTI, whose focal length is right
        (0.03, 0.001, False),
        (0.0, 0.001, False),
    ],
)
def test_a_focal_length_is_warned_of_beyond_chance_and_lenses(
    log_ratio: float, sigma: float, warned: bool
) -> None:
    text = focal_warning(FocalLengthError(log_ratio, sigma))
    assert (text is not None) == warned
    if text is not None:
        assert "4.9 ± 0.4 % shorter than calibrated" in text
    assert focal_warning(None) is None
