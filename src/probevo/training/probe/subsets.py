"""One iteration of PROBE (Fig. 2): motions of random subsets of features, and their errors α."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.config import SolverConfig
from probevo.estimation.reprojection import ReprojectionSolution, sum_products
from probevo.estimation.two_frame import TwoFrameEstimator
from probevo.noise import NoiseModel
from probevo.training.drive import Drive
from probevo.training.supervision import Supervision


class Stream(IntEnum):
    """Purpose of a random number; each purpose has its own stream of numbers."""

    DIRECTION = 0
    SUBSET = 1
    HALVES = 2


class SubsetErrors(NamedTuple):
    """Motions by subsets of the features of a drive, whose errors are known."""

    features: IntArray
    """The feature of each entry, [n]; there is one for each feature of each subset."""
    alphas: FloatArray
    """The error α of the motion by that subset, [n], m or relative."""


@dataclass(frozen=True)
class SubsetSampler:
    """A drive, and all that an iteration of PROBE over it needs."""

    drive: Drive
    coordinates: FloatArray
    """Standardised point of each of the n features in the prediction space, [n, M]."""
    supervision: Supervision
    camera: StereoCamera
    base: NoiseModel
    """Static noise model of all features."""
    solver: SolverConfig
    subset: int
    """Number of features in a subset."""
    contrast: float
    """How similar the features of a subset are; 0 draws them uniformly."""
    divides_by_predicted: bool
    """Whether α is divided by the error that the covariance of the subset predicts."""
    seed: tuple[int, ...]
    """Seed of this drive."""

    def iterate(self, iteration: int) -> SubsetErrors:
        """Solve each step with a random subset of its features.

        There is one subset a step. With ``contrast``, the subsets of one stretch of the supervision
        lean in the same direction. A step with too few features, or whose subset fixes no motion,
        keeps the motion of all its features.

        Args:
            iteration: number of the iteration, on which the draw depends.
        """
        drive = self.drive
        T_curr_prev = drive.T_curr_prev.copy()
        cov = np.zeros((len(T_curr_prev), 6, 6))
        stretch_of_step = self.supervision.stretch_of_step(len(T_curr_prev))
        directions = self._directions(len(self.supervision.stretches), iteration)
        estimator = TwoFrameEstimator(self.camera, self.solver)
        features = []
        steps = []
        for step in np.flatnonzero(stretch_of_step >= 0).tolist():
            # Draw a subset of the step's features.
            rows = drive.rows(step)
            chosen = self._choose(
                np.flatnonzero(drive.used[rows]),
                rows,
                directions[stretch_of_step[step]],
                key=(iteration, step),
            )
            if len(chosen) < self.subset:
                continue

            # Solve for the motion with this subset only.
            solution = estimator.solve(
                drive.tracks(step).subset(chosen),
                self.base.predict(np.zeros((self.subset, 0))),
                guess=drive.T_curr_prev[step],
            )
            # Converged or not: solves fail most often where the features are worst, and without
            # them these features would seem better than they are.
            if np.isfinite(solution.cov).all():
                T_curr_prev[step] = solution.T_curr_prev
                cov[step] = _predicted_cov(solution)
                features.append(rows.start + chosen)
                steps.append(step)
        if not steps:
            return SubsetErrors(np.zeros(0, np.int64), np.zeros(0))

        # The error over a stretch counts for each feature that took part in it. α, [U], is spread
        # to the steps of each stretch, and from there to the features of each subset.
        alphas = self.supervision.errors(T_curr_prev)
        if self.divides_by_predicted:
            alphas = alphas / self.supervision.predicted_errors(T_curr_prev, cov)
        return SubsetErrors(
            features=np.concatenate(features),
            alphas=np.repeat(alphas[stretch_of_step[steps]], self.subset),
        )

    def _directions(self, count: int, iteration: int) -> FloatArray:
        """Draw a random direction of the prediction space for each of ``count`` stretches.

        Returns:
            vectors whose length is the contrast, [count, M].
        """
        rng = np.random.default_rng([*self.seed, Stream.DIRECTION, iteration])
        normal = rng.normal(size=(count, self.coordinates.shape[1]))
        scaled: FloatArray = self.contrast * normal / np.linalg.norm(normal, axis=1, keepdims=True)
        return scaled

    def _choose(
        self, used: IntArray, rows: slice, direction: FloatArray, key: tuple[int, int]
    ) -> IntArray:
        """Draw a subset without repetition, with probabilities ∝ exp(direction · coordinates).

        This is Gumbel's trick: the largest of log probability plus Gumbel noise are drawn.

        Args:
            used: features of the step to draw from, counted from its first, [n].
            rows: the step's features among the drive's.
            direction: direction in the prediction space in which the subset leans, [M].
            key: numbers of iteration and step.
        """
        # A stream for each step: the draw does not depend on which steps were drawn before.
        gumbel = np.random.default_rng([*self.seed, Stream.SUBSET, *key]).gumbel(size=len(used))
        # An undefined value leans nowhere.
        is_defined = np.isfinite(self.drive.phi[rows][used])
        coordinates = np.where(is_defined, self.coordinates[rows][used], 0.0)
        score = gumbel + coordinates @ direction
        return used[np.sort(np.argsort(-score, kind="stable")[: self.subset])]


def _predicted_cov(solution: ReprojectionSolution) -> FloatArray:
    """Return the covariance of a motion whose features all have the noise of the base, [6, 6].

    It depends on the geometry of the features but not on their residuals.
    """
    # Λ = Σ Jᵀ Σ_i⁻¹ J. A pseudo-inverse, since the features of a subset need not fix all of ξ to
    # working precision.
    jacobian = solution.features.jacobian
    information = sum_products(jacobian, solution.features.information @ jacobian)
    return np.asarray(np.linalg.pinv(information, hermitian=True), dtype=np.float64)
