"""The result of a run: its motions, their covariances, and how each was estimated."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from html import escape
from typing import Any

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.focal_length import FocalLengthError
from probevo.camera.rig_calibration import RowErrors
from probevo.errors import InputError
from probevo.estimation.motion_estimate import (
    COMMON_MODE_COLUMNS,
    MotionEstimate,
    SensorOutcome,
    Status,
)
from probevo.evaluation.accelerometer_scale import AccelerometerScale
from probevo.evaluation.consistency import drift_covariances
from probevo.evaluation.ground_height import GroundHeight
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.geometry import se3
from probevo.measurements.imu_calibration_errors import ImuCalibrationErrors
from probevo.measurements.imu_reason import ImuFault
from probevo.output.imu_use import ImuUse
from probevo.output.rows import Rows
from probevo.tracking.fixed_features import FixedFeatures, StepsAtRest

_RECORD = np.dtype(
    [
        ("stamp_ns", np.int64),
        ("T_world_cam", np.float64, (4, 4)),
        ("cov_cam_world", np.float64, (6, 6)),
        ("T_curr_prev", np.float64, (4, 4)),
        ("cov", np.float64, (6, 6)),
        ("common_mode", np.float64, (6, COMMON_MODE_COLUMNS)),
        ("path_cross_cov", np.float64, (6, 6)),
        ("noise_factor", np.float64),
        ("total_ms", np.float64),
        ("status", np.int64),
        ("num_tracks", np.int64),
        ("num_inliers", np.int64),
        ("num_used", np.int64),
        ("num_out_of_domain", np.int64),
    ]
)
"""Record that a recorder keeps of a frame, with the names of ``MotionEstimate`` and ``RunResult``;
−1 features out of domain stand for None."""
STEPS_WITHOUT_IMU = "steps_without_imu"
"""Name of the steps without an IMU in ``RunResult.unusable``; with the fault behind it, of those
that it caused. Steps of a test that the IMU passed later do not count."""
STEPS_WITHOUT_IMU_BY_FAULT = tuple(f"{STEPS_WITHOUT_IMU}_{fault.value}" for fault in ImuFault)
"""Names of the steps without an IMU by the fault that caused them: what they sum up to is counted
as ``STEPS_WITHOUT_IMU``, too."""
SIGMA_NAMES = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
"""Names of the standard deviations of ξ = [ρ; φ] along the axes of the current camera."""


@dataclass(frozen=True)
class SensorUse:
    """Number of steps in which a further sensor was used, gated, silent or excluded."""

    used: int = 0
    gated: int = 0
    """Steps whose measurements were rejected."""
    silent: Mapping[str, int] = field(default_factory=dict)
    """Steps without a measurement, by the reason that the sensor gave."""
    excluded: int = 0
    """Steps after it was found to be faulty, including that one."""
    excluded_at: int | None = None
    """Index of the first frame in which it is excluded; None if it is not."""
    reason: str | None = None
    """Why it is excluded."""

    def and_then(self, outcome: SensorOutcome, frame: int) -> SensorUse:
        """Return the same with one more step."""
        if outcome.state == "used":
            return replace(self, used=self.used + 1)
        if outcome.state == "gated":
            return replace(self, gated=self.gated + 1)
        if outcome.state == "silent":
            reason = outcome.reason or "no reason given"
            return replace(self, silent={**self.silent, reason: self.silent.get(reason, 0) + 1})
        return replace(
            self,
            excluded=self.excluded + 1,
            excluded_at=frame if self.excluded_at is None else self.excluded_at,
            reason=outcome.reason,
        )

    def __str__(self) -> str:
        """Return it in one line."""
        parts = [f"{self.used:,} steps used it"]
        if self.gated:
            parts.append(f"{self.gated:,} turned it away")
        parts += [f"{count:,} without: {reason}" for reason, count in self.silent.items()]
        if self.excluded_at is not None:
            parts.append(f"excluded from frame {self.excluded_at} on: {self.reason}")
        return ", ".join(parts)


@dataclass(frozen=True)
class RunResult:
    """A run over N frames.

    The first frame has a pose but no motion: the arrays of motions start at the second.
    """

    stamps_ns: IntArray
    """Time of each frame, [N]."""
    T_world_cam: FloatArray
    """Poses of the left camera, world = first camera, [N, 4, 4], m."""
    T_curr_prev: FloatArray
    """Relative motions, [N-1, 4, 4], m."""
    cov: FloatArray
    """Covariance of the left perturbation [ρ; φ] of each motion, [N-1, 6, 6], m and rad."""
    common_mode: FloatArray
    """Columns of the common-mode errors of all motions, [N-1, 6, C]; see
    ``MotionEstimate.common_mode``."""
    path_cross_cov: FloatArray
    """Cross-covariances of each motion with the path before it, [N-1, 6, 6]; see
    ``MotionEstimate.path_cross_cov``."""
    status: IntArray
    """``Status`` of each motion, [N-1]."""
    num_tracks: IntArray
    """Tracks of each motion, [N-1]."""
    num_inliers: IntArray
    """Tracks that are inliers, [N-1]."""
    stage_ms: dict[str, FloatArray]
    """Wall time of each stage, [N-1], ms, by name in the order of the flow; 0 where a stage did not
    run."""
    total_ms: FloatArray
    """Wall time of the whole step, [N-1], ms."""
    rejected: dict[str, int] = field(default_factory=dict)
    """Number of candidate points that each consistency check rejected, by the check's name."""
    num_used: IntArray | None = None
    """Tracks used in the solve, [N-1]; None if it is not known."""
    num_out_of_domain: IntArray | None = None
    """Tracks used that are outside of the noise model's domain, [N-1]; None if it has none."""
    noise_factor: FloatArray | None = None
    """Factor of the noise model's variances in each step, [N-1] (``NoiseScale``); None if it is not
    known."""
    cov_cam_world: FloatArray | None = None
    """Covariance of the left perturbation of T_cam_world of each frame, [N, 6, 6], m and rad, where
    sensors have corrected the poses (``MotionEstimate.cov_cam_world``); None without sensors."""
    smoothed: FloatArray | None = None
    """Poses as they left the window, with what later frames say of them, [N, 4, 4], m; None for the
    two-frame estimator."""
    smoothed_cov: FloatArray | None = None
    """Covariance of the left perturbation of T_cam_world of these, [N, 6, 6], m and rad; None for
    the two-frame estimator."""
    stopped: str | None = None
    """Reason why the run stopped early, such as a damaged image; None if it did not."""
    jitter_sigma_rad: FloatArray | None = None
    """Standard deviation by which pitch, yaw and roll of the right camera relative to the left one
    are off in each frame, as estimated at the end, [3]; None without self-calibration."""
    row_errors: RowErrors | None = None
    """Errors of the rows of the right images, as estimated at the end; None without
    self-calibration."""
    fixed_features: FixedFeatures | None = None
    """Features that stayed where they are although the motion should have moved them; None without
    any."""
    steps_at_rest: StepsAtRest | None = None
    """Steps whose motion leaves its features where they are, and what moves in them; None if that
    is not known."""
    right_delay_s: float = 0.0
    """Time by which right images are exposed later than left ones, within a frame, as it was
    corrected at the end; negative if they are exposed earlier."""
    readout_s: float = 0.0
    """Time from the exposure of the first row of an image to that of the last one, as it was
    corrected at the end; negative if rows are read from the bottom."""
    focal_length: FocalLengthError | None = None
    """Error of the focal length that the images show; None without self-calibration."""
    right_late_frames: int = 0
    """Frames by which the right images are late, as ``PairTiming`` finds it; negative if the left
    ones are, and 0 also where nothing is known."""
    is_interlaced: bool = False
    """Whether odd rows of the images are of another time than even ones (``Interlacing``)."""
    other_camera: str | None = None
    """Difference of the camera from the one on which the noise model was trained, in words; None
    if there is none."""
    noise_is_learned: bool = False
    """Whether the noise model was learned from recordings."""
    imu_left_out: str | None = None
    """Why the window did not use the IMU at the end of the run, the most frequent reason since it
    was last used; None if it did, or there was none."""
    imu_fault: ImuFault | None = None
    """Kind of the reason in ``imu_left_out``."""
    imu_unused_from: int | None = None
    """Index of the first frame after the window last used the IMU; None if it did at the end, or
    never."""
    imu_noise_factor: float | None = None
    """Factor by which the variances of the IMU's samples exceed those of its calibration, as the
    window assumed at the end; None where it uses no IMU."""
    imu_calibration_errors: ImuCalibrationErrors | None = None
    """What the images have shown of the errors of the IMU's calibration; None where the window uses
    no IMU at the end."""
    accelerometer_scale: AccelerometerScale | None = None
    """Length of the path by the images over that by the accelerometer; None if that is not
    known."""
    ground_height: GroundHeight | None = None
    """Height of the camera above the ground by the images; None if that is not known."""
    unusable: dict[str, int] = field(default_factory=dict)
    """Samples, features and images that could not be used, counted by what was wrong with them
    (``Defect``)."""
    sensors: dict[str, SensorUse] = field(default_factory=dict)
    """Use of each further sensor, by name."""

    @property
    def faults(self) -> dict[str, int]:
        """Count all faults of the run by name; empty if there were none.

        They are frames that were lost, by the stamps; steps that were not solved, by their status;
        steps without a sensor that was found to lie; and what was ``unusable``.
        """
        counts = {"lost_frames": num_lost_frames(self.stamps_ns)}
        for status in Status:
            if status not in (Status.FIRST, Status.OK):
                counts[f"steps_{status.name.lower()}"] = int((self.status == status).sum())
        silent_steps = {f"steps_without_{name}": use.excluded for name, use in self.sensors.items()}
        return {
            name: count for name, count in (counts | silent_steps | self.unusable).items() if count
        }

    @property
    def out_of_domain(self) -> float | None:
        """Share, 0 … 1, of all features used that lie outside of the noise model's domain."""
        if self.num_used is None or self.num_out_of_domain is None:
            return None
        if not self.num_used.any():
            return None
        return float(self.num_out_of_domain.sum() / self.num_used.sum())

    def drift_covariances_from(self, origin: int) -> FloatArray:
        """Compute the covariances of all poses from a frame on, relative to that frame.

        What sensors of the pose say is known relative to the first frame alone. From a later one
        on, the motions are compounded as if there were no such sensors, which is conservative. The
        steps of a window correct the path before them. From a later frame on, these corrections
        cannot be distinguished from new errors, and count as such, which is conservative.

        Args:
            origin: the frame.

        Returns:
            Covariance of the left perturbation of T_cam_world, [N − origin, 6, 6]; 0 at the first.
        """
        if self.cov_cam_world is not None and origin == 0:
            return self.cov_cam_world
        cross_cov = self.path_cross_cov[origin:]
        # What was read from a file has the smoothed covariances, but not the smoothed poses.
        is_smoothed = self.smoothed is not None or self.smoothed_cov is not None
        if is_smoothed and origin > 0:
            cross_cov = np.zeros_like(cross_cov)
        return drift_covariances(
            self.T_curr_prev[origin:],
            self.cov[origin:],
            self.common_mode[origin:],
            path_cross_cov=cross_cov,
        )

    def metrics(self, T_world_cam_true: FloatArray) -> Metrics:
        """Compare the run with true poses of its frames, [N, 4, 4], m; NaN where unknown."""
        smoothed = None
        if self.smoothed is not None:
            smoothed = evaluate(self.smoothed, T_world_cam_true).of_path()
        return replace(
            evaluate(self.T_world_cam, T_world_cam_true, self.T_curr_prev, cov=self.cov),
            out_of_domain=self.out_of_domain,
            smoothed=smoothed,
            faults=self.faults,
            stopped=self.stopped,
        )

    def __len__(self) -> int:
        """Return the number of frames N."""
        return len(self.stamps_ns)

    def __repr__(self) -> str:
        """Return the number of frames, the duration, the path and the statuses, in one line."""
        return f"RunResult({', '.join(f'{name} {text}' for name, text in self.facts())})"

    def _repr_html_(self) -> str:
        """Return the same as a table, for notebooks."""
        return facts_table(self.facts())

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with a row a frame: pose, motion, its σ, and its status.

        Positions and distances are in m, quaternions (x, y, z, w) those of T_world_cam, standard
        deviations those of ``cov`` in m and rad. What belongs to a motion is NaN at the first
        frame. Its index is the stamp, ns.

        Raises:
            InputError: pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            cure = "Install it: pip install pandas."
            raise InputError("to_dataframe", "it needs the package pandas.", cure) from error
        from scipy.spatial.transform import Rotation

        sigma = np.sqrt(np.diagonal(self.cov, axis1=1, axis2=2))
        quaternions = Rotation.from_matrix(self.T_world_cam[:, :3, :3]).as_quat(canonical=True)
        columns: dict[str, Any] = {
            f"{axis}_m": self.T_world_cam[:, k, 3] for k, axis in enumerate("xyz")
        }
        columns |= {f"q{axis}": quaternions[:, k] for k, axis in enumerate("xyzw")}
        motion_columns = {
            "distance_m": np.linalg.norm(self.T_curr_prev[:, :3, 3], axis=1),
            **{f"sigma_{name}": sigma[:, k] for k, name in enumerate(SIGMA_NAMES)},
            "num_tracks": self.num_tracks,
            "num_inliers": self.num_inliers,
            "total_ms": self.total_ms,
        }
        columns |= {name: np.r_[np.nan, values] for name, values in motion_columns.items()}
        names = [Status(int(status)).name for status in self.status]
        columns["status"] = ["FIRST", *names][: len(self)]
        return pd.DataFrame(columns, index=pd.Index(self.stamps_ns, name="stamp_ns"))

    def facts(self) -> list[tuple[str, str]]:
        """Return name and text of what a glance should show."""
        duration_s = 1e-9 * float(self.stamps_ns[-1] - self.stamps_ns[0]) if len(self) else 0.0
        path_m = float(np.linalg.norm(self.T_curr_prev[:, :3, 3], axis=1).sum())
        counts = Counter(Status(int(status)).name for status in self.status)
        return [
            ("frames", str(len(self))),
            ("duration", f"{duration_s:.4g} s"),
            ("path", f"{path_m:.4g} m"),
            ("steps", ", ".join(f"{count} {name}" for name, count in counts.most_common())),
        ]


def num_lost_frames(stamps_ns: IntArray) -> int:
    """Count the frames that are missing where a step is longer than the median one.

    Args:
        stamps_ns: of the N frames that are there, [N], ns.
    """
    steps_ns = np.diff(stamps_ns)
    if len(steps_ns) == 0:
        return 0
    return int(np.maximum(np.round(steps_ns / np.median(steps_ns)) - 1.0, 0.0).sum())


def facts_table(facts: list[tuple[str, str]]) -> str:
    """Return names and texts as a table in HTML."""
    rows = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in facts
    )
    return f"<table>{rows}</table>"


class RunRecorder:
    """A recorder collects the estimates of a run as they come, 1 kB each.

    Its ``result`` may be requested at any time.
    """

    def __init__(self) -> None:
        self._frames = Rows(_RECORD)
        self._stage_ms: dict[str, Rows] = {}
        self._rejected: Counter[str] = Counter()
        self._unusable: Counter[str] = Counter()
        self._sensors: dict[str, SensorUse] = {}
        self._imu = ImuUse()

    def add(
        self,
        stamp_ns: int,
        motion: MotionEstimate,
        *,
        total_ms: float | None = None,
        rejected: Mapping[str, int] | None = None,
        imu_is_in_window: bool = False,
    ) -> None:
        """Record the estimate of the next frame.

        Args:
            stamp_ns: time of the frame.
            motion: its estimate; of the first frame, only its existence counts.
            total_ms: wall time of the step; the sum of its stages by default.
            rejected: points rejected at this step, by the check's name.
            imu_is_in_window: whether the poses of the window depend on an IMU
                (``Inertial.is_used``).
        """
        index = len(self._frames)
        # A stage that runs for the first time took 0 ms in the steps before. The first frame is no
        # step, and its stages do not count.
        if index > 0:
            for name in motion.stage_ms:
                if name not in self._stage_ms:
                    self._stage_ms[name] = Rows(np.float64, zeros=index)
        for name, times_ms in self._stage_ms.items():
            times_ms.add(motion.stage_ms.get(name, 0.0))
        self._rejected.update(rejected or {})
        self._imu.add(index, motion.imu_reason, is_in_window=imu_is_in_window)
        if motion.imu_reason is not None and motion.imu_reason.fault is not ImuFault.TESTING:
            self._unusable[STEPS_WITHOUT_IMU] += 1
            self._unusable[f"{STEPS_WITHOUT_IMU}_{motion.imu_reason.fault.value}"] += 1
        for missing in motion.missing:
            self._unusable[missing.defect.value] += missing.count
        for outcome in motion.sensors:
            use = self._sensors.get(outcome.name, SensorUse())
            self._sensors[outcome.name] = use.and_then(outcome, index)
        record = np.zeros((), _RECORD)
        record["stamp_ns"] = stamp_ns
        record["T_world_cam"] = motion.T_world_cam
        record["cov_cam_world"] = motion.cov_cam_world
        record["T_curr_prev"] = motion.T_curr_prev
        record["cov"] = motion.cov
        record["common_mode"] = motion.common_mode
        record["path_cross_cov"] = motion.path_cross_cov
        record["noise_factor"] = motion.noise_factor
        record["total_ms"] = sum(motion.stage_ms.values()) if total_ms is None else total_ms
        record["status"] = motion.status
        record["num_tracks"] = motion.num_tracks
        record["num_inliers"] = motion.num_inliers
        record["num_used"] = motion.num_used
        num_outside = motion.num_out_of_domain
        record["num_out_of_domain"] = -1 if num_outside is None else num_outside
        self._frames.add(record)

    def result(self) -> RunResult:
        """Collect all that was recorded so far.

        A frame counts once its record is added, last of all; one at which ``add`` was interrupted
        does not.
        """
        frames = self._frames.table()
        num_frames = len(frames)
        # The first frame has a stamp and a pose, but no motion.
        motions = frames[1:]
        T_curr_prev = motions["T_curr_prev"].copy()
        # The path is that of the motions, unless sensors have corrected the poses.
        T_world_cam = se3.chain_motions(T_curr_prev)[:num_frames]
        cov_cam_world = None
        if self._sensors:
            T_world_cam = frames["T_world_cam"].copy()
            cov_cam_world = frames["cov_cam_world"].copy()
        num_outside = motions["num_out_of_domain"]
        left_out = self._imu.left_out
        unusable = self._unusable.copy()
        if self._imu.num_tested:
            unusable[STEPS_WITHOUT_IMU] += self._imu.num_tested
            unusable[f"{STEPS_WITHOUT_IMU}_{ImuFault.TESTING.value}"] += self._imu.num_tested
        return RunResult(
            stamps_ns=frames["stamp_ns"].copy(),
            T_world_cam=T_world_cam,
            T_curr_prev=T_curr_prev,
            cov=motions["cov"].copy(),
            common_mode=motions["common_mode"].copy(),
            path_cross_cov=motions["path_cross_cov"].copy(),
            cov_cam_world=cov_cam_world,
            status=motions["status"].copy(),
            num_tracks=motions["num_tracks"].copy(),
            num_inliers=motions["num_inliers"].copy(),
            stage_ms={
                name: times_ms.table()[1:num_frames] for name, times_ms in self._stage_ms.items()
            },
            total_ms=motions["total_ms"].copy(),
            rejected=dict(self._rejected),
            unusable=dict(unusable),
            sensors=dict(self._sensors),
            imu_left_out=None if left_out is None else left_out.text,
            imu_fault=None if left_out is None else left_out.fault,
            imu_unused_from=self._imu.unused_from,
            noise_factor=motions["noise_factor"].copy(),
            num_used=motions["num_used"].copy(),
            num_out_of_domain=np.maximum(num_outside, 0) if (num_outside >= 0).any() else None,
        )
