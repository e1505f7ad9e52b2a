"""Run an odometry for hours of frames, and watch memory, threads, file handles and latency.

    python benchmarks/soak.py [--through live|run] [--estimator two-frame|window]
                              [--of images|tracks|PATH] [--spoiled 4] [--rendered] [--forwards]
                              [--frames 72000] [--minutes 120] [--seed 0] [--out FILE.json]

A recording is played back and forth, as it is, in spoiled versions of it, and with --rendered as
a rendered street that the same camera sees, until the frames or the minutes are over. 72,000 frames
are two hours at 10 Hz. At a turn the velocity jumps, which no accelerometer has measured: with an
IMU take --forwards, where only the place jumps.

`live` is one LiveOdometry. Of 1,000 frames, some 10 are lost, 10 refused (a stamp of the past), 5
black; 2 come after a stall and 2 at once with the frame before. In 10 each a sensor and the noise
model raise an exception, and in 1 the callback, which ends the thread: another one goes on with
the same odometry. What was injected is compared with what the LiveOdometry counts.

`run` is what `probevo run` does, again and again: each run ends after 3,000 frames, or by an
exception of a sensor, of the noise model or of the callback, or by a damaged image, in some 1 of
1,000 frames altogether. Some 10 of 1,000 frames are lost, and 5 black. What was injected is
compared with `stopped` and `faults` of the `metrics.json` that the run has written.

Every hundred frames, freed memory is given back, as docs/performance.md says. Resident memory,
before and after that, the part of it that no file backs, memory in use (`heap.py`), the number of
small Python objects, threads and file handles are sampled. Slopes are fitted to the means of rounds
through all versions of the recording, after the first ten minutes of frames, or a fifth of them if
these are fewer, and are those of an hour of frames, with their standard error. Latencies are those
of the clock, which depend on what else the machine does, and those of the processor time of the
thread that steps. Linux.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import cycle
from pathlib import Path
from threading import Condition
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np
from heap import heap_mb
from memory import SOURCES, anonymous_mb, back_and_forth, resident_mb

import probevo as pv
from probevo.allocator import keep_freed_memory, release_freed_memory
from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.estimation.motion_estimate import MotionEstimate
from probevo.runs import runner
from probevo.sequences.frame import GroundTruth
from probevo_sim.scene.config import RigConfig, SceneConfig
from probevo_sim.scene.recording import open_scene
from probevo_sim.spoiling.config import SpoilConfig
from probevo_sim.spoiling.recording import SpoiledRecording

SHARE = 0.01
"""Share of the frames with a fault of a frequent kind."""
BLACK_SHARE = 0.005
STALL_SHARE = 0.002
CALLBACK_SHARE = 0.001
STOP_SHARE = 0.00025
"""Of each of the four faults that end a run."""
STALL_S = 0.2
LONGEST_RUN = 3_000
"""Frames of a run that nothing ends."""
WARM = 500
"""Frames after which all is compiled, and what lives by then lives to the end."""
MAX_STEPS = 1_000_000
EVERY = 100
"""Frames from one sample of memory, and one release, to the next."""
RATE_HZ = 10.0
SETTLED = int(600.0 * RATE_HZ)
"""Frames after which memory should not grow: ten minutes."""
MARGIN_PX = 32
"""By which rendered images are larger, so that a piece of them has the principal point sought."""
BLIND = ("TOO_FEW_TRACKS", "DEGENERATE", "NOT_CONVERGED", "GAP", "FIRST")
"""What the step of a black frame may be."""


class InjectedError(Exception):
    """A part of the user fails."""


class TimeIsUpError(Exception):
    """The minutes are over."""


class Faults:
    """Decides when what fails, and counts it; a sensor and a noise model that fail now and then."""

    def __init__(self, seed: int, share: float) -> None:
        self.rng = np.random.default_rng(seed)
        self.share = share
        self.injected: Counter[str] = Counter()
        self.noise = pv.noise.StudentT()
        self.columns: tuple[str, ...] = ()
        self.scale_is_relative = self.noise.scale_is_relative

    def happens(self, kind: str, share: float) -> bool:
        """Draw whether a fault happens, and count it."""
        happens = bool(self.rng.random() < share)
        self.injected[kind] += happens
        return happens

    def sensor(self, prev_frame: Any, frame: Any) -> Iterable[Any]:
        """Measure nothing, or fail."""
        if self.happens("sensor", self.share):
            raise InjectedError("sensor")
        return []

    def predict(self, predictors: Any) -> Any:
        """Predict the noise, or fail."""
        if self.happens("noise model", self.share):
            raise InjectedError("noise model")
        return self.noise.predict(predictors)

    def check_camera(self, camera: Any) -> None:
        """Accept what the noise model accepts."""
        self.noise.check_camera(camera)


@dataclass(frozen=True)
class Version:
    """A recording as it is, or another version of it: its frames, and what is known of them."""

    frames: list[pv.Frame]
    T_world_cam: FloatArray
    slots: IntArray
    """Place of each frame among those of the original, of which some may be missing."""

    @staticmethod
    def original(sequence: Any) -> Version:
        """Read a recording."""
        frames = list(sequence)
        return Version(frames, _poses(sequence, len(frames)), np.arange(len(frames)))

    @staticmethod
    def spoiled(sequence: Any, seed: int) -> Version:
        """Read a spoiled version of a recording."""
        recording = SpoiledRecording.of(sequence, SpoilConfig(seed=seed))
        slots = [k for k, plan in enumerate(recording.plans) if plan.effect != "dropped"]
        frames = list(recording)
        return Version(frames, _poses(recording, len(frames)), np.array(slots))

    @staticmethod
    def rendered(sequence: Any) -> Version:
        """Render a street as the camera of a recording would see it, with its stamps."""
        camera = sequence.camera
        width, height = camera.size_px
        rig = RigConfig(
            width_px=width + MARGIN_PX,
            height_px=height + MARGIN_PX,
            focal_px=camera.fu_px,
            baseline_m=camera.baseline_m,
        )
        scene = open_scene(SceneConfig(preset="city", distance_m=150.0, rig=rig))
        count = min(len(scene), len(sequence))
        from_u = round(scene.camera.cu_px - camera.cu_px)
        from_v = round(scene.camera.cv_px - camera.cv_px)
        if not (0 <= from_u <= MARGIN_PX and 0 <= from_v <= MARGIN_PX):
            raise InputError(sequence.path, "its principal point is far from the middle.", "")
        rows = slice(from_v, from_v + height)
        columns = slice(from_u, from_u + width)
        frames = []
        for k in range(count):
            left, right = scene.images(k)
            frames.append(
                pv.Frame(
                    index=k,
                    stamp_ns=int(sequence.stamps_ns[k]),
                    left=left[rows, columns].copy(),
                    right=right[rows, columns].copy(),
                )
            )
        return Version(frames, _poses(scene, count), np.arange(count))


def _poses(sequence: Any, count: int) -> FloatArray:
    """Return the true poses of the first frames, NaN where there are none."""
    if sequence.truth is None:
        return np.full((count, 4, 4), np.nan)
    return np.asarray(sequence.truth.T_world_cam[:count])


@dataclass(frozen=True)
class Played:
    """A frame of the endless recording."""

    frame: pv.Frame
    T_world_cam: FloatArray
    num_lost: int
    """Frames that the recording lacks right before it."""


def endless(versions: list[Version], *, forwards: bool) -> Iterator[Played]:
    """Play versions of a recording again and again, with stamps and indices that go on."""
    index = 0
    next_ns = versions[0].frames[0].stamp_ns
    for version in cycle(versions):
        last = len(version.frames) - 1
        order = list(range(last + 1))
        played: Iterable[pv.Frame] = version.frames
        if not forwards:
            # All versions begin with the same clean frame, with which the last one would end.
            order += list(range(last - 1, 0, -1))
            played = back_and_forth(version.frames)
        offset_ns = next_ns - version.frames[0].stamp_ns
        prev_slot = None
        for at, frame in zip(order, played, strict=False):
            slot = int(version.slots[at])
            num_lost = 0 if prev_slot is None else abs(slot - prev_slot) - 1
            prev_slot = slot
            imu = frame.imu
            if imu is not None:
                imu = replace(imu, stamps_ns=imu.stamps_ns + offset_ns)
            stamp_ns = frame.stamp_ns + offset_ns
            shown = replace(frame, index=index, stamp_ns=stamp_ns, imu=imu, prepared=None)
            yield Played(shown, version.T_world_cam[at], num_lost)
            index += 1
            next_ns = stamp_ns + int(1e9 / RATE_HZ)


def blackened(frame: pv.Frame) -> pv.Frame:
    """Return a frame whose images show nothing."""
    if frame.left is None or frame.right is None:
        return frame
    return replace(frame, left=np.zeros_like(frame.left), right=np.zeros_like(frame.right))


@dataclass
class Watch:
    """Samples memory, threads and file handles, and keeps the times of each step."""

    minutes: float
    num_frames: int
    round_frames: int
    """Frames after which the recording begins again with its first version."""
    start_s: float = field(default_factory=time.monotonic)
    num_steps: int = 0
    times_ms: FloatArray = field(default_factory=lambda: np.full((MAX_STEPS, 2), 1.0))
    """By the clock and by the processor; written to now, so that it is in memory from now on."""
    samples: FloatArray = field(default_factory=lambda: np.full((MAX_STEPS // EVERY, 8), 1.0))
    """Step, resident memory before and after the release, the part of the latter that no file
    backs, and memory in use (NaN where it is not known) in MB, small objects, threads, handles;
    rows of numbers, since the objects of a list would be counted, too."""

    def is_over(self) -> bool:
        """Whether the frames or the minutes are over."""
        over = time.monotonic() - self.start_s > 60.0 * self.minutes
        return over or self.num_steps >= self.num_frames

    def add(self, clock_ms: float, processor_ms: float) -> None:
        """Take one step; NaN for a time that is not that of a usual step."""
        self.times_ms[self.num_steps] = clock_ms, processor_ms
        self.num_steps += 1
        if self.num_steps % EVERY == 0:
            threads = len(os.listdir("/proc/self/task"))  # noqa: PTH208
            handles = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
            gathered_mb = resident_mb()
            if self.num_steps == WARM:
                gc.freeze()
            if self.num_steps >= WARM:
                gc.collect()
            release_freed_memory()
            used_mb = heap_mb()
            self.samples[self.num_steps // EVERY - 1] = (
                self.num_steps,
                gathered_mb,
                resident_mb(),
                anonymous_mb(),
                np.nan if used_mb is None else used_mb,
                sys.getallocatedblocks(),
                threads,
                handles,
            )

    def facts(self) -> dict[str, Any]:
        """Return what was found."""
        samples = self.samples[: self.num_steps // EVERY]
        late = samples[samples[:, 0] >= min(SETTLED, 0.2 * samples[-1, 0])]
        frames, gathered_mb, memory_mb, anonymous, used_mb, objects, threads, handles = late.T
        return {
            "frames": self.num_steps,
            "minutes": (time.monotonic() - self.start_s) / 60.0,
            "slope_from_frame": int(frames[0]),
            "memory_mb_per_hour": _per_hour(frames, memory_mb, self.round_frames),
            "memory_before_release_mb_per_hour": _per_hour(frames, gathered_mb, self.round_frames),
            "anonymous_mb_per_hour": _per_hour(frames, anonymous, self.round_frames),
            "heap_mb_per_hour": _per_hour(frames, used_mb, self.round_frames),
            "objects_per_hour": _per_hour(frames, objects, self.round_frames),
            "memory_mb": _first_most_last(memory_mb),
            "memory_mb_by_round": _means(frames, memory_mb, self.round_frames).tolist(),
            "anonymous_mb": _first_most_last(anonymous),
            "heap_mb": _first_most_last(used_mb),
            "objects": _first_most_last(objects),
            "threads": _first_most_last(threads),
            "handles": _first_most_last(handles),
            "step_ms": self._latency(0),
            "step_processor_ms": self._latency(1),
        }

    def _latency(self, column: int) -> dict[str, float]:
        """Return median and 99.9th percentile of the times of the steps."""
        times_ms = self.times_ms[: self.num_steps, column]
        median_ms, high_ms = np.nanpercentile(times_ms, [50.0, 99.9])
        return {
            "median": float(median_ms),
            "p99.9": float(high_ms),
            "ratio": float(high_ms / median_ms),
        }


def _per_hour(frames: FloatArray, values: FloatArray, round_frames: int) -> dict[str, float]:
    """Return by how much values at the numbers of some frames grow in an hour of frames.

    What a step holds depends on where in the recording it is. The line is therefore fitted to the
    means of whole rounds; its standard error is that of their scatter about it. Both are NaN with
    fewer than three rounds.
    """
    hours = _means(frames, frames, round_frames) / (3600.0 * RATE_HZ)
    means = _means(frames, values, round_frames)
    if len(means) < 3:
        return {"slope": np.nan, "standard_error": np.nan}
    hours -= hours.mean()
    slope = hours @ means / (hours @ hours)
    left = means - means.mean() - slope * hours
    variance = left @ left / (len(means) - 2) / (hours @ hours)
    return {"slope": float(slope), "standard_error": float(np.sqrt(variance))}


def _means(frames: FloatArray, values: FloatArray, round_frames: int) -> FloatArray:
    """Return the mean of the values at some frames over each whole round."""
    rounds = ((frames - frames[0]) // round_frames).astype(np.int64)
    # The last one is not whole.
    means: FloatArray = np.bincount(rounds, values)[:-1] / np.bincount(rounds)[:-1]
    return means


def _first_most_last(values: FloatArray) -> list[float]:
    """Return the first sample, the largest one, and the last one."""
    return [float(value) for value in (values[0], values.max(), values[-1])]


class LiveSoak:
    """Plays frames with faults to a LiveOdometry, and compares what it counts with these."""

    def __init__(self, odometry: pv.StereoOdometry, faults: Faults, watch: Watch) -> None:
        self.odometry = odometry
        self.faults = faults
        self.watch = watch
        self.statuses: Counter[str] = Counter()
        self.counted: Counter[str] = Counter()
        """By LiveOdometries that have ended."""
        self.unexpected: list[str] = []
        self.black: set[int] = set()
        """Indices of black frames."""
        self.num_delivered = 0
        self.num_pushed = 0
        self.changed = Condition()
        self.live = pv.LiveOdometry(odometry, on_estimate=self.on_estimate)
        self.prev_s: float | None = None
        """Processor time of the thread at the last estimate."""

    def on_estimate(self, estimate: pv.LiveEstimate) -> None:
        """Take an estimate, in the thread of the odometry; or fail."""
        now_s = time.thread_time()
        is_usual = self.prev_s is not None and estimate.num_failed == 0
        step_ms = 1e3 * (now_s - self.prev_s) if is_usual and self.prev_s is not None else np.nan
        status = estimate.motion.status.name
        self.statuses[status] += 1
        self.counted["dropped by estimates"] += estimate.num_dropped
        self.counted["failed by estimates"] += estimate.num_failed
        if estimate.index in self.black:
            self.black.discard(estimate.index)
            self.counted["black frames"] += status in BLIND
        self.watch.add(estimate.latency_ms, step_ms)
        self.prev_s = time.thread_time()  # without what was sampled now
        with self.changed:
            self.num_delivered += 1
            self.changed.notify_all()
        if self.faults.happens("callback", CALLBACK_SHARE):
            raise InjectedError("callback")

    def push(self, frame: pv.Frame, *, wait: bool) -> None:
        """Hand in a frame, and wait for what becomes of it."""
        try:
            self.live.push(frame)
            self.num_pushed += 1
            if wait:
                self._wait()
        except Exception:  # noqa: BLE001 - ``end`` tells which
            self._begin_anew()

    def _wait(self) -> None:
        """Wait until nothing is left to be done, or the thread has ended."""
        while self.live._fault is None:
            with self.changed:
                done = self.num_delivered + self.live.num_failed + self.live.num_dropped
                if done >= self.num_pushed:
                    return
                self.changed.wait(0.002)
        self._begin_anew()

    def end(self) -> None:
        """End the thread, and take over its counts."""
        live = self.live
        try:
            live.close()
        except InjectedError as error:
            self.counted[str(error)] += 1
        except Exception as error:  # noqa: BLE001 - a permanent fault, which is reported
            frame = self.watch.num_steps
            self.unexpected.append(f"ended at step {frame}: {type(error).__name__}: {error}")
            self.odometry._state = None
        failure = live.last_failure
        if failure is not None and not isinstance(failure, InjectedError):
            self.unexpected.append(f"{type(failure).__name__}: {failure}")
        self.counted["failed"] += live.num_failed
        self.counted["refused"] += live.num_refused
        self.counted["dropped"] += live.num_dropped
        self.counted["pushed"] += self.num_pushed
        self.counted["delivered"] += self.num_delivered
        self.num_pushed = 0
        self.num_delivered = 0

    def _begin_anew(self) -> None:
        """Go on with another thread where one was ended by its callback."""
        self.end()
        self.prev_s = None
        self.live = pv.LiveOdometry(self.odometry, on_estimate=self.on_estimate)


def soak_live(
    played: Iterator[Played], sequence: Any, watch: Watch, *, estimator: str, seed: int
) -> dict[str, Any]:
    """Play the recording to a LiveOdometry with faults, and return what was found."""
    faults = Faults(seed, SHARE)
    drawn = np.random.default_rng(seed + 1)
    odometry = pv.StereoOdometry(
        sequence.camera,
        faults,
        sequence.imu,
        config={"estimator": estimator},
        sensors=[faults.sensor],
    )
    soak = LiveSoak(odometry, faults, watch)
    injected: Counter[str] = Counter()
    newest = None  # the image of the last frame
    waiting = None  # that of a frame that the odometry may not have seen yet
    for item in played:
        if watch.is_over():
            break
        frame = item.frame
        held = [newest, waiting]
        if odometry.state is not None:
            held.append(odometry.state.frame.left)
            outage = odometry.state.outage
            if outage is not None and outage.lasts:
                held.append(outage.before.frame.left)
        if frame.left is not None and any(frame.left is image for image in held):
            # The recording has turned where a frame was lost or failed: an image that the odometry
            # still holds, or that came last, is rightly refused.
            continue
        kind = drawn.random()
        if kind < SHARE:
            injected["lost frames"] += 1
            continue
        kind -= SHARE
        wait = True
        if 0.0 <= kind < SHARE and soak.num_pushed:  # a new LiveOdometry knows no stamp yet
            injected["refused frames"] += 1
            with suppress(InputError):
                soak.live.push(replace(frame, stamp_ns=frame.stamp_ns - 10**14))
        elif SHARE <= kind < SHARE + BLACK_SHARE and frame.left is not None:
            injected["black frames"] += 1
            frame = blackened(frame)
            soak.black.add(frame.index)
        elif SHARE + BLACK_SHARE <= kind < SHARE + BLACK_SHARE + STALL_SHARE:
            injected["stalls"] += 1
            time.sleep(STALL_S)
        elif 0.5 < kind < 0.5 + STALL_SHARE:
            injected["frames at once with the next"] += 1
            wait = False
        soak.push(frame, wait=wait)
        newest = frame.left
        waiting = None if wait else frame.left
    soak.end()
    counted = soak.counted
    raised = faults.injected["sensor"] + faults.injected["noise model"]
    # A black frame whose step failed, or that was dropped, has no estimate.
    seen = injected["black frames"] - len(soak.black)
    return {
        "injected": {**injected, **faults.injected},
        "counted": dict(counted),
        "statuses": dict(soak.statuses),
        "unexpected": soak.unexpected,
        "accounted": {
            "failing parts": counted["failed"] == raised,
            "refused frames": counted["refused"] == injected["refused frames"],
            "failing callbacks": counted["callback"] == faults.injected["callback"],
            "black frames": counted["black frames"] == seen,
            "every frame": counted["pushed"]
            == counted["delivered"] + counted["failed"] + counted["dropped"],
        },
    }


class Piece:
    """A ``Sequence`` of the next frames of the endless recording, with faults on the way."""

    def __init__(self, played: Iterator[Played], original: Any, faults: Faults) -> None:
        self.path = original.path
        self.format = original.format
        self.camera = original.camera
        self.imu = original.imu
        self._played = played
        self._faults = faults
        self._is_known = original.truth is not None
        self._stamps_ns: list[int] = []
        self._poses: list[FloatArray] = []
        self.num_lost: list[int] = []
        """Frames that were lost before each one, all since the first added up."""
        self.black: list[int] = []
        """Indices of the black frames."""
        self.damaged: str | None = None
        """What the image that ended it was said to be."""

    @property
    def stamps_ns(self) -> IntArray:
        """Times of the frames so far."""
        return np.array(self._stamps_ns, dtype=np.int64)

    @property
    def truth(self) -> GroundTruth | None:
        """Poses of the frames so far."""
        if not self._is_known:
            return None
        return GroundTruth(self.stamps_ns, np.reshape(self._poses, (-1, 4, 4)))

    def __len__(self) -> int:
        return LONGEST_RUN

    def __iter__(self) -> Iterator[pv.Frame]:
        num_lost = 0
        prev_left = None
        for item in self._played:
            num_lost += item.num_lost
            frame = item.frame
            is_repeated = frame.left is not None and frame.left is prev_left
            if is_repeated or self._faults.happens("lost frames", SHARE):
                # A turn around a lost frame shows the same frame twice, which counts as lost, too.
                num_lost += 1
                continue
            if not self._stamps_ns:
                num_lost = 0  # nobody can know what came before the first frame
            if self._faults.happens("damaged image", STOP_SHARE):
                self.damaged = f"frame {item.frame.index}"
                raise InputError(self.damaged, "its pixels cannot be decoded.", "Copy it again.")
            index = len(self._stamps_ns)
            prev_left = frame.left
            if frame.left is not None and self._faults.happens("black frames", BLACK_SHARE):
                self.black.append(index)
                frame = blackened(frame)
            self._stamps_ns.append(frame.stamp_ns)
            self._poses.append(item.T_world_cam)
            self.num_lost.append(num_lost)
            yield replace(frame, index=index, imu=frame.imu if index else None)


class RunSoak:
    """Runs over one piece after the other as ``probevo run`` does, and checks what was written."""

    def __init__(self, sequence: Any, watch: Watch, *, estimator: str, seed: int) -> None:
        self.sequence = sequence
        self.watch = watch
        self.estimator = estimator
        self.faults = Faults(seed, STOP_SHARE)
        self.statuses: list[str] = []
        """Of the frames of the current run."""
        self.counted: Counter[str] = Counter()
        self.wrong: list[str] = []
        """What a file says otherwise."""
        self.prev_s: float | None = None

    def on_step(self, motion: MotionEstimate) -> None:
        """Take the motion of a frame, or fail."""
        now_s = time.thread_time()
        step_ms = np.nan if self.prev_s is None else 1e3 * (now_s - self.prev_s)
        self.statuses.append(motion.status.name)
        # Images are decoded in another thread.
        times_ms = motion.stage_ms
        clock_ms = sum(times_ms.values()) - times_ms.get("decode", 0.0)
        self.watch.add(clock_ms if np.isfinite(step_ms) else np.nan, step_ms)
        self.prev_s = time.thread_time()  # without what was sampled now
        if self.watch.is_over():
            raise TimeIsUpError
        if self.faults.happens("callback", STOP_SHARE):
            raise InjectedError("callback")

    def run(self, played: Iterator[Played], out: Path) -> None:
        """Run over one piece, and compare its ``metrics.json`` with what was injected."""
        piece = Piece(played, self.sequence, self.faults)
        self.statuses = []
        self.prev_s = None
        stopped = None
        try:
            runner.run_sequence(
                piece,
                {"estimator": self.estimator},
                out,
                self.on_step,
                sensors=[self.faults.sensor],
            )
        except InjectedError as error:
            stopped = f"InjectedError: {error}"
        except TimeIsUpError:
            stopped = "TimeIsUpError: "
        except InputError as error:
            stopped = f"{error.where}: {error.what}"
        self.counted["runs"] += 1
        count = len(self.statuses)
        if count < 2:
            return
        written = json.loads((out / "metrics.json").read_text())
        faults = written["faults"] or {}
        expected = {f"steps_{name.lower()}": n for name, n in Counter(self.statuses[1:]).items()}
        expected.pop("steps_ok", None)
        expected["lost_frames"] = piece.num_lost[count - 1] - piece.num_lost[0]
        expected = {name: number for name, number in expected.items() if number}
        found = {name: n for name, n in faults.items() if name in expected or "steps_" in name}
        found.pop("steps_without_imu", None)
        if found != expected:
            self.wrong.append(f"run of {count} frames: {found} instead of {expected}")
        if written["stopped"] != stopped:
            self.wrong.append(f"run of {count} frames: {written['stopped']} instead of {stopped}")
        blind = [self.statuses[k] for k in piece.black if k < count]
        self.counted["black frames"] += len(blind)
        seeing = [status for status in blind if status not in BLIND]
        if seeing:
            self.wrong.append(f"run of {count} frames: black frames are {seeing}")
        self.counted["frames"] += count
        self.counted["lost frames"] += expected.get("lost_frames", 0)
        is_damaged = stopped is not None and stopped.startswith(f"{piece.damaged}:")
        self.counted[f"ended by {'damaged image' if is_damaged else stopped or 'its end'}"] += 1
        for status in self.statuses:
            self.counted[status] += 1
        self.counted["steps without IMU"] += faults.get("steps_without_imu", 0)


def soak_run(
    played: Iterator[Played], sequence: Any, watch: Watch, *, estimator: str, seed: int
) -> dict[str, Any]:
    """Run again and again as ``probevo run`` does, and return what was found."""
    soak = RunSoak(sequence, watch, estimator=estimator, seed=seed)
    with (
        tempfile.TemporaryDirectory() as out,
        patch.object(runner, "noise_model", lambda spec: soak.faults),
    ):
        while not watch.is_over():
            soak.run(played, Path(out))
    return {
        "injected": dict(soak.faults.injected),
        "counted": dict(soak.counted),
        "contradictions": soak.wrong,
    }


def main() -> None:
    """Parse the command line, soak, and print what was found as JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--through", choices=("live", "run"), default="live")
    parser.add_argument("--estimator", choices=("two-frame", "window"), default="two-frame")
    parser.add_argument("--of", default="images", help="images, tracks, or a recording")
    parser.add_argument("--spoiled", type=int, default=4, help="spoiled versions of it")
    parser.add_argument("--rendered", action="store_true", help="and a rendered street")
    parser.add_argument(
        "--forwards", action="store_true", help="begin anew at the end, instead of going back"
    )
    parser.add_argument("--frames", type=int, default=72_000)
    parser.add_argument("--minutes", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="also write it to this file")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    keep_freed_memory()
    sequence = pv.open_sequence(SOURCES.get(given.of, given.of))
    versions = [Version.original(sequence)]
    if given.rendered:
        versions.append(Version.rendered(sequence))
    versions += [Version.spoiled(sequence, seed) for seed in range(given.spoiled)]
    played = endless(versions, forwards=given.forwards)
    # Back and forth, the first frame and the last one are played once, the others twice.
    num_frames = [len(version.frames) for version in versions]
    round_frames = sum(n if given.forwards else 2 * n - 2 for n in num_frames)
    watch = Watch(given.minutes, given.frames, round_frames)
    soak = soak_live if given.through == "live" else soak_run
    found = soak(played, sequence, watch, estimator=given.estimator, seed=given.seed)
    facts = {"through": given.through, "estimator": given.estimator, **watch.facts(), **found}
    text = json.dumps(facts, indent=1)
    print(text)
    if given.out:
        given.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
