"""Run the odometry over a recording: sequence → odometry → recorder → files.

``probevo run`` is this function with a progress bar.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from probevo import __version__
from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.window.inertial import Inertial
from probevo.evaluation.accelerometer_scale import AccelerometerScale, accelerometer_scale
from probevo.evaluation.ground_height import GroundHeights
from probevo.evaluation.metrics import Metrics
from probevo.geometry import se3
from probevo.measurements.correction import MotionCorrection
from probevo.measurements.sensor import Sensor
from probevo.noise.base import NoiseModel
from probevo.noise.named import is_learned, noise_model, other_camera, portable
from probevo.odometry import StereoOdometry
from probevo.output.drawing import draw_tracks
from probevo.output.headline import headline_drift
from probevo.output.json_file import write_json
from probevo.output.motions_file import write_motions
from probevo.output.ros.odometry_bag import check_odometry_path, write_odometry_bag
from probevo.output.rows import Rows
from probevo.output.run_facts import run_facts
from probevo.output.run_files import (
    METRICS,
    MOTIONS,
    REPORT,
    SETTINGS,
    SMOOTHED_KITTI,
    SMOOTHED_TUM,
    TRAJECTORY_KITTI,
    TRAJECTORY_TUM,
)
from probevo.output.run_result import RunRecorder, RunResult, facts_table
from probevo.output.viewer_file import ViewerFile, check_viewer_path, opened_viewer
from probevo.python_arguments import as_path, as_sensors, as_sequence
from probevo.run_checks import check_run
from probevo.run_config import RunConfig, as_run_config, config_text
from probevo.runs.smoothed_path import SmoothedPath
from probevo.sensor_kinds import load_sensors
from probevo.sequences import Frame, Sequence
from probevo.sequences.base import first_frames, imu_stream_of
from probevo.sequences.pose_files import write_kitti_poses, write_tum
from probevo.sequences.without_imu import WithoutImu
from probevo.storage.files import remove_stale, write_atomically, written_together
from probevo.storage.lock import locked
from probevo.tracking.fixed_features import FixedFeatureCount
from probevo.tracking.interlacing import Interlacing
from probevo.tracking.left_right import IdenticalImagesError, LeftRightCheck, SwappedImagesError
from probevo.tracking.pair_timing import PairTiming
from probevo.tracking.preparation import prepare_ahead

NUM_PICTURES = 4
"""Frames that the report shows with their tracks."""


@dataclass(frozen=True, repr=False)
class Run:
    """The results of a run over N frames."""

    result: RunResult
    metrics: Metrics | None
    """Comparison with the truth; None if the recording has no truth."""
    truth: FloatArray | None = None
    """True poses T_world_cam of the frames, [N, 4, 4], m; NaN where unknown."""
    pictures: tuple[tuple[str, bytes], ...] = ()
    """Caption and JPEG file of a few frames with their tracks."""

    def __repr__(self) -> str:
        """Return what a glance should show, in one line."""
        return f"Run({', '.join(f'{name} {text}' for name, text in self._facts())})"

    def _repr_html_(self) -> str:
        """Return the same as a table, for notebooks."""
        return facts_table(self._facts())

    def _facts(self) -> list[tuple[str, str]]:
        """Return name and text of what a glance should show: the run, and its errors if known."""
        facts = self.result.facts()
        metrics = self.metrics
        if metrics is None:
            return facts
        drift = headline_drift(metrics)
        if drift is not None:
            facts.append(("drift", f"{drift.translation_percent:.3g} % over {drift.segments} m"))
        if metrics.final_error_m is not None:
            facts.append(("error at the end", f"{metrics.final_error_m:.3g} m"))
        if metrics.anees is not None:
            facts.append(("NEES", f"{metrics.anees:.3g} (6 is consistent)"))
        return facts


def run_sequence(
    sequence: Sequence,
    config: RunConfig | Mapping[str, Any] | None,
    out: Path | str,
    on_step: Callable[[MotionEstimate], None] | None = None,
    *,
    sensors: Iterable[Sensor | MotionCorrection] = (),
) -> Run:
    """Run the odometry over a recording and write all results into a folder.

    The files are ``config.yaml``, ``trajectory.tum``, ``trajectory.kitti.txt``, ``motions.npz``,
    ``metrics.json`` (if truth is known) and ``report.html``; with a window also the smoothed path,
    ``trajectory.smoothed.tum`` and ``.kitti.txt``; and a bag if ``config.write`` names one. They
    are written at the end and replace those of an earlier run.

    If anything stops the run early, such as a damaged image or Ctrl-C, the same files are written
    for the frames so far, and name the reason; the exception is raised again with a note that says
    where they are. Nothing is written if fewer than two frames were processed, or if the left and
    right images are swapped.

    Args:
        sequence: the recording.
        config: all settings, or a dictionary of those that differ from the defaults.
        out: folder for the files; created if it is missing.
        on_step: called with the estimate of each frame, the first one included.
        sensors: further sensors, beside those that ``config.sensor`` names; they correct the path.

    Returns:
        The estimates, and their comparison with the truth.

    Raises:
        InputError: a file of the recording is damaged, the left and right images are swapped,
            ``out`` is not writable or another process is writing into it, the noise model is
            unknown, a sensor cannot be loaded, or ``check_run`` refuses the run.
    """
    # Check everything that can be checked before the first frame.
    sequence = as_sequence(sequence)
    out = as_path(out, "out")
    config = as_run_config(config)
    if not config.imu:
        sequence = WithoutImu.of(sequence)
    noise = noise_model(config.noise)
    check_run(sequence, config, noise)
    if config.write is not None:
        check_odometry_path(config.write, "--write")
    if config.viewer is not None:
        check_viewer_path(config.viewer, "--viewer")
    used = (*load_sensors(config.sensor, sequence), *as_sensors(sensors))
    with locked(out), opened_viewer(config.viewer) as viewer:
        return _run(
            sequence,
            config,
            out,
            noise=noise,
            on_step=on_step,
            sensors=used,
            viewer=viewer,
        )


def _run(
    sequence: Sequence,
    config: RunConfig,
    out: Path,
    *,
    noise: NoiseModel,
    on_step: Callable[[MotionEstimate], None] | None,
    sensors: tuple[Sensor | MotionCorrection, ...],
    viewer: ViewerFile | None,
) -> Run:
    """Run the odometry and write the results, while no other process writes into the folder."""
    num_frames = min(len(sequence), config.max_frames or len(sequence))
    odometry = StereoOdometry(sequence.camera, noise, sequence.imu, config=config, sensors=sensors)
    records = _Records.of_run(sequence, config, num_frames)
    left_right = LeftRightCheck(sequence.path, num_frames)
    try:
        for frame in prepare_ahead(first_frames(sequence, num_frames), config.tracking):
            start = perf_counter()
            motion = odometry.step(frame)
            total_ms = 1e3 * (perf_counter() - start)
            records.add(frame, motion, odometry, total_ms=total_ms)
            if viewer is not None:
                viewer.add(frame, odometry)

            left_right.see(frame, odometry.tracks)
            if on_step is not None:
                on_step(motion)
    except (SwappedImagesError, IdenticalImagesError):
        raise
    except BaseException as stop:
        # Keep what was computed, whatever the reason. The first frame is no motion, and must not
        # replace the results of an earlier run.
        result = records.result(sequence, odometry)
        if len(result) > 1:
            result = replace(result, stopped=_reason(stop))
            _write_results(
                out, sequence, config, result=result, pictures=records.pictures, viewer=viewer
            )
            stop.add_note(f"The results of the first {len(result)} frames are in {out}.")
        raise
    return _write_results(
        out,
        sequence,
        config,
        result=records.result(sequence, odometry),
        pictures=records.pictures,
        viewer=viewer,
    )


@dataclass(frozen=True)
class _Records:
    """Everything that a run collects frame by frame, for its files and its report."""

    recorder: RunRecorder
    """Motions, covariances, times and counts."""
    pictures: _Pictures
    smoothed: SmoothedPath
    timing: PairTiming
    """Test whether left and right images belong to the same frames."""
    interlacing: Interlacing
    """Test whether odd and even rows are of different times."""
    motions_of_images: Rows
    """Motions of the two-frame solves, [N, 4, 4], to compare with the accelerometer."""
    fixed: FixedFeatureCount
    """Features that do not move with the scene."""
    heights: GroundHeights
    """Heights above the ground, to compare with the known one."""

    @staticmethod
    def of_run(sequence: Sequence, config: RunConfig, num_frames: int) -> _Records:
        """Return empty records for a run over so many frames of a recording."""
        return _Records(
            recorder=RunRecorder(),
            pictures=_Pictures.spread_over(num_frames),
            smoothed=SmoothedPath(),
            timing=PairTiming(config.tracking),
            interlacing=Interlacing(),
            motions_of_images=Rows(np.float64, (4, 4)),
            fixed=FixedFeatureCount(sequence.camera),
            heights=GroundHeights(sequence.camera, config.camera_height_m),
        )

    def add(
        self, frame: Frame, motion: MotionEstimate, odometry: StereoOdometry, *, total_ms: float
    ) -> None:
        """Record a step of the odometry."""
        self.pictures.add(frame, odometry)
        self.smoothed.add(odometry.window)
        self.timing.add(frame)
        self.interlacing.add(frame)
        self.motions_of_images.add(odometry.T_curr_prev_before_window)
        if motion.status is Status.OK:
            self.fixed.add(
                odometry.tracks, motion.T_curr_prev, vehicle_tracks=odometry.tracks_of_vehicle
            )
        seen = odometry.tracks.subset(odometry.used)
        self.heights.add(
            frame.stamp_ns,
            odometry.T_curr_prev_before_window,
            seen.ids,
            seen.curr_px,
            is_ok=motion.status is Status.OK,
        )
        # Last: only then the frame counts, so that Ctrl-C between two of these lines does no harm.
        self.recorder.add(
            frame.stamp_ns,
            motion,
            total_ms=total_ms,
            rejected=odometry.tracks.rejected,
            imu_is_in_window=Inertial.of(odometry.window).is_used,
        )

    def result(self, sequence: Sequence, odometry: StereoOdometry) -> RunResult:
        """Return the results so far, with the checks of calibration and scale over all frames.

        The odometry may be a step ahead of the records, if that was interrupted in between.
        """
        rig = odometry.rig
        result = self.recorder.result()
        self.smoothed.add(odometry.window)  # adding a pose again changes nothing
        smoothed = self.smoothed.poses(odometry.window, num_frames=len(result))
        return replace(
            result,
            accelerometer_scale=_accelerometer_scale(sequence, result, self.motions_of_images),
            ground_height=self.heights.height(),
            jitter_sigma_rad=None if rig is None else rig.jitter.sigma_rad,
            row_errors=None if rig is None else rig.row_errors(sequence.camera),
            fixed_features=self.fixed.total(),
            steps_at_rest=self.fixed.steps_at_rest,
            right_delay_s=0.0 if rig is None else rig.delay.delay_s,
            readout_s=0.0 if rig is None else rig.image.readout_s,
            focal_length=None if rig is None else rig.focal.error(),
            smoothed=None if smoothed is None else smoothed.T_world_cam,
            smoothed_cov=None if smoothed is None else smoothed.cov,
            right_late_frames=self.timing.right_late_frames,
            is_interlaced=self.interlacing.is_found,
            other_camera=other_camera(odometry.noise, sequence.camera),
            noise_is_learned=is_learned(odometry.noise),
            imu_noise_factor=Inertial.of(odometry.window).noise_factor_in_use,
            imu_calibration_errors=Inertial.of(odometry.window).calibration_errors_in_use,
        )


def _accelerometer_scale(
    sequence: Sequence, result: RunResult, motions_of_images: Rows
) -> AccelerometerScale | None:
    """Compare the path by the images alone with the samples of the recording, if it has them at
    their own rate.

    Args:
        sequence: the recording.
        result: the run.
        motions_of_images: one for each frame, [N, 4, 4]; that of the first one is the identity.
    """
    stream = imu_stream_of(sequence)
    if stream is None or sequence.imu is None or len(result) < 2:
        return None
    return accelerometer_scale(
        result.stamps_ns,
        se3.chain_motions(motions_of_images.table()[1 : len(result)]),
        result.status == Status.OK,
        stream=stream,
        calibration=sequence.imu,
    )


def _reason(stop: BaseException) -> str:
    """Return what stopped a run, in words."""
    if isinstance(stop, KeyboardInterrupt):
        return f"stopped by {str(stop) or 'Ctrl-C'}."  # or the name of another signal
    if isinstance(stop, InputError):
        return f"{stop.where}: {stop.what}"
    return f"{type(stop).__name__}: {stop}"


def _write_results(
    out: Path,
    sequence: Sequence,
    config: RunConfig,
    *,
    result: RunResult,
    pictures: _Pictures,
    viewer: ViewerFile | None,
) -> Run:
    """Write all files of a run, and remove those of an earlier run that this one does not write."""
    # Only now: importing Matplotlib would delay the first frame.
    from probevo.output.report.report import RunDescription, write_report

    settings = _portable_settings(sequence, config)
    truth = None
    metrics = None
    if sequence.truth is not None:
        truth = sequence.truth.T_world_cam[: len(result)]
        metrics = result.metrics(truth)

    # All files or none: part of them beside those of an earlier run would pass for one run.
    with written_together(out) as folder:
        write_atomically(folder / SETTINGS, f"# by probevo {__version__}\n{settings}")
        write_tum(folder / TRAJECTORY_TUM, result.stamps_ns, result.T_world_cam)
        write_kitti_poses(folder / TRAJECTORY_KITTI, result.T_world_cam)
        if result.smoothed is not None:
            write_tum(folder / SMOOTHED_TUM, result.stamps_ns, result.smoothed)
            write_kitti_poses(folder / SMOOTHED_KITTI, result.smoothed)
        write_motions(folder / MOTIONS, result)
        if metrics is not None:
            write_json(folder / METRICS, metrics.as_dict())
        if len(result) >= 2:
            write_report(
                folder / REPORT,
                result,
                RunDescription(
                    title=sequence.path.resolve().name,
                    facts=run_facts(sequence, config, result),
                    config=settings,
                ),
                truth=truth,
                metrics=metrics,
                thumbnails=pictures.drawn,
            )
    # What an earlier run left does not belong to these results, whatever happens below.
    if result.smoothed is None:
        remove_stale(out / SMOOTHED_TUM)
        remove_stale(out / SMOOTHED_KITTI)
    if metrics is None:
        remove_stale(out / METRICS)
    if len(result) < 2:
        remove_stale(out / REPORT)
    if config.write is not None:
        write_odometry_bag(config.write, result, config.ros, camera=sequence.camera)
    if viewer is not None:
        viewer.finish(result, truth)
    return Run(result, metrics, truth, pictures=tuple(pictures.drawn))


def _portable_settings(sequence: Sequence, config: RunConfig) -> str:
    """Return all settings as YAML, with absolute paths: ``--config`` finds the recording and the
    noise model from any directory.

    Files that the run writes beside the folder are none of them: a run by these settings, or by
    others that begin with these, would replace those of this one.
    """
    names = ("calibration", "imu_noise", "truth", "mask_left", "mask_right")
    paths = {name: getattr(config, name) for name in names}
    absolute = {name: None if path is None else path.resolve() for name, path in paths.items()}
    absolute["sequence"] = (config.sequence or sequence.path).resolve()
    absolute["noise"] = portable(config.noise)
    absolute["sensor"] = tuple(path.resolve() for path in config.sensor)
    written = {"write": None, "viewer": None}
    return config_text(config.model_copy(update=absolute | written))


@dataclass(frozen=True)
class _Pictures:
    """A few frames, evenly spread over the run, with their tracks drawn for the report."""

    chosen: frozenset[int]
    """Indices of the frames to draw."""
    drawn: list[tuple[str, bytes]] = field(default_factory=list)
    """Caption and JPEG file of those that were processed."""

    @staticmethod
    def spread_over(num_frames: int) -> _Pictures:
        """Choose the middles of equal parts of a run; its first frame has no tracks."""
        indices = np.linspace(1, num_frames - 1, 2 * NUM_PICTURES + 1)[1::2]
        return _Pictures(frozenset(np.round(indices).astype(int).tolist()))

    def add(self, frame: Frame, odometry: StereoOdometry) -> None:
        """Draw the tracks of a frame, if it is one of those chosen."""
        if frame.index not in self.chosen or frame.left is None:
            return
        tracks = odometry.tracks
        caption = f"Frame {frame.index}: {len(tracks)} tracks"
        picture = draw_tracks(frame.left, tracks.prev_px, tracks.curr_px, weights=odometry.weights)
        self.drawn.append((caption, picture))
