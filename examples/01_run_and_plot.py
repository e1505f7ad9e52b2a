"""Run the odometry over a recording, frame by frame, and plot the path with what it claims to know.

python examples/01_run_and_plot.py SEQUENCE [PICTURE.png]
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import probevo as pv
from probevo.evaluation.consistency import drift_covariances
from probevo.geometry import se3


def run(path: Path) -> list[pv.MotionEstimate]:
    """The motion of each frame since the one before; the first is the identity."""
    sequence = pv.open_sequence(path)
    odometry = pv.StereoOdometry(sequence.camera, noise=pv.noise.StudentT(), imu=sequence.imu)
    motions = []
    for frame in sequence:
        motion = odometry.step(frame)
        motions.append(motion)
        sigma_mm = 1e3 * np.sqrt(np.diagonal(motion.cov)[:3])
        print(
            f"{frame.index:5d} {motion.status.name:14} {motion.num_tracks:4d} tracks, 1σ"
            f" {sigma_mm.round(2)} mm"
        )
    return motions


def plot(motions: list[pv.MotionEstimate], picture: Path) -> None:
    """The path from above, and the standard deviation of the position along it."""
    names = ("T_curr_prev", "cov", "shared", "path_cross_cov")
    steps = [np.array([getattr(motion, name) for motion in motions[1:]]) for name in names]
    x_m, _, z_m = se3.chain_motions(steps[0])[:, :3, 3].T
    # Along the axes of each camera. The doubt about the calibration is one error for all steps, and
    # adds up; and what tracks remember ties each step to the path before it.
    sigma_m = np.sqrt(np.diagonal(drift_covariances(*steps)[:, :3, :3], axis1=1, axis2=2))

    figure = Figure(figsize=(9, 4), layout="constrained")
    path, uncertainty = figure.subplots(1, 2)
    path.plot(x_m, z_m)
    path.set(
        xlabel="right x, m",
        ylabel="forward z, m",
        title="from above",
        aspect="equal",
        adjustable="datalim",
    )
    uncertainty.plot(1e3 * sigma_m, label=["right", "down", "forward"])
    uncertainty.set(xlabel="frame", ylabel="1σ of the position, mm", title="claimed")
    uncertainty.legend()
    figure.savefig(picture)


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        print("usage: python examples/01_run_and_plot.py SEQUENCE [PICTURE.png]", file=sys.stderr)
        sys.exit(2)
    plot(run(Path(sys.argv[1])), Path(sys.argv[2] if len(sys.argv) > 2 else "path.png"))
