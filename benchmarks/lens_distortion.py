"""Measure what the distortion field of the self-calibration gains, and whether its claims hold.

    python benchmarks/lens_distortion.py

First on real recordings: drift over pieces of 10 to 50 m and rotation with the field and without
it, and the size that the prior of the field, which is learned on line, has at the end (τ). On MH_01
the end error instead of a drift.

Then on features of rendered streets, which are moved by a field drawn at random, as by lenses whose
distortion the calibration has not removed. The truth is exact, so that NEES, divided by its 6
dimensions, is 1 where a covariance holds: that of the motion from frame to frame, and over eight
frames by the joint covariance of the window.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from plain_odometry import RECORDINGS
from window import SCENES, SPAN

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.image_errors import INITIAL_SIGMA_PX, NUM_ERRORS, ImageErrors
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.stereo import StereoCamera
from probevo.evaluation.metrics import evaluate
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.sequences.frame import Frame, StereoFeatures
from probevo_sim.scene.writer import write_scene

FLAWLESS_PX = 1e-6
"""Prior standard deviation of a field that is taken for zero."""
DISTORTED = ("city, clean", "residential, clean", "rover's loop, clean")
"""Scenes of ``window.py`` whose features are moved."""
SIGMAS_PX = (0.0, 0.1, 0.2, 0.4)
"""Standard deviations from which the coefficients of a field are drawn."""
FRAMES = 200
"""Most frames of a scene."""


@dataclass(frozen=True)
class Result:
    """What an odometry has made of a recording."""

    T_world_cam: FloatArray
    """The live path, [N, 4, 4], m."""
    step_nees: list[float]
    """Of each step, over its 6 dimensions; empty without truth."""
    span_nees: list[float]
    """Of the motion over ``SPAN`` frames of the window."""
    tau_px: float
    """τ at the end."""


def run(
    frames: Iterable[Frame],
    camera: StereoCamera,
    truth: FloatArray,
    *,
    estimator: str,
    tau_px: float,
) -> Result:
    """Run an odometry without IMU, with a prior of the field."""
    initial = replace(RigCalibration.initial(), image=ImageErrors.initial(tau_px))
    with patch.object(RigCalibration, "initial", return_value=initial):
        odometry = pv.StereoOdometry(camera, config={"estimator": estimator})
        path = [np.eye(4)]
        step_nees = []
        span_nees = []
        for k, frame in enumerate(frames):
            estimate = odometry.step(frame)
            if k == 0:
                continue
            path.append(path[-1] @ se3.inverse(estimate.T_curr_prev))
            step_nees.append(nees(estimate.T_curr_prev, estimate.cov, truth, (k, k - 1)))
            if estimator == "window" and k >= SPAN:
                T, cov = odometry.relative(k, k - SPAN)
                span_nees.append(nees(T, cov, truth, (k, k - SPAN)))
    tau_px = odometry.rig.image.distortion_sigma_px if odometry.rig else 0.0
    return Result(np.array(path), step_nees, span_nees, tau_px)


def nees(T: FloatArray, cov: FloatArray, truth: FloatArray, between: tuple[int, int]) -> float:
    """Return the squared error of a motion in units of its covariance, over its 6 dimensions."""
    curr, prev = between
    true = se3.inverse(truth[curr]) @ truth[prev]
    return float(normalized_error_squared(T[None], true[None], cov[None])[0]) / 6.0


def drift_text(path: FloatArray, truth: FloatArray, start: int) -> str:
    """Return drift and rotation from a frame on, or the end error where there is no drift."""
    count = len(path)
    relative = [se3.inverse(poses[start]) @ poses[start:count] for poses in (path, truth)]
    found = evaluate(*relative)
    if found.short_t_percent is None:
        return f"{1e3 * (found.final_error_m or 0.0):.1f} mm"
    return f"{found.short_t_percent:.2f} / {found.short_r_deg_per_m:.4f}"


def tracked(sequence: pv.sequences.Sequence) -> list[dict[int, FloatArray]]:
    """Return the observations of each frame by the identity of their feature, as tracked."""
    odometry = pv.StereoOdometry(sequence.camera, config={"self_calibration": False})
    seen: list[dict[int, FloatArray]] = []
    for frame, _ in zip(sequence, range(FRAMES), strict=False):
        odometry.step(frame)
        seen.append({})
        tracks = odometry.tracks
        if len(seen) > 1:
            seen[-2].update(zip(tracks.ids.tolist(), tracks.prev_px, strict=True))
            seen[-1].update(zip(tracks.ids.tolist(), tracks.curr_px, strict=True))
    return seen


def distorted(
    seen: list[dict[int, FloatArray]], sequence: pv.sequences.Sequence, field_px: FloatArray
) -> Iterator[Frame]:
    """Yield frames of features as lenses with this distortion field show them."""
    errors = replace(ImageErrors.initial(), mean=np.concatenate([np.zeros(2), field_px]))
    rig = replace(RigCalibration.initial(), image=errors)
    for k, observations in enumerate(seen):
        exact_px = np.array(list(observations.values()))
        pixels = exact_px.copy()
        # What is corrected to the exact observation, by fixed-point iteration.
        for _ in range(10):
            pixels += exact_px - rig.corrected(pixels, sequence.camera)
        yield Frame(
            index=k,
            stamp_ns=int(sequence.stamps_ns[k]),
            features=StereoFeatures(np.array(list(observations)), pixels),
        )


def show_real() -> None:
    """Print drifts of the real recordings, without and with the field."""
    for name, (folder, start) in RECORDINGS.items():
        if not folder.is_dir():
            print(f"{name:26} not there")
            continue
        for estimator in ("two-frame", "window"):
            texts = []
            for tau_px in (FLAWLESS_PX, INITIAL_SIGMA_PX):
                sequence = pv.open_sequence(folder)
                truth = sequence.truth.T_world_cam
                found = run(sequence, sequence.camera, truth, estimator=estimator, tau_px=tau_px)
                texts.append(drift_text(found.T_world_cam, truth, start))
            print(
                f"{name:26} {estimator:10} without {texts[0]:16} with {texts[1]:16}"
                f" τ {found.tau_px:.3f} px",
                flush=True,
            )


def show_distorted() -> None:
    """Print drifts and consistency for features moved by random fields."""
    with tempfile.TemporaryDirectory() as folder:
        for name in DISTORTED:
            out = Path(folder) / "".join(letter for letter in name if letter.isalpha())
            write_scene(SCENES[name], out, jobs=2)
            sequence = pv.open_sequence(out)
            truth = sequence.truth.T_world_cam
            seen = tracked(sequence)
            for seed, sigma_px in enumerate(SIGMAS_PX):
                rng = np.random.default_rng(seed)
                field_px = rng.normal(scale=sigma_px, size=NUM_ERRORS - 2)
                for estimator in ("two-frame", "window"):
                    texts = []
                    for tau_px in (FLAWLESS_PX, INITIAL_SIGMA_PX):
                        frames = distorted(seen, sequence, field_px)
                        found = run(
                            frames, sequence.camera, truth, estimator=estimator, tau_px=tau_px
                        )
                        spans = f", {np.mean(found.span_nees):.1f}" if found.span_nees else ""
                        texts.append(
                            f"{drift_text(found.T_world_cam, truth, 0)},"
                            f" NEES {np.mean(found.step_nees):.1f}{spans}"
                        )
                    print(
                        f"{name:20} {sigma_px:.1f} px {estimator:10} without {texts[0]:36}"
                        f" with {texts[1]:36} τ {found.tau_px:.3f} px",
                        flush=True,
                    )


if __name__ == "__main__":
    show_real()
    show_distorted()
