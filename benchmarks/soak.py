"""Run a LiveOdometry for long while frames are dropped, delayed and refused, and parts fail.

    python benchmarks/soak.py [--minutes 120] [--of images|tracks] [--seed 0]

A recording is played back and forth. Of 1,000 frames, some 10 are lost, 2 come after a stall, 10
are refused (a stamp of the past), and in 10 each a sensor and the noise model raise an exception.
Every fault is counted where it is injected, and compared with what the odometry reports. Resident
memory, threads and file handles are sampled; the slope is fitted after the first fifth. Linux.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from memory import SOURCES, back_and_forth, resident_mb

import probevo as pv
from probevo.allocator import keep_freed_memory
from probevo.errors import InputError

SHARE = 0.01
"""Share of the frames with a fault of each kind."""
SAMPLE_S = 5.0


class InjectedError(Exception):
    """A part of the user fails."""


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


def counts() -> tuple[int, int]:
    """Return the number of threads and of file handles of this process."""
    return len(os.listdir("/proc/self/task")), len(os.listdir("/proc/self/fd"))  # noqa: PTH208


def soak(minutes: float, of: str, seed: int) -> dict[str, Any]:
    """Play the recording for so long, and return what was found."""
    cv2.setNumThreads(1)
    keep_freed_memory()
    sequence = pv.open_sequence(SOURCES[of])
    faults = Faults(seed)
    drawn = np.random.default_rng(seed + 1)
    odometry = pv.StereoOdometry(sequence.camera, faults, sequence.imu, sensors=[faults.sensor])
    live = pv.LiveOdometry(odometry)
    estimates = live.estimates()
    samples: list[tuple[float, float, int, int]] = []
    latency_ms: list[float] = []
    injected: Counter[str] = Counter()
    estimated = 0
    failed_before = 0
    start_s = time.monotonic()
    next_s = 0.0
    for frame in back_and_forth(list(sequence)):
        now_s = time.monotonic() - start_s
        if now_s > 60.0 * minutes:
            break
        if now_s > next_s:
            samples.append((now_s, resident_mb(), *counts()))
            next_s += SAMPLE_S
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
                live.push(replace(frame, stamp_ns=frame.stamp_ns - 10**12))
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
            estimated += 1
            latency_ms.append(1e3 * (time.perf_counter() - pushed_s))
    live.close()
    t, memory, threads, handles = np.array(samples).T
    late = t >= 0.2 * t[-1]
    median_ms, high_ms = np.percentile(latency_ms, [50.0, 99.9])
    return {
        "minutes": minutes,
        "frames": estimated,
        "injected": {**injected, **faults.injected},
        "reported": {"failed": live.num_failed, "refused": live.num_refused},
        "accounted": live.num_failed == faults.injected.total()
        and live.num_refused == injected["refused frames"],
        "memory_mb_per_hour": 3600.0 * float(np.polyfit(t[late], memory[late], 1)[0]),
        "memory_mb": [float(memory[late][0]), float(memory[-1])],
        "threads": [int(threads[late][0]), int(threads[-1])],
        "handles": [int(handles[late][0]), int(handles[-1])],
        "latency_ms": {"median": float(median_ms), "p99.9": float(high_ms)},
    }


def main() -> None:
    """Parse the command line, soak, and print what was found as JSON."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=120.0)
    parser.add_argument("--of", choices=SOURCES, default="images")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="also write it to this file")
    given = parser.parse_args()
    text = json.dumps(soak(given.minutes, given.of, given.seed), indent=1)
    print(text)
    if given.out:
        given.out.write_text(text + "\n")


if __name__ == "__main__":
    main()
