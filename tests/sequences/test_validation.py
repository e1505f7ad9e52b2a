"""Frames as users hand them in: converted, freed of what is unusable, or refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import probevo as pv
from probevo.arrays import AnyArray
from probevo.errors import InputError
from probevo.sequences.frame import Frame, ImuSamples, StereoFeatures
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.missing_data import Defect, MissingData
from probevo.sequences.validation import (
    MAX_FORCE_M_S2,
    MAX_PIXEL_PX,
    MAX_RATE_RAD_S,
    usable_imu,
    validated,
)
from worlds import CAMERA, FRAME_NS, START_NS, drive

IMU = ImuCalibration(np.eye(4), 2e-4, 0.01)


def samples(stamp_ns: int = START_NS + FRAME_NS) -> ImuSamples:
    """Return the samples of an IMU at rest, from one frame to the one at ``stamp_ns``."""
    stamps_ns = np.arange(stamp_ns - FRAME_NS, stamp_ns + 1, FRAME_NS // 10)
    still = np.zeros((len(stamps_ns), 3))
    return ImuSamples(stamps_ns, still, accel_m_s2=still - np.array([0.0, 9.81, 0.0]))


def frame(**changes: Any) -> Frame:
    """Return a frame of features with IMU samples."""
    features = StereoFeatures(np.arange(20), np.random.default_rng(0).uniform(0, 300, (20, 4)))
    return replace(Frame(1, START_NS + FRAME_NS, features=features, imu=samples()), **changes)


def with_value(array: AnyArray, index: Any, value: float) -> AnyArray:
    changed = array.copy()
    changed[index] = value
    return changed


@pytest.mark.parametrize("dtype", [np.int64, np.int16, np.uint8, np.float32, np.longdouble])
def test_pixels_of_any_type_give_the_motions_of_float64(dtype: type) -> None:
    frames = drive(np.random.default_rng(0), 4, points=60)
    odometries = [pv.StereoOdometry(CAMERA) for _ in range(2)]
    for each in frames:
        assert each.features is not None
        pixels = np.clip(np.round(each.features.pixels), 0, 255)
        both = (pixels.astype(dtype), pixels)
        motions = [
            odometry.step(replace(each, features=StereoFeatures(each.features.ids, kind)))
            for odometry, kind in zip(odometries, both, strict=True)
        ]
        np.testing.assert_array_equal(motions[0].T_curr_prev, motions[1].T_curr_prev)


@pytest.mark.parametrize("dtype", [np.uint64, np.int32, np.uint8])
def test_identities_of_any_whole_type_are_taken(dtype: type) -> None:
    features = frame().features
    assert features is not None
    given = replace(features, ids=features.ids.astype(dtype))
    found = validated(frame(features=given), CAMERA, None)[0].features
    assert found is not None
    assert found.ids.dtype == np.int64


IMU_CHANGES: dict[str, tuple[dict[str, Any], str]] = {
    "accelerometer None": ({"accel_m_s2": None}, "IMU accel_m_s2 are missing"),
    "accelerometer empty": ({"accel_m_s2": np.zeros((0, 3))}, r"specific forces of shape \(0, 3\)"),
    "stamps float": ({"stamps_ns": samples().stamps_ns.astype(float)}, "IMU stamps_ns are of type"),
    "stamps too large": (
        {"stamps_ns": samples().stamps_ns.astype(np.uint64) + np.uint64(2**63)},
        "does not fit in 64 bits",
    ),
    "rates complex": ({"gyro_rad_s": samples().gyro_rad_s * 1j}, "IMU gyro_rad_s are of type comp"),
    "rates of words": ({"gyro_rad_s": [["a"] * 3] * 11}, "IMU gyro_rad_s are of type <U1"),
    "rates ragged": ({"gyro_rad_s": [[1.0], [1.0, 2.0]]}, "IMU gyro_rad_s are not an array"),
}


@pytest.mark.parametrize("case", IMU_CHANGES)
def test_imu_samples_of_a_wrong_kind_are_refused(case: str) -> None:
    changes, what = IMU_CHANGES[case]
    given = frame(imu=replace(samples(), **changes))
    with pytest.raises(InputError, match=f"frame 1: .*{what}"):
        validated(given, CAMERA, None)
    usable_imu(given)  # raises nothing


def test_unsigned_stamps_of_the_imu_are_compared_as_signed_ones() -> None:
    stamps_ns = samples().stamps_ns[::-1].astype(np.uint64)
    with pytest.raises(InputError, match="not in the order of their times"):
        validated(frame(imu=replace(samples(), stamps_ns=stamps_ns)), CAMERA, None)


def test_a_sample_that_a_driver_gives_twice_counts_once() -> None:
    once = samples()
    rows = np.insert(np.arange(11), 4, 3)
    twice = ImuSamples(once.stamps_ns[rows], once.gyro_rad_s[rows], once.accel_m_s2[rows])
    usable, missing = validated(frame(imu=twice), CAMERA, None)
    assert usable.imu is not None
    np.testing.assert_array_equal(usable.imu.stamps_ns, once.stamps_ns)
    assert missing == (MissingData(Defect.STAMP_REPEATED, 1, 12),)
    assert str(missing[0]) == "1 of 12 IMU samples with the stamp of the sample before"
    refused = usable_imu(frame(imu=twice, stamp_ns=None))
    assert refused is not None
    np.testing.assert_array_equal(refused.stamps_ns, once.stamps_ns)


def test_stamps_of_numpy_do_not_overflow() -> None:
    first = frame(index=np.int64(0), stamp_ns=np.int64(-(2**62)), imu=None)
    second = frame(index=np.int64(1), stamp_ns=np.int64(2**62 + 2**61), imu=None)
    prev, _ = validated(first, CAMERA, None)
    curr, _ = validated(second, CAMERA, prev)
    assert curr.stamp_ns - prev.stamp_ns == 2**63 + 2**61


@pytest.mark.parametrize(
    ("unit_ns", "cure"),
    [
        (1_000, r"Are these microseconds\? Multiply them by 1,000"),
        (1_000_000, r"Are these milliseconds\? Multiply them by 1,000,000"),
        (1_000_000_000, r"if the camera's stamps have jumped(.|\n)*nanoseconds, not seconds"),
    ],
)
def test_stamps_of_another_unit_are_refused(unit_ns: int, cure: str) -> None:
    """In whole seconds, frames have equal stamps."""
    first = frame(index=0, stamp_ns=START_NS // unit_ns, imu=None)
    second = frame(stamp_ns=(START_NS + FRAME_NS) // unit_ns, imu=None)
    with pytest.raises(InputError, match=rf"(?i){cure}"):
        validated(second, CAMERA, first)


@pytest.mark.parametrize(
    ("start_ns", "step_ns"), [(0, 1_000_000), (1_700_000_000_000_000_000, 100_000)]
)
def test_fast_cameras_and_stamps_of_arrival_are_taken(start_ns: int, step_ns: int) -> None:
    """A camera of 1 kHz; and images that arrive nearly at once, whose stamps since 1970 can be in
    no other unit."""
    first = frame(index=0, stamp_ns=start_ns, imu=None)
    validated(frame(stamp_ns=start_ns + step_ns, imu=None), CAMERA, first)


FRAME_CHANGES: dict[str, tuple[dict[str, Any], str]] = {
    "index float": ({"index": 1.0}, r"its index is 1\.0"),
    "index of the frame before": ({"index": 0}, "its index, 0, is not after that of the frame"),
    "index beyond 64 bits": ({"index": 2**70}, "its index is too large"),
    "image of lists": ({"left": [[0, 1], [2, 3]]}, "its left image is .*0, 1"),
    "image by its name": ({"left": "left/0.png"}, "its left image is 'left/0.png'"),
    "identity without an array": (
        {"features": StereoFeatures(np.array(1), np.ones((1, 4)))},
        r"its feature ids have shape \(\)",
    ),
    "index None": ({"index": None}, "its index is None"),
    "stamp 2⁶³": ({"stamp_ns": 2**63}, "its stamp, 9223372036854775808 ns, does not fit"),
    "stamp −2⁶⁴": ({"stamp_ns": -(2**64)}, "does not fit in 64 bits"),
    "stamp unsigned": ({"stamp_ns": np.uint64(2**63)}, "does not fit in 64 bits"),
    "stamp without end": ({"stamp_ns": 10**4000}, "does not fit in 64 bits"),
    "identities float": (
        {"features": StereoFeatures(np.arange(2.0), np.ones((2, 4)))},  # type: ignore[arg-type]
        "its feature ids are of type float64",
    ),
    "features of two arrays": (
        {"features": (np.arange(2), np.ones((2, 4)))},
        r"argument features is a tuple\.\n *Give features=StereoFeatures\(ids, pixels\)\.",
    ),
    "IMU of three arrays": (
        {"imu": (np.arange(2), np.ones((2, 3)), np.ones((2, 3)))},
        r"argument imu is a tuple\.\n *Give imu=ImuSamples\(stamps_ns, gyro_rad_s, accel_m_s2\)\.",
    ),
    "pixels None": (
        {"features": StereoFeatures(np.arange(2), None)},  # type: ignore[arg-type]
        "its feature pixels are missing",
    ),
}


@pytest.mark.parametrize("case", FRAME_CHANGES)
def test_a_frame_of_a_wrong_kind_is_refused_and_the_next_is_not(case: str) -> None:
    changes, what = FRAME_CHANGES[case]
    odometry = pv.StereoOdometry(CAMERA, imu=IMU)
    odometry.step(replace(frame(imu=None), index=0, stamp_ns=START_NS))
    with pytest.raises(InputError, match=what):
        odometry.step(frame(**changes))
    odometry.step(frame())


def test_a_camera_whose_stamps_have_jumped_goes_on_with_a_new_odometry() -> None:
    """One stamp that is an hour ahead ends the first one: no later frame can follow it."""
    frames = drive(np.random.default_rng(0), 6)
    frames[3] = replace(frames[3], stamp_ns=frames[3].stamp_ns + 3600 * 10**9)
    odometry = pv.StereoOdometry(CAMERA)
    assert [odometry.step(each).status for each in frames[:4]][-1] is pv.Status.GAP
    for each in frames[4:]:
        with pytest.raises(InputError, match=r"not after .*\n.*start a new odometry from this"):
            odometry.step(each)
    after = pv.StereoOdometry(CAMERA)
    assert after.step(frames[4]).status is pv.Status.FIRST
    assert after.step(frames[5]).status is pv.Status.OK


@pytest.mark.parametrize("given", [None, np.zeros((375, 1242), np.uint8), (1, 2)])
def test_what_is_no_frame_is_refused(given: Any) -> None:
    """As of a reader who hands in the left image."""
    odometry = pv.StereoOdometry(CAMERA)
    with pytest.raises(pv.InputError, match=r"^frame: is a \w+\.\n *Give a Frame"):
        odometry.step(given)
    with pv.LiveOdometry(odometry) as live:
        with pytest.raises(pv.InputError, match=r"^frame: is "):
            live.push(given)
        assert live.num_refused == 1


@pytest.mark.parametrize("rate", [np.nan, np.inf, 1e300, -1e18, 1.001 * MAX_RATE_RAD_S])
def test_an_implausible_angular_rate_is_a_missing_sample(rate: float) -> None:
    imu = replace(samples(), gyro_rad_s=with_value(samples().gyro_rad_s, (3, 1), rate))
    found, missing = validated(frame(imu=imu), CAMERA, None)
    assert found.imu is not None
    np.testing.assert_array_equal(found.imu.stamps_ns, np.delete(imu.stamps_ns, 3))
    defect = Defect.RATE_TOO_LARGE if np.isfinite(rate) else Defect.RATE_NOT_FINITE
    assert missing == (MissingData(defect, 1, 11),)
    kept = usable_imu(frame(imu=imu))
    assert kept is not None
    np.testing.assert_array_equal(kept.stamps_ns, found.imu.stamps_ns)


@pytest.mark.parametrize("force", [np.inf, 1e300, -1.001 * MAX_FORCE_M_S2])
def test_an_implausible_force_is_not_recorded(force: float) -> None:
    imu = replace(samples(), accel_m_s2=with_value(samples().accel_m_s2, (3, 1), force))
    found, missing = validated(frame(imu=imu), CAMERA, None)
    assert found.imu is not None
    assert np.isnan(found.imu.accel_m_s2[3]).all()
    assert np.isfinite(np.delete(found.imu.accel_m_s2, 3, axis=0)).all()
    defect = Defect.FORCE_TOO_LARGE if np.isfinite(force) else Defect.FORCE_NOT_FINITE
    assert missing == (MissingData(defect, 1, 11),)


@pytest.mark.parametrize("rate", [1e300, 1e18, 1e5])
def test_one_implausible_rate_does_no_harm(rate: float) -> None:
    """Before, the motion was NaN, and the trajectory could not be written."""
    frames = drive(np.random.default_rng(0), 6)
    odometry = pv.StereoOdometry(CAMERA, imu=IMU)
    for each in frames:
        imu = samples(each.stamp_ns)
        if each.index == 3:
            imu = replace(imu, gyro_rad_s=with_value(imu.gyro_rad_s, (5, 0), rate))
        motion = odometry.step(replace(each, imu=imu))
        assert np.isfinite(motion.T_world_cam).all()
        assert np.isfinite(motion.cov).all()


@pytest.mark.parametrize("column", range(4))
@pytest.mark.parametrize("pixel", [np.nan, -np.inf, 1e200, -1e300, 1.001 * MAX_PIXEL_PX])
def test_an_implausible_feature_is_left_out(column: int, pixel: float) -> None:
    """Before, all later steps were degenerate."""
    frames = drive(np.random.default_rng(0), 6)
    odometry = pv.StereoOdometry(CAMERA)
    for each in frames:
        assert each.features is not None
        if each.index == 2:
            pixels = with_value(each.features.pixels, (7, column), pixel)
            each = replace(each, features=replace(each.features, pixels=pixels))
        motion = odometry.step(each)
        assert motion.status is (pv.Status.FIRST if each.index == 0 else pv.Status.OK)
        defect = Defect.PIXEL_TOO_LARGE if np.isfinite(pixel) else Defect.PIXEL_NOT_FINITE
        expected = MissingData(defect, 1, len(each.features.ids))
        assert motion.missing == ((expected,) if each.index == 2 else ())


@pytest.mark.parametrize("column", range(4))
def test_a_feature_just_within_the_bound_does_no_harm(column: int) -> None:
    frames = drive(np.random.default_rng(0), 6)
    odometry = pv.StereoOdometry(CAMERA)
    for each in frames:
        assert each.features is not None
        if each.index == 2:
            pixels = with_value(each.features.pixels, (7, column), MAX_PIXEL_PX)
            each = replace(each, features=replace(each.features, pixels=pixels))
        assert odometry.step(each).status in (pv.Status.FIRST, pv.Status.OK)


def test_samples_of_a_frame_with_faulty_features_go_on() -> None:
    samples = ImuSamples(np.array([0, 10**8]), np.ones((2, 3)), np.ones((2, 3)))
    features = StereoFeatures(np.zeros(2), np.zeros((2, 4)))  # identities are no floats
    assert usable_imu(Frame(1, 10**8, features=features, imu=samples)) is not None
