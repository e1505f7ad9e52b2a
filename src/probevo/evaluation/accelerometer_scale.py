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

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation, RotationSpline

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.evaluation.clustered_regression import two_sided_p
from probevo.measurements.preintegration import LONGEST_HOLE
from probevo.sequences.imu import HELD_NS, ImuStream
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.validation import MAX_FORCE_M_S2

INTERVAL_S = 0.5
"""T₁ and T₂: long enough for the noise of the images, short enough for a vehicle's accelerations
not to cancel."""
BLOCK_S = 8.0
"""Length of a block, over which gravity has a constant direction in the world of the images."""
PASSES = 3
"""Passes of the regression: the weight of the bias's prior depends on the noise, which is estimated
in the pass before."""
MIN_SAMPLES = 20
"""Minimum number of samples in a pair of intervals: at the rate of the frames, they would alias the
acceleration."""
MIN_CHANGES = 8
"""Minimum number of velocity changes, beyond the number of unknowns."""
MAX_SIGMA = 0.1
"""Largest σ of a ratio that is reported: without accelerations, the scale is unobservable."""


@dataclass(frozen=True)
class VelocityChange:
    """The change of the mean velocity over a pair of intervals, by images and accelerometer."""

    seen: FloatArray
    """D[p], by the images, [3], m/s."""
    measured: FloatArray
    """∫ w C f dt less D[C l], by the accelerometer, [3], m/s."""
    turn: FloatArray
    """∫ w C dt, which its bias is multiplied by, [3, 3], s."""
    start_s: float
    """Start of the first interval, since the first frame."""
    weight_s: float
    """∫ w dt, which gravity is multiplied by."""


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
    if len(triples) < MIN_CHANGES:
        return None
    # Attitudes between the frames by a spline; specific force in the axes of the camera, with bias.
    time_s = 1e-9 * (stamps_ns - stamps_ns[0])
    attitude = RotationSpline(time_s, Rotation.from_matrix(T_world_cam[:, :3, :3]))
    samples = _Samples(
        time_s=1e-9 * (stream.stamps_ns - stamps_ns[0]),
        force_m_s2=stream.accel_m_s2 @ calibration.C_cam_imu.T,
    )
    path = _Path(
        time_s=time_s,
        place_m=T_world_cam[:, :3, 3],
        lever_m=T_world_cam[:, :3, :3] @ calibration.T_cam_imu[:3, 3],
        attitude=attitude,
    )
    changes = []
    for i, j, k in triples:
        change = _velocity_change(path, samples, i, j=j, k=k)
        if change is not None:
            changes.append(change)
    if not changes:
        return None
    return _regressed(changes, bias_sigma_m_s2=calibration.accel_bias_sigma_m_s2)


@dataclass(frozen=True)
class _Samples:
    """The n samples of the accelerometer."""

    time_s: FloatArray
    """Since the first frame, [n]."""
    force_m_s2: FloatArray
    """Specific force in the axes of the camera, with bias, [n, 3]."""


@dataclass(frozen=True)
class _Path:
    """The path of the camera by images, over N frames."""

    time_s: FloatArray
    """Since the first frame, [N]."""
    place_m: FloatArray
    """Position of the camera in the world, p, [N, 3]."""
    lever_m: FloatArray
    """Lever arm of the IMU in the axes of the world, C l, [N, 3]."""
    attitude: RotationSpline
    """C_world_cam at any time since the first frame."""


def _velocity_change(
    path: _Path, samples: _Samples, i: int, *, j: int, k: int
) -> VelocityChange | None:
    """Compare a pair of intervals, from frame i to j and from j to k, with the accelerometer.

    Returns:
        The change; None unless samples cover the pair without a hole, and each force is plausible.
    """
    start_s = path.time_s[i]
    middle_s = path.time_s[j]
    end_s = path.time_s[k]
    first, end = np.searchsorted(samples.time_s, [start_s, end_s])
    inside = slice(first, end)
    t_s = samples.time_s[inside]
    force = samples.force_m_s2[inside]
    if not (np.abs(force) < MAX_FORCE_M_S2).all():
        return None
    gaps_s = np.diff(np.concatenate([[start_s], t_s, [end_s]]))
    # A held sample has two stamps, at both ends of its interval; it counts once.
    apart_s = gaps_s[gaps_s > 1e-9 * HELD_NS]
    if len(apart_s) <= MIN_SAMPLES or gaps_s.max() > LONGEST_HOLE * np.median(apart_s):
        return None
    first_s = middle_s - start_s
    second_s = end_s - middle_s
    # The triangle w is 0 at both ends of the pair and 1 where the intervals meet: w' = 1/T₁, then
    # −1/T₂, so that integration by parts of ∫ w p̈ dt leaves D[p].
    w = np.minimum((t_s - start_s) / first_s, (end_s - t_s) / second_s)
    w *= 0.5 * (first_s + second_s) / w.sum()  # its integral, whatever the samples' places
    C_world_cam = path.attitude(t_s).as_matrix()
    lever = _change(path.lever_m, i, j, k, first_s=first_s, second_s=second_s)
    return VelocityChange(
        seen=_change(path.place_m, i, j, k, first_s=first_s, second_s=second_s),
        measured=np.einsum("n,nij,nj->i", w, C_world_cam, force) - lever,
        turn=np.einsum("n,nij->ij", w, C_world_cam),
        start_s=start_s,
        weight_s=0.5 * (first_s + second_s),
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
    changes: Sequence[VelocityChange], *, bias_sigma_m_s2: float
) -> AccelerometerScale | None:
    """Regress D[p] of M ≥ 1 changes on the accelerometer's integral, gravity of each block, and the
    bias."""
    seen = np.array([change.seen for change in changes])
    measured = np.array([change.measured for change in changes])
    turns = np.array([change.turn for change in changes])
    weight_s = np.array([change.weight_s for change in changes])
    # Number the blocks that have a change consecutively.
    start_s = np.array([change.start_s for change in changes])
    block = (start_s // BLOCK_S).astype(np.int64)
    _, block = np.unique(block, return_inverse=True)
    # D[p] = (1/s) (integral − D[C l]) + (g/s) ∫ w dt − (∫ w C dt) b/s: linear in 1/s, which is the
    # ratio wanted, in gravity over s of each block, and in the bias over s.
    count = len(seen)
    num_blocks = int(block.max()) + 1
    num_unknowns = 1 + 3 * num_blocks + 3
    if 3 * count - num_unknowns < 3 * MIN_CHANGES:
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
    if freedom < MIN_CHANGES or not 0.0 < sigma < MAX_SIGMA:
        return None
    return AccelerometerScale(ratio, sigma, freedom)
