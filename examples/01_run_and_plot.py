"""Run the odometry over a recording, frame by frame, and plot the path with what it claims to know.

python examples/01_run_and_plot.py SEQUENCE [PICTURE.png]
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import probevo as pv
from probevo.geometry.uncertainty import compound_chain


def run(path: Path) -> list[pv.MotionEstimate]:
    """The motion of each frame since the one before; the first is the identity."""
    sequence = pv.open_sequence(path)
    odometry = pv.StereoOdometry(sequence.camera, noise=pv.noise.StudentT(), imu=sequence.imu)
    motions = []
    for frame in sequence:
        motion = odometry.step(frame)
        motions.append(motion)
        sigma_mm = 1e3 * np.sqrt(np.diagonal(motion.cov)[:3])
        print(f"{frame.index:5d} {motion.status.name:14} {motion.num_tracks:4d} tracks, 1σ {sigma_mm.round(2)} mm")
    return motions


def plot(motions: list[pv.MotionEstimate], picture: Path) -> None:
    """The path from above, and the standard deviation of the position along it."""
    T_curr_prev = np.array([motion.T_curr_prev for motion in motions])
    cov = np.array([motion.cov for motion in motions])
    T_world_cam, cov_world_cam = compound_chain(T_curr_prev, cov)
    x_m, _, z_m = T_world_cam[:, :3, 3].T
    # The covariance is that of ξ in T = Exp(ξ) T̄: a small turn about the origin moves the position, p = ρ + φ × p̄.
    lever = np.cross(np.eye(3), T_world_cam[:, None, :3, 3]).swapaxes(1, 2)
    to_position = np.concatenate([np.broadcast_to(np.eye(3), lever.shape), lever], axis=2)
    sigma_m = np.sqrt(np.diagonal(to_position @ cov_world_cam @ to_position.swapaxes(1, 2), axis1=1, axis2=2))

    figure = Figure(figsize=(9, 4), layout="constrained")
    path, uncertainty = figure.subplots(1, 2)
    path.plot(x_m, z_m)
    path.set(xlabel="right x, m", ylabel="forward z, m", title="from above", aspect="equal", adjustable="datalim")
    uncertainty.plot(1e3 * sigma_m, label=["x", "y", "z"])
    uncertainty.set(xlabel="frame", ylabel="1σ of the position, mm", title="claimed")
    uncertainty.legend()
    figure.savefig(picture)


if __name__ == "__main__":
    plot(run(Path(sys.argv[1])), Path(sys.argv[2] if len(sys.argv) > 2 else "path.png"))
