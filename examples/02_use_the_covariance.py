"""Hand a motion and its covariance to GTSAM or ROS, which have other conventions.

python examples/02_use_the_covariance.py RUN_DIR        (the --out folder of `probevo run`)

probevo: T = Exp(ξ) T̄, ξ = [ρ; φ]. The perturbation acts on the left, with the translation first.
"""

import sys
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.geometry.uncertainty import invert
from probevo.output.motions_file import read_motions


def to_gtsam(T_curr_prev: FloatArray, cov: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the measurement of a ``BetweenFactorPose3(prev, curr)``.

    That is the pose of curr in prev, [4, 4], and its covariance, [6, 6]. GTSAM perturbs on the
    right and puts the rotation first. With T_prev_curr = T̄⁻¹ Exp(−ξ), the right perturbation is
    −ξ itself. Its sign does not change the covariance, so that only the order of the blocks does.
    """
    rotation_first = [3, 4, 5, 0, 1, 2]
    return se3.inverse(T_curr_prev), cov[np.ix_(rotation_first, rotation_first)]


def to_ros(T_curr_prev: FloatArray, cov: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return pose, [4, 4], and covariance, [6, 6], of a ``geometry_msgs/PoseWithCovariance``.

    ROS takes the errors of position and of small rotations about the fixed axes of prev. The left
    perturbation of T_prev_curr rotates about the same axes, but through the origin of prev, which
    also moves the position: p = ρ + φ × p̄.
    """
    T_prev_curr, cov_left = invert(T_curr_prev, cov)
    at_position = np.eye(6)
    at_position[:3, 3:] = np.cross(np.eye(3), T_prev_curr[:3, 3]).T
    return T_prev_curr, at_position @ cov_left @ at_position.T


def report(name: str, pose: FloatArray, cov: FloatArray) -> None:
    """Print a position and the standard deviations of its pose."""
    sigma = np.sqrt(np.diagonal(cov)).round(6)
    print(f"{name}: position {pose[:3, 3].round(4)} m, 1σ {sigma}")


def main(run: Path) -> None:
    """Convert the first step of a run for both."""
    result = read_motions(run / "motions.npz")
    report("GTSAM, [rotation; translation]", *to_gtsam(result.T_curr_prev[0], result.cov[0]))
    report("ROS, [position; rotation]", *to_ros(result.T_curr_prev[0], result.cov[0]))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        print("usage: python examples/02_use_the_covariance.py RUN_DIR", file=sys.stderr)
        sys.exit(2)
    main(Path(sys.argv[1]))
