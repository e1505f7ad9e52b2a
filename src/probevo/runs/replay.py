"""Replay of a finished run for the viewer, with images and features from its recording.

A run stores its motions and the effective settings, not its images and features. Running the same
settings again gives the same features.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np

from probevo.noise.named import noise_model
from probevo.odometry import StereoOdometry
from probevo.output.run_result import RunResult
from probevo.output.viewer_file import ViewerFile
from probevo.run_config import RunConfig
from probevo.sensor_kinds import load_sensors
from probevo.sequences import Sequence
from probevo.sequences.without_imu import WithoutImu
from probevo.tracking.preparation import prepare_ahead

SAME_M = 1e-6
"""Largest difference between two runs that rounding on another processor may cause, m."""


def write_viewer_file_again(
    path: Path,
    result: RunResult,
    sequence: Sequence,
    config: RunConfig,
    *,
    on_frame: Callable[[], None] = lambda: None,
) -> bool:
    """Run a finished run's recording again, and write it for the viewer.

    Args:
        path: a file ``.rrd``.
        result: the run, of N frames.
        sequence: its recording, of N frames or more.
        config: the effective settings of the run.
        on_frame: called after each frame, for a progress bar.

    Returns:
        Whether the motions are the same as in the run. If not, the run was made with another
        version of probevo or of the recording, and the features shown are not exactly its own.

    Raises:
        InputError: the recording is damaged, or the noise model, a sensor or the file cannot be
            used.
    """
    if not config.imu:
        sequence = WithoutImu.of(sequence)
    odometry = StereoOdometry(
        sequence.camera,
        noise_model(config.noise),
        sequence.imu,
        config=config,
        sensors=load_sensors(config.sensor, sequence),
    )
    motions = []
    viewer = ViewerFile(path)
    try:
        for frame in prepare_ahead(islice(sequence, len(result)), config.tracking):
            motions.append(odometry.step(frame).T_curr_prev)
            viewer.add(frame, odometry)
            on_frame()
        truth = None if sequence.truth is None else sequence.truth.T_world_cam[: len(result)]
        viewer.finish(result, truth)
    finally:
        viewer.discard()
    return bool(np.allclose(motions[1:], result.T_curr_prev, rtol=0.0, atol=SAME_M))
