"""Odometry that keeps up with a camera: steps in a thread of its own, and skips frames rather than
fall behind."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from threading import Condition, Thread, current_thread
from time import perf_counter
from types import TracebackType

from probevo.estimation.motion_estimate import MotionEstimate
from probevo.odometry import StereoOdometry
from probevo.sequences.frame import Frame, check_frame, check_order

MOST_UNREAD = 16
"""Estimates that may wait for ``estimates()``; the next step is not begun before there is room
again."""

MOST_IMU_NS = 10_000_000_000
"""Of a longer time, a frame takes over no IMU samples of dropped ones: where nobody reads, they
would pile up."""


@dataclass(frozen=True)
class LiveEstimate:
    """The motion between two frames that were both processed; those between them were dropped."""

    index: int
    """``Frame.index`` of the current frame."""
    stamp_ns: int
    """Its time."""
    prev_stamp_ns: int | None
    """Time of the frame that ``motion`` leads from; None at the first frame."""
    motion: MotionEstimate
    num_dropped: int
    """Frames dropped between these two."""
    latency_ms: float
    """Wall time from ``push`` of the frame to its estimate."""


@dataclass(frozen=True)
class _Arrival:
    """A frame that waits."""

    frame: Frame
    time_s: float
    dropped: int = 0
    """Frames dropped right before it."""

    def after(self, dropped: _Arrival) -> _Arrival:
        """The same without the one before it, whose IMU samples it takes over, unless they become
        too many."""
        between = dropped.frame.imu
        own = self.frame.imu
        imu = between.followed_by(own) if between is not None and own is not None else None
        if imu is not None and imu.stamps_ns[-1] - imu.stamps_ns[0] > MOST_IMU_NS:
            imu = None
        return replace(self, frame=replace(self.frame, imu=imu), dropped=1 + dropped.dropped)


class LiveOdometry:
    """Steps a ``StereoOdometry`` in a thread, with the newest frames of a camera that does not wait
    for it.

    A frame that finds ``waiting`` others waiting takes the place of the oldest of them. So with
    steps of at most S, no estimate comes later than (waiting + 1) S after its frame: the rest of
    the step under way, then one for each frame that waits. What is dropped costs no motion and no
    gyro: each motion leads from the last frame that was *processed*, and the IMU samples of a
    dropped frame go to the next. Nothing grows, however long it runs.

    Estimates go to ``on_estimate``, called in the thread, its time being part of S; or else to
    ``estimates()``. Who reads those too slowly makes frames be dropped, but misses no motion: they
    can always be chained.

    ``with LiveOdometry(…) as live:`` closes it at the end, at once if that is an exception. An
    exception of a step or of ``on_estimate`` ends the thread, and comes out of ``push``,
    ``estimates()`` and ``close``.

    Args:
        odometry: nobody else may step it meanwhile.
        waiting: frames that may wait, at least 1; more than one only spreads out what a slow step
            delays.
        on_estimate: takes each estimate.
    """

    def __init__(
        self,
        odometry: StereoOdometry,
        *,
        waiting: int = 1,
        on_estimate: Callable[[LiveEstimate], None] | None = None,
    ) -> None:
        if waiting < 1:
            raise ValueError(f"waiting is {waiting}; at least one frame has to wait")
        self._odometry = odometry
        self._waiting = waiting
        self._on_estimate = on_estimate
        self._frames: deque[_Arrival] = deque()
        self._unread: deque[LiveEstimate] = deque()
        self._newest: Frame | None = None
        self._num_dropped = 0
        self._closed = self._ended = False
        self._failure: BaseException | None = None
        self._failed_at: TracebackType | None = None
        self._changed = Condition()  # guards all of the above
        self._thread = Thread(target=self._work, name="probevo-live", daemon=True)
        self._thread.start()

    @property
    def num_dropped(self) -> int:
        """Frames dropped so far."""
        with self._changed:
            return self._num_dropped

    def push(self, frame: Frame) -> None:
        """Hand in the next frame; never waits for a step.

        Its images are not copied: nobody may write to them again. Its IMU samples cover the time
        since the frame pushed
        before, whether that was dropped or not.

        Raises:
            InputError: the frame is not later than the one before, or not what its camera sees. It
                is left out; the next may be right.
            RuntimeError: pushed after ``close``.
        """
        arrival = _Arrival(frame, perf_counter())
        check_frame(frame, self._odometry.camera)
        with self._changed:
            self._raise_failure()
            if self._closed:
                raise RuntimeError("pushed a frame after close()")
            if self._newest is not None:
                check_order(self._newest, frame)
            self._newest = frame
            self._frames.append(arrival)
            if len(self._frames) > self._waiting:
                oldest = self._frames.popleft()
                self._frames[0] = self._frames[0].after(oldest)
                self._num_dropped += 1
            self._changed.notify_all()

    def estimates(self) -> Iterator[LiveEstimate]:
        """Each estimate as it comes, until it is closed and all are read."""
        if self._on_estimate is not None:
            raise RuntimeError("the estimates go to on_estimate")
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._unread or self._ended)
                if not self._unread:
                    self._raise_failure()
                    return
                estimate = self._unread.popleft()
                self._changed.notify_all()
            yield estimate

    def close(self, *, drain: bool = True) -> None:
        """Take no more frames, and return when the thread has ended; what is unread can still be
        read.

        Args:
            drain: process first the frames that wait; otherwise they are dropped, and only the step
                under way ends.
        """
        self._end(drain)
        with self._changed:
            self._raise_failure()

    def __enter__(self) -> LiveOdometry:
        """Itself: it runs since it was made."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: object, traceback: object) -> None:
        """Close it; after an exception at once, and without another one."""
        if kind is None:
            self.close()
        else:
            self._end(drain=False)

    def _end(self, drain: bool) -> None:
        with self._changed:
            self._closed = True
            if not drain:
                self._num_dropped += len(self._frames)
                self._frames.clear()
            self._changed.notify_all()
        if current_thread() is not self._thread:  # on_estimate may close it too
            self._thread.join()

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure.with_traceback(
                self._failed_at
            )  # not longer with each time that it is raised

    def _work(self) -> None:
        """The thread."""
        prev_stamp_ns = None
        try:
            while (arrival := self._next_arrival()) is not None:
                motion = self._odometry.step(arrival.frame)
                frame = arrival.frame
                latency_ms = 1e3 * (perf_counter() - arrival.time_s)
                self._deliver(
                    LiveEstimate(
                        frame.index,
                        frame.stamp_ns,
                        prev_stamp_ns,
                        motion=motion,
                        num_dropped=arrival.dropped,
                        latency_ms=latency_ms,
                    )
                )
                prev_stamp_ns = frame.stamp_ns
        except BaseException as error:  # noqa: BLE001 - whatever it is, it goes on in the threads that hear of it
            with self._changed:
                self._failure = error
                self._failed_at = error.__traceback__
        finally:
            with self._changed:
                self._closed = self._ended = True
                self._frames.clear()
                self._changed.notify_all()

    def _next_arrival(self) -> _Arrival | None:
        """The oldest frame that waits, as soon as there is one and room for its estimate; None at
        the end."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._closed or (self._frames and len(self._unread) < MOST_UNREAD)
            )
            return self._frames.popleft() if self._frames else None

    def _deliver(self, estimate: LiveEstimate) -> None:
        if self._on_estimate is not None:
            self._on_estimate(estimate)
            return
        with self._changed:
            self._unread.append(estimate)
            self._changed.notify_all()
