"""Solve every step with GTSAM too, under the noise predicted for each feature.

pip install '.[gtsam]'; python examples/05_noise_for_gtsam.py SEQUENCE NOISE
for example: out/points/test.npz fixed. The derivation is in docs/other-back-ends.md.
"""

import sys
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import probevo as pv
from probevo.estimation.track_factors import TrackFactors
from probevo.geometry import se3
from probevo.noise.named import noise_model

PREV, CURR, COMMON, FIRST_POINT = range(4)  # keys of the variables


def factors_of(odometry: pv.StereoOdometry, before: Any) -> TrackFactors:
    """Return the factors of the last step; ``before`` is ``odometry.state`` before it."""
    noise = odometry.noise.predict(odometry.phi[odometry.used])
    # What the residuals of earlier steps have shown of its size
    noise = noise.scaled(np.full(len(noise.dof), before.noise_scale.factor))
    if before.rig is not None:
        noise = replace(noise, jitter_cov=before.rig.jitter.cov)
    tracks = odometry.tracks.subset(odometry.used)
    return TrackFactors.of(tracks, noise, odometry.camera, before.disparities)


def error(factors: TrackFactors, track: int, factor: Any, values: Any, H: Any) -> np.ndarray:
    """Return the residual of a track, [7], px, and its Jacobians in ``H`` if GTSAM wants them."""
    prev, curr, common, point = factor.keys()
    T_curr_prev = values.atPose3(curr).between(values.atPose3(prev)).matrix()
    at = factors.linearize(track, T_curr_prev, values.atVector(point), values.atVector(common))
    if H is not None:  # GTSAM perturbs poses on the right, rotation first.
        H[0] = np.roll(at.motion @ se3.adjoint(T_curr_prev), 3, axis=1)
        H[1] = np.roll(-at.motion, 3, axis=1)
        H[2] = at.common
        H[3] = at.point
    return at.residual


def graphs(factors: TrackFactors, start: np.ndarray) -> tuple[Any, Any, Any]:
    """Return the graph to solve, that of its Fisher information, and where to start."""
    import gtsam  # only here: probevo itself needs none of it

    robust = gtsam.NonlinearFactorGraph()
    robust.addPriorPose3(PREV, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6))
    num_common = factors.common.shape[2]
    robust.addPriorVector(COMMON, np.zeros(num_common), gtsam.noiseModel.Unit.Create(num_common))
    fisher = robust.clone()
    values = gtsam.Values()
    values.insert(PREV, gtsam.Pose3())
    values.insert(CURR, gtsam.Pose3(se3.inverse(start)))
    values.insert(COMMON, np.zeros(num_common))
    gaussian = gtsam.noiseModel.Gaussian.Covariance
    for track, nu in enumerate(np.minimum(factors.dof, 1e9)):
        keys = [PREV, CURR, COMMON, FIRST_POINT + track]
        values.insert(keys[3], factors.point[track])
        residual = partial(error, factors, track)
        cauchy = gtsam.noiseModel.mEstimator.Cauchy(np.sqrt(nu + 4.0))
        cov = nu / (nu + 4.0) * factors.cov[track]
        student_t = gtsam.noiseModel.Robust.Create(cauchy, gaussian(cov))
        robust.add(gtsam.CustomFactor(student_t, keys, residual))
        cov = (nu + 6.0) / (nu + 4.0) * factors.cov[track]
        fisher.add(gtsam.CustomFactor(gaussian(cov), keys, residual))
    return robust, fisher, values


def solve(
    factors: TrackFactors, start: np.ndarray, tolerance: float = 1e-9
) -> tuple[np.ndarray, np.ndarray]:
    """Return T_curr_prev [4, 4] and the covariance of its left perturbation [6, 6]."""
    import gtsam

    robust, fisher, values = graphs(factors, start)
    params = gtsam.LevenbergMarquardtParams()
    params.setRelativeErrorTol(tolerance)  # its default, 1e-5, stops up to 0.08 σ early
    params.setAbsoluteErrorTol(tolerance)
    best = gtsam.LevenbergMarquardtOptimizer(robust, values, params).optimize()
    cov = gtsam.Marginals(fisher, best).marginalCovariance(CURR)
    return best.atPose3(CURR).inverse().matrix(), np.roll(cov, 3, (0, 1))


def main(path: str, noise: str) -> None:
    """Print both motions of every step, and how far GTSAM's is from probevo's."""
    sequence = pv.open_sequence(path)
    odometry = pv.StereoOdometry(
        sequence.camera, noise_model(noise), sequence.imu, config={"estimator": "two-frame"}
    )
    np.set_printoptions(precision=3, suppress=True, linewidth=200)
    for frame in sequence:
        before = odometry.state
        own = odometry.step(frame)
        if own.status is not pv.Status.OK:
            continue
        # Without the uncertainty of the rig's calibration, of which GTSAM knows nothing.
        own_cov = own.cov - own.common_mode @ own.common_mode.T
        own_sigma = np.sqrt(np.diagonal(own_cov))
        other, other_cov = solve(factors_of(odometry, before), own.T_curr_prev)
        for name, T, cov in (("probevo", own.T_curr_prev, own_cov), ("GTSAM", other, other_cov)):
            apart = se3.log(T @ se3.inverse(own.T_curr_prev)) / own_sigma
            sigma = np.sqrt(np.diagonal(cov))
            motion = f"{1e3 * se3.log(T)} ± {1e3 * sigma} mm, mrad"
            print(f"{name:7} {motion}; off probevo's by {apart} σ")


if __name__ == "__main__":
    if len(sys.argv) != 3:
        print("usage: python examples/05_noise_for_gtsam.py SEQUENCE NOISE", file=sys.stderr)
        sys.exit(2)
    main(sys.argv[1], sys.argv[2])
