"""The scale of the path by images, checked against the accelerometer.

Let p be the position of the camera by images, s the factor by which its path is too short, and l
the lever arm of the IMU, whose position is then s p + C l. Weight its acceleration, C f + g with
the specific force f less the bias b, with a triangle w over two successive intervals T₁ and T₂. The
integral is exactly the change of the mean velocity from one interval to the other,

    s D[p] + D[C l] = ∫ w C f dt + g ∫ w dt − (∫ w C dt) b,
    D[p] = (p_k − p_j)/T₂ − (p_j − p_i)/T₁,

so that no velocity has to be known. D[p] is regressed on the right-hand side, which is less noisy.
Gravity is a separate unknown in each block of the path, so that a drifting attitude does no harm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.evaluation.clustered_regression import two_sided_p
from probevo.measurements.preintegration import LONGEST_HOLE
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.validation import LARGEST_FORCE_M_S2

INTERVAL_S = 0.5
"""T₁ and T₂: long enough for the noise of the images, short enough for a vehicle's accelerations
not to cancel."""
BLOCK_S = 8.0
"""Length of a block, over which gravity has a constant direction in the world of the images."""
PASSES = 3
"""Passes of the regression: the weight of the bias's prior depends on the noise, which is estimated
in the pass before."""
FEWEST_SAMPLES = 20
"""Least number of samples in a pair of intervals: at the rate of the frames, they would alias the
acceleration."""
FEWEST = 8
"""Least number of velocity changes, beyond the number of unknowns."""
LARGEST_SIGMA = 0.1
"""Largest σ of a ratio that is reported: without accelerations, the scale is unobservable."""


@dataclass(frozen=True)
class AccelerometerScale:
    """The length of the path by the images over that by the accelerometer."""

    ratio: float
    sigma: float
    count: int
    """Degrees of freedom of its standard deviation."""

    @property
    def p_value(self) -> float:
        """Probability of a ratio at least as far from 1, if the true ratio is 1."""
        return two_sided_p((self.ratio - 1.0) / self.sigma, self.count)


def accelerometer_scale(
    stamps_ns: IntArray,
    T_world_cam: FloatArray,
    is_ok: BoolArray,
    stream: ImuStream,
    calibration: ImuCalibration,
) -> AccelerometerScale | None:
    """Compare a path with the accelerometer.

    Args:
        stamps_ns: stamps of N frames, [N].
        T_world_cam: poses by images, [N, 4, 4], m.
        is_ok: whether each step was solved, [N − 1].
        stream: the samples of the IMU, on the clock of the images.
        calibration: of the IMU on the camera.

    Returns:
        The scale; None if too few intervals have samples and only solved steps, or if the camera
        hardly accelerates.
    """
    triples = _triples(stamps_ns, is_ok)
    if len(triples) < FEWEST:
        return None
    # Attitudes between the frames by a spline; specific force in the axes of the camera, with bias.
    time_s = 1e-9 * (stamps_ns - stamps_ns[0])
    attitude = RotationSpline(time_s, Rotation.from_matrix(T_world_cam[:, :3, :3]))
    sampled_s = 1e-9 * (stream.stamps_ns - stamps_ns[0])
    force = stream.accel_m_s2 @ calibration.C_cam_imu.T
    place_m = T_world_cam[:, :3, 3]
    lever_m = T_world_cam[:, :3, :3] @ calibration.T_cam_imu[:3, 3]
    # Per pair of intervals: D[p], the integral less D[C l], ∫ w C dt, its begin, and ∫ w dt.
    seen = []
    measured = []
    turns = []
    starts_s = []
    weights = []
    for i, j, k in triples:
        # Use a pair only if samples cover it without a hole, and no force is implausible.
        inside = slice(*np.searchsorted(sampled_s, [time_s[i], time_s[k]]))
        t_s = sampled_s[inside]
        if len(t_s) < FEWEST_SAMPLES or not (np.abs(force[inside]) < LARGEST_FORCE_M_S2).all():
            continue
        gaps_s = np.diff(np.concatenate([[time_s[i]], t_s, [time_s[k]]]))
        if gaps_s.max() > LONGEST_HOLE * np.median(gaps_s):
            continue
        first_s = time_s[j] - time_s[i]
        second_s = time_s[k] - time_s[j]
        # The triangle w is 0 at both ends of the pair and 1 where the intervals meet: w' = 1/T₁,
        # then −1/T₂, so that integration by parts of ∫ w p̈ dt leaves D[p].
        w = np.minimum((t_s - time_s[i]) / first_s, (time_s[k] - t_s) / second_s)
        w *= 0.5 * (first_s + second_s) / w.sum()  # its integral, whatever the samples' places
        C_world_cam = attitude(t_s).as_matrix()
        seen.append(_change(place_m, i, j, k, first_s=first_s, second_s=second_s))
        lever = _change(lever_m, i, j, k, first_s=first_s, second_s=second_s)
        measured.append(np.einsum("n,nij,nj->i", w, C_world_cam, force[inside]) - lever)
        turns.append(np.einsum("n,nij->ij", w, C_world_cam))
        starts_s.append(time_s[i])
        weights.append(0.5 * (first_s + second_s))
    if not seen:
        return None
    # Number the blocks that have a pair consecutively.
    block = (np.array(starts_s) // BLOCK_S).astype(np.int64)
    _, block = np.unique(block, return_inverse=True)
    return _regressed(
        np.array(seen),
        np.array(measured),
        np.array(turns),
        block=block,
        weight_s=np.array(weights),
        bias_sigma_m_s2=calibration.accel_bias_sigma_m_s2,
    )


def _triples(stamps_ns: IntArray, is_ok: BoolArray) -> list[tuple[int, int, int]]:
    """Return the ends and the middle of successive pairs of intervals with solved steps only."""
    triples: list[tuple[int, int, int]] = []
    length_ns = round(1e9 * INTERVAL_S)
    # Number of unsolved steps before each frame; a millisecond of tolerance for jittered stamps
    bad_before = np.concatenate([[0], np.cumsum(~is_ok)])
    i = 0
    while True:
        j = int(np.searchsorted(stamps_ns, stamps_ns[i] + length_ns - 1_000_000))
        if j >= len(stamps_ns):
            return triples
        k = int(np.searchsorted(stamps_ns, stamps_ns[j] + length_ns - 1_000_000))
        if k >= len(stamps_ns):
            return triples
        if bad_before[k] == bad_before[i]:
            triples.append((i, j, k))
        i = j  # pairs of intervals overlap by half


def _change(
    values: FloatArray, i: int, j: int, k: int, *, first_s: float, second_s: float
) -> FloatArray:
    """Return D[values] of the docstring of this module: the change of the mean velocity, [3]."""
    return np.asarray((values[k] - values[j]) / second_s - (values[j] - values[i]) / first_s)


def _regressed(
    seen: FloatArray,
    measured: FloatArray,
    turns: FloatArray,
    *,
    block: IntArray,
    weight_s: FloatArray,
    bias_sigma_m_s2: float,
) -> AccelerometerScale | None:
    """Regress D[p], [M, 3], on the accelerometer's integral, gravity of each block, and the
    bias."""
    # D[p] = (1/s) (integral − D[C l]) + (g/s) ∫ w dt − (∫ w C dt) b/s: linear in 1/s, which is the
    # ratio wanted, in gravity over s of each block, and in the bias over s.
    count = len(seen)
    num_blocks = int(block.max()) + 1
    num_unknowns = 1 + 3 * num_blocks + 3
    if 3 * count - num_unknowns < 3 * FEWEST:
        return None
    design = np.zeros((count, 3, num_unknowns))
    design[:, :, 0] = measured
    for axis in range(3):
        design[np.arange(count), axis, 1 + 3 * block + axis] = weight_s
    design[:, :, -3:] = -turns
    rows = design.reshape(-1, num_unknowns)
    # Least squares in units of the variance of D[p]; only the bias has a prior.
    prior = np.zeros((num_unknowns, num_unknowns))
    values = np.zeros(num_unknowns)
    variance = 1.0
    try:
        for _ in range(PASSES):
            prior[-3:, -3:] = np.eye(3) * variance / max(bias_sigma_m_s2, 1e-6) ** 2
            bread = np.linalg.inv(rows.T @ rows + prior)
            values = bread @ (rows.T @ seen.ravel())
            residual = (seen.ravel() - rows @ values).reshape(count, 3)
            variance = float(np.sum(residual**2)) / (3 * count - num_unknowns)
    except np.linalg.LinAlgError:  # a camera at rest
        return None
    # Pairs of intervals overlap, so errors of neighbours are correlated: sandwich covariance with
    # one lag (Newey–West).
    score = np.einsum("mau,ma->mu", design, residual)
    meat = score.T @ score
    lagged = score[1:].T @ score[:-1]
    meat += 0.5 * (lagged + lagged.T)
    meat += variance * prior
    freedom = count - 1 - num_blocks
    factor = 3 * count / (3 * count - num_unknowns)
    ratio = float(values[0])
    # σ is the larger of the sandwich's, corrected for small samples, and the model's own.
    sandwich = float((bread @ meat @ bread)[0, 0]) * factor
    model = variance * float(bread[0, 0])
    sigma = float(np.sqrt(max(sandwich, model)))
    if freedom < FEWEST or not 0.0 < sigma < LARGEST_SIGMA:
        return None
    return AccelerometerScale(ratio, sigma, freedom)
