from pathlib import Path

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.output import files


@pytest.fixture
def T_world_cam() -> FloatArray:
    return se3.exp(np.random.default_rng(0).normal(scale=[100, 100, 100, 1, 1, 1], size=(40, 6)))


def test_kitti_poses_come_back_bit_for_bit(tmp_path: Path, T_world_cam: FloatArray) -> None:
    files.write_kitti_poses(tmp_path / "trajectory.kitti.txt", T_world_cam)
    np.testing.assert_array_equal(files.read_kitti_poses(tmp_path / "trajectory.kitti.txt"), T_world_cam)


def test_unknown_kitti_poses_come_back_unknown(tmp_path: Path, T_world_cam: FloatArray) -> None:
    T_world_cam[3] = np.nan
    files.write_kitti_poses(tmp_path / "poses.txt", T_world_cam)
    np.testing.assert_array_equal(files.read_kitti_poses(tmp_path / "poses.txt"), T_world_cam)


def test_tum_keeps_stamps_exactly_and_poses_to_rounding(tmp_path: Path, T_world_cam: FloatArray) -> None:
    stamps_ns = 1_403_715_273_262_142_976 + np.cumsum(np.random.default_rng(1).integers(1, 10**8, 40))
    files.write_tum(tmp_path / "trajectory.tum", stamps_ns, T_world_cam)
    read_ns, read_T = files.read_tum(tmp_path / "trajectory.tum")
    np.testing.assert_array_equal(read_ns, stamps_ns)
    np.testing.assert_array_equal(read_T[:, :3, 3], T_world_cam[:, :3, 3])
    np.testing.assert_allclose(read_T, T_world_cam, atol=1e-15, rtol=0)


def test_tum_line(tmp_path: Path) -> None:
    """The stamp has nine decimals, the quaternion ends with its scalar."""
    files.write_tum(tmp_path / "t.tum", np.array([1_000_000_001]), np.eye(4)[None])
    assert (tmp_path / "t.tum").read_text() == "1.000000001 0.0 0.0 0.0 0.0 0.0 0.0 1.0\n"


def test_evo_reads_tum(tmp_path: Path, T_world_cam: FloatArray) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    files.write_tum(tmp_path / "t.tum", np.arange(40) * 10**8, T_world_cam)
    np.testing.assert_allclose(
        file_interface.read_tum_trajectory_file(tmp_path / "t.tum").poses_se3, T_world_cam, atol=1e-12
    )


def test_comments_blank_lines_and_scientific_stamps_are_read(tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    path.write_text("# stamp tx ty tz qx qy qz qw\n\n1.403636579763555584e+09 1 2 3 0 0 0 1\n")
    stamps_ns, T_world_cam = files.read_tum(path)
    assert stamps_ns.tolist() == [1_403_636_579_763_555_584]
    np.testing.assert_array_equal(T_world_cam[0, :3, 3], [1.0, 2.0, 3.0])


IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "holds no poses"),
        (f"{IDENTITY}\n1 0 0", "line 2: 3 numbers"),
        (f"{IDENTITY}\n{IDENTITY.replace('1', 'x')}", "line 2: could not convert"),
        (f"{IDENTITY}\n\n{IDENTITY[:-1]}inf", "line 3: not all numbers are finite"),
        (f"{IDENTITY}\n{IDENTITY[:-1]}nan", "line 2: not all numbers are finite"),
        ("2 0 0 0 0 2 0 0 0 0 2 0", "are no rotation"),
        ("1 0 0 1e300 0 1 0 0 0 0 1 0", "line 1: the position is over"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0", "are no rotation"),
    ],
)
def test_malformed_kitti_poses(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(InputError, match=complaint) as caught:
        files.read_kitti_poses(tmp_path / "poses.txt")
    assert caught.value.where.endswith("poses.txt")
    assert caught.value.cure


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("0 0 0 0 0 0 0 0", "line 1: the quaternion has length 0"),
        ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1", "line 2: stamp is not later"),
        ("0 0 0 nan 0 0 0 1", "not all numbers are finite"),
        ("0 0 -1e10 0 0 0 0 1", "line 1: the position is over"),
        ("inf 0 0 0 0 0 0 1", "no time in s"),
        ("a 0 0 0 0 0 0 1", "no time in s"),
        ("1e300 0 0 0 0 0 0 1", "no time in s"),
        ("0, 0, 0, 0, 0, 0, 0, 1", "no time in s"),
    ],
)
def test_malformed_tum(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "t.tum").write_text(text)
    with pytest.raises(InputError, match=complaint):
        files.read_tum(tmp_path / "t.tum")


def test_unreadable_files(tmp_path: Path) -> None:
    (tmp_path / "image.png").write_bytes(b"\x89PNG\xff\xfe")
    for path in (tmp_path / "absent.txt", tmp_path, tmp_path / "image.png"):
        with pytest.raises(InputError, match="cannot be read"):
            files.read_kitti_poses(path)


def test_json_keeps_order_and_precision(tmp_path: Path) -> None:
    files.write_json(tmp_path / "metrics.json", {"b": 0.1 + 0.2, "a": None})
    assert (tmp_path / "metrics.json").read_text() == '{\n  "b": 0.30000000000000004,\n  "a": null\n}\n'


def test_writing_replaces_whole_files_and_leaves_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "new" / "config.yaml"
    files.write_atomically(path, "a" * 1000)
    files.write_atomically(path, "b")
    assert path.read_text() == "b"
    assert [p.name for p in path.parent.iterdir()] == ["config.yaml"]


def test_place_that_cannot_be_written_to(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        files.write_atomically(tmp_path / "file" / "config.yaml", "")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        files.write_atomically(tmp_path / "folder", "")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "folder"]


def test_check_folder_makes_nothing(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    files.check_folder(tmp_path / "new" / "folder", "--out")
    for path in (tmp_path / "file", tmp_path / "file" / "folder"):
        with pytest.raises(InputError, match=r"--out: .*file is a file"):
            files.check_folder(path, "--out")
    assert [p.name for p in tmp_path.iterdir()] == ["file"]
