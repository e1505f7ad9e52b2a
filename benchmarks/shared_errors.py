"""Measure which errors features in neighbouring places have in common, and for how long.

    python benchmarks/shared_errors.py

On real recordings and a rendered street, ``student-t``, 60 frames each, without IMU. First the
correlation of the residuals u_l, v_l, u_r and v_r of different features within 60 px of each other,
in one frame and ten frames apart, before the distortion field corrects them.

Then what such errors add to the covariance of a step: with z_i the contribution of feature i to the
motion in units of the claimed covariance, the sum of z_iᵀ z_j over pairs within 160 px, over its 6
dimensions, less what independent errors give, since all contributions add up to zero. Without and
with the field.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from unittest.mock import patch

import numpy as np
from image_halves import RECORDINGS
from lens_distortion import FLAWLESS_PX
from recordings import ROOT
from window import SCENES

import probevo as pv
from probevo.arrays import FloatArray, IntArray
from probevo.camera.image_errors import INITIAL_SIGMA_PX, ImageErrors
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rolling_shutter import Twists
from probevo.camera.stereo import StereoCamera
from probevo.estimation import self_calibration
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.estimation.rig_update import CommonMode, update_rig
from probevo.tracking.tracks import Tracks
from probevo_sim.scene.writer import write_scene

FRAMES = 60
NEIGHBOURS_PX = 60.0
FAR_PX = 160.0
LAG = 10
USUAL = 0.5
"""Weight from which on a feature's residual counts for the correlation."""

Step = tuple[Tracks, ReprojectionSolution]


def steps(sequence: pv.sequences.Sequence, tau_px: float) -> Iterator[Step]:
    """Yield the tracks of each accepted step, and its solve of these two frames alone."""
    initial = replace(RigCalibration.initial(), image=ImageErrors.initial(tau_px))
    found: list[Step] = []

    def noted(
        rig: RigCalibration,
        tracks: Tracks,
        solution: ReprojectionSolution,
        camera: StereoCamera,
        twists: Twists,
    ) -> tuple[RigCalibration, CommonMode]:
        """Update the rig, and keep what the update was given."""
        found.append((tracks, solution))
        return update_rig(rig, tracks, solution, camera, twists)

    with (
        patch.object(RigCalibration, "initial", return_value=initial),
        patch.object(self_calibration, "update_rig", noted),
    ):
        odometry = pv.StereoOdometry(sequence.camera)
        for frame in islice(sequence, FRAMES):
            found.clear()
            if odometry.step(frame).status is pv.Status.OK:
                yield found[-1]


def distances_px(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the distances of places in the image, [N, 2] and [M, 2], px: [N, M]."""
    difference = one[:, None] - other[None]
    return np.asarray(np.hypot(difference[..., 0], difference[..., 1]))


def correlations(solved: list[Step], lag: int) -> FloatArray:
    """Return the correlation of residuals of neighbours so many frames apart, [4]."""
    usual: list[tuple[IntArray, FloatArray, FloatArray]] = []
    for tracks, solution in solved:
        keep = solution.features.weight >= USUAL
        usual.append(
            (tracks.ids[keep], tracks.curr_px[keep, :2], solution.features.residuals[keep])
        )
    products = np.zeros(4)
    count = 0
    for one, other in zip(usual, usual[lag:], strict=False):
        near = distances_px(one[1], other[1]) < NEIGHBOURS_PX
        near &= one[0][:, None] != other[0][None]
        products += np.einsum("nk,nm,mk->k", one[2], near.astype(float), other[2])
        count += int(near.sum())
    variance = np.mean(np.concatenate([residuals**2 for _, _, residuals in usual]), axis=0)
    return np.asarray(products / count / variance)


def added(tracks: Tracks, solution: ReprojectionSolution) -> float:
    """Return what errors of neighbours add to the covariance of a motion, as a share of it."""
    features = solution.features
    jacobian = solution.full_jacobian
    # The contribution of a feature is H⁻¹ w Jᵀ Σ⁻¹ e, with the curvature of the loss in H.
    scores = np.einsum("nij,nik,nk->nj", jacobian, features.information, features.residuals)
    scores *= features.irls_weight[:, None]
    own = np.einsum("nij,nik,nkl->njl", jacobian, features.information, jacobian)
    hessian = np.einsum("n,njl->jl", features.curvature, own)
    prior = np.arange(len(hessian)) >= 6  # the jitter has a prior of unit covariance
    hessian[prior, prior] += features.irls_weight.mean()
    contributions = np.linalg.solve(hessian, scores.T)[:6]
    z = np.linalg.solve(np.linalg.cholesky(solution.cov), contributions).T
    # Independent errors have E[z_iᵀ z_j] = −s tr(P_i P_j), P_i the share of i in the information.
    of_motion = features.irls_weight[:, None, None] * own[:, :6, :6]
    shares = np.linalg.solve(of_motion.sum(axis=0), of_motion)
    flat = shares.reshape(len(z), -1)
    independent = -flat @ np.swapaxes(shares, 1, 2).reshape(len(z), -1).T
    products = z @ z.T
    scale = np.trace(products) / (6.0 + np.trace(independent))
    near = distances_px(tracks.curr_px[:, :2], tracks.curr_px[:, :2]) < FAR_PX
    np.fill_diagonal(near, val=False)
    return float(products[near].sum() / scale - independent[near].sum()) / 6.0


def show(name: str, folder: Path) -> None:
    """Print both for a recording."""
    without = list(steps(pv.open_sequence(folder), FLAWLESS_PX))
    corrected = list(steps(pv.open_sequence(folder), INITIAL_SIGMA_PX))
    texts = [", ".join(f"{value:5.2f}" for value in correlations(without, lag)) for lag in (0, LAG)]
    shares = [np.mean([added(*step) for step in solved]) for solved in (without, corrected)]
    print(
        f"{name:16} in one frame {texts[0]}; ten apart {texts[1]}; adds {shares[0]:.2f},"
        f" with the field {shares[1]:.2f}",
        flush=True,
    )


if __name__ == "__main__":
    recordings = RECORDINGS | {"EuRoC V1_01": ROOT / "euroc" / "V1_01_micro"}
    for recording, path in recordings.items():
        if path.is_dir():
            show(recording, path)
        else:
            print(f"{recording:16} not there")
    with tempfile.TemporaryDirectory() as scratch:
        write_scene(SCENES["city, clean"], Path(scratch) / "city", jobs=2)
        show("city, clean", Path(scratch) / "city")
