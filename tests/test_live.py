"""Live odometry: which frames it drops, when estimates come, what ends it. Steps wait for a word;
nothing is timed."""

import gc
import threading
import traceback
import weakref
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from queue import Queue
from threading import Semaphore
from time import sleep

import numpy as np
import pytest

import probevo as pv
from probevo.errors import InputError
from probevo.evaluation.metrics import evaluate
from probevo.geometry import se3, so3
from probevo.live import MAX_FAILURES, MAX_UNREAD
from probevo.sequences.frame import Frame, ImuSamples, StereoFeatures
from probevo.sequences.imu import ImuStream
from probevo.state import OdometryState
from worlds import CAMERA, FORWARD, FRAME_NS, START_NS, blind_frame, drive

PATIENCE_S = 60.0
"""A test that would wait for longer has failed."""


class Gated:
    """An odometry whose every step says that it has begun, and ends when it is told to."""

    camera = replace(CAMERA, size_px=None)

    def __init__(self, step: Callable[[Frame], pv.MotionEstimate] | None = None) -> None:
        self.begun: Queue[Frame] = Queue()
        self.go = Semaphore(0)
        self._step = step or (
            lambda frame: pv.MotionEstimate(np.eye(4), np.eye(6), pv.Status.OK, 0)
        )

    def step(self, frame: Frame) -> pv.MotionEstimate:
        self.begun.put(frame)
        assert self.go.acquire(timeout=PATIENCE_S)
        return self._step(frame)

    def has_begun(self, index: int) -> None:
        assert self.begun.get(timeout=PATIENCE_S).index == index


def free(step: Callable[[Frame], pv.MotionEstimate] | None = None) -> Gated:
    """One that need not be told."""
    gated = Gated(step)
    gated.go = Semaphore(10**9)
    return gated


def indices(live: pv.LiveOdometry) -> list[int]:
    return [estimate.index for estimate in live.estimates()]


def test_who_keeps_up_drops_nothing() -> None:
    odometry = Gated()
    with pv.LiveOdometry(odometry) as live:
        estimates = live.estimates()
        for index in range(5):
            live.push(blind_frame(index))
            odometry.go.release()
            estimate = next(estimates)
            assert (estimate.index, estimate.stamp_ns) == (index, START_NS + index * FRAME_NS)
            assert estimate.prev_stamp_ns == (estimate.stamp_ns - FRAME_NS if index else None)
            assert estimate.num_dropped == 0
            assert estimate.latency_ms >= 0.0
    assert live.num_dropped == 0
    assert list(estimates) == []


@pytest.mark.parametrize("waiting", [1, 2, 3])
def test_the_oldest_waiting_frame_is_dropped(waiting: int) -> None:
    odometry = Gated()
    with pv.LiveOdometry(odometry, waiting=waiting) as live:
        live.push(blind_frame(0))
        odometry.has_begun(0)
        for index in range(1, 10):
            live.push(blind_frame(index))  # returns, although no step does
        odometry.go.release(10)
    estimates = list(live.estimates())
    assert [estimate.index for estimate in estimates] == [0, *range(10 - waiting, 10)]
    assert [estimate.num_dropped for estimate in estimates] == [
        0,
        9 - waiting,
        *[0] * (waiting - 1),
    ]
    assert live.num_dropped == 9 - waiting
    for before, estimate in pairwise(estimates):
        assert estimate.prev_stamp_ns == before.stamp_ns


@pytest.mark.parametrize("waiting", [1, 2, 3])
def test_an_estimate_comes_at_most_waiting_plus_one_steps_after_its_frame(waiting: int) -> None:
    """However many frames are pushed during a step: between the push of a frame and its estimate,
    so many steps end."""
    odometry = Gated()
    steps_ended = 0
    pushed_at = {}
    late = []
    rng = np.random.default_rng(0)
    index = 0
    with pv.LiveOdometry(odometry, waiting=waiting) as live:
        estimates = live.estimates()
        for _ in range(200):
            for _ in range(rng.integers(1, 5)):
                pushed_at[index] = steps_ended
                live.push(blind_frame(index))
                index += 1
            odometry.begun.get(timeout=PATIENCE_S)
            odometry.go.release()
            steps_ended += 1
            late.append(steps_ended - pushed_at[next(estimates).index])
        odometry.go.release(waiting)
    assert max(late) <= waiting + 1
    assert live.num_dropped > 100


def test_what_waits_has_arrays_of_its_own() -> None:
    """A driver may use its arrays of features and samples again."""
    gated = Gated()
    (frame,) = drive(np.random.default_rng(0), 1)
    assert frame.features is not None
    pixels = frame.features.pixels.copy()
    samples = ImuSamples(np.array([0, FRAME_NS]), np.ones((2, 3)), np.ones((2, 3)))
    with pv.LiveOdometry(gated) as live:  # type: ignore[arg-type]
        live.push(frame)
        gated.has_begun(0)
        features = StereoFeatures(frame.features.ids, pixels)
        stamp_ns = frame.stamp_ns + FRAME_NS
        live.push(Frame(1, stamp_ns, features=features, imu=samples))
        pixels[:] = 0.0
        samples.gyro_rad_s[:] = 0.0
        gated.go.release(2)
        waited = gated.begun.get(timeout=PATIENCE_S)
        assert waited.features is not None
        assert waited.imu is not None
        np.testing.assert_array_equal(waited.features.pixels, frame.features.pixels)
        np.testing.assert_array_equal(waited.imu.gyro_rad_s, 1.0)


def test_estimates_go_to_the_callback() -> None:
    seen: list[pv.LiveEstimate] = []
    with pv.LiveOdometry(free(), waiting=20, on_estimate=seen.append) as live:
        for index in range(20):
            live.push(blind_frame(index))
    assert [estimate.index for estimate in seen] == list(range(20))
    with pytest.raises(RuntimeError, match="on_estimate"):
        next(live.estimates())


def test_the_callback_may_close() -> None:
    seen: list[int] = []

    def stop_at_two(estimate: pv.LiveEstimate) -> None:
        seen.append(estimate.index)
        if estimate.index == 2:
            live.close(drain=False)

    odometry = Gated()
    live = pv.LiveOdometry(odometry, waiting=9, on_estimate=stop_at_two)
    for index in range(5):
        live.push(blind_frame(index))
    odometry.go.release(9)
    live.close()
    assert seen == [0, 1, 2]
    assert live.num_dropped == 2


def test_who_does_not_read_loses_frames_but_no_motion_and_keeps_no_memory() -> None:
    """The step after the last that has room is not begun; frames are dropped, and let go of."""
    odometry = free()
    live = pv.LiveOdometry(odometry)
    images = []
    for index in range(MAX_UNREAD):
        live.push(blind_frame(index))
        odometry.has_begun(index)
    for index in range(MAX_UNREAD, 100):
        image = np.zeros((4, 4), np.uint8)
        images.append(weakref.ref(image))
        live.push(replace(blind_frame(index), left=image))
    del image
    gc.collect()
    assert odometry.begun.empty()
    assert sum(image() is not None for image in images) == 1
    live.close()
    estimates = list(live.estimates())
    assert [estimate.index for estimate in estimates] == [*range(MAX_UNREAD), 99]
    assert estimates[-1].prev_stamp_ns == estimates[-2].stamp_ns
    assert (
        sum(estimate.num_dropped for estimate in estimates) == live.num_dropped == 99 - MAX_UNREAD
    )


def test_closing_processes_what_waits_or_drops_it() -> None:
    for drain, expected in ((True, [0, 1, 2]), (False, [0])):
        odometry = Gated()
        live = pv.LiveOdometry(odometry, waiting=2)
        for index in range(3):
            live.push(blind_frame(index))
            if index == 0:
                odometry.has_begun(0)
        closing = threading.Thread(target=live.close, kwargs={"drain": drain})
        closing.start()
        while live.num_dropped < 3 - len(expected):  # until what waits is dropped
            sleep(0.001)
        odometry.go.release(3)
        closing.join(PATIENCE_S)
        assert indices(live) == expected
        with pytest.raises(RuntimeError, match="after close"):
            live.push(blind_frame(9))
        live.close()  # once more does no harm


def test_an_exception_in_the_body_stops_at_once() -> None:
    odometry = Gated()
    live = pv.LiveOdometry(odometry, waiting=5)
    for index in range(4):
        live.push(blind_frame(index))
    odometry.has_begun(0)
    odometry.go.release()  # of the step under way alone: the others would wait for ever
    with pytest.raises(KeyError), live:
        raise KeyError
    assert live.num_dropped + len(indices(live)) == 4


def failing(frame: Frame) -> pv.MotionEstimate:
    raise InputError("the camera", "is dead.", "Buy another.")


def dead() -> pv.LiveOdometry:
    """A live odometry that was given as many frames as may fail, and whose steps all fail."""
    live = pv.LiveOdometry(free(failing), waiting=MAX_FAILURES)
    for index in range(MAX_FAILURES):
        live.push(blind_frame(index))
    return live


def test_a_permanent_fault_is_raised_wherever_it_is_asked_for_until_closed() -> None:
    live = dead()
    live._thread.join()
    for ask in (
        lambda: next(live.estimates()),
        lambda: live.push(blind_frame(MAX_FAILURES)),
        lambda: next(live.estimates()),
    ):
        with pytest.raises(InputError, match="Buy another"):
            ask()
    depth = []
    for _ in range(3):
        with pytest.raises(InputError, match="Buy another") as error:
            live.push(blind_frame(MAX_FAILURES))
        depth.append(len(error.traceback))
    assert depth[0] == depth[2]  # it does not grow by being raised
    with pytest.raises(InputError, match="Buy another"):
        live.close()
    live.close()
    with pytest.raises(RuntimeError, match="after close"):
        live.push(blind_frame(MAX_FAILURES))
    assert list(live.estimates()) == []
    assert live.num_failed == MAX_FAILURES


@pytest.mark.parametrize("closes", [True, False])
def test_whose_callback_failed_goes_without_garbage_collection_once_closed(closes: bool) -> None:
    """The fault, its traceback and the calls in it do not keep one another."""

    def fail(estimate: pv.LiveEstimate) -> None:
        raise OverflowError

    def failed() -> weakref.ref[object]:
        live = pv.LiveOdometry(Raising(), waiting=2, on_estimate=fail)
        live.push(blind_frame(0))  # its step fails, and that is the last failure
        live.push(blind_frame(1))
        # ``pytest.raises`` would make a cycle of its own.
        if closes:
            with suppress(OverflowError):
                live.close()
        else:
            with suppress(KeyError), live:
                raise KeyError
        return weakref.ref(live)

    gc.collect()
    gc.disable()
    try:
        kept = failed()
        assert kept() is None
    finally:
        gc.enable()


def test_frames_that_wait_when_the_callback_fails_count_as_dropped() -> None:
    def fail(estimate: pv.LiveEstimate) -> None:
        raise ZeroDivisionError

    odometry = Gated()
    live = pv.LiveOdometry(odometry, waiting=5, on_estimate=fail)
    for index in range(4):
        live.push(blind_frame(index))
    odometry.go.release()
    with pytest.raises(ZeroDivisionError):
        live.close()
    assert live.num_dropped == 3


def test_a_permanent_fault_does_not_hide_another_exception() -> None:
    with pytest.raises(KeyError), dead():
        raise KeyError


def test_what_was_estimated_before_a_permanent_fault_can_still_be_read() -> None:
    odometry = free(
        lambda frame: failing(frame) if frame.index >= 2 else pv.StereoOdometry(CAMERA).step(frame)
    )
    live = pv.LiveOdometry(odometry, waiting=MAX_FAILURES + 2)
    for index in range(MAX_FAILURES + 2):
        live.push(blind_frame(index))
    estimates = live.estimates()
    assert [next(estimates).index, next(estimates).index] == [0, 1]
    with pytest.raises(InputError):
        next(estimates)


@pytest.mark.parametrize("error", [InputError("a sample", "is broken."), ZeroDivisionError("bug")])
def test_a_step_that_fails_is_counted_and_the_next_frame_is_processed(error: Exception) -> None:
    """With the samples of its gyro, as if the frame had been dropped."""
    frames = drive(np.random.default_rng(0), 6)
    frames = with_gyro(frames, gyro_stream(frames))
    odometry = pv.StereoOdometry(CAMERA, imu=GYRO)
    step = odometry.step

    def failing_once(frame: Frame) -> pv.MotionEstimate:
        if frame.index == 3:
            raise error
        return step(frame)

    gated = free(failing_once)
    gated.camera = CAMERA
    with pv.LiveOdometry(gated, waiting=9) as live:
        for frame in frames:
            live.push(frame)
    estimates = list(live.estimates())
    assert [estimate.index for estimate in estimates] == [0, 1, 2, 4, 5]
    assert [estimate.num_failed for estimate in estimates] == [0, 0, 0, 1, 0]
    assert live.num_failed == 1
    assert live.last_failure is error
    reference = pv.StereoOdometry(CAMERA, imu=GYRO)
    joined = replace(frames[4], imu=frames[3].imu.followed_by(frames[4].imu))
    for estimate, frame in zip(estimates, [*frames[:3], joined, frames[5]], strict=True):
        motion = reference.step(frame)
        assert estimate.motion.T_curr_prev.tobytes() == motion.T_curr_prev.tobytes()
        assert estimate.motion.cov.tobytes() == motion.cov.tobytes()
    assert estimates[3].prev_stamp_ns == frames[2].stamp_ns


class Raising:
    """An odometry whose step of frame 0 raises."""

    camera = Gated.camera

    def step(self, frame: Frame) -> pv.MotionEstimate:
        try:
            raise KeyError(frame.index)
        except KeyError as error:
            if frame.index == 0:
                raise ZeroDivisionError from error
        return pv.MotionEstimate(np.eye(4), np.eye(6), pv.Status.OK, 0)


def test_what_has_failed_keeps_neither_images_nor_the_odometry() -> None:
    """Neither the last failure nor the fault that has ended it, although their lines are known."""
    kept: list[weakref.ref[object]] = []

    def seen(index: int) -> Frame:
        image = np.zeros((4, 4), np.uint8)
        kept.append(weakref.ref(image))
        return replace(blind_frame(index), left=image)

    def fail(estimate: pv.LiveEstimate) -> None:
        raise OverflowError

    odometry = Raising()
    gc.collect()
    gc.disable()  # what a collection of cycles would find may stay for hours
    try:
        live = pv.LiveOdometry(odometry, waiting=9, on_estimate=fail)
        live.push(seen(0))
        live.push(seen(1))
        live._thread.join()
        with pytest.raises(OverflowError):
            live.push(seen(2))
        with pytest.raises(OverflowError):
            live.close()
        kept.append(weakref.ref(odometry))
        del odometry
        alive = [thing() is not None for thing in kept]
    finally:
        gc.enable()
    assert alive == [False] * 4
    assert isinstance(live.last_failure, ZeroDivisionError)
    assert traceback.extract_tb(live.last_failure.__traceback__)[-1].name == "step"


def test_a_refused_frame_leaves_its_imu_samples_to_the_next() -> None:
    frames = drive(np.random.default_rng(0), 4)
    frames = with_gyro(frames, gyro_stream(frames))
    odometry = pv.StereoOdometry(CAMERA, imu=GYRO)
    with pv.LiveOdometry(odometry, waiting=9) as live:
        live.push(frames[0])
        live.push(frames[1])
        doubled = replace(frames[2], features=StereoFeatures(np.array([1, 1]), np.zeros((2, 4))))
        with pytest.raises(InputError, match="same identity"):
            live.push(doubled)
        live.push(frames[3])
    assert live.num_refused == 1
    reference = pv.StereoOdometry(CAMERA, imu=GYRO)
    joined = replace(frames[3], imu=frames[2].imu.followed_by(frames[3].imu))
    motions = [reference.step(frame) for frame in [frames[0], frames[1], joined]]
    estimates = list(live.estimates())
    assert estimates[-1].motion.T_curr_prev.tobytes() == motions[-1].T_curr_prev.tobytes()
    assert odometry.gyro_bias.mean.tobytes() == reference.gyro_bias.mean.tobytes()


def test_a_frame_out_of_order_is_refused_and_the_next_is_taken() -> None:
    with pv.LiveOdometry(free(), waiting=3) as live:
        live.push(blind_frame(5))
        for index in (5, 4):
            with pytest.raises(InputError, match="is not after that of the frame before"):
                live.push(blind_frame(index))
        live.push(blind_frame(6))
    assert indices(live) == [5, 6]


def test_a_frame_that_the_camera_cannot_have_taken_is_refused_and_the_next_is_taken() -> None:
    picture = np.zeros((50, 60), np.uint8)
    frames = drive(np.random.default_rng(0), 3)
    odometry = pv.StereoOdometry(CAMERA)
    with pv.LiveOdometry(odometry, waiting=9) as live:
        live.push(frames[0])
        with pytest.raises(InputError, match="its left image is 60×50 px"):
            live.push(Frame(1, frames[1].stamp_ns, picture, right=picture))
        for frame in frames[1:]:
            live.push(frame)
    assert indices(live) == [0, 1, 2]


def test_at_least_one_frame_waits() -> None:
    with pytest.raises(pv.InputError, match=r"^waiting: is 0\."):
        pv.LiveOdometry(free(), waiting=0)
    with pytest.raises(pv.InputError, match=r"^odometry: is None\.\n *Give a StereoOdometry"):
        pv.LiveOdometry(None)  # type: ignore[arg-type]
    for waiting in (None, "1", float("nan"), 1.5):
        with pytest.raises(pv.InputError, match=r"^waiting: is .*\n *Give a whole number"):
            pv.LiveOdometry(free(), waiting=waiting)  # type: ignore[arg-type]
    with pytest.raises(pv.InputError, match=r"^on_estimate: is 'print'\.\n *Give a function"):
        pv.LiveOdometry(free(), on_estimate="print")  # type: ignore[arg-type]


def test_an_odometry_that_has_stepped_goes_on_from_its_last_frame() -> None:
    frames = drive(np.random.default_rng(0), 4)
    odometry = pv.StereoOdometry(CAMERA)
    odometry.step(frames[0])
    odometry.step(frames[2])
    with pv.LiveOdometry(odometry) as live:
        with pytest.raises(InputError, match="is not after that of the frame before"):
            live.push(frames[1])
        live.push(frames[3])
    (estimate,) = live.estimates()
    assert estimate.prev_stamp_ns == frames[2].stamp_ns
    assert (live.num_refused, live.num_failed) == (1, 0)


class CountedReads(pv.StereoOdometry):
    """An odometry that counts how often its state is read."""

    num_reads = 0

    @property
    def _state(self) -> OdometryState | None:  # type: ignore[override]
        self.num_reads += 1
        return self.__dict__.get("kept")

    @_state.setter
    def _state(self, state: OdometryState | None) -> None:
        self.__dict__["kept"] = state


def test_whoever_reads_while_it_steps_sees_one_step() -> None:
    """What reads the state once cannot mix two of them."""
    odometry = CountedReads(CAMERA)
    for frame in drive(np.random.default_rng(0), 3):
        odometry.step(frame)
    names = [name for name, kind in vars(pv.StereoOdometry).items() if isinstance(kind, property)]
    reads: dict[str, Callable[[], object]] = {
        name: partial(getattr, odometry, name) for name in names
    }
    reads["relative"] = lambda: odometry.relative(2, 1)
    assert {"tracks", "landmarks", "window"} <= set(reads)
    for name, read in reads.items():
        odometry.num_reads = 0
        read()
        assert odometry.num_reads == 1, name


GYRO = pv.ImuCalibration(np.eye(4), 2e-4, 0.01)


def gyro_stream(frames: list[Frame]) -> ImuStream:
    """A gyro at 200 Hz, its stamps between those of the frames, that feels the turn of FORWARD and
    trembles."""
    stamps_ns = np.arange(
        frames[0].stamp_ns - 7_000_000, frames[-1].stamp_ns + 9_000_000, 5_000_000
    )
    trembling = 0.002 * np.sin(
        1e-9 * (stamps_ns - START_NS)[:, None] * np.array([70.0, 110.0, 130.0])
    )
    rates = trembling - so3.log(FORWARD[:3, :3]) / (1e-9 * FRAME_NS)
    return ImuStream.checked(
        stamps_ns,
        rates,
        np.zeros_like(rates),
        frames_ns=np.array([f.stamp_ns for f in frames]),
        where="gyro",
    )


def with_gyro(frames: list[Frame], stream: ImuStream) -> list[Frame]:
    slices = (stream.between(prev.stamp_ns, now.stamp_ns) for prev, now in pairwise(frames))
    return frames[:1] + [
        replace(frame, imu=imu) for frame, imu in zip(frames[1:], slices, strict=True)
    ]


def estimates_of_every_third(
    odometry: pv.StereoOdometry, frames: Iterable[Frame]
) -> list[pv.LiveEstimate]:
    """Three frames come during each step, and then a third of them is all that is processed."""
    gated = Gated(odometry.step)
    estimates = []
    with pv.LiveOdometry(gated, on_estimate=estimates.append) as live:
        for frame in frames:
            live.push(frame)
            if frame.index % 3 == 0:
                if frame.index:
                    gated.go.release()
                gated.has_begun(frame.index)
        gated.go.release()
    return estimates


def test_frames_that_wait_for_bursts_of_imu_samples_lose_none() -> None:
    """As docs/api.md joins them: samples behind a frame are not used until the next."""
    frames = drive(np.random.default_rng(0), 8)
    gyro = gyro_stream(frames)
    reference = pv.StereoOdometry(CAMERA, imu=GYRO)
    odometry = pv.StereoOdometry(CAMERA, imu=GYRO)
    expected = [reference.step(frame) for frame in with_gyro(frames, gyro)]
    bursts = np.array_split(np.arange(len(gyro.stamps_ns)), 5)
    num_joined = 0

    def next_burst() -> ImuSamples:
        nonlocal num_joined
        rows = bursts[num_joined]
        num_joined += 1
        return ImuSamples(gyro.stamps_ns[rows], gyro.gyro_rad_s[rows], gyro.accel_m_s2[rows])

    samples = next_burst()
    for frame, of_slices in zip(frames, expected, strict=True):
        while samples.stamps_ns[-1] < frame.stamp_ns:
            samples = samples.followed_by(next_burst())
        motion = odometry.step(replace(frame, imu=samples))
        first = max(np.searchsorted(samples.stamps_ns, frame.stamp_ns, side="right") - 1, 0)
        samples = ImuSamples(
            samples.stamps_ns[first:], samples.gyro_rad_s[first:], samples.accel_m_s2[first:]
        )
        np.testing.assert_allclose(motion.T_curr_prev, of_slices.T_curr_prev, atol=1e-9)
    assert num_joined == 5
    np.testing.assert_allclose(odometry.gyro_bias.mean, reference.gyro_bias.mean, atol=1e-12)


def test_dropped_frames_leave_their_gyro_to_the_next() -> None:
    """Motion, covariance and bias are, to the last bit, those of a recording that never had the
    dropped frames."""
    frames = drive(np.random.default_rng(1), 31)
    stream = gyro_stream(frames)
    ours, theirs = (pv.StereoOdometry(CAMERA, imu=GYRO) for _ in range(2))
    estimates = estimates_of_every_third(ours, with_gyro(frames, stream))
    assert [estimate.index for estimate in estimates] == list(range(0, 31, 3))
    for estimate, frame in zip(estimates, with_gyro(frames[::3], stream), strict=True):
        motion = theirs.step(frame)
        assert estimate.motion.status is (pv.Status.OK if frame.index else pv.Status.FIRST)
        assert estimate.motion.T_curr_prev.tobytes() == motion.T_curr_prev.tobytes()
        assert estimate.motion.cov.tobytes() == motion.cov.tobytes()
    assert ours.gyro_bias is not None
    assert theirs.gyro_bias is not None
    assert ours.gyro_bias.mean.tobytes() == theirs.gyro_bias.mean.tobytes()


def test_a_dropped_frame_without_gyro_leaves_the_interval_uncovered() -> None:
    """The gyro of a part of it does not tell the whole rotation."""
    frames = with_gyro(
        drive(np.random.default_rng(2), 4), gyro_stream(drive(np.random.default_rng(2), 4))
    )
    frames[2] = replace(frames[2], imu=None)
    odometry = Gated()
    with pv.LiveOdometry(odometry) as live:
        live.push(frames[0])
        odometry.has_begun(0)
        for frame in frames[1:]:
            live.push(frame)
        odometry.go.release(2)
        assert odometry.begun.get(timeout=PATIENCE_S).imu is None


def test_who_stalls_does_not_pile_up_imu_samples() -> None:
    """Of 700 frames, ten a second, that are dropped one after the other, the last holds no more
    than of 10 s."""
    frames = drive(np.random.default_rng(3), 700)
    odometry = Gated()
    with pv.LiveOdometry(odometry) as live:
        live.push(frames[0])
        odometry.has_begun(0)
        for frame in with_gyro(frames, gyro_stream(frames))[1:]:
            live.push(frame)
        odometry.go.release(2)
        assert odometry.begun.get(timeout=PATIENCE_S).imu is None


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["kitti_odometry/sequences/06", "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync"],
    ids=["06", "0005"],
)
def test_tracking_survives_dropped_frames(name: str, data_root: Path) -> None:
    """With two of three frames missing, every motion is solved from the images, and the path is
    about as good as with all of them (0.012 and 0.020 °/m)."""
    sequence = pv.open_sequence(data_root / name)
    frames = islice(sequence, 3 * (len(sequence) // 3) - 2)
    estimates = estimates_of_every_third(
        pv.StereoOdometry(sequence.camera, imu=sequence.imu), frames
    )
    assert len(estimates) == len(sequence) // 3
    assert all(estimate.motion.status is pv.Status.OK for estimate in estimates[1:])
    assert sequence.truth is not None
    path = se3.chain_motions(estimate.motion.T_curr_prev for estimate in estimates[1:])
    metrics = evaluate(path, sequence.truth.T_world_cam[[estimate.index for estimate in estimates]])
    assert (metrics.short_r_deg_per_m or np.inf) <= 0.021


def test_a_frame_whose_imu_was_silent_is_dropped_and_may_fail() -> None:
    """Its samples are none, which is not None."""
    frames = drive(np.random.default_rng(0), 4)
    silent = gyro_stream(frames[:1]).between(0, 1)
    frames = [frames[0], *(replace(frame, imu=silent) for frame in frames[1:])]
    calls = iter([None, ZeroDivisionError("once"), None, None])

    def step(frame: Frame) -> pv.MotionEstimate:
        fault = next(calls)
        if fault is not None:
            raise fault
        return pv.MotionEstimate(np.eye(4), np.eye(6), pv.Status.OK, 0)

    odometry = Gated(step)
    live = pv.LiveOdometry(odometry, waiting=1)
    live.push(frames[0])
    odometry.has_begun(0)
    live.push(frames[1])
    live.push(frames[2])  # drops the one before
    odometry.go.release(9)
    odometry.has_begun(2)
    live.push(frames[3])
    live.close()
    assert live.num_dropped == 1
    assert live.num_failed == 1
    assert indices(live) == [0, 3]


def test_refused_frames_do_not_pile_up_imu_samples() -> None:
    """A front end whose features are wrong from then on, for 40 s."""
    frames = drive(np.random.default_rng(0), 400, points=20)
    frames = with_gyro(frames, gyro_stream(frames))
    with pv.LiveOdometry(free(), waiting=9) as live:
        live.push(frames[0])
        for frame in frames[1:]:
            doubled = replace(frame, features=StereoFeatures(np.array([1, 1]), np.zeros((2, 4))))
            with pytest.raises(InputError, match="same identity"):
                live.push(doubled)
        kept = live._refused_imu
        assert kept is None or len(kept.stamps_ns) <= 1.1 * 10.0 * 200
