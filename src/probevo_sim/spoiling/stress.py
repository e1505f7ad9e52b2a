"""The odometry on spoiled versions of a recording, held against its run on the recording itself.

A run on the clean images is the reference, so that any recording will do, with or without truth.
Both runs err, and the error of a step is compared with the sum of both covariances. What they have
in common, such as a wrong calibration, does not show.
"""

from __future__ import annotations

import hashlib
import json
from collections import abc
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtri

from probevo import __version__
from probevo.arrays import FloatArray, Image, IntArray
from probevo.errors import InputError
from probevo.estimation.motion_estimate import Status
from probevo.geometry import se3
from probevo.geometry.uncertainty import compound_pair, normalized_error_squared
from probevo.noise.named import noise_model
from probevo.odometry import StereoOdometry
from probevo.output.drawing import draw_tracks
from probevo.output.run_result import RunRecorder, RunResult
from probevo.run_config import RunConfig, config_text
from probevo.sequences import Frame, Sequence
from probevo.storage.files import write_atomically
from probevo.tracking.left_right import LeftRightCheck
from probevo.tracking.preparation import prepare_ahead
from probevo_sim.spoiling.config import SpoilConfig, StressConfig, StressPreset
from probevo_sim.spoiling.recording import SpoiledRecording

REGION = 0.9973
"""Probability of the region of a step's error that is counted, 3σ of a normal number."""
RUNS_FOLDER = "runs"
"""Folder of the finished runs, from which an interrupted command goes on."""
_REGION_NEES = float(chdtri(6, 1.0 - REGION))


@dataclass(frozen=True)
class StressRun:
    """One run on a spoiled version of the recording."""

    preset: StressPreset
    severity: float
    seed: int
    recording: SpoiledRecording
    num_frames: int
    """Frames of it that are run on."""

    @property
    def name(self) -> str:
        """Return the name of its file."""
        return f"{self.preset}-{self.severity:g}-{self.seed}"


@dataclass(frozen=True)
class StepErrors:
    """The K steps of a spoiled run that the clean run has solved, too."""

    is_ok: tuple[bool, ...]
    """Whether the spoiled run has solved them, [K]."""
    translation_m: tuple[float, ...]
    """Length of the error of the translation, [K]."""
    rotation_rad: tuple[float, ...]
    """Angle of the error of the rotation, [K]."""
    translation_sigma_m: tuple[float, ...]
    """Root of the trace of the claimed covariance of the translation, both runs, [K]."""
    rotation_sigma_rad: tuple[float, ...]
    """The same for the rotation, [K]."""
    nees: tuple[float, ...]
    """ξᵀ (Σ + Σ_clean)⁻¹ ξ, [K]."""


@dataclass(frozen=True)
class Figures:
    """What the runs of one preset and severity give; None where no step is OK."""

    preset: str
    severity: float
    steps: int
    """Steps that are compared."""
    ok: float
    """Share of them that are OK, 0 … 1."""
    translation_m: float | None
    """RMS of the error of the translation over the steps that are OK."""
    translation_sigma_m: float | None
    """RMS of what is claimed for it."""
    rotation_rad: float | None
    rotation_sigma_rad: float | None
    outside: float | None
    """Share of the steps that are OK whose error lies outside of the region ``REGION``."""
    not_ok_m: float | None
    """RMS of the error of the translation over the steps that are not OK; None without any."""
    not_ok_sigma_m: float | None
    """RMS of what is claimed for it."""

    @property
    def num_ok(self) -> int:
        """Return the number of steps that are OK."""
        return round(self.ok * self.steps)


@dataclass(frozen=True)
class Stress:
    """The figures of all presets and severities, and what they are compared with."""

    figures: tuple[Figures, ...]
    clean_ok: float
    """Share of the steps of the recording itself that are OK."""
    clean_sigma_m: float
    """RMS of the claimed standard deviation of its translation, over its steps that are OK."""
    clean_sigma_rad: float
    """The same for its rotation."""
    num_runs: int
    """Runs on spoiled versions."""
    num_resumed: int
    """Runs that an earlier command had already finished."""
    pictures: tuple[tuple[str, bytes], ...]
    """Caption and JPEG file of a spoiled frame of each preset, with its tracks."""

    def of(self, preset: str) -> list[Figures]:
        """Return the figures of one preset, the least severity first."""
        chosen = [figures for figures in self.figures if figures.preset == preset]
        return sorted(chosen, key=lambda figures: figures.severity)

    @property
    def presets(self) -> list[str]:
        """Names of the presets, in their order."""
        return list(dict.fromkeys(figures.preset for figures in self.figures))

    def as_dict(self) -> dict[str, Any]:
        """Return the figures for ``metrics.json``."""
        return {
            "clean": {
                "ok": self.clean_ok,
                "translation_sigma_m": self.clean_sigma_m,
                "rotation_sigma_rad": self.clean_sigma_rad,
            },
            "spoiled": [asdict(figures) for figures in self.figures],
        }


def stress(
    sequence: Sequence,
    config: RunConfig,
    settings: StressConfig,
    *,
    out: Path,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Stress:
    """Run the odometry on a recording, and on spoiled versions of it.

    Each finished run is kept in ``out / "runs"``. Those of an earlier call with the same recording
    and settings are not repeated. The same arguments give the same figures.

    Args:
        sequence: the recording; at most ``config.max_frames`` of its frames are looked at.
        config: settings of the odometry; the spoiled versions count their seeds from its seed on.
        settings: which spoiled versions.
        out: folder of the results.
        on_frame: called with the number of frames that are done, and of all.

    Raises:
        InputError: the recording has no images, is too short, or is damaged; hardly any step of
            it is OK; or the folder is not writable.
    """
    count = min(len(sequence), config.max_frames or len(sequence))
    runs = _planned(sequence, count, settings, seed=config.seed)
    total = count + sum(run.num_frames for run in runs)
    done = 0

    def on_one() -> None:
        """Count a frame."""
        nonlocal done
        done += 1
        on_frame(done, total)

    clean = _run(sequence, count, config, on_one=on_one).result()
    is_ok = clean.status == Status.OK
    if is_ok.sum() < 2:
        what = f"only {int(is_ok.sum())} of its {len(clean.status)} steps are OK on clean images."
        cure = "`probevo info` says what is wrong with a recording."
        raise InputError(sequence.path, what, cure)
    errors: dict[tuple[str, float], list[StepErrors]] = {}
    pictures: dict[str, tuple[str, bytes]] = {}
    num_resumed = 0
    for run in runs:
        file = out / RUNS_FOLDER / f"{run.name}.json"
        key = _fingerprint(clean, config, run.recording.config)
        picture = _Picture.of(run) if run.seed == config.seed else None
        if picture is not None and run.severity < max(settings.severities):
            picture = None
        picture_file = out / RUNS_FOLDER / f"{run.name}.jpg"
        steps = _finished(file, key)
        if steps is not None and (picture is None or picture_file.is_file()):
            num_resumed += 1
            done += run.num_frames
            on_frame(done, total)
        else:
            recorder = _run(run.recording, run.num_frames, config, on_one=on_one, look=picture)
            steps = step_errors(clean, recorder.result(), _kept(run))
            if picture is not None:
                write_atomically(picture_file, picture.jpeg)
            write_atomically(file, json.dumps({"key": key, "steps": asdict(steps)}) + "\n")
        if picture is not None:
            pictures[run.preset] = (picture.caption, picture_file.read_bytes())
        errors.setdefault((run.preset, run.severity), []).append(steps)
    variances = np.diagonal(clean.cov[is_ok], axis1=1, axis2=2)
    return Stress(
        figures=tuple(
            figures_of(preset, severity, parts) for (preset, severity), parts in errors.items()
        ),
        clean_ok=float(is_ok.mean()),
        clean_sigma_m=float(np.sqrt(variances[:, :3].sum(axis=1).mean())),
        clean_sigma_rad=float(np.sqrt(variances[:, 3:].sum(axis=1).mean())),
        num_runs=len(runs),
        num_resumed=num_resumed,
        pictures=tuple(pictures.values()),
    )


def step_errors(clean: RunResult, spoiled: RunResult, kept: IntArray) -> StepErrors:
    """Compare the steps of a spoiled run with the clean run between the same frames.

    Several clean steps are compounded as independent ones. Steps across which the clean
    run has a step that is not OK are left out.

    Args:
        clean: the run on N frames.
        spoiled: the run on M ≤ N of them.
        kept: numbers of these M frames among the N, ascending, [M].
    """
    rows: list[tuple[bool, float, float, float, float, float]] = []
    for k, (start, end) in enumerate(pairwise(kept.tolist())):
        steps = range(start, end)
        if any(clean.status[step] != Status.OK for step in steps):
            continue
        T_curr_prev = np.eye(4)
        cov = np.zeros((6, 6))
        for step in steps:
            T_curr_prev, cov = compound_pair(
                T_curr_prev, cov, clean.T_curr_prev[step], cov_c_b=clean.cov[step]
            )
        both = cov + spoiled.cov[k]
        error = se3.log(T_curr_prev @ se3.inverse(spoiled.T_curr_prev[k]))
        nees = normalized_error_squared(T_curr_prev, spoiled.T_curr_prev[k], both)
        rows.append(
            (
                bool(spoiled.status[k] == Status.OK),
                float(np.linalg.norm(error[:3])),
                float(np.linalg.norm(error[3:])),
                float(np.sqrt(np.trace(both[:3, :3]))),
                float(np.sqrt(np.trace(both[3:, 3:]))),
                float(nees),
            )
        )
    columns = list(zip(*rows, strict=True)) if rows else [()] * 6
    return StepErrors(
        is_ok=columns[0],
        translation_m=columns[1],
        rotation_rad=columns[2],
        translation_sigma_m=columns[3],
        rotation_sigma_rad=columns[4],
        nees=columns[5],
    )


def figures_of(preset: str, severity: float, runs: abc.Sequence[StepErrors]) -> Figures:
    """Summarise the steps of the runs of one preset and severity."""
    is_ok = np.concatenate([np.array(run.is_ok, bool) for run in runs])

    def together(name: str, chosen: Any) -> FloatArray:
        """Return one quantity of the chosen steps of all runs."""
        values = np.concatenate([np.array(getattr(run, name), float) for run in runs])
        return np.asarray(values[chosen])

    outside = together("nees", is_ok) > _REGION_NEES
    return Figures(
        preset=preset,
        severity=severity,
        steps=len(is_ok),
        ok=float(is_ok.mean()) if len(is_ok) else 0.0,
        translation_m=_rms_if_any(together("translation_m", is_ok)),
        translation_sigma_m=_rms_if_any(together("translation_sigma_m", is_ok)),
        rotation_rad=_rms_if_any(together("rotation_rad", is_ok)),
        rotation_sigma_rad=_rms_if_any(together("rotation_sigma_rad", is_ok)),
        outside=float(outside.mean()) if len(outside) else None,
        not_ok_m=_rms_if_any(together("translation_m", ~is_ok)),
        not_ok_sigma_m=_rms_if_any(together("translation_sigma_m", ~is_ok)),
    )


@dataclass
class _Picture:
    """The tracks on the frame of a run that is spoiled most."""

    number: int
    """Number of the frame within the run."""
    caption: str
    jpeg: bytes = b""

    @staticmethod
    def of(run: StressRun) -> _Picture | None:
        """Choose the frame; None if no image is changed."""
        shown = [plan for plan in run.recording.plans if plan.effect != "dropped"]
        amounts = [
            plan.amount if plan.effect not in (None, "frozen") else 0.0
            for plan in shown[1 : run.num_frames]
        ]
        if not amounts or max(amounts) == 0.0:
            return None
        number = 1 + int(np.argmax(amounts))
        effect = str(shown[number].effect).replace("_", " ")
        return _Picture(number, f"{run.preset}: {effect}, severity {run.severity:g}")

    def take(self, left: Image, odometry: StereoOdometry) -> None:
        """Draw the tracks of the step that has just been made."""
        tracks = odometry.tracks
        self.jpeg = draw_tracks(left, tracks.prev_px, tracks.curr_px, weights=odometry.weights)


def _planned(sequence: Sequence, count: int, settings: StressConfig, seed: int) -> list[StressRun]:
    """Return all runs on the spoiled versions of the first ``count`` frames."""
    runs = []
    for preset in settings.presets:
        for severity in settings.severities:
            for own_seed in range(seed, seed + settings.repeats):
                spoiling = settings.spoiling(preset, severity, own_seed)
                recording = SpoiledRecording.of(sequence, spoiling)
                num_frames = sum(plan.effect != "dropped" for plan in recording.plans[:count])
                runs.append(StressRun(preset, severity, own_seed, recording, num_frames))
    return runs


def _kept(run: StressRun) -> IntArray:
    """Return the numbers of the frames that are not dropped, as far as the run goes, [M]."""
    plans = run.recording.plans
    kept = [index for index, plan in enumerate(plans) if plan.effect != "dropped"]
    return np.array(kept[: run.num_frames])


def _run(
    sequence: Sequence,
    count: int,
    config: RunConfig,
    *,
    on_one: Callable[[], None],
    look: _Picture | None = None,
) -> RunRecorder:
    """Run the odometry over the first ``count`` frames."""
    odometry = StereoOdometry(
        sequence.camera, noise_model(config.noise), sequence.imu, config=config
    )
    recorder = RunRecorder()
    left_right = LeftRightCheck(sequence.path, count)
    for number, frame in enumerate(_prepared(sequence, count, config)):
        recorder.add(frame.stamp_ns, odometry.step(frame))
        left_right.see(frame, odometry.tracks)
        if look is not None and look.number == number and frame.left is not None:
            look.take(frame.left, odometry)
        on_one()
    return recorder


def _prepared(sequence: Sequence, count: int, config: RunConfig) -> Iterator[Frame]:
    return prepare_ahead(islice(sequence, count), config.tracking)


def _fingerprint(clean: RunResult, config: RunConfig, spoiling: SpoilConfig) -> str:
    """Return a hash of what the results depend on: the motions of the clean run stand for images,
    software and machine."""
    texts = (__version__, config_text(config), spoiling.model_dump_json())
    content = "\n".join(texts).encode() + clean.T_curr_prev.tobytes() + clean.cov.tobytes()
    return hashlib.sha256(content).hexdigest()


def _finished(file: Path, key: str) -> StepErrors | None:
    """Read the result of a finished run; None if there is none, or one of something else."""
    try:
        content = json.loads(file.read_text("utf-8"))
        if content["key"] != key:
            return None
        return StepErrors(**{name: tuple(values) for name, values in content["steps"].items()})
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _rms_if_any(values: FloatArray) -> float | None:
    return _rms(values) if len(values) else None
