"""Validation of frames before a step: faulty ones are refused, unusable samples are left out."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.sequences.frame import Frame, ImuSamples, StereoFeatures
from probevo.sequences.frame_checks import check_frame, check_order
from probevo.sequences.gyro_spikes import find_spikes
from probevo.sequences.imu import ImuStream
from probevo.sequences.missing_data import Defect, MissingData
from probevo.sequences.text import INT64_LIMIT

MAX_RATE_RAD_S = 2e3
"""Largest plausible angular rate: 30 times the range of the fastest MEMS gyros, 4000 °/s."""
MAX_FORCE_M_S2 = 1e6
"""Largest plausible specific force: ten times the range of accelerometers for shocks, 10⁴ g."""
MAX_PIXEL_PX = 1e6
"""Largest plausible coordinate of a feature: ten times the width of the largest images."""


def validated(
    frame: Frame, camera: StereoCamera, prev_frame: Frame | None
) -> tuple[Frame, tuple[MissingData, ...]]:
    """Check a frame, and leave out its unusable features and IMU samples.

    Features and angular rates that are not finite or implausibly large are left out, and so are
    spikes of the angular rate, and IMU samples that repeat the stamp of the one before. Whether the
    remaining samples still cover the interval is checked when the gyro is integrated. A sample with
    an unusable specific force keeps its angular rate.

    Args:
        frame: the frame as given.
        camera: the camera that it has to match.
        prev_frame: the previous frame, if there is one.

    Returns:
        The usable frame, and what was left out of it.

    Raises:
        InputError: the frame cannot be used at all; see ``with_plain_arrays``, ``check_frame`` and
            ``check_order``.
    """
    frame = with_plain_arrays(frame)
    missing: list[MissingData] = []
    imu = frame.imu
    if imu is not None and _has_rows(imu):
        is_repeated = _repeats_stamp(imu)
        if is_repeated.any():
            count = int(is_repeated.sum())
            missing.append(MissingData(Defect.STAMP_REPEATED, count, len(is_repeated)))
            imu = _kept(imu, ~is_repeated)
        has_gyro = are_within(imu.gyro_rad_s, MAX_RATE_RAD_S)
        if not has_gyro.all():
            missing += _left_out(
                imu.gyro_rad_s,
                usable=has_gyro,
                not_finite=Defect.RATE_NOT_FINITE,
                too_large=Defect.RATE_TOO_LARGE,
            )
            imu = _kept(imu, has_gyro)
        is_spike = find_spikes(imu.gyro_rad_s)
        if is_spike.any():
            missing.append(MissingData(Defect.RATE_IS_SPIKE, int(is_spike.sum()), len(is_spike)))
            imu = _kept(imu, ~is_spike)
        has_force = are_within(imu.accel_m_s2, MAX_FORCE_M_S2)
        if not has_force.all():
            # An IMU without an accelerometer has no specific force at all: that is not a fault.
            if np.isfinite(imu.accel_m_s2).all(axis=1).any():
                missing += _left_out(
                    imu.accel_m_s2,
                    usable=has_force,
                    not_finite=Defect.FORCE_NOT_FINITE,
                    too_large=Defect.FORCE_TOO_LARGE,
                )
            imu = replace(imu, accel_m_s2=np.where(has_force[:, None], imu.accel_m_s2, np.nan))
        frame = replace(frame, imu=imu)
    features = frame.features
    if features is not None and features.pixels.shape == (len(features.ids), 4):
        is_plausible = are_within(features.pixels, MAX_PIXEL_PX)
        if not is_plausible.all():
            missing += _left_out(
                features.pixels,
                usable=is_plausible,
                not_finite=Defect.PIXEL_NOT_FINITE,
                too_large=Defect.PIXEL_TOO_LARGE,
            )
            features = StereoFeatures(features.ids[is_plausible], features.pixels[is_plausible])
            frame = replace(frame, features=features)
    check_frame(frame, camera)
    if prev_frame is not None:
        check_order(prev_frame, frame)
    return frame, tuple(missing)


def usable_stream(stream: ImuStream, frames_ns: IntArray) -> ImuStream:
    """Return the samples of a recording that the odometry would use between its frames.

    Args:
        stream: the samples of the IMU.
        frames_ns: stamps of the frames, [K].
    """
    stream = plausible_stream(stream)
    return _kept_of_stream(stream, ~np.isin(stream.stamps_ns, spike_stamps(stream, frames_ns)))


def plausible_stream(stream: ImuStream) -> ImuStream:
    """Return the samples with a finite, plausible angular rate; other forces than such are NaN."""
    has_force = are_within(stream.accel_m_s2, MAX_FORCE_M_S2)
    accel_m_s2 = np.where(has_force[:, None], stream.accel_m_s2, np.nan)
    has_gyro = are_within(stream.gyro_rad_s, MAX_RATE_RAD_S)
    return _kept_of_stream(replace(stream, accel_m_s2=accel_m_s2), has_gyro)


def spike_stamps(stream: ImuStream, frames_ns: IntArray) -> IntArray:
    """Return the stamps of the spikes of the gyro, which are looked for between two frames.

    Args:
        stream: samples with plausible angular rates.
        frames_ns: stamps of the frames, [K].
    """
    spikes_ns: set[int] = set()  # a sample at a frame belongs to two intervals
    for start_ns, end_ns in pairwise(frames_ns.tolist()):
        samples = stream.between(start_ns, end_ns)
        if samples is not None:
            spikes_ns.update(samples.stamps_ns[find_spikes(samples.gyro_rad_s)].tolist())
    return np.array(sorted(spikes_ns), np.int64)


def with_plain_arrays(frame: Frame) -> Frame:
    """Return the frame with numbers of the types that the odometry computes with.

    These are float64 for pixels, rates and forces, and int64 for identities and stamps; index and
    stamp of the frame are ints, whose differences do not overflow.

    Raises:
        InputError: it is no frame; features or IMU samples are of another class; an array holds
            something else than numbers, or than whole numbers where they are needed, or some that
            do not fit in 64 bits.
    """
    if not isinstance(frame, Frame):
        cure = "Give a Frame, such as Frame(index, stamp_ns, left, right)."
        raise InputError("frame", f"is a {type(frame).__name__}.", cure)
    if isinstance(frame.index, np.integer):
        frame = replace(frame, index=int(frame.index))
    if isinstance(frame.stamp_ns, np.integer):
        frame = replace(frame, stamp_ns=int(frame.stamp_ns))
    where = f"frame {frame.index}"
    features = frame.features
    if features is not None:
        _check_kind(features, StereoFeatures, where, "features")
        features = StereoFeatures(
            ids=_whole_numbers(features.ids, where, "feature ids"),
            pixels=_numbers(features.pixels, where, "feature pixels"),
        )
    imu = frame.imu
    if imu is not None:
        _check_kind(imu, ImuSamples, where, "imu")
        imu = ImuSamples(
            stamps_ns=_whole_numbers(imu.stamps_ns, where, "IMU stamps_ns"),
            gyro_rad_s=_numbers(imu.gyro_rad_s, where, "IMU gyro_rad_s"),
            accel_m_s2=_numbers(imu.accel_m_s2, where, "IMU accel_m_s2"),
        )
    return replace(frame, features=features, imu=imu)


def with_copied_arrays(frame: Frame) -> Frame:
    """Return the frame with features and IMU samples of its own, which nobody else overwrites."""
    features = frame.features
    if features is not None:
        features = StereoFeatures(features.ids.copy(), features.pixels.copy())
    imu = frame.imu
    if imu is not None:
        imu = ImuSamples(
            stamps_ns=imu.stamps_ns.copy(),
            gyro_rad_s=imu.gyro_rad_s.copy(),
            accel_m_s2=imu.accel_m_s2.copy(),
        )
    return replace(frame, features=features, imu=imu)


def usable_imu(frame: Frame) -> ImuSamples | None:
    """Return the IMU samples of a refused frame, for the next one; None if they are faulty."""
    if not isinstance(frame, Frame):
        return None
    try:
        imu = with_plain_arrays(replace(frame, features=None)).imu
    except InputError:
        return None
    if imu is None or not _has_rows(imu) or not (np.diff(imu.stamps_ns) >= 0).all():
        return None
    imu = _kept(imu, ~_repeats_stamp(imu))
    return _kept(imu, are_within(imu.gyro_rad_s, MAX_RATE_RAD_S))


def _check_kind(
    value: object, kind: type[StereoFeatures | ImuSamples], where: str, name: str
) -> None:
    """Refuse features or IMU samples of another class, such as a tuple of arrays.

    Raises:
        InputError: names the field of the frame, and the class that it takes.
    """
    if not isinstance(value, kind):
        names = ", ".join(field.name for field in fields(kind))
        what = f"the argument {name} is a {type(value).__name__}."
        raise InputError(where, what, f"Give {name}={kind.__name__}({names}).")


def _numbers(values: object, where: str, name: str) -> FloatArray:
    """Return an array as float64.

    Raises:
        InputError: it holds no numbers.
    """
    array = _array_of(values, "iuf", where, name)
    with np.errstate(over="ignore"):  # what is larger than a float64 can be becomes infinite
        return np.asarray(array, dtype=np.float64)


def _whole_numbers(values: object, where: str, name: str) -> AnyArray:
    """Return an array as int64, [N].

    Raises:
        InputError: it holds no whole numbers, one that does not fit, or has another shape.
    """
    array = _array_of(values, "iu", where, name)
    if array.ndim != 1:
        raise InputError(where, f"its {name} have shape {array.shape}.", "Give them as [N].")
    if array.dtype.kind == "u" and int(array.max(initial=0)) >= INT64_LIMIT:
        raise InputError(where, f"of its {name}, one does not fit in 64 bits.", "Use int64.")
    return np.asarray(array, dtype=np.int64)


def _array_of(values: object, kinds: str, where: str, name: str) -> AnyArray:
    """Return an array of one of the kinds of ``numpy.dtype.kind``, or an empty one of any kind.

    Raises:
        InputError: it is of another kind.
    """
    needed = "an array of numbers" if "f" in kinds else "an array of whole numbers"
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise InputError(
            where, f"its {name} are not an array ({error}).", f"Give {needed}."
        ) from None
    if array.dtype.kind not in kinds and (array.size > 0 or array.dtype.kind == "O"):
        found = "missing" if values is None else f"of type {array.dtype}"
        raise InputError(where, f"its {name} are {found}.", f"Give {needed}.")
    return array


def are_within(values: FloatArray, largest: float) -> BoolArray:
    """Return which rows, [N], of an array are finite and at most that large."""
    return np.asarray((np.abs(values) <= largest).all(axis=1))


def _kept(imu: ImuSamples, rows: BoolArray) -> ImuSamples:
    """Return the samples that are marked."""
    return ImuSamples(
        stamps_ns=imu.stamps_ns[rows],
        gyro_rad_s=imu.gyro_rad_s[rows],
        accel_m_s2=imu.accel_m_s2[rows],
    )


def _kept_of_stream(stream: ImuStream, rows: BoolArray) -> ImuStream:
    """Return the samples of a recording that are marked."""
    return replace(
        stream,
        stamps_ns=stream.stamps_ns[rows],
        gyro_rad_s=stream.gyro_rad_s[rows],
        accel_m_s2=stream.accel_m_s2[rows],
    )


def _repeats_stamp(imu: ImuSamples) -> BoolArray:
    """Return which samples, [N], have the stamp of the one before, as where a driver gives one
    twice."""
    is_repeated: BoolArray = np.append(False, np.diff(imu.stamps_ns) == 0)[: len(imu.stamps_ns)]
    return is_repeated


def _has_rows(imu: ImuSamples) -> bool:
    """Return whether the arrays have the shapes that ``check_frame`` will ask for."""
    shape = (len(imu.stamps_ns), 3)
    return np.shape(imu.gyro_rad_s) == shape and np.shape(imu.accel_m_s2) == shape


def _left_out(
    values: FloatArray, usable: BoolArray, *, not_finite: Defect, too_large: Defect
) -> list[MissingData]:
    """Count the rows, [N], that are not usable, by what is wrong with them."""
    is_finite = np.isfinite(values).all(axis=1)
    counts = {not_finite: int((~is_finite).sum()), too_large: int((is_finite & ~usable).sum())}
    return [MissingData(what, count, len(values)) for what, count in counts.items() if count]
