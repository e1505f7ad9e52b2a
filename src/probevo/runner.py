"""A whole run: sequence → odometry → recorder → files. ``probevo run`` is this and a progress bar."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from time import perf_counter

import numpy as np

from probevo import __version__
from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.estimation.motion_estimate import MotionEstimate
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.files import check_folder, remove_stale, write_atomically
from probevo.noise import NoiseModel
from probevo.noise.named import check_model_camera, noise_model, portable
from probevo.odometry import StereoOdometry
from probevo.output.drawing import draw_tracks
from probevo.output.files import write_json, write_kitti_poses, write_tum
from probevo.output.motions_file import write_motions
from probevo.output.run_facts import run_facts
from probevo.output.run_result import RunRecorder, RunResult
from probevo.predictors import space_for
from probevo.run_config import RunConfig, config_text
from probevo.sequences import Frame, Sequence
from probevo.sequences.pose_files import FARTHEST_M
from probevo.sequences.requirements import check_imu
from probevo.sequences.without_imu import WithoutImu
from probevo.tracking.left_right import (
    FRAMES_TO_SEE,
    SwappedImagesError,
    check_left_right,
    count_matches,
)
from probevo.tracking.preparation import prepared_ahead

NUM_PICTURES = 4


@dataclass(frozen=True)
class Run:
    """What a run came to."""

    result: RunResult
    metrics: Metrics | None
    """None where the recording has no truth."""
    truth: FloatArray | None = None
    """True poses T_world_cam of its frames, [N, 4, 4], m; NaN where unknown."""
    pictures: tuple[tuple[str, bytes], ...] = ()
    """Caption and JPEG file of a few frames with their tracks."""


def run_sequence(
    sequence: Sequence,
    config: RunConfig,
    out: Path,
    on_step: Callable[[MotionEstimate], None] | None = None,
) -> Run:
    """Run the odometry over a recording and write everything that follows from it.

    Into ``out`` go, at the end, ``config.yaml``, ``trajectory.tum``, ``trajectory.kitti.txt``,
    ``motions.npz``, ``metrics.json`` (if truth is known) and ``report.html``; files of an earlier
    run are replaced. Whatever stops the run midway, a damaged image or Ctrl-C, the same files are
    written for the frames before and say what it was, and the exception goes on with a note that
    says so. Where there are none before, or left and right are swapped, nothing is written.

    Args:
        sequence: the recording.
        config: all settings.
        out: folder for the files; made if it is missing.
        on_step: called with the estimate of each frame, the first included.

    Raises:
        InputError: a file of the recording is at fault, its left and right images are swapped,
            ``out`` cannot be written to, or what ``noise_model`` and ``check_run`` raise.
    """
    sequence = sequence if config.imu else WithoutImu.of(sequence)
    noise = noise_model(config.noise)
    check_run(sequence, config, noise)
    check_folder(out, "--out")
    num_frames = min(len(sequence), config.max_frames or len(sequence))
    odometry = StereoOdometry(sequence.camera, noise, sequence.imu, config=config)
    recorder = RunRecorder()
    pictures = _Pictures.spread_over(num_frames)
    matches = np.zeros(2, np.int64)
    try:
        for frame in prepared_ahead(islice(sequence, num_frames), config.tracking):
            start = perf_counter()
            motion = odometry.step(frame)
            total_ms = 1e3 * (perf_counter() - start)
            recorder.add(
                frame.stamp_ns, motion, total_ms=total_ms, rejected=odometry.tracks.rejected
            )
            pictures.add(frame, odometry)
            matches += count_matches(odometry.tracks)
            if frame.index == min(FRAMES_TO_SEE, num_frames - 1):
                check_left_right(int(matches[0]), int(matches[1]), sequence.path)
            if on_step is not None:
                on_step(motion)
    except SwappedImagesError:
        raise
    except BaseException as stop:  # whatever it is, it goes on; but not without what was computed
        if (
            len(recorder.result()) > 1
        ):  # the first frame alone is no motion, and nothing to replace a run with
            _write(
                out,
                sequence,
                config,
                result=replace(recorder.result(), stopped=_reason(stop)),
                pictures=pictures,
            )
            stop.add_note(
                f"What was computed before, {len(recorder.result())} frames, lies in {out}."
            )
        raise
    return _write(out, sequence, config, result=recorder.result(), pictures=pictures)


def _reason(stop: BaseException) -> str:
    """What stopped a run, in words."""
    if isinstance(stop, KeyboardInterrupt):
        return "stopped by Ctrl-C."
    return (
        f"{stop.where}: {stop.what}"
        if isinstance(stop, InputError)
        else f"{type(stop).__name__}: {stop}"
    )


def check_run(sequence: Sequence, config: RunConfig, noise: NoiseModel) -> None:
    """Refuse what would only show after the whole run, or not at all.

    Raises:
        InputError: the noise model needs predictors that are not known, or belongs to another
            camera; the settings ask for an IMU that the recording does not have; or its truth is
            absurd.
    """
    space_for(noise.columns).check_recording(sequence)
    check_model_camera(config.noise, noise, sequence.camera)
    check_imu(sequence, config)
    truth = sequence.truth
    if truth is not None and (np.abs(truth.T_world_cam[:, :3, 3]) > FARTHEST_M).any():
        what = f"a true position is over {FARTHEST_M:g} m from the first."
        raise InputError(sequence.path, what, "Mend the ground truth: positions are in metres.")


def _write(
    out: Path, sequence: Sequence, config: RunConfig, result: RunResult, pictures: _Pictures
) -> Run:
    from probevo.output.report import (
        write_report,
    )  # only now: importing Matplotlib would hold up the first frame

    # Absolute, so that --config finds the recording and the noise model from any directory.
    found = {
        "sequence": (config.sequence or sequence.path).resolve(),
        "noise": portable(config.noise),
    }
    settings = config_text(config.model_copy(update=found))
    write_atomically(out / "config.yaml", f"# by probevo {__version__}\n{settings}")
    write_tum(out / "trajectory.tum", result.stamps_ns, result.T_world_cam)
    write_kitti_poses(out / "trajectory.kitti.txt", result.T_world_cam)
    write_motions(out / "motions.npz", result)
    truth = None if sequence.truth is None else sequence.truth.T_world_cam[: len(result)]
    metrics = None
    if truth is not None:
        metrics = evaluate(result.T_world_cam, truth, result.T_curr_prev, cov=result.cov)
        metrics = replace(metrics, out_of_domain=result.out_of_domain, stopped=result.stopped)
        write_json(out / "metrics.json", metrics.as_dict())
    else:
        remove_stale(out / "metrics.json")
    if len(result) >= 2:
        facts = run_facts(sequence, config, result)
        title = sequence.path.resolve().name
        write_report(
            out / "report.html",
            result,
            title,
            facts=facts,
            truth=truth,
            metrics=metrics,
            thumbnails=pictures.drawn,
            config=settings,
        )
    else:
        remove_stale(out / "report.html")
    return Run(result, metrics, truth, pictures=tuple(pictures.drawn))


@dataclass(frozen=True)
class _Pictures:
    """A few frames with their tracks, for the report."""

    chosen: frozenset[int]
    """Indices of the frames to draw."""
    drawn: list[tuple[str, bytes]] = field(default_factory=list)
    """Caption and JPEG file of those that have come."""

    @staticmethod
    def spread_over(num_frames: int) -> _Pictures:
        indices = np.linspace(1, num_frames - 1, 2 * NUM_PICTURES + 1)[1::2]
        return _Pictures(frozenset(np.round(indices).astype(int).tolist()))

    def add(self, frame: Frame, odometry: StereoOdometry) -> None:
        if frame.index not in self.chosen or frame.left is None:
            return
        tracks = odometry.tracks
        caption = f"Frame {frame.index}: {len(tracks)} tracks"
        self.drawn.append(
            (
                caption,
                draw_tracks(frame.left, tracks.prev_px, tracks.curr_px, weights=odometry.weights),
            )
        )
