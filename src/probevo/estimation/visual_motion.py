"""The motion by the tracks of one step, and what is known about the step before they are used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.estimation import levenberg_marquardt
from probevo.estimation.disparity_filter import DisparityFilter
from probevo.estimation.feature_weights import OUTLIER_BELOW, num_inliers
from probevo.estimation.motion_estimate import Status
from probevo.estimation.motion_model import MotionPrediction
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.measurements.base import Measurement
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.variables import MOTION, Variable
from probevo.noise.base import StereoNoise


@dataclass(frozen=True)
class VisualMotion:
    """The motion by the tracks of one step, with status, weights and noise."""

    status: Status
    weights: FloatArray
    """Weight of each track, [N]: from 0 for an outlier of RANSAC to 1 for a small residual."""
    used: BoolArray
    """Which tracks the solve used, [N]; RANSAC rejected the others."""
    solution: ReprojectionSolution | None = None
    """The last solve, accepted only if the status is OK. None if there were too few tracks, or if
    it is degenerate."""
    two_frames_only: ReprojectionSolution | None = None
    """The same features evaluated at that motion, without disparity filter and gyro."""
    T_reference: FloatArray | None = None
    """The motion for the residuals that predict noise in the next step, [4, 4]; None without a
    solve."""
    noise: StereoNoise | None = None
    """Predicted noise of the tracks used, times the running factor, and enlarged where most
    residuals exceed it; None without a solve."""
    disparities: DisparityFilter = field(default_factory=DisparityFilter.none)
    """The disparity filter after the step; empty unless the step was accepted."""
    estimated_noise_factor: float | None = None
    """Factor by which the variances of the noise model would fit the residuals; None if they do not
    show it, or if the model keeps its scale."""
    is_partly_determined: bool = False
    """Whether the tracks leave a direction of the motion open, status DEGENERATE, but agree with
    each other and with the prediction in all others."""
    num_out_of_domain: int | None = None
    """Number of tracks used that are outside of the noise model's training data. None without a
    solve, or if the model has no such domain."""

    @property
    def outliers(self) -> BoolArray:
        """Which tracks the tracker should drop, [N]."""
        return np.asarray(self.weights < OUTLIER_BELOW)

    @property
    def accepted_solution(self) -> ReprojectionSolution:
        """The solve of a step with status OK.

        Raises:
            ValueError: there is none.
        """
        if self.status is not Status.OK or self.solution is None:
            raise ValueError(f"a step with status {self.status.name} has no accepted solution")
        return self.solution

    @property
    def is_rejected(self) -> bool:
        """Whether there is a solve that did not converge, or that contradicts the prediction."""
        return self.status is Status.NOT_CONVERGED

    @property
    def num_inliers(self) -> int:
        """Tracks with a weight of at least one half."""
        return num_inliers(self.weights)

    @property
    def num_used(self) -> int:
        """Tracks that the solve used."""
        return int(self.used.sum())

    @property
    def num_iterations(self) -> int:
        """Iterations of the last solve."""
        return self.solution.iterations if self.solution else 0


@dataclass(frozen=True)
class MotionPriors:
    """What is known about a step before its tracks are used."""

    prediction: MotionPrediction
    gyro: RelativeRotation | None
    """The gyro's rotation, if there is one."""
    disparities: DisparityFilter
    """The disparity filter after the previous step."""
    measurements: Sequence[Measurement] = ()
    """Measurements of the motion other than the tracks; they enter the solve."""
    curr: Variable = MOTION
    """The variable by which these refer to the pose of the current frame."""
    noise_factor: float = 1.0
    """By how much the variances of the noise model are multiplied (``NoiseScale``)."""
    jitter_cov: FloatArray | None = None
    """Covariance of the rig's jitter, estimated online, [3, 3], rad²; None for that of the noise
    model."""

    def information_of_measurements(self, T_curr_prev: FloatArray) -> FloatArray:
        """Return the information of these measurements on a motion T_curr_prev, [6, 6]."""
        if not self.measurements:
            return np.zeros((6, 6))
        values = {variable: np.eye(4) for one in self.measurements for variable in one.variables}
        values[self.curr] = T_curr_prev
        return levenberg_marquardt.information(self.measurements, values, [self.curr])
