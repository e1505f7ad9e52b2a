"""Motions of random subsets of a drive's features, and the error α of each: one iteration of PROBE
Fig. 2."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.config import SolverConfig
from probevo.estimation.reprojection import ReprojectionSolution, sum_products
from probevo.estimation.two_frame import solve
from probevo.noise import NoiseModel
from probevo.training.drive import Drive
from probevo.training.supervision import Supervision


class Stream(IntEnum):
    """What a random number is for: each use has a stream of its own."""

    DIRECTION = 0
    SUBSET = 1
    HALVES = 2


@dataclass(frozen=True)
class Learner:
    """All that an iteration over a drive needs."""

    drive: Drive
    coordinates: FloatArray
    """Standardised place of each of the n features in the prediction space, [n, M]."""
    supervision: Supervision
    camera: StereoCamera
    base: NoiseModel
    """Noise of all features alike."""
    solver: SolverConfig
    subset: int
    """Features in a subset."""
    contrast: float
    """How much alike they are; 0 is not at all."""
    relative: bool
    """Whether α counts relative to what the geometry of the features lets expect."""
    seed: tuple[int, ...]
    """Of this drive."""

    def iterate(self, iteration: int) -> tuple[IntArray, FloatArray]:
        """Features that took part in a motion whose error is known, [m], and that error α, [m], m.

        One subset a step; with ``contrast``, those of one stretch of the supervision lean in the
        same direction. A step with too few features, or whose subset fixes no motion, keeps the
        motion of all its features.
        """
        drive, T_curr_prev = self.drive, self.drive.T_curr_prev.copy()
        cov = np.zeros((len(T_curr_prev), 6, 6))
        owner = self.supervision.stretch_of_step(len(T_curr_prev))
        directions = self._directions(len(self.supervision.stretches), iteration)
        features = []
        steps = []
        for step in np.flatnonzero(owner >= 0).tolist():
            rows = drive.rows(step)
            chosen = self._choose(
                np.flatnonzero(drive.used[rows]),
                rows,
                directions[owner[step]],
                key=(iteration, step),
            )
            if len(chosen) < self.subset:
                continue
            tracks = drive.tracks(step).kept(chosen)
            guess = drive.T_curr_prev[step]
            noise = self.base.predict(np.zeros((self.subset, 0)))
            solution = solve(
                tracks, noise, guess, camera=self.camera, prior=None, config=self.solver
            )
            if np.isfinite(
                solution.cov
            ).all():  # converged or not: what fails most is what the worst features do
                T_curr_prev[step] = solution.T_curr_prev
                cov[step] = _expected_cov(solution)
                features.append(rows.start + chosen)
                steps.append(step)
        if not steps:
            return np.zeros(0, np.int64), np.zeros(0)
        alphas = self.supervision.errors(T_curr_prev)
        if self.relative:
            alphas = alphas / self.supervision.expected_errors(T_curr_prev, cov)
        return np.concatenate(features), np.repeat(alphas[owner[steps]], self.subset)

    def _directions(self, count: int, iteration: int) -> FloatArray:
        """A random direction of the prediction space for each stretch, as long as the contrast,
        [count, M]."""
        arrows = np.random.default_rng([*self.seed, Stream.DIRECTION, iteration]).normal(
            size=(count, self.coordinates.shape[1])
        )
        scaled: FloatArray = self.contrast * arrows / np.linalg.norm(arrows, axis=1, keepdims=True)
        return scaled

    def _choose(
        self, used: IntArray, rows: slice, direction: FloatArray, key: tuple[int, int]
    ) -> IntArray:
        """A subset without repetition, drawn with probabilities ∝ exp(direction · coordinates)
        (Gumbel's trick)."""
        gumbel = np.random.default_rng([*self.seed, Stream.SUBSET, *key]).gumbel(size=len(used))
        defined = np.isfinite(self.drive.phi[rows][used])  # an undefined value leans nowhere
        score = gumbel + np.where(defined, self.coordinates[rows][used], 0.0) @ direction
        return used[np.sort(np.argsort(-score, kind="stable")[: self.subset])]


def _expected_cov(solution: ReprojectionSolution) -> FloatArray:
    """Covariance of a motion if all its features had the noise of the base, whatever their
    residuals say, [6, 6]."""
    information = sum_products(solution.jacobian, solution.information @ solution.jacobian)
    return np.asarray(np.linalg.pinv(information, hermitian=True), dtype=np.float64)
