"""Pairs of images of a recording: true rotations, copies that turn further, files, refusals."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from cli.rendering import FOCAL_PX, STEP, write_wall
from probevo.errors import InputError
from probevo.geometry import so3
from probevo.nets.flow_field import rotated
from probevo.nets.image_pairs import facts_of, read_pairs
from probevo.sequences import open_sequence


def test_the_rotations_are_those_of_the_truth(tmp_path: Path) -> None:
    pairs = read_pairs(open_sequence(write_wall(tmp_path, frames=5)), 4)
    assert len(pairs) == 3
    np.testing.assert_allclose(pairs.rotations, np.tile(STEP[3:], (3, 1)), atol=1e-9)


@pytest.mark.parametrize(("repeats", "count"), [(0, 6), (1, 4), (3, 2)])
def test_images_that_stand_still_while_the_camera_moves_make_no_pair(
    tmp_path: Path, repeats: int, count: int
) -> None:
    """Nor does the next one: it shows the motion of all these frames."""
    folder = write_wall(tmp_path, frames=7)
    for side in ("left", "right"):
        for k in range(repeats):
            shutil.copy(folder / side / "000002.png", folder / side / f"{3 + k:06d}.png")
    pairs = read_pairs(open_sequence(folder), 7)
    assert len(pairs) == count
    np.testing.assert_allclose(pairs.rotations, np.tile(STEP[3:], (count, 1)), atol=1e-9)


def test_the_flow_is_that_of_the_images(tmp_path: Path) -> None:
    """A wall 8 m away that is approached by 0.15 m: mostly the rotation moves it."""
    pairs = read_pairs(open_sequence(write_wall(tmp_path, frames=3)), 3)
    by_rotation = rotated(np.zeros_like(pairs.fields), so3.exp(pairs.rotations))
    remaining = np.abs(pairs.fields[:, :2] - by_rotation[:, :2])
    assert np.median(remaining) < 2.0 / FOCAL_PX


def test_a_recording_without_truth_is_refused(tmp_path: Path) -> None:
    sequence = open_sequence(write_wall(tmp_path, frames=3, truth=False))
    with pytest.raises(InputError, match="no true poses"):
        read_pairs(sequence, 3)


def test_other_truth_is_another_recording(tmp_path: Path) -> None:
    """The facts, by which work of an earlier training is found again, differ."""
    folder = write_wall(tmp_path, frames=3)
    before = facts_of(open_sequence(folder), 3)
    assert facts_of(open_sequence(folder), 3) == before
    poses = (folder / "poses.txt").read_text().splitlines()
    (folder / "poses.txt").write_text("\n".join([poses[0], poses[2], poses[2]]) + "\n")
    assert facts_of(open_sequence(folder), 3) != before
