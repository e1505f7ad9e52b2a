"""Resident memory over many frames: a recording played back and forth, its stamps going on.

python benchmarks/memory.py [--frames 20000] [--of images|tracks] [--noise NAME|MODEL] [--recorded]
[--live]

`images` are those of raw 0005, `tracks` those of the tracks file of the same drive; --recorded also
keeps of each frame what `probevo run` keeps, and --live steps in the thread of a LiveOdometry. The
slope is fitted after the first 1,000 frames; wanted is less than 1 MB per 1,000 frames.
"""

from __future__ import annotations

import argparse
import os
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count, islice
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np
from recordings import RECORDINGS, ROOT

import probevo as pv
from probevo.allocator import keep_freed_memory
from probevo.noise.named import noise_model
from probevo.output.run_result import RunRecorder

SOURCES = {
    "images": RECORDINGS["raw 0005"],
    "tracks": ROOT / "kitti_tracks" / "2011_09_26_drive_0005.npz",
}


def resident_mb() -> float:
    """Of this process, now (Linux)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20


def back_and_forth(frames: list[pv.Frame]) -> Iterator[pv.Frame]:
    """The frames forwards, backwards, forwards … without end; backwards, the gyro turns the other
    way."""
    last = len(frames) - 1
    stamp_ns = frames[0].stamp_ns
    index = count()
    yield replace(frames[0], index=next(index), imu=None)
    while True:
        for k in range(1, last + 1):
            now = frames[k]
            duration_ns = frames[k].stamp_ns - frames[k - 1].stamp_ns
            imu = now.imu and replace(
                now.imu, stamps_ns=now.imu.stamps_ns + (stamp_ns - frames[k - 1].stamp_ns)
            )
            stamp_ns += duration_ns
            yield replace(now, index=next(index), stamp_ns=stamp_ns, imu=imu)
        for k in range(last - 1, -1, -1):
            now = frames[k]
            imu = frames[k + 1].imu
            turned_ns = stamp_ns + frames[k + 1].stamp_ns
            imu = imu and pv.ImuSamples(
                turned_ns - imu.stamps_ns[::-1], -imu.gyro_rad_s[::-1], imu.accel_m_s2[::-1]
            )
            stamp_ns += frames[k + 1].stamp_ns - now.stamp_ns
            yield replace(now, index=next(index), stamp_ns=stamp_ns, imu=imu)


def steps_of(odometry: pv.StereoOdometry, live: bool) -> Callable[[pv.Frame], pv.MotionEstimate]:
    """Its ``step``; live, each frame waits for the estimate of the one before, so that none is
    dropped."""
    if not live:
        return odometry.step
    thread = pv.LiveOdometry(odometry)
    estimates = thread.estimates()

    def step(frame: pv.Frame) -> pv.MotionEstimate:
        thread.push(frame)
        return next(estimates).motion

    return step


def main(source: str, num_frames: int, noise: str, recorded: bool, live: bool) -> None:
    cv2.setNumThreads(1)
    keep_freed_memory()
    sequence = pv.open_sequence(SOURCES[source])
    frames = list(sequence)
    odometry = pv.StereoOdometry(sequence.camera, noise_model(noise), sequence.imu)
    recorder = RunRecorder()
    step = steps_of(odometry, live)
    statuses = Counter()
    seen = []
    start = perf_counter()
    for frame in islice(back_and_forth(frames), num_frames):
        motion = step(frame)
        statuses[motion.status.name] += 1
        if recorded:
            recorder.add(frame.stamp_ns, motion, rejected=odometry.tracks.rejected)
        if (frame.index + 1) % 1000 == 0:
            seen.append((frame.index + 1, resident_mb()))
            took_ms = 1e3 * (perf_counter() - start) / (frame.index + 1)
            print(
                f"{seen[-1][0]:7,} frames: {seen[-1][1]:7.2f} MB resident, {took_ms:.1f} ms a"
                " frame",
                flush=True,
            )
    print(", ".join(f"{number:,} {name}" for name, number in statuses.most_common()))
    at, mb = np.array(seen).T
    print(
        f"slope after the first 1,000 frames: {1e3 * np.polyfit(at, mb, 1)[0]:+.3f} MB per 1,000"
        " frames"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--of", choices=SOURCES, default="images")
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--noise", default="student-t")
    parser.add_argument("--recorded", action="store_true")
    parser.add_argument("--live", action="store_true")
    given = parser.parse_args()
    main(given.of, given.frames, given.noise, given.recorded, given.live)
