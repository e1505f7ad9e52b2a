"""Measure the time of a frame, decoding included, against a plain OpenCV odometry.

    python benchmarks/speed.py [--repeats 3] [--frames 154] [--estimator window] [--clock cpu]

Measured on one core and on two, and by stage. Ours predicts the noise of each feature from all
default predictors by a generalized kernel of 2,000 centers. Both odometries read the same files, in
turn; a frame's time is that from one motion to the next. Each line is a process of its own, limited
to so many cores. OpenCV has as many threads for the baseline, and one for ours, as in ``probevo
run``, whose own threads use the other core. ``--clock cpu`` counts the CPU time of the process
instead, of all its threads, which other users of the machine change less.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from probevo.noise import GeneralizedKernel
    from probevo.sequences import Sequence
    from probevo.sequences.recording import StereoRecording

THREADS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
CLOCKS = {"wall": time.perf_counter, "cpu": time.process_time}
FIRST = 5
"""Frames of a pass that do not count: there is no motion yet, or compiled code is being loaded."""


def measure(
    path: Path, cores: int, estimator: str, *, clock: str, repeats: int, frames: int
) -> None:
    """Measure in this process, and print the result as JSON."""
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    import cv2
    import numpy as np

    import probevo as pv
    from probevo.allocator import keep_freed_memory

    keep_freed_memory()  # as ``probevo run`` does; both odometries gain by it
    sequence = cast("StereoRecording", pv.open_sequence(path))
    model = kernel(sequence, frames)
    stages: list[dict[str, float]] = []
    ours = []
    theirs = []
    for _ in range(repeats):
        cv2.setNumThreads(1)
        ours += gaps(ours_over(sequence, model, estimator, stages.append), frames, clock)
        cv2.setNumThreads(cores)
        theirs += gaps(theirs_over(sequence), frames, clock)
    stage_ms = {
        name: float(np.median([stage.get(name, 0.0) for stage in stages])) for name in stages[-1]
    }
    found = {
        "ours": float(np.median(ours)),
        "p99": float(np.percentile(ours, 99)),
        "theirs": float(np.median(theirs)),
        "stages": stage_ms,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    print(json.dumps(found))


def kernel(sequence: Sequence, frames: int) -> GeneralizedKernel:
    """Fit a model with all default predictors to the recording itself."""
    import numpy as np

    import probevo as pv
    from probevo.config.training import KERNEL_PREDICTORS
    from probevo.predictors import prediction_space
    from probevo.training.drive import joined
    from probevo.training.extraction import Extraction
    from probevo.training.gk.expectation import expect
    from probevo.training.supervised_drive import DriveInMemory
    from probevo.training.supervision import supervision_of

    count = min(frames, len(sequence), 60)
    space = prediction_space(KERNEL_PREDICTORS)
    config = pv.OdometryConfig(estimator="two-frame")
    drive = joined(Extraction(sequence, space, config, num_frames=count))
    supervised = DriveInMemory(
        drive, sequence.camera, supervision_of(sequence, "none", 0.0, num_frames=count)
    )
    found = expect(
        supervised, pv.noise.StudentT().predict, config.solver, truth_sigma=None
    ).feature_errors
    metric = pv.noise.metric.Metric.fitted(drive.phi, space.columns, space.may_be_undefined)
    model = pv.noise.GeneralizedKernel(
        neighbors=400,
        prior_counts=1.0,
        dof_counts=30.0,
        bias_counts=np.inf,
        weights=np.ones(len(space.columns)),
        refers_to="observation",
        time_correlation_ratio=1.0,
    )
    return model.fit(found.phi, found.errors, error_cov=found.error_cov, metric=metric)


def ours_over(
    sequence: Sequence,
    model: GeneralizedKernel,
    estimator: str,
    keep: Callable[[dict[str, float]], None],
) -> Iterator[None]:
    """Yield after each motion of probevo; hand the times of its stages to ``keep``."""
    import probevo as pv
    from probevo.tracking.preparation import prepare_ahead

    odometry = pv.StereoOdometry(
        sequence.camera, model, sequence.imu, config={"estimator": estimator}
    )
    for frame in prepare_ahead(sequence, odometry.config.tracking_of_estimator):
        motion = odometry.step(frame)
        if frame.index >= FIRST:
            keep(dict(motion.stage_ms))
        yield


def theirs_over(sequence: StereoRecording) -> Iterator[None]:
    """Yield after each motion of the baseline."""
    import cv2
    from opencv_odometry import OpenCvOdometry

    odometry = OpenCvOdometry(sequence.camera)
    for left, right in zip(sequence.left_files, sequence.right_files, strict=True):
        left_image = cv2.imread(str(left), cv2.IMREAD_GRAYSCALE)
        right_image = cv2.imread(str(right), cv2.IMREAD_GRAYSCALE)
        odometry.step(left_image, right_image)
        yield


def gaps(motions: Iterator[None], frames: int, clock: str) -> list[float]:
    """Return the times from each motion to the next, ms, by one of the clocks."""
    now = CLOCKS[clock]
    times = []
    previous = now()
    for number, _ in enumerate(motions, start=1):
        current = now()
        times.append(1e3 * (current - previous))
        previous = current
        if number == frames:
            break
    return times[FIRST:]


def measure_apart(
    path: Path, cores: int, estimator: str, *, clock: str, repeats: int, frames: int
) -> dict[str, Any]:
    """Measure in a process of its own."""
    words = [sys.executable, __file__, "--measure", str(path), str(cores)]
    words += ["--estimator", estimator, "--clock", clock]
    words += ["--repeats", str(repeats), "--frames", str(frames)]
    done = subprocess.run(
        words, env=os.environ | THREADS, stdout=subprocess.PIPE, text=True, check=True
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def main() -> None:
    """Parse the command line, and print a line for each recording and number of cores."""
    from recordings import available

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--frames", type=int, default=154)
    parser.add_argument("--estimator", choices=["two-frame", "window"], default="two-frame")
    parser.add_argument("--clock", choices=list(CLOCKS), default="wall")
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    repeats = arguments.repeats
    frames = arguments.frames
    if arguments.measure:
        path, cores = arguments.measure
        measure(
            Path(path),
            int(cores),
            arguments.estimator,
            clock=arguments.clock,
            repeats=repeats,
            frames=frames,
        )
        return
    print(f"{'recording':12} cores  ours  p99  baseline  ratio  p99/median  peak, MB   stages, ms")
    for name, path in available().items():
        for cores in (1, 2):
            found = measure_apart(
                path,
                cores,
                arguments.estimator,
                clock=arguments.clock,
                repeats=repeats,
                frames=frames,
            )
            ours = found["ours"]
            p99 = found["p99"]
            theirs = found["theirs"]
            stages = "  ".join(f"{stage} {ms:.2f}" for stage, ms in found["stages"].items())
            print(
                f"{name:12} {cores:5} {ours:5.1f} {p99:5.1f} {theirs:8.1f} {ours / theirs:6.2f}"
                f" {p99 / ours:8.2f} {found['peak_mb']:9.0f}   {stages}",
                flush=True,
            )


if __name__ == "__main__":
    main()
