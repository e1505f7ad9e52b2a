"""Measure whether resident memory grows over many frames.

    python benchmarks/memory.py [--frames 20000] [--of images|tracks] [--noise NAME|MODEL]
                                [--recorded] [--live]

A recording is played back and forth, with stamps that go on: `images` are those of raw 0005,
`tracks` the tracks file of the same drive. --recorded also keeps of each frame what `probevo run`
keeps, and --live steps in the thread of a LiveOdometry. The slope is fitted after the first 1,000
frames; the limit is 1 MB per 1,000 frames.
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
    """Return the resident memory of this process, MiB (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def anonymous_mb() -> float:
    """Return the part of the resident memory that no file backs, MiB (Linux).

    The other part are pages of programs and libraries, each since it was needed first.
    """
    lines = Path("/proc/self/smaps_rollup").read_text().splitlines()
    sizes_kb = {line.split(":")[0]: line.split()[1] for line in lines[1:]}
    return int(sizes_kb["Anonymous"]) / 2**10


def back_and_forth(frames: list[pv.Frame]) -> Iterator[pv.Frame]:
    """Yield the frames forwards, backwards, forwards … without end; the gyro is reversed, too."""
    last = len(frames) - 1
    stamp_ns = frames[0].stamp_ns
    index = count()
    yield replace(frames[0], index=next(index), imu=None)
    while True:
        for k in range(1, last + 1):
            frame = frames[k]
            prev_ns = frames[k - 1].stamp_ns
            imu = frame.imu
            if imu:
                imu = replace(imu, stamps_ns=imu.stamps_ns + (stamp_ns - prev_ns))
            stamp_ns += frame.stamp_ns - prev_ns
            yield replace(frame, index=next(index), stamp_ns=stamp_ns, imu=imu)
        for k in range(last - 1, -1, -1):
            frame = frames[k]
            # The samples between this frame and the later one, in reverse order; backwards in time,
            # rates have the opposite sign.
            later_ns = frames[k + 1].stamp_ns
            imu = frames[k + 1].imu
            if imu:
                imu = pv.ImuSamples(
                    stamp_ns + later_ns - imu.stamps_ns[::-1],
                    -imu.gyro_rad_s[::-1],
                    imu.accel_m_s2[::-1],
                )
            stamp_ns += later_ns - frame.stamp_ns
            yield replace(frame, index=next(index), stamp_ns=stamp_ns, imu=imu)


def steps_of(odometry: pv.StereoOdometry, live: bool) -> Callable[[pv.Frame], pv.MotionEstimate]:
    """Return the ``step`` of an odometry, or one that steps in the thread of a LiveOdometry.

    The live one waits for the estimate of each frame, so that none is dropped.
    """
    if not live:
        return odometry.step
    thread = pv.LiveOdometry(odometry)
    estimates = thread.estimates()

    def step(frame: pv.Frame) -> pv.MotionEstimate:
        thread.push(frame)
        return next(estimates).motion

    return step


def measure(arguments: argparse.Namespace) -> None:
    """Play the recording, and print the resident memory every 1,000 frames and its slope."""
    cv2.setNumThreads(1)
    keep_freed_memory()
    sequence = pv.open_sequence(SOURCES[arguments.of])
    frames = list(sequence)
    odometry = pv.StereoOdometry(
        sequence.camera,
        noise_model(arguments.noise),
        sequence.imu,
        config={"estimator": "two-frame"},
    )
    step = steps_of(odometry, arguments.live)
    recorder = RunRecorder()
    statuses: Counter[str] = Counter()
    frames_seen = []
    memory_mb = []
    start = perf_counter()
    for frame in islice(back_and_forth(frames), arguments.frames):
        motion = step(frame)
        statuses[motion.status.name] += 1
        if arguments.recorded:
            recorder.add(frame.stamp_ns, motion, rejected=odometry.tracks.rejected)
        number = frame.index + 1
        if number % 1000 == 0:
            frames_seen.append(number)
            memory_mb.append(resident_mb())
            frame_ms = 1e3 * (perf_counter() - start) / number
            print(
                f"{number:7,} frames: {memory_mb[-1]:7.2f} MB resident, {frame_ms:.1f} ms a frame",
                flush=True,
            )
    print(", ".join(f"{number:,} {name}" for name, number in statuses.most_common()))
    slope = 1e3 * np.polyfit(frames_seen, memory_mb, 1)[0]
    print(f"slope after the first 1,000 frames: {slope:+.3f} MB per 1,000 frames")


def main() -> None:
    """Parse the command line, and measure."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--of", choices=SOURCES, default="images")
    parser.add_argument("--frames", type=int, default=20_000)
    parser.add_argument("--noise", default="student-t")
    parser.add_argument("--recorded", action="store_true")
    parser.add_argument("--live", action="store_true")
    measure(parser.parse_args())


if __name__ == "__main__":
    main()
