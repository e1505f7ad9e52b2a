"""KITTI odometry benchmark: one sequence in its native layout, ``sequences/<nn>`` and
``poses/<nn>.txt``."""

from __future__ import annotations

from pathlib import Path

from probevo.sequences.images import list_pairs, read_gray
from probevo.sequences.kitti_calibration import KittiCalibration
from probevo.sequences.pose_files import read_kitti_truth
from probevo.sequences.recording import StereoRecording
from probevo.sequences.stamps import read_times


def open_kitti_odometry(path: Path) -> StereoRecording:
    """Grayscale cameras 0 and 1 of a sequence, with the benchmark's poses if
    ``../../poses/<nn>.txt`` is there.

    The layout does not write down the size of the images, so that of the first one counts.

    Raises:
        InputError: a file or field is missing, counts differ (of images, times, poses), or a value
            cannot be right.
    """
    left_files, right_files = list_pairs(path / "image_0", path / "image_1")
    height, width = read_gray(left_files[0]).shape
    calibration = KittiCalibration(path / "calib.txt", "It holds the projections P0 and P1.")
    camera = calibration.stereo_camera("P0", "P1", (width, height))
    stamps_ns = read_times(path / "times.txt", len(left_files))
    absolute = path.resolve()
    poses = absolute.parent.parent / "poses" / f"{absolute.name}.txt"
    truth = read_kitti_truth(poses, stamps_ns) if poses.exists() else None
    return StereoRecording(
        path,
        "kitti-odometry",
        camera,
        stamps_ns=stamps_ns,
        left_files=left_files,
        right_files=right_files,
        truth=truth,
    )
