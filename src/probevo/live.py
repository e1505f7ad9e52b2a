"""Odometry of a live camera: it runs in its own thread, and drops frames instead of falling
behind."""

from __future__ import annotations

import inspect
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from threading import Condition, Thread, current_thread
from time import perf_counter
from traceback import walk_tb
from types import TracebackType

import numpy as np

from probevo.errors import InputError, brief
from probevo.estimation.motion_estimate import MotionEstimate
from probevo.odometry import StereoOdometry
from probevo.sequences.frame import Frame, ImuSamples
from probevo.sequences.validation import (
    usable_imu,
    validated,
    with_copied_arrays,
    with_plain_arrays,
)

MAX_UNREAD = 16
"""Estimates that may wait for ``estimates()``; the next step begins only when there is room."""

MAX_IMU_NS = 10_000_000_000
"""Longest interval of IMU samples that a frame takes over from dropped ones; without a bound they
would accumulate if nobody reads the estimates."""

MAX_FAILURES = 30
"""Number of failing steps in a row after which the thread gives up. A single failure may be a
broken image; after so many the fault is permanent, and nobody should wait for an estimate."""

_MAY_BE_SUSPENDED = inspect.CO_GENERATOR | inspect.CO_COROUTINE | inspect.CO_ASYNC_GENERATOR
"""Flags of a call that may go on after an exception has passed it."""


@dataclass(frozen=True)
class LiveEstimate:
    """The motion between two frames that were both processed; those between them were not."""

    index: int
    """``Frame.index`` of the current frame."""
    stamp_ns: int
    """Its time."""
    prev_stamp_ns: int | None
    """Time of the frame that ``motion`` leads from; None at the odometry's first frame."""
    motion: MotionEstimate
    num_dropped: int
    """Frames between these two that were dropped, for lack of time."""
    num_failed: int
    """Frames between these two whose step raised an exception."""
    latency_ms: float
    """Wall time from ``push`` of the frame to its estimate."""


@dataclass(frozen=True)
class _Arrival:
    """A frame that waits."""

    frame: Frame
    time_s: float
    num_dropped: int = 0
    """Frames dropped right before it."""
    num_failed: int = 0
    """Frames whose step failed right before it."""

    def after_dropped(self, earlier: _Arrival) -> _Arrival:
        """Return this arrival with the IMU samples and counts of an earlier one that is dropped."""
        joined = self._joined(earlier)
        return replace(joined, num_dropped=joined.num_dropped + 1)

    def after_failed(self, earlier: _Arrival) -> _Arrival:
        """Return this arrival with the IMU samples and counts of an earlier one that failed."""
        joined = self._joined(earlier)
        return replace(joined, num_failed=joined.num_failed + 1)

    def _joined(self, earlier: _Arrival) -> _Arrival:
        """Take over the IMU samples of the earlier frame, unless they become too many."""
        return replace(
            self,
            frame=replace(self.frame, imu=_joined_samples(earlier.frame.imu, self.frame.imu)),
            num_dropped=self.num_dropped + earlier.num_dropped,
            num_failed=self.num_failed + earlier.num_failed,
        )


def _joined_samples(earlier: ImuSamples | None, later: ImuSamples | None) -> ImuSamples | None:
    """Return the IMU samples of two intervals in a row; None if either has none, or if both are
    longer than ``MAX_IMU_NS``."""
    if earlier is None or later is None:
        return None
    joined = earlier.followed_by(later)
    stamps_ns = joined.stamps_ns
    if len(stamps_ns) and stamps_ns[-1] - stamps_ns[0] > MAX_IMU_NS:
        return None
    return joined


class LiveOdometry:
    """Steps a ``StereoOdometry`` in a thread, with the newest frames of a camera.

    If more than ``waiting`` frames wait, the oldest is dropped. With steps of at most S, no
    estimate is later than (waiting + 1) S after its frame: the rest of the current step, then one
    step for each waiting frame. A dropped frame loses neither motion nor gyro data: each motion
    starts at the last frame that was *processed*, and the IMU samples of a dropped frame go to the
    next one. Memory stays constant, however long it runs.

    Estimates go to ``on_estimate``, which is called in the thread and whose time is part of S, or
    else to ``estimates()``. If these are read too slowly, frames are dropped, but the motions still
    form an unbroken chain.

    A step that raises an exception leaves the odometry as it was. Its frame is counted as failed
    (``num_failed``, ``last_failure``), its IMU samples go to the next frame, and the thread goes
    on; only after ``MAX_FAILURES`` of them in a row does it give up.

    ``with LiveOdometry(…) as live:`` closes it at the end, at once if that is an exception. The
    exception of a permanent fault, or of ``on_estimate``, ends the thread, and is raised by
    ``push`` and ``estimates()`` until ``close``, which raises it once. Exceptions that are kept
    have the lines of their traceback, but not the variables of these calls, which would keep
    images.

    Args:
        odometry: the odometry; nothing else may call its ``step`` meanwhile.
        waiting: number of frames that may wait, at least 1. More than one bridges single slow
            steps, at the cost of delay.
        on_estimate: called with each estimate.

    Raises:
        InputError: ``odometry`` is something else, ``waiting`` is no whole number or less than 1,
            or ``on_estimate`` cannot be called.
    """

    def __init__(
        self,
        odometry: StereoOdometry,
        *,
        waiting: int = 1,
        on_estimate: Callable[[LiveEstimate], None] | None = None,
    ) -> None:
        # Whatever wraps an odometry may take its place.
        if not all(hasattr(odometry, member) for member in ("camera", "step")):
            cure = "Give a StereoOdometry: LiveOdometry(StereoOdometry(camera))."
            raise InputError("odometry", f"is {brief(odometry)}.", cure)
        if not isinstance(waiting, int | np.integer):
            raise InputError("waiting", f"is {brief(waiting)}.", "Give a whole number of frames.")
        if waiting < 1:
            raise InputError("waiting", f"is {waiting}.", "At least one frame has to wait: give 1.")
        if on_estimate is not None and not callable(on_estimate):
            cure = "Give a function of a LiveEstimate; or leave it out, and read estimates()."
            raise InputError("on_estimate", f"is {brief(on_estimate)}.", cure)
        # One that has stepped before goes on from its last frame.
        state = getattr(odometry, "state", None)
        newest: Frame | None = None if state is None else state.frame
        self._camera = odometry.camera
        self._waiting = waiting
        self._on_estimate = on_estimate
        self._frames: deque[_Arrival] = deque()
        self._unread: deque[LiveEstimate] = deque()
        self._newest = newest
        self._first_prev_ns = None if newest is None else int(newest.stamp_ns)
        self._num_dropped = 0
        self._num_failed = 0
        self._num_refused = 0
        self._refused_imu: ImuSamples | None = None
        self._last_failure: Exception | None = None
        self._closed = False
        self._ended = False
        self._fault: BaseException | None = None
        self._fault_traceback: TracebackType | None = None
        self._changed = Condition()  # guards all of the above
        self._thread = Thread(target=self._work, args=(odometry,), name="probevo-live", daemon=True)
        self._thread.start()

    @property
    def num_dropped(self) -> int:
        """Frames dropped so far, for lack of time."""
        with self._changed:
            return self._num_dropped

    @property
    def num_failed(self) -> int:
        """Frames so far whose step raised an exception."""
        with self._changed:
            return self._num_failed

    @property
    def num_refused(self) -> int:
        """Frames so far that ``push`` refused."""
        with self._changed:
            return self._num_refused

    @property
    def last_failure(self) -> Exception | None:
        """The exception of the last step that failed; None if none has."""
        with self._changed:
            return self._last_failure

    def push(self, frame: Frame) -> None:
        """Pass the next frame; does not wait for a step.

        Its images are not copied, so they must not be overwritten; features and IMU samples are.
        The samples cover the time since the last pushed frame, whether that was dropped or not.

        An exception is raised in the thread of the camera's driver, which has to call ``close`` in
        the end, whatever happens: until then, ``estimates`` waits for more.

        Raises:
            InputError: the frame is not later than the previous one, or does not match the camera.
                It is counted (``num_refused``) and left out, but its IMU samples go to the next
                frame.
            RuntimeError: pushed after ``close``.
            Exception: what has ended the thread before, until ``close``.
        """
        time_s = perf_counter()
        with self._changed:
            if self._fault is not None:
                del frame  # a kept traceback refers to this call: do not keep the images with it
            self._raise_fault()
            if self._closed:
                raise RuntimeError("pushed a frame after close()")
            try:
                frame = with_plain_arrays(frame)
                validated(frame, self._camera, prev_frame=self._newest)
            except InputError:
                self._num_refused += 1
                self._keep_imu(usable_imu(frame))
                raise
            frame = with_copied_arrays(frame)
            self._newest = frame
            if self._refused_imu is not None:
                frame = replace(frame, imu=_joined_samples(self._refused_imu, frame.imu))
            self._refused_imu = None
            self._frames.append(_Arrival(frame, time_s))
            if len(self._frames) > self._waiting:
                oldest = self._frames.popleft()
                self._frames[0] = self._frames[0].after_dropped(oldest)
                self._num_dropped += 1
            self._changed.notify_all()

    def estimates(self) -> Iterator[LiveEstimate]:
        """Yield each estimate as it comes, until it is closed and all are read.

        Without ``close``, it waits for ever after the last frame.
        """
        if self._on_estimate is not None:
            raise RuntimeError("the estimates go to on_estimate")
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._unread or self._ended)
                if not self._unread:
                    self._raise_fault()
                    return
                estimate = self._unread.popleft()
                self._changed.notify_all()
            yield estimate

    def close(self, *, drain: bool = True) -> None:
        """Accept no more frames, and return when the thread has ended.

        Estimates that are not yet read can still be read. What has ended the thread before is
        raised the first time.

        Args:
            drain: process the waiting frames first; otherwise they are dropped, and only the
                current step is finished.
        """
        self._end(drain)
        # Forget the fault before it is raised for the last time: kept, it and its traceback would
        # form a cycle.
        with self._changed:
            fault = self._fault
            traceback = self._fault_traceback
            self._forget_fault()
        if fault is None:
            return
        try:
            raise fault.with_traceback(traceback)
        finally:
            del fault, traceback

    def __enter__(self) -> LiveOdometry:
        """Return itself: it runs since it was made."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, traceback: object) -> None:
        """Close it; after an exception at once, and without another one."""
        if kind is None:
            self.close()
            return
        self._end(drain=False)
        with self._changed:
            self._forget_fault()

    def _end(self, drain: bool) -> None:
        with self._changed:
            self._closed = True
            if not drain:
                self._num_dropped += len(self._frames)
                self._frames.clear()
            self._changed.notify_all()
        if current_thread() is not self._thread:  # on_estimate may close it, too
            self._thread.join()

    def _forget_fault(self) -> None:
        self._fault = None
        self._fault_traceback = None

    def _raise_fault(self) -> None:
        if self._fault is not None:
            # The traceback of the thread, so that it does not grow each time that it is raised.
            raise self._fault.with_traceback(self._fault_traceback)

    def _work(self, odometry: StereoOdometry) -> None:
        """Run the thread: step until closed, and keep the exception that ends it early."""
        try:
            self._step_frames(odometry)
        except BaseException as error:  # noqa: BLE001 - raised again in the threads that ask
            _release_variables(error)
            with self._changed:
                self._fault = error
                self._fault_traceback = error.__traceback__
        finally:
            del odometry  # a kept traceback refers to this call
            with self._changed:
                if self._last_failure is not None:
                    _release_variables(self._last_failure)  # of the call that was running then
                self._closed = True
                self._ended = True
                self._num_dropped += len(self._frames)  # a fault leaves what waits unprocessed
                self._frames.clear()
                self._newest = None
                self._refused_imu = None
                self._changed.notify_all()
            del self  # which keeps the exception

    def _step_frames(self, odometry: StereoOdometry) -> None:
        """Step the odometry until it is closed."""
        prev_stamp_ns = self._first_prev_ns
        failed: _Arrival | None = None  # the last frames, if their steps failed
        num_in_a_row = 0
        while (arrival := self._next_arrival()) is not None:
            if failed is not None:
                arrival = arrival.after_failed(failed)
            try:
                motion = odometry.step(arrival.frame)
            except Exception as error:
                num_in_a_row += 1
                self._count_failure(error)
                if num_in_a_row >= MAX_FAILURES:
                    raise
                failed = arrival
                continue
            failed = None
            num_in_a_row = 0
            frame = arrival.frame
            self._deliver(
                LiveEstimate(
                    index=frame.index,
                    stamp_ns=frame.stamp_ns,
                    prev_stamp_ns=prev_stamp_ns,
                    motion=motion,
                    num_dropped=arrival.num_dropped,
                    num_failed=arrival.num_failed,
                    latency_ms=1e3 * (perf_counter() - arrival.time_s),
                )
            )
            prev_stamp_ns = frame.stamp_ns

    def _keep_imu(self, imu: ImuSamples | None) -> None:
        """Keep the samples of a refused frame for the next one."""
        if self._refused_imu is not None:
            imu = _joined_samples(self._refused_imu, imu)
        self._refused_imu = imu

    def _count_failure(self, error: Exception) -> None:
        _release_variables(error)
        with self._changed:
            self._num_failed += 1
            self._last_failure = error

    def _next_arrival(self) -> _Arrival | None:
        """Return the oldest frame that waits, as soon as there is one and room for its estimate;
        None at the end."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._closed or (self._frames and len(self._unread) < MAX_UNREAD)
            )
            return self._frames.popleft() if self._frames else None

    def _deliver(self, estimate: LiveEstimate) -> None:
        if self._on_estimate is not None:
            self._on_estimate(estimate)
            return
        with self._changed:
            self._unread.append(estimate)
            self._changed.notify_all()


def _release_variables(error: BaseException) -> None:
    """Clear the variables of the calls that an exception has passed, as far as these are over.

    Its traceback refers to them, and they to images and states of the odometry. Files and lines
    remain.
    """
    cause: BaseException | None = error
    seen: set[int] = set()
    while cause is not None and id(cause) not in seen:
        seen.add(id(cause))
        for frame, _ in walk_tb(cause.__traceback__):
            if not frame.f_code.co_flags & _MAY_BE_SUSPENDED:
                with suppress(RuntimeError):  # it is still running
                    frame.clear()
        cause = cause.__cause__ or cause.__context__
