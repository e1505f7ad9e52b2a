"""Run an odometry for hours of frames, and watch memory, threads, file handles and latency.

    python benchmarks/soak.py [--through live|run|window] [--of images|tracks|PATH] [--spoiled 4]
                              [--forwards] [--frames 72000] [--minutes 120] [--seed 0]

A recording is played back and forth, as it is and in spoiled versions of it, until the frames or
the minutes are over. 72,000 frames are two hours at 10 Hz. At a turn the velocity jumps, which no
accelerometer has measured: with an IMU take --forwards, where only the place jumps.

`run` and `window` are what `probevo run` does, with the two-frame estimator and with the window:
they keep about 1 kB of each frame for the results, whose growth is known (`kept_mb_per_hour`).
`live` is a LiveOdometry with faults: of 1,000 frames, some 10 are lost, 2 come after a stall, 10
are refused (a stamp of the past), and in 10 each a sensor and the noise model raise an exception.
Every fault is counted where it is injected, and compared with what the odometry reports.

Resident memory, threads and file handles are sampled. The slope of memory is fitted after the first
ten minutes of frames, and is that of an hour of frames. Linux.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import cycle, islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from memory import SOURCES, back_and_forth, resident_mb

import probevo as pv
from probevo.allocator import keep_freed_memory
from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.estimation.motion_estimate import MotionEstimate
from probevo.runner import run_sequence
from probevo_sim.spoiling.config import SpoilConfig
from probevo_sim.spoiling.recording import SpoiledRecording

SHARE = 0.01
"""Share of the frames with a fault of each kind."""
EVERY = 100
"""Frames from one sample of memory to the next."""
RATE_HZ = 10.0
SETTLED = int(600.0 * RATE_HZ)
"""Frames after which memory should not grow: ten minutes."""


class InjectedError(Exception):
    """A part of the user fails."""


class TimeIsUpError(Exception):
    """The minutes are over."""


class Faults:
    """Decides when what fails, and counts it; a sensor and a noise model that fail now and then."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.injected: Counter[str] = Counter()
        self.noise = pv.noise.StudentT()
        self.columns: tuple[str, ...] = ()

    def happens(self, kind: str, share: float = SHARE) -> bool:
        happens = bool(self.rng.random() < share)
        self.injected[kind] += happens
        return happens

    def sensor(self, prev_frame: Any, frame: Any) -> Iterable[Any]:
        if self.happens("sensor"):
            raise InjectedError("sensor")
        return []

    def predict(self, predictors: Any) -> Any:
        if self.happens("noise model"):
            raise InjectedError("noise model")
        return self.noise.predict(predictors)

    def check_camera(self, camera: Any) -> None:
        self.noise.check_camera(camera)


class Loop:
    """A ``Sequence`` of many frames: a recording again and again, each time in another version."""

    def __init__(self, original: Any, num_spoiled: int, num_frames: int, *, forwards: bool) -> None:
        self.forwards = forwards
        self.path = original.path
        self.format = original.format
        self.camera = original.camera
        self.imu = original.imu
        self.truth = None
        self.versions = [list(original)]
        for seed in range(num_spoiled):
            self.versions.append(list(SpoiledRecording.of(original, SpoilConfig(seed=seed))))
        self.num_frames = num_frames

    @property
    def stamps_ns(self) -> IntArray:
        """Times as if no frame were dropped; only their first and last ones are of interest."""
        first_ns = self.versions[0][0].stamp_ns
        return first_ns + (1e9 / RATE_HZ * np.arange(self.num_frames)).astype(np.int64)

    def __len__(self) -> int:
        return self.num_frames

    def __iter__(self) -> Iterator[pv.Frame]:
        return islice(self._endless(), self.num_frames)

    def _endless(self) -> Iterator[pv.Frame]:
        index = 0
        next_ns = self.versions[0][0].stamp_ns
        for version in cycle(self.versions):
            played: Iterable[pv.Frame] = version
            if not self.forwards:
                # All versions begin with the same clean frame, with which the last one would end.
                played = islice(back_and_forth(version), 2 * len(version) - 2)
            offset_ns = next_ns - version[0].stamp_ns
            for frame in played:
                imu = frame.imu
                if imu is not None:
                    imu = replace(imu, stamps_ns=imu.stamps_ns + offset_ns)
                stamp_ns = frame.stamp_ns + offset_ns
                yield replace(frame, index=index, stamp_ns=stamp_ns, imu=imu, prepared=None)
                index += 1
                next_ns = stamp_ns + int(1e9 / RATE_HZ)


@dataclass
class Watch:
    """Samples memory, threads and file handles, and keeps the time of each step."""

    minutes: float
    start_s: float = field(default_factory=time.monotonic)
    samples: list[tuple[float, float, float, float]] = field(default_factory=list)
    num_steps: int = 0
    times_ms: FloatArray = field(default_factory=lambda: np.full(1_000_000, np.nan))
    """Of all steps; as large from the beginning as it will ever be."""

    @property
    def step_ms(self) -> FloatArray:
        """Times of the steps so far."""
        return self.times_ms[: self.num_steps]

    def is_over(self) -> bool:
        """Whether the minutes are over."""
        return time.monotonic() - self.start_s > 60.0 * self.minutes

    def add(self, step_ms: float) -> None:
        """Take one step."""
        self.times_ms[self.num_steps] = step_ms
        self.num_steps += 1
        if self.num_steps % EVERY == 0:
            threads = len(os.listdir("/proc/self/task"))  # noqa: PTH208
            handles = len(os.listdir("/proc/self/fd"))  # noqa: PTH208
            self.samples.append((self.num_steps, resident_mb(), threads, handles))

    def facts(self) -> dict[str, Any]:
        """Return what was found."""
        frames, memory, threads, handles = np.array(self.samples).T
        late = frames >= min(SETTLED, 0.2 * frames[-1])
        per_frame = float(np.polyfit(frames[late], memory[late], 1)[0])
        median_ms, high_ms = np.percentile(self.step_ms, [50.0, 99.9])
        return {
            "frames": self.num_steps,
            "minutes": (time.monotonic() - self.start_s) / 60.0,
            "slope_from_frame": int(frames[late][0]),
            "memory_mb_per_hour": 3600.0 * RATE_HZ * per_frame,
            "memory_mb": [float(memory[late][0]), float(memory[-1])],
            "threads": [int(threads[late][0]), int(threads[late].max()), int(threads[-1])],
            "handles": [int(handles[late][0]), int(handles[late].max()), int(handles[-1])],
            "step_ms": {
                "median": float(median_ms),
                "p99.9": float(high_ms),
                "ratio": float(high_ms / median_ms),
            },
        }


def soak_live(loop: Loop, watch: Watch, seed: int) -> dict[str, Any]:
    """Play the recording to a LiveOdometry with faults, and return what was found."""
    faults = Faults(seed)
    drawn = np.random.default_rng(seed + 1)
    odometry = pv.StereoOdometry(loop.camera, faults, loop.imu, sensors=[faults.sensor])
    live = pv.LiveOdometry(odometry)
    estimates = live.estimates()
    injected: Counter[str] = Counter()
    failed_before = 0
    for frame in loop:
        if watch.is_over():
            break
        kind = drawn.random()
        state = odometry.state
        if state is not None and frame.left is not None and frame.left is state.frame.left:
            # The recording has turned where a frame was lost or failed: an image that the odometry
            # still holds is rightly refused.
            continue
        if kind < SHARE:
            injected["lost frames"] += 1
            continue
        if kind < 2.0 * SHARE:
            injected["refused frames"] += 1
            with suppress(InputError):
                live.push(replace(frame, stamp_ns=frame.stamp_ns - 10**14))
        elif kind < 2.2 * SHARE:
            injected["stalls"] += 1
            time.sleep(0.2)
        pushed_s = time.perf_counter()
        live.push(frame)
        # Wait for the estimate, or for the failure, so that each fault can be accounted for.
        while live.num_failed == failed_before and not live._unread:
            time.sleep(0.0002)
        if live.num_failed > failed_before:
            failed_before = live.num_failed
        else:
            next(estimates)
            watch.add(1e3 * (time.perf_counter() - pushed_s))
    live.close()
    return {
        "injected": {**injected, **faults.injected},
        "reported": {"failed": live.num_failed, "refused": live.num_refused},
        "accounted": live.num_failed == faults.injected.total()
        and live.num_refused == injected["refused frames"],
    }


def soak_run(loop: Loop, watch: Watch, estimator: str) -> dict[str, Any]:
    """Run over the recording as ``probevo run`` does, and return what was found."""
    statuses: Counter[str] = Counter()
    last_s = time.perf_counter()

    def on_step(motion: MotionEstimate) -> None:
        nonlocal last_s
        statuses[motion.status.name] += 1
        statuses["without the IMU"] += bool(motion.imu_left_out)
        now_s = time.perf_counter()
        watch.add(1e3 * (now_s - last_s))
        last_s = now_s
        if watch.is_over():
            raise TimeIsUpError

    # Of each frame: 107 float64 and 6 int64 of the motion, the pose, and the times of its stages.
    kept_bytes = 8 * (107 + 6 + 16 + 10) + (400 if estimator == "window" else 0)
    with tempfile.TemporaryDirectory() as out, suppress(TimeIsUpError):
        run_sequence(loop, {"estimator": estimator}, out, on_step)
    return {
        "statuses": dict(statuses),
        "kept_mb_per_hour": 3600.0 * RATE_HZ * kept_bytes / 2**20,
    }


def main() -> None:
    """Parse the command line, soak, and print what was found as JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--through", choices=("live", "run", "window"), default="live")
    parser.add_argument("--of", default="images", help="images, tracks, or a recording")
    parser.add_argument("--spoiled", type=int, default=4, help="spoiled versions of it")
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
    original = pv.open_sequence(SOURCES.get(given.of, given.of))
    loop = Loop(original, given.spoiled, given.frames, forwards=given.forwards)
    watch = Watch(given.minutes)
    if given.through == "live":
        facts = soak_live(loop, watch, given.seed)
    else:
        estimator = "window" if given.through == "window" else "two-frame"
        facts = soak_run(loop, watch, estimator)
    text = json.dumps({"through": given.through, **watch.facts(), **facts}, indent=1)
    print(text)
    if given.out:
        given.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
