"""The prediction space: its columns in order, what a recording lacks, and the space that a model's
columns ask for."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.predictors import (
    PREDICTORS,
    Needs,
    PredictionSpace,
    Predictor,
    Step,
    prediction_space,
    space_for,
)
from probevo.sequences.frame import Frame, ImuSamples
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.tracking.tracks import Tracks
from training.supervised_drives import recording
from worlds import CAMERA, FORWARD, FRAME_NS, seen_twice

COUNT = 20
IMAGE = np.random.default_rng(0).integers(0, 256, (370, 1226), dtype=np.uint8)
IMU = ImuSamples(
    np.arange(0, FRAME_NS + 1, FRAME_NS // 20),
    np.zeros((21, 3)),
    np.tile([0.0, -9.81, 0.0], (21, 1)),
)
STEP = Step(
    tracks=replace(seen_twice(np.random.default_rng(1), COUNT), difference=np.ones((COUNT, 2))),
    camera=CAMERA,
    expected=FORWARD,
    before=Frame(0, 0, IMAGE, right=IMAGE),
    now=Frame(1, FRAME_NS, IMAGE, right=IMAGE, imu=IMU),
)


def own(
    name: str, compute: Callable[[Step], FloatArray], *columns: str, undefined: str = ""
) -> Predictor:
    return Predictor(
        name,
        dict.fromkeys(columns or (name,), "1"),
        "test",
        needs=Needs.TRACKS,
        compute=compute,
        undefined=undefined,
    )


def ramp(step: Step) -> FloatArray:
    return np.arange(float(len(step.tracks)))


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


def test_no_two_predictors_share_a_column() -> None:
    """A model knows its predictors by their columns alone."""
    columns = [column for predictor in PREDICTORS.values() for column in predictor.columns]
    assert len(set(columns)) == len(columns)
    assert list(PREDICTORS) == [predictor.name for predictor in PREDICTORS.values()]


def test_columns_stand_in_the_order_of_their_predictors() -> None:
    names = ["row_offset", "place", "disparity"]
    space = prediction_space(names)
    assert space.columns == ("row_offset", "x", "y", "disparity")
    alone = [prediction_space([name])(STEP) for name in names]
    np.testing.assert_array_equal(space(STEP), np.hstack(alone))
    assert prediction_space(names[::-1]).columns == ("disparity", "x", "y", "row_offset")


def test_one_column_may_be_a_vector() -> None:
    pair = own(
        "pair",
        lambda step: np.column_stack([ramp(step), -ramp(step)]),
        "a",
        "b",
        undefined="nowhere",
    )
    space = PredictionSpace((own("ramp", ramp), pair))
    assert (space.columns, space.may_be_undefined) == (("ramp", "a", "b"), (False, True, True))
    np.testing.assert_array_equal(space(STEP), np.arange(float(COUNT))[:, None] * [1.0, 1.0, -1.0])


def test_the_empty_space_has_no_columns() -> None:
    space = prediction_space([])
    assert (space.names, space.columns, space.may_be_undefined) == ((), (), ())
    assert space(STEP).shape == (COUNT, 0)


@pytest.mark.parametrize("names", [["blurr"], ["blur", "speed", "place"], [""]])
def test_an_unknown_predictor_is_named(names: list[str]) -> None:
    with pytest.raises(InputError) as caught:
        prediction_space(names)
    unknown = next(name for name in names if name not in PREDICTORS)
    assert str(caught.value).startswith(f"--predictors: {unknown} is not known.")
    cure = "Did you mean blur?" if unknown == "blurr" else "Known are acceleration, turn_rate, blur"
    assert cure in caught.value.cure


def test_a_predictor_named_twice_is_refused() -> None:
    """A column that counts twice is a column of twice the weight, and no model could tell which is
    which."""
    with pytest.raises(InputError, match="place"):
        prediction_space(["place", "disparity", "place"])


NO_IMAGES = (replace(STEP.before, left=None, right=None), replace(STEP.now, left=None, right=None))
NO_ACCELEROMETER = ImuSamples(IMU.stamps_ns, IMU.gyro_rad_s, np.full((21, 3), np.nan))


@pytest.mark.parametrize(
    ("name", "step", "lacking"),
    [
        ("blur", replace(STEP, now=NO_IMAGES[1]), "images"),
        ("structure", replace(STEP, now=NO_IMAGES[1]), "images"),
        ("forward_backward", replace(STEP, before=NO_IMAGES[0]), "images"),
        (
            "acceleration",
            replace(STEP, now=replace(STEP.now, imu=NO_ACCELEROMETER)),
            "accelerometer",
        ),
    ],
)
def test_what_a_recording_lacks_is_said(name: str, step: Step, lacking: str) -> None:
    with pytest.raises(InputError) as caught:
        prediction_space(["place", name])(step)
    assert str(caught.value).startswith(
        f"frame 1: it has no {lacking}, which the predictor {name} needs."
    )
    assert "--predictors" in caught.value.cure


def test_where_the_imu_s_samples_are_missing_the_acceleration_is_undefined() -> None:
    """A gap of the IMU is no reason to stop."""
    space = prediction_space(["acceleration", "place"])
    phi = space(replace(STEP, now=replace(STEP.now, imu=None)))
    np.testing.assert_array_equal(np.isnan(phi), np.tile([True, True, False, False], (len(phi), 1)))
    assert space.may_be_undefined == (True, True, False, False)


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


def test_the_image_before_is_needed_by_those_alone_that_look_at_it() -> None:
    step = replace(STEP, before=NO_IMAGES[0])
    assert np.isfinite(prediction_space(["structure"])(step)).any()


def test_tracks_without_images_and_imu_have_what_tracks_tell() -> None:
    names = [name for name, predictor in PREDICTORS.items() if predictor.needs is Needs.TRACKS]
    space = prediction_space(names)
    step = Step(
        STEP.tracks, CAMERA, FORWARD, before=NO_IMAGES[0], now=replace(NO_IMAGES[1], imu=None)
    )
    assert {"place", "disparity", "flow", "residual_flow", "row_offset", "age", "turn_rate"} <= set(
        names
    )
    assert space(step).shape == (COUNT, len(space.columns))


@pytest.mark.parametrize(
    "names", [["blur"], ["disparity", "place", "acceleration"], list(PREDICTORS), []]
)
def test_the_space_of_a_model_is_found_by_its_columns(names: list[str]) -> None:
    space = prediction_space(names)
    found = space_for(space.columns)
    assert (found.names, found.columns) == (tuple(names), space.columns)


def test_a_given_space_with_the_right_columns_is_taken() -> None:
    space = PredictionSpace((own("ramp", ramp), *prediction_space(["place"]).predictors))
    assert space_for(("ramp", "x", "y"), space) is space


def test_a_model_that_needs_no_columns_takes_any_space() -> None:
    space = prediction_space(["place"])
    assert space_for((), space) is space
    assert space_for(()).columns == ()


def test_a_column_of_nobody_needs_its_predictor() -> None:
    with pytest.raises(InputError) as caught:
        space_for(("x", "y", "ramp"))
    assert "noise model: its predictor ramp is not known." in str(caught.value)
    assert "StereoOdometry" in caught.value.cure


@pytest.mark.parametrize(
    "columns",
    [("y", "x"), ("x",), ("x", "y", "x"), ("x", "disparity", "y"), ("turn_rate",), ("vibration",)],
)
def test_columns_that_no_order_of_predictors_gives_are_refused(columns: tuple[str, ...]) -> None:
    """Half a predictor, or its columns swapped."""
    with pytest.raises(InputError, match=f"trained on {', '.join(columns)}, in this order"):
        space_for(columns)


@pytest.mark.parametrize(
    "names", [["disparity", "place"], ["place"], ["place", "disparity", "age"], []]
)
def test_a_given_space_with_other_columns_is_refused(names: list[str]) -> None:
    given = prediction_space(names)
    with pytest.raises(InputError) as caught:
        space_for(("x", "y", "disparity"), given)
    gets = ", ".join(given.columns) or "none"
    assert f"it was trained on x, y, disparity, in this order, but gets {gets}." in str(
        caught.value
    )
    assert "Give it the predictors that it was trained with, in their order." in str(caught.value)


def test_the_time_between_the_frames() -> None:
    assert STEP.duration_s == pytest.approx(0.1)
    stamps = [Frame(k, 1_400_000_000_123_456_789 + k) for k in range(3)]
    for before, now in pairwise(stamps):
        assert replace(STEP, before=before, now=now).duration_s == pytest.approx(1e-9)
