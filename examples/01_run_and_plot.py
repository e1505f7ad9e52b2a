"""Run the odometry over a recording, frame by frame; plot the path and its claimed uncertainty.

python examples/01_run_and_plot.py SEQUENCE [PICTURE.png]
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import probevo as pv


def run(path: Path) -> list[pv.MotionEstimate]:
    """Estimate the motion of each frame from the previous one; the first is the identity."""
    sequence = pv.open_sequence(path)
    odometry = pv.StereoOdometry(sequence.camera, noise=pv.noise.StudentT(), imu=sequence.imu)
    motions = []
    for frame in sequence:
        motion = odometry.step(frame)
        motions.append(motion)
        sigma_mm = (1e3 * np.sqrt(np.diagonal(motion.cov)[:3])).round(2)
        status = motion.status.name
        print(f"{frame.index:5d} {status:14} {motion.num_tracks:4d} tracks, 1σ {sigma_mm} mm")
    return motions


def plot(motions: list[pv.MotionEstimate], picture: Path) -> None:
    """Plot the path from above, and the standard deviation of the position along it."""
    # Errors of steps are correlated, by the calibration and by tracks: ``compound`` knows how.
    T_world_cam, cov = pv.compound(motions)
    x_m, _, z_m = T_world_cam[:, :3, 3].T
    sigma_mm = 1e3 * np.sqrt(np.diagonal(cov, axis1=1, axis2=2)[:, :3])

    figure = Figure(figsize=(9, 4), layout="constrained")
    path, uncertainty = figure.subplots(1, 2)
    path.plot(x_m, z_m)
    path.set(xlabel="right x, m", ylabel="forward z, m", title="from above", aspect="equal")
    uncertainty.plot(sigma_mm, label=["right", "down", "forward"])
    uncertainty.set(xlabel="frame", ylabel="1σ of the position, mm", title="claimed")
    uncertainty.legend()
    figure.savefig(picture)


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3):
        print("usage: python examples/01_run_and_plot.py SEQUENCE [PICTURE.png]", file=sys.stderr)
        sys.exit(2)
    plot(run(Path(sys.argv[1])), Path(sys.argv[2] if len(sys.argv) > 2 else "path.png"))
