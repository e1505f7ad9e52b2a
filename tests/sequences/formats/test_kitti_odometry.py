"""KITTI's odometry benchmark: the colour release, and a recording of which a part is kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from probevo.errors import InputError
from probevo.sequences import open_sequence
from sequences.recordings import (
    BASELINE_M,
    FU_PX,
    numbers,
    poses,
    projection,
    write_kitti_odometry,
    write_lines,
)

OF_CAMERA_2_M = 0.06
"""How far camera 2 is to the left of camera 0."""


def test_without_grey_images_those_of_the_colour_cameras_are_read(tmp_path: Path) -> None:
    path = write_kitti_odometry(tmp_path)
    for grey, colour in (("image_0", "image_2"), ("image_1", "image_3")):
        (path / grey).rename(path / colour)
    shift_px_m = FU_PX * OF_CAMERA_2_M
    write_lines(
        path / "calib.txt",
        [
            f"P0: {projection()}",
            f"P1: {projection(-FU_PX * 0.537)}",
            f"P2: {projection(shift_px_m)}",
            f"P3: {projection(shift_px_m - FU_PX * BASELINE_M)}",
        ],
    )
    sequence = open_sequence(path)
    assert sequence.format == "kitti-odometry"
    assert len(list(sequence)) == 4
    np.testing.assert_allclose(sequence.camera.baseline_m, BASELINE_M)
    assert sequence.truth is not None
    expected = poses(4)
    expected[:, :3, 3] -= expected[:, :3, 0] * OF_CAMERA_2_M  # poses are those of camera 0
    np.testing.assert_allclose(sequence.truth.T_world_cam, expected, atol=1e-9)


def test_frames_that_were_left_out_keep_the_poses_of_their_numbers(tmp_path: Path) -> None:
    path = write_kitti_odometry(tmp_path)
    for folder in ("image_0", "image_1"):
        (path / folder / "000001.png").unlink()
    write_lines(path / "times.txt", [f"{0.1 * index:.6e}" for index in (0, 2, 3)])
    truth = open_sequence(path).truth
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam, poses(4)[[0, 2, 3]], atol=1e-9)


def test_poses_of_fewer_frames_are_refused(tmp_path: Path) -> None:
    path = write_kitti_odometry(tmp_path)
    write_lines(tmp_path / "poses" / "07.txt", [numbers(T[:3]) for T in poses(3)])
    with pytest.raises(InputError, match="3 poses for 4 frames"):
        open_sequence(path)
