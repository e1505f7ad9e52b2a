"""Names of the files that a run writes.

This module imports nothing: the help of a command should not wait for NumPy.
"""

SETTINGS = "config.yaml"
METRICS = "metrics.json"
REPORT = "report.html"
TRAJECTORY_TUM = "trajectory.tum"
TRAJECTORY_KITTI = "trajectory.kitti.txt"
MOTIONS = "motions.npz"
"""The motions, with all that is known of each step; a folder that has it is that of a run."""
SMOOTHED_TUM = "trajectory.smoothed.tum"
SMOOTHED_KITTI = "trajectory.smoothed.kitti.txt"
"""Poses as they left the window, if there is one."""
VIEWER_SUFFIX = ".rrd"
"""Ending of a file for the Rerun viewer."""
