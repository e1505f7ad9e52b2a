"""The prediction space: its columns in order, and what a recording or a step lacks."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from predictors.steps import COUNT, IMAGE, IMU, STEP, own, ramp
from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.predictors import (
    PREDICTORS,
    Needs,
    PredictionSpace,
    Step,
    prediction_space,
)
from probevo.sequences.frame import Frame, ImuSamples, StereoFeatures
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.tracking.tracks import Tracks
from training.supervised_drives import recording
from worlds import CAMERA, FORWARD


@pytest.mark.parametrize("name", PREDICTORS)
def test_every_predictor_fills_its_columns(name: str) -> None:
    """[N, C], finite unless it says where it is not; and [0, C] without features."""
    space = prediction_space([name])
    assert space.names == (name,)
    phi = space(STEP)
    assert phi.shape == (COUNT, len(space.columns))
    assert phi.dtype == np.float64
    assert np.isfinite(phi[:, ~np.array(space.may_be_undefined)]).all()
    nothing = replace(STEP, tracks=Tracks.none())
    assert space(nothing).shape == (0, len(space.columns))


def test_columns_stand_in_the_order_of_their_predictors() -> None:
    names = ["row_offset", "place", "disparity"]
    space = prediction_space(names)
    assert space.columns == ("row_offset", "x", "y", "disparity")
    one_by_one = [prediction_space([name])(STEP) for name in names]
    np.testing.assert_array_equal(space(STEP), np.hstack(one_by_one))
    assert prediction_space(names[::-1]).columns == ("disparity", "x", "y", "row_offset")


def test_a_predictor_may_have_several_columns() -> None:
    pair = own(
        "pair",
        lambda step: np.column_stack([ramp(step), -ramp(step)]),
        "a",
        "b",
        undefined="nowhere",
    )
    space = PredictionSpace((own("ramp", ramp), pair))
    assert space.columns == ("ramp", "a", "b")
    assert space.may_be_undefined == (False, True, True)
    np.testing.assert_array_equal(space(STEP), np.arange(float(COUNT))[:, None] * [1.0, 1.0, -1.0])


def test_the_empty_space_has_no_columns() -> None:
    space = prediction_space([])
    assert space.names == ()
    assert space.columns == ()
    assert space.may_be_undefined == ()
    assert not space.depends_on_previous_motion
    assert space(STEP).shape == (COUNT, 0)


def test_a_predictor_named_twice_is_refused() -> None:
    """A column that counts twice has twice the weight, and no model could tell which is which."""
    with pytest.raises(InputError, match="place"):
        prediction_space(["place", "disparity", "place"])


def test_only_the_last_residual_depends_on_previous_motion() -> None:
    """The flow, too, is that of a prediction from previous motions, but no residual at them."""
    depending = [name for name in PREDICTORS if PREDICTORS[name].depends_on_previous_motion]
    assert depending == ["last_residual"]
    assert prediction_space(["place", "last_residual"]).depends_on_previous_motion
    assert not prediction_space(["place", "velocity"]).depends_on_previous_motion


NO_IMAGES_BEFORE = replace(STEP.prev_frame, left=None, right=None)
NO_IMAGES_NOW = replace(STEP.curr_frame, left=None, right=None)
NO_ACCELEROMETER = ImuSamples(IMU.stamps_ns, IMU.gyro_rad_s, np.full((21, 3), np.nan))


@pytest.mark.parametrize(
    ("name", "step", "lacking"),
    [
        ("blur", replace(STEP, curr_frame=NO_IMAGES_NOW), "images"),
        ("structure", replace(STEP, curr_frame=NO_IMAGES_NOW), "images"),
        ("forward_backward", replace(STEP, prev_frame=NO_IMAGES_BEFORE), "images"),
        (
            "acceleration",
            replace(STEP, curr_frame=replace(STEP.curr_frame, imu=NO_ACCELEROMETER)),
            "accelerometer",
        ),
    ],
)
def test_what_a_frame_lacks_is_said(name: str, step: Step, lacking: str) -> None:
    with pytest.raises(InputError) as caught:
        prediction_space(["place", name])(step)
    assert str(caught.value).startswith(
        f"frame 1: it has no {lacking}, which the predictor {name} needs."
    )
    assert "--predictors" in caught.value.cure


@pytest.mark.parametrize(
    ("need", "image", "step"),
    [
        (Needs.LEFT, "left", replace(STEP, curr_frame=replace(STEP.curr_frame, left=None))),
        (Needs.RIGHT, "right", replace(STEP, curr_frame=replace(STEP.curr_frame, right=None))),
        (
            Needs.PREVIOUS_LEFT,
            "previous_left",
            replace(STEP, prev_frame=replace(STEP.prev_frame, left=None)),
        ),
        (
            Needs.PREVIOUS_RIGHT,
            "previous_right",
            replace(STEP, prev_frame=replace(STEP.prev_frame, right=None)),
        ),
    ],
)
def test_a_step_has_each_of_the_four_images_that_a_predictor_needs(
    need: Needs, image: str, step: Step
) -> None:
    """A predictor of one image is refused without it, and by the recording without any."""
    predictor = own("mean", lambda step: ramp(step) + getattr(step, image).mean(), needs=need)
    space = PredictionSpace((predictor,))
    assert space(STEP)[0, 0] == IMAGE.mean()
    assert getattr(step, image).shape == (0, 0)
    with pytest.raises(InputError, match=r"frame 1: it has no images, which the predictor mean"):
        space(step)
    tracks = replace(recording(None), camera=replace(CAMERA, size_px=None))
    with pytest.raises(InputError, match=r"drive: it has no images, which the predictor mean"):
        space.check_recording(tracks)
    assert need in Needs.IMAGES


def test_each_image_is_its_own() -> None:
    """Current and previous, left and right are not mixed up."""
    images = [np.full((2, 3), grey, np.uint8) for grey in range(4)]
    step = replace(
        STEP,
        prev_frame=Frame(0, 0, images[0], right=images[1]),
        curr_frame=Frame(1, 1, images[2], right=images[3]),
    )
    assert step.previous_left is images[0]
    assert step.previous_right is images[1]
    assert step.left is images[2]
    assert step.right is images[3]


def test_where_the_imu_s_samples_are_missing_the_acceleration_is_undefined() -> None:
    """A gap of the IMU is no reason to stop."""
    space = prediction_space(["acceleration", "place"])
    phi = space(replace(STEP, curr_frame=replace(STEP.curr_frame, imu=None)))
    np.testing.assert_array_equal(np.isnan(phi), np.tile([True, True, False, False], (len(phi), 1)))
    assert space.may_be_undefined == (True, True, False, False)


@pytest.mark.parametrize("num_finite", [1, 20])
def test_single_samples_without_a_force_are_no_missing_accelerometer(num_finite: int) -> None:
    """As long as one is finite on all axes: one axis of each sample is not enough."""
    accel_m_s2 = IMU.accel_m_s2.copy()
    accel_m_s2[num_finite:, 1] = np.nan
    frame = replace(STEP.curr_frame, imu=replace(IMU, accel_m_s2=accel_m_s2))
    space = prediction_space(["acceleration"])
    np.testing.assert_allclose(space(replace(STEP, curr_frame=frame)), 0.0, atol=1e-9)
    accel_m_s2[:, 1] = np.nan
    with pytest.raises(InputError, match="frame 1: it has no accelerometer"):
        space(replace(STEP, curr_frame=frame))


@pytest.mark.parametrize(
    ("name", "lacking"), [("blur", "images"), ("acceleration", "accelerometer")]
)
def test_a_recording_is_refused_for_what_it_lacks_before_anything_runs(
    name: str, lacking: str
) -> None:
    tracks = replace(recording(None), camera=replace(CAMERA, size_px=None))
    prediction_space(["place", "turn_rate"]).check_recording(tracks)
    with pytest.raises(InputError) as caught:
        prediction_space(["place", name]).check_recording(tracks)
    assert str(caught.value).startswith(
        f"drive: it has no {lacking}, which the predictor {name} needs."
    )
    assert "--predictors" in caught.value.cure


def test_a_recording_with_images_and_imu_has_all_that_predictors_need() -> None:
    whole = replace(
        recording(None),
        camera=replace(CAMERA, size_px=(1226, 370)),
        imu=ImuCalibration(np.eye(4), 1e-4, 1e-3),
    )
    prediction_space(list(PREDICTORS)).check_recording(whole)


def test_the_previous_image_is_needed_only_by_predictors_that_look_at_it() -> None:
    step = replace(STEP, prev_frame=NO_IMAGES_BEFORE)
    assert np.isfinite(prediction_space(["structure"])(step)).any()


def test_tracks_without_images_and_imu_are_enough_for_predictors_of_tracks() -> None:
    names = [name for name, predictor in PREDICTORS.items() if predictor.needs is Needs.TRACKS]
    assert {"place", "disparity", "flow", "residual_flow", "row_offset", "age", "turn_rate"} <= set(
        names
    )
    space = prediction_space(names)
    step = Step(
        tracks=STEP.tracks,
        camera=CAMERA,
        predicted_T_curr_prev=FORWARD,
        prev_frame=NO_IMAGES_BEFORE,
        curr_frame=replace(NO_IMAGES_NOW, imu=None),
    )
    assert space(step).shape == (COUNT, len(space.columns))


def test_the_time_between_the_frames() -> None:
    assert STEP.duration_s == pytest.approx(0.1)
    frames = [Frame(k, 1_400_000_000_123_456_789 + k) for k in range(3)]
    for previous, current in pairwise(frames):
        step = replace(STEP, prev_frame=previous, curr_frame=current)
        assert step.duration_s == pytest.approx(1e-9)


@pytest.mark.parametrize("values", [np.zeros((2, COUNT)), np.zeros(COUNT), np.zeros((COUNT, 3))])
def test_an_array_of_another_shape_is_refused(values: FloatArray) -> None:
    """Transposed, it would have as many numbers, in the wrong places."""
    pair = own("pair", lambda step: values, "a", "b")
    with pytest.raises(InputError, match=rf"predictor pair: [\s\S]*Return \[{COUNT}, 2\]"):
        PredictionSpace((pair,))(STEP)


@pytest.mark.parametrize("name", ["window_difference", "alignment"])
def test_features_of_another_front_end_have_no_alignment_even_with_images(name: str) -> None:
    """It would be NaN where none may be."""
    given = StereoFeatures(STEP.tracks.ids, STEP.tracks.curr_px)
    step = replace(STEP, curr_frame=replace(STEP.curr_frame, features=given))
    with pytest.raises(InputError, match=f"no features of our own front end, .* {name} needs"):
        prediction_space(["place", name])(step)
    prediction_space(["place", "structure"])(step)
