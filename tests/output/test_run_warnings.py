"""The warnings of a run: which steps count, and what is said of them."""

import numpy as np
import pytest

from probevo.estimation.motion_estimate import Status
from probevo.output.run_warnings import imu_warning, status_warning, timing_warning


@pytest.mark.parametrize("status", [s for s in Status if s not in (Status.FIRST, Status.OK)])
def test_the_status_that_prevails_is_named(status: Status) -> None:
    other = Status.GAP if status is not Status.GAP else Status.DEGENERATE
    said = status_warning(np.array([Status.OK, other, status, status]))
    assert said is not None
    assert said.startswith("Only 1 of 4 steps are OK")
    assert f"Most others are {status.name.replace('_', ' ').lower()}," in said


def test_half_of_the_steps_are_enough() -> None:
    assert status_warning(np.array([Status.OK, Status.GAP])) is None
    assert status_warning(np.zeros(0, np.int64)) is None


def test_an_imu_that_was_left_out_is_named_with_the_reason() -> None:
    assert imu_warning(None) is None
    said = imu_warning("contradicts the images")
    assert said is not None
    assert said.startswith("The IMU contradicts the images.")


def test_images_of_other_frames_are_named_with_the_cure() -> None:
    assert timing_warning(0) is None
    right = timing_warning(1)
    left = timing_warning(-2)
    assert right is not None
    assert left is not None
    assert right.startswith("The right images are one frame late")
    assert right.endswith("leave out the first right image.")
    assert left.startswith("The left images are 2 frames late")
    assert "2 frames earlier" in left
    assert left.endswith("leave out the first 2 left images.")
