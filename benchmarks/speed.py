"""Time of a frame, decoding included, against the yardstick in the same run: one core and two, and
by stage.

python benchmarks/speed.py [--repeats 3] [--frames 154]

Ours predicts the noise of each feature from all default predictors by a generalized kernel of 2,000
centers. Both read the same files and go over them in turn; a frame's time is that from one motion
to the next. Each line is a process of its own, held to so many cores. OpenCV has as many threads
for the yardstick, and one for ours, as in ``probevo run``, whose own threads use the other core.
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

THREADS = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
FIRST = 5
"""Frames of a pass that do not count: there is no motion yet, or the compiled code is being loaded.
"""


def measure(path: Path, cores: int, repeats: int, frames: int) -> None:
    """In a process of its own: print what was measured as JSON."""
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    import cv2
    import numpy as np

    import probevo as pv
    from probevo.allocator import keep_freed_memory

    keep_freed_memory()  # as ``probevo run`` does; both gain by it
    sequence = pv.open_sequence(path)
    model = kernel(sequence, frames)
    stages: list[dict[str, float]] = []
    ours = []
    theirs = []
    for _ in range(repeats):
        cv2.setNumThreads(1)
        ours += gaps(ours_over(sequence, model, stages.append), frames)
        cv2.setNumThreads(cores)
        theirs += gaps(theirs_over(sequence), frames)
    own = {name: float(np.median([s.get(name, 0.0) for s in stages])) for name in stages[-1]}
    found = {
        "ours": float(np.median(ours)),
        "p99": float(np.percentile(ours, 99)),
        "theirs": float(np.median(theirs)),
        "stages": own,
        "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
    }
    print(json.dumps(found))


def kernel(sequence, frames: int):
    """A model with all default predictors, none of them cut away, from the recording itself."""
    import numpy as np

    import probevo as pv
    from probevo.predictors import prediction_space
    from probevo.training.drive import joined
    from probevo.training.extraction import Extraction
    from probevo.training.gk.expectation import expect
    from probevo.training.settings import KERNEL
    from probevo.training.supervised_drive import DriveInMemory
    from probevo.training.supervision import supervision_of

    count = min(frames, len(sequence), 60)
    space = prediction_space(KERNEL)
    config = pv.OdometryConfig()
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
    return model.fit(found.phi, found.errors, error_cov=found.spread, metric=metric)


def ours_over(sequence, model, keep: Callable[[dict[str, float]], None]) -> Iterator[None]:
    import probevo as pv
    from probevo.tracking.preparation import prepare_ahead

    odometry = pv.StereoOdometry(sequence.camera, model, sequence.imu)
    for frame in prepare_ahead(sequence, odometry.config.tracking):
        motion = odometry.step(frame)
        if frame.index >= FIRST:
            keep(dict(motion.stage_ms))
        yield


def theirs_over(sequence) -> Iterator[None]:
    import cv2
    from opencv_odometry import OpenCvOdometry

    odometry = OpenCvOdometry(sequence.camera)
    for left, right in zip(sequence.left_files, sequence.right_files, strict=True):
        odometry.step(*(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in (left, right)))
        yield


def gaps(motions: Iterator[None], frames: int) -> list[float]:
    """Milliseconds from each motion to the next."""
    times = []
    before = time.perf_counter()
    for number, _ in enumerate(motions, start=1):
        now = time.perf_counter()
        times.append(1e3 * (now - before))
        before = now
        if number == frames:
            break
    return times[FIRST:]


def main() -> None:
    from recordings import available

    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--frames", type=int, default=154)
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure:
        measure(Path(given.measure[0]), int(given.measure[1]), given.repeats, given.frames)
        return
    print(f"{'recording':12} cores  ours  p99  yardstick  ratio  p99/median  peak, MB   stages, ms")
    for name, path in available().items():
        for cores in (1, 2):
            words = [sys.executable, __file__, "--measure", str(path), str(cores)]
            words += ["--repeats", str(given.repeats), "--frames", str(given.frames)]
            done = subprocess.run(
                words, env=os.environ | THREADS, stdout=subprocess.PIPE, text=True, check=True
            )
            found = json.loads(done.stdout)
            ours = found["ours"]
            p99 = found["p99"]
            theirs = found["theirs"]
            row = (
                f"{name:12} {cores:5} {ours:5.1f} {p99:5.1f} {theirs:9.1f} {ours / theirs:6.2f}"
                f" {p99 / ours:8.2f}"
            )
            stages = "  ".join(f"{stage} {ms:.2f}" for stage, ms in found["stages"].items())
            print(f"{row} {found['peak_mb']:9.0f}   {stages}", flush=True)


if __name__ == "__main__":
    main()
