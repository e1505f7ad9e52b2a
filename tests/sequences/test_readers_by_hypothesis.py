"""Readers by properties: what is written is read back; any bytes give an InputError or a value."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.calibrations.calibration_content import load_calibration
from probevo.sequences.calibrations.calibration_files import read_stereo_calibration
from probevo.sequences.formats.tracks_file import open_tracks
from probevo.sequences.images import read_gray
from probevo.sequences.pose_files import (
    read_kitti_poses,
    read_tum,
    write_kitti_poses,
    write_tum,
)
from probevo.sequences.stamps import read_datetimes, read_times
from probevo.sequences.text import read_stamped_csv, read_table
from probevo.sequences.yaml_file import load_yaml

few = settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
meters = st.floats(-1e6, 1e6, allow_nan=False)
radians = st.floats(-3.0, 3.0, allow_nan=False)
tangents = st.lists(
    st.tuples(meters, meters, meters, radians, radians, radians), min_size=1, max_size=9
)

READERS: dict[str, Callable[[Path], object]] = {
    "tum": read_tum,
    "kitti": read_kitti_poses,
    "times": lambda path: read_times(path, 3),
    "datetimes": lambda path: read_datetimes(path, 3),
    "table": lambda path: read_table(path, 4),
    "csv": lambda path: read_stamped_csv(path, 6, is_imu=True),
    "yaml": load_yaml,
    "calibration": read_stereo_calibration,
    "calibration content": load_calibration,
    "image": read_gray,
    "tracks": open_tracks,
}
NUMBERS = st.text(alphabet="0123456789.eE+-naif ,\n\t#:", max_size=200)
"""Texts that are nearly tables."""
YAMLISH = st.text(alphabet="abcu_px:[]{}-0123456789. \n&*!#'\"", max_size=200)


def poses(values: list[tuple[float, ...]]) -> FloatArray:
    return se3.exp(np.array(values))


@few
@given(values=tangents, start_ns=st.integers(0, 2**62))
def test_tum_poses_come_back(
    values: list[tuple[float, ...]], start_ns: int, tmp_path: Path
) -> None:
    """Stamps to the nanosecond; a quaternion has the rounding of its four numbers."""
    T = poses(values)
    stamps_ns = start_ns + 10_000_000 * np.arange(len(T))
    write_tum(tmp_path / "a.tum", stamps_ns, T)
    read_ns, read = read_tum(tmp_path / "a.tum")
    np.testing.assert_array_equal(read_ns, stamps_ns)
    np.testing.assert_array_equal(read[:, :3, 3], T[:, :3, 3])
    np.testing.assert_allclose(read[:, :3, :3], T[:, :3, :3], atol=1e-14)


@few
@given(values=tangents)
def test_kitti_poses_come_back_to_the_bit(values: list[tuple[float, ...]], tmp_path: Path) -> None:
    T = poses(values)
    write_kitti_poses(tmp_path / "a.txt", T)
    np.testing.assert_array_equal(read_kitti_poses(tmp_path / "a.txt"), T)


@pytest.mark.parametrize("name", READERS)
@few
@given(content=st.one_of(st.binary(max_size=300), NUMBERS, YAMLISH, st.text(max_size=100)))
def test_anything_is_a_value_or_refused(name: str, content: bytes | str, tmp_path: Path) -> None:
    data = content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass")
    path = tmp_path / ("a.npz" if name == "tracks" else "a.yaml")
    path.write_bytes(data)
    messages = []
    try:
        READERS[name](path)
    except InputError as error:
        messages.append(str(error))
    assert all(text.startswith(str(path)) for text in messages)
