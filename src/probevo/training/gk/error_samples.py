"""The E-step over all drives: each drive is one worker's task and yields a sample of its errors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray, concatenated
from probevo.config import SolverConfig
from probevo.config.training import KernelSettings, TrainSettings
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.noise.base import NoiseModel, StereoNoise
from probevo.noise.student_t_numba import MIN_SIGMA_PX
from probevo.training.gk.expectation import expect
from probevo.training.supervised_drive import SupervisedDrive
from probevo.training.supervision import Supervision
from probevo.training.trainer import TrainingContext

BLOCKS_A_DRIVE = 10
"""Largest number of blocks of time into which a drive is cut for cross-validation."""
STEPS_A_BLOCK = 20
"""Minimum number of steps in a block: a shorter one would share its tracks with the next block."""
MAX_FEATURES = 500_000
"""Approximate largest number of features that a model is fitted to. If there are more, a random
share is drawn, evenly from all drives and times."""


class FeatureLikelihoods(NamedTuple):
    """How likely the residuals of N features are under a model."""

    features: IntArray
    """Index of each feature among the features of all drives, [N], without repetition."""
    log_likelihood: FloatArray
    """Log density of each residual, [N], nats."""

    def gain_over(self, before: FeatureLikelihoods) -> float:
        """Return by how much the features that both have are likelier than before, nats a feature.

        Means over all features of each would differ by which ones these are: a step that is no
        longer solved is a hard one. Without any feature in common, the gain is 0.
        """
        both, own, other = np.intersect1d(
            self.features, before.features, assume_unique=True, return_indices=True
        )
        if not len(both):
            return 0.0
        return float(np.mean(self.log_likelihood[own] - before.log_likelihood[other]))


@dataclass(frozen=True)
class ErrorSamples:
    """Errors of N features to learn from, and how well the model explained them."""

    features: IntArray
    """Index of each feature among the features of all drives, [N]."""
    phi: FloatArray
    """Place of each feature in the prediction space, [N, M]."""
    errors: FloatArray
    """Error of each feature, [N, 4], px."""
    error_cov: FloatArray
    """Covariance of each error that the uncertainty of the motion causes, [N, 4, 4], px²."""
    groups: IntArray
    """Block of time of each feature, [N]; the drives' blocks follow each other."""
    log_likelihood: FloatArray
    """Log density of each residual under the model, [N], nats."""
    profile: FloatArray
    """Likelihood of each residual as a function of the time correlation, [N, 4], the ``rows`` of a
    ``TimeCorrelationProfile``."""
    jitter_moments: FloatArray
    """Second moment of the change of the rig's jitter in each step, [K, 3, 3], rad²; none where the
    noise has no jitter."""
    gaps_m: FloatArray
    """Distance between the estimated and the true end of each drive whose ends are known."""

    @property
    def drives(self) -> IntArray:
        """Number of the drive of each feature, [N]."""
        return self.groups // BLOCKS_A_DRIVE

    def with_noise(self) -> ErrorSamples:
        """Return the samples without those of drives that have no noise, unless none has any.

        Simulated or frozen images repeat a coordinate exactly. Between such errors and those of
        other drives, no distribution is like either.
        """
        numbers, drives = np.unique(self.drives, return_inverse=True)
        squared = [np.median(self.errors[drives == k] ** 2, axis=0) for k in range(len(numbers))]
        is_noisy: BoolArray = np.all(np.array(squared) >= MIN_SIGMA_PX**2, axis=1)
        if is_noisy.all() or not is_noisy.any():
            return self
        kept = np.flatnonzero(is_noisy[drives])
        return replace(
            self,
            features=self.features[kept],
            phi=self.phi[kept],
            errors=self.errors[kept],
            error_cov=self.error_cov[kept],
            groups=self.groups[kept],
            log_likelihood=self.log_likelihood[kept],
            profile=self.profile[kept],
        )

    @property
    def likelihoods(self) -> FeatureLikelihoods:
        """The likelihood of each feature."""
        return FeatureLikelihoods(self.features, self.log_likelihood)

    @property
    def progress(self) -> dict[str, float]:
        """Likelihood a feature and loop closure error, by which an iteration is evaluated (PROBE-GK
        Fig. 8)."""
        progress = {"log_likelihood": float(np.mean(self.log_likelihood))}
        if len(self.gaps_m):
            progress["loop_error_m"] = float(np.mean(self.gaps_m))
        return progress


@dataclass(frozen=True)
class _Task:
    number: int
    first_feature: int
    """Number of features of all drives before this one."""
    drive: SupervisedDrive
    model: NoiseModel
    factor: float
    """Factor of the model's variances in this drive."""
    settings: TrainSettings
    share: float
    """Share of the features to draw."""
    blocks: int
    """Number of blocks of time."""


def gather_error_samples(
    context: TrainingContext,
    model: NoiseModel,
    on_part: Callable[[float], None],
    *,
    factors: FloatArray | None = None,
) -> ErrorSamples:
    """Compute the errors of the features of all drives under a noise model.

    Args:
        context: the D drives, the settings and the workers.
        model: the noise model of the E-step.
        on_part: called with the share of the work that is done, 0 … 1.
        factors: factor of the model's variances in each drive, [D]; 1 by default.

    Raises:
        InputError: there is nothing to learn from, or what ``Workers.map`` raises.
    """
    drives = context.drives
    # Draw a share of the features, the same of each drive.
    facts_of_drives = [drive.facts for drive in drives]
    num_used = sum(facts.used for facts in facts_of_drives)
    share = min(1.0, MAX_FEATURES / max(num_used, 1))

    # The errors of each drive are one task.
    blocks = blocks_of([facts.steps for facts in facts_of_drives])
    first_features = np.cumsum([0, *(facts.features for facts in facts_of_drives)]).tolist()
    tasks = [
        _Task(
            number=number,
            first_feature=first_features[number],
            drive=drive,
            model=model,
            factor=1.0 if factors is None else float(factors[number]),
            settings=context.settings,
            share=share,
            blocks=blocks[number],
        )
        for number, drive in enumerate(drives)
    ]
    done: set[int] = set()

    def on_done(number: int) -> None:
        """Report the share of the tasks that are done."""
        # A task that was lost with its worker may be reported twice.
        done.add(number)
        on_part(len(done) / len(tasks))

    # Concatenate the samples in the order of the drives, whoever was done first.
    names = [f"recording {number + 1}" for number in range(len(tasks))]
    parts = context.workers.map(_samples_of_drive, tasks, names, on_done)
    samples = concatenated(parts)
    if not len(samples.errors):
        fewest = context.settings.odometry.solver.min_tracks
        raise InputError(
            "training data",
            f"no step has {fewest} features to learn from.",
            "Give other recordings.",
        )
    return samples


def blocks_of(steps: Sequence[int]) -> list[int]:
    """Return into how many blocks of time to cut drives of so many steps; at least two in all."""
    blocks = [min(BLOCKS_A_DRIVE, max(1, count // STEPS_A_BLOCK)) for count in steps]
    return blocks if sum(blocks) > 1 else [2] * len(blocks)


def _samples_of_drive(task: _Task) -> ErrorSamples:
    """Compute the errors of one drive."""

    def predict(phi: FloatArray) -> StereoNoise:
        """Predict the noise of n features of this drive, [n, M]."""
        noise = task.model.predict(phi)
        return noise if task.factor == 1.0 else noise.scaled(task.factor)

    expectation = expect(
        task.drive,
        predict,
        _solver(task.settings),
        truth_sigma=_truth_sigma(task.settings.gk),
        share=task.share,
        seed=(task.settings.odometry.seed, task.number),
    )
    feature_errors = expectation.feature_errors
    num_steps = len(expectation.T_features_only)
    # Samples of one block of time are left out together in cross-validation: features that are
    # close in time have errors in common.
    block = feature_errors.steps * task.blocks // max(num_steps, 1)
    gap_m = _loop_error_m(task.drive.supervision, expectation.T_features_only)
    return ErrorSamples(
        features=task.first_feature + feature_errors.features,
        phi=feature_errors.phi,
        errors=feature_errors.errors,
        error_cov=feature_errors.error_cov,
        groups=task.number * BLOCKS_A_DRIVE + block,  # no drive has more blocks than that
        log_likelihood=feature_errors.log_likelihood,
        profile=feature_errors.profile,
        jitter_moments=feature_errors.jitter_moments,
        gaps_m=np.array([gap_m] if np.isfinite(gap_m) else []),
    )


def _solver(settings: TrainSettings) -> SolverConfig:
    """Return the settings of the solver: with a quadratic loss if least squares is asked for."""
    solver = settings.odometry.solver
    return solver.model_copy(update={"loss": "l2"}) if settings.gk.quadratic else solver


def _truth_sigma(given: KernelSettings) -> FloatArray | None:
    """Return the standard deviation of the truth over a stretch, m and rad, [6].

    None means that it is to be estimated.
    """
    if given.truth_sigma_m is None or given.truth_sigma_deg is None:
        return None
    return np.repeat([given.truth_sigma_m, np.deg2rad(given.truth_sigma_deg)], 3)


def _loop_error_m(supervision: Supervision, T_curr_prev: FloatArray) -> float:
    """Return the distance between the estimated and the true end of the path, seen from its start.

    Args:
        supervision: the known poses.
        T_curr_prev: estimated motion of each step, [K − 1, 4, 4].

    Returns:
        distance, m; NaN if a pose at one end is unknown.
    """
    first, last = supervision.frames[[0, -1]]
    # The end seen from the start: the world of the truth does not matter.
    T_world_cam = se3.chain_motions(T_curr_prev)
    estimated = se3.inverse(T_world_cam[first]) @ T_world_cam[last]
    true = se3.inverse(supervision.T_world_cam[0]) @ supervision.T_world_cam[-1]
    return float(np.linalg.norm((estimated - true)[:3, 3]))
