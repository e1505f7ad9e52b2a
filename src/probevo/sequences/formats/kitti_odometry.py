"""KITTI odometry benchmark: a sequence in its native layout.

Images are in ``sequences/<nn>``, poses of camera 0 in ``poses/<nn>.txt``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from probevo.sequences.calibrations.kitti_calibration import KittiCalibration
from probevo.sequences.images import list_pairs, pair_size_px
from probevo.sequences.pose_files import read_kitti_truth
from probevo.sequences.recording import StereoRecording
from probevo.sequences.stamps import read_times

# Numbers of the left and the right camera
GRAY = (0, 1)
COLOUR = (2, 3)


def open_kitti_odometry(path: Path) -> StereoRecording:
    """Open the grayscale cameras 0 and 1 of a sequence, or else the colour cameras 2 and 3.

    Ground truth is ``../../poses/<nn>.txt``, if that file exists. The size of the images is that of
    the first one, since the layout does not state it.

    Raises:
        InputError: a file or field is missing, the counts of images, times and poses differ, or a
            value is impossible.
    """
    has_only_colour = (path / "image_2").exists() and not (path / "image_0").exists()
    left, right = COLOUR if has_only_colour else GRAY
    left_files, right_files = list_pairs(path / f"image_{left}", path / f"image_{right}")
    size_px = pair_size_px(left_files[0], right_files[0])
    calibration = KittiCalibration(path / "calib.txt", "It holds the projections P0 to P3.")
    camera = calibration.stereo_camera(f"P{left}", f"P{right}", size_px)
    stamps_ns = read_times(path / "times.txt", len(left_files))
    absolute = path.resolve()
    poses = absolute.parent.parent / "poses" / f"{absolute.name}.txt"
    truth = None
    if poses.exists():
        image_names = [file.stem for file in left_files]
        truth = read_kitti_truth(poses, stamps_ns, image_names=image_names)
    if truth is not None and has_only_colour:
        truth = replace(truth, T_world_cam=truth.T_world_cam @ calibration.T_cam0_cam("P2"))
    return StereoRecording(
        path=path,
        format="kitti-odometry",
        camera=camera,
        stamps_ns=stamps_ns,
        left_files=left_files,
        right_files=right_files,
        truth=truth,
    )
