"""Solve every step with GTSAM too, under the noise predicted for each feature; derivations:
docs/other-back-ends.md.

pip install '.[gtsam]'; python examples/05_noise_for_gtsam.py SEQUENCE NOISE    e.g.
out/points/test.npz fixed
"""

import sys

import numpy as np

import probevo as pv
from probevo.geometry import se3
from probevo.noise.named import noise_model


def merge_rows(pixels: np.ndarray, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of observations [N, 4], px: (u_l, u_r, v) [N, 3], scale [N, 3, 3], px², s of what the rows
    disagree in [N]."""
    H = np.eye(3)[[0, 2, 1, 2]]
    weight = np.linalg.inv(scale)  # H: to (u_l, v, u_r, v)
    R = np.linalg.inv(H.T @ weight @ H)
    merged = (R @ H.T @ weight @ pixels[..., None])[..., 0]
    return merged, R, np.einsum("ni,nij,nj->n", pixels, weight, pixels - merged @ H.T)


def solve(odometry: pv.StereoOdometry, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The last step anew: T_curr_prev [4, 4], sought from a start, and covariance of its left
    perturbation [6, 6]."""
    import gtsam  # only here: probevo itself needs none of it

    c = odometry.camera
    prev = odometry.tracks.prev_px
    curr = odometry.tracks.curr_px
    keep = (odometry.weights > 0.1) & (
        np.minimum(prev[:, 0] - prev[:, 2], curr[:, 0] - curr[:, 2]) > 1.0
    )
    noise, exact = (
        model.predict(odometry.phi[keep])
        for model in (odometry.noise, pv.noise.Fixed(1e-6 * np.eye(4)))
    )
    K = gtsam.Cal3_S2Stereo(c.fu_px, c.fv_px, 0.0, c.cu_px, c.cv_px, c.baseline_m)
    values = gtsam.Values()
    robust = gtsam.NonlinearFactorGraph()
    values.insert(
        0, gtsam.Pose3()
    )  # the previous camera, held in place; 1 is the current one, points start at 2
    values.insert(1, gtsam.Pose3(se3.inverse(start)))
    robust.addPriorPose3(0, gtsam.Pose3(), gtsam.noiseModel.Isotropic.Sigma(6, 1e-6))
    honest = robust.clone()
    Gaussian = gtsam.noiseModel.Gaussian.Covariance
    before = exact if noise.refers_to == "residual" else noise
    for camera, pixels, its in ((0, prev[keep], before), (1, curr[keep] - noise.bias, noise)):
        features = zip(*merge_rows(pixels, its.scale), np.minimum(its.dof, 1e9), strict=True)
        for point, (merged, R, s, dof) in enumerate(features, start=2):
            seen = gtsam.StereoPoint2(*merged)
            cauchy = gtsam.noiseModel.mEstimator.Cauchy(np.sqrt(dof + 4.0))
            student_t = gtsam.noiseModel.Robust.Create(
                cauchy, Gaussian((dof + s) / (dof + 4.0) * R)
            )
            robust.add(gtsam.GenericStereoFactor3D(seen, student_t, camera, point, K))
            honest.add(
                gtsam.GenericStereoFactor3D(
                    seen, Gaussian((dof + 6.0) / (dof + 4.0) * R), camera, point, K
                )
            )
            values.insert_or_assign(
                point, gtsam.StereoCamera(values.atPose3(camera), K).backproject(seen)
            )
    best = gtsam.LevenbergMarquardtOptimizer(robust, values).optimize()
    return best.atPose3(1).inverse().matrix(), np.roll(
        gtsam.Marginals(honest, best).marginalCovariance(1), 3, (0, 1)
    )


if __name__ == "__main__":
    if len(sys.argv) != 3:
        print("usage: python examples/05_noise_for_gtsam.py SEQUENCE NOISE", file=sys.stderr)
        sys.exit(2)
    sequence = pv.open_sequence(sys.argv[1])
    odometry = pv.StereoOdometry(sequence.camera, noise_model(sys.argv[2]), sequence.imu)
    np.set_printoptions(precision=3, suppress=True, linewidth=200)
    for own in (motion for motion in map(odometry.step, sequence) if motion.status is pv.Status.OK):
        T_own = own.T_curr_prev
        cov_own = (
            own.cov - own.common_mode @ own.common_mode.T
        )  # without the doubt about the calibration
        for name, T, cov in (("probevo", T_own, cov_own), ("GTSAM", *solve(odometry, T_own))):
            apart = se3.log(T @ se3.inverse(T_own))
            sigma = np.sqrt(np.diagonal(cov))
            print(
                f"{name:7} {1e3 * se3.log(T)} ± {1e3 * sigma} mm, mrad; off probevo's by"
                f" {apart / sigma} σ"
            )
