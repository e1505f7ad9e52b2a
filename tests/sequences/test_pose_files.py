from pathlib import Path

import numpy as np
import pytest

import probevo as pv
from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.pose_files import read_kitti_poses, read_tum, write_kitti_poses, write_tum


@pytest.fixture
def T_world_cam() -> FloatArray:
    return se3.exp(np.random.default_rng(0).normal(scale=[100, 100, 100, 1, 1, 1], size=(40, 6)))


def test_kitti_poses_come_back_bit_for_bit(tmp_path: Path, T_world_cam: FloatArray) -> None:
    write_kitti_poses(tmp_path / "trajectory.kitti.txt", T_world_cam)
    np.testing.assert_array_equal(read_kitti_poses(tmp_path / "trajectory.kitti.txt"), T_world_cam)


def test_unknown_kitti_poses_come_back_unknown(tmp_path: Path, T_world_cam: FloatArray) -> None:
    T_world_cam[3] = np.nan
    write_kitti_poses(tmp_path / "poses.txt", T_world_cam)
    np.testing.assert_array_equal(read_kitti_poses(tmp_path / "poses.txt"), T_world_cam)


def test_tum_keeps_stamps_exactly_and_poses_to_rounding(
    tmp_path: Path, T_world_cam: FloatArray
) -> None:
    stamps_ns = 1_403_715_273_262_142_976 + np.cumsum(
        np.random.default_rng(1).integers(1, 10**8, 40)
    )
    write_tum(tmp_path / "trajectory.tum", stamps_ns, T_world_cam)
    read_ns, read_T = read_tum(tmp_path / "trajectory.tum")
    np.testing.assert_array_equal(read_ns, stamps_ns)
    np.testing.assert_array_equal(read_T[:, :3, 3], T_world_cam[:, :3, 3])
    np.testing.assert_allclose(read_T, T_world_cam, atol=1e-15, rtol=0)


def test_tum_line(tmp_path: Path) -> None:
    """The stamp has nine decimals, the quaternion ends with its scalar."""
    write_tum(tmp_path / "t.tum", np.array([1_000_000_001]), np.eye(4)[None])
    assert (tmp_path / "t.tum").read_text() == "1.000000001 0.0 0.0 0.0 0.0 0.0 0.0 1.0\n"


def test_evo_reads_tum(tmp_path: Path, T_world_cam: FloatArray) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    write_tum(tmp_path / "t.tum", np.arange(40) * 10**8, T_world_cam)
    np.testing.assert_allclose(
        file_interface.read_tum_trajectory_file(tmp_path / "t.tum").poses_se3,
        T_world_cam,
        atol=1e-12,
    )


def test_comments_blank_lines_and_scientific_stamps_are_read(tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    path.write_text("# stamp tx ty tz qx qy qz qw\n\n1.403636579763555584e+09 1 2 3 0 0 0 1\n")
    stamps_ns, T_world_cam = read_tum(path)
    assert stamps_ns.tolist() == [1_403_636_579_763_555_584]
    np.testing.assert_array_equal(T_world_cam[0, :3, 3], [1.0, 2.0, 3.0])


IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "holds no values"),
        (f"{IDENTITY}\n1 0 0", "poses.txt:2: this line has 3 values"),
        (f"{IDENTITY}\n{IDENTITY.replace('1', 'x')}", "poses.txt:2: 'x' is not a number"),
        (f"{IDENTITY}\n\n{IDENTITY[:-1]}inf", "poses.txt:3: the value 'inf' is not finite"),
        (f"{IDENTITY}\n{IDENTITY[:-1]}nan", "pose 1 .* partly not finite"),
        ("2 0 0 0 0 2 0 0 0 0 2 0", "no rotation matrix"),
        ("1 0 0 1e300 0 1 0 0 0 0 1 0", "the position of pose 0 .* is over"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0", "no rotation matrix"),
    ],
)
def test_malformed_kitti_poses(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(InputError, match=complaint) as caught:
        read_kitti_poses(tmp_path / "poses.txt")
    assert "poses.txt" in caught.value.where


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("0 0 0 0 0 0 0 0", "t.tum:1: the quaternion has length 0"),
        ("0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1", "stamp 1 .* is a duplicate of"),
        ("0 0 0 nan 0 0 0 1", "t.tum:1: the value 'nan' is not finite"),
        ("0 0 -1e10 0 0 0 0 1", "the position of pose 0 .* is over"),
        ("inf 0 0 0 0 0 0 1", "number of seconds"),
        ("a 0 0 0 0 0 0 1", "number of seconds"),
        ("1e300 0 0 0 0 0 0 1", "number of seconds"),
        ("0, 0, 0, 0, 0, 0, 0, 1", "commas(?s:.*)Replace the commas by blanks"),
    ],
)
def test_malformed_tum(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "t.tum").write_text(text)
    with pytest.raises(InputError, match=complaint):
        read_tum(tmp_path / "t.tum")


def test_unreadable_files(tmp_path: Path) -> None:
    (tmp_path / "image.png").write_bytes(b"\x89PNG\xff\xfe")
    for path in (tmp_path / "absent.txt", tmp_path, tmp_path / "image.png"):
        with pytest.raises(InputError, match=r"is missing|cannot be read"):
            read_kitti_poses(path)


def test_a_path_of_another_shape_is_refused(tmp_path: Path, T_world_cam: FloatArray) -> None:
    with pytest.raises(InputError, match=r"T_world_cam: its shape is \(4, 4\)"):
        pv.write_kitti_poses(tmp_path / "poses.txt", T_world_cam[0])
    stamps_s = 0.1 * np.arange(len(T_world_cam))
    with pytest.raises(InputError, match=r"stamps_ns: .* its type float64"):
        pv.write_tum(tmp_path / "path.tum", stamps_s, T_world_cam)  # type: ignore[arg-type]
    pv.write_tum(str(tmp_path / "path.tum"), (1e9 * stamps_s).astype(np.int64), T_world_cam)
    assert len((tmp_path / "path.tum").read_text().splitlines()) == len(T_world_cam)


def test_unknown_poses_have_no_line_in_tums_format(tmp_path: Path, T_world_cam: FloatArray) -> None:
    T_world_cam[3] = np.nan
    T_world_cam[7, :3] = np.nan
    stamps_ns = np.arange(40) * 10**8
    pv.write_tum(tmp_path / "path.tum", stamps_ns, T_world_cam)
    read_ns, read_T = read_tum(tmp_path / "path.tum")
    known = np.delete(np.arange(40), [3, 7])
    np.testing.assert_array_equal(read_ns, stamps_ns[known])
    np.testing.assert_allclose(read_T, T_world_cam[known], atol=1e-15, rtol=0)


@pytest.mark.parametrize(
    ("pose", "complaint"),
    [
        (np.zeros((4, 4)), "pose 5 .* holds no rotation matrix"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "pose 5 .* holds no rotation matrix"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "pose 5 .* holds no rotation matrix"),
        (np.diag([1.0, 1.0, np.nan, 1.0]), "pose 5 .* is partly not finite"),
    ],
)
def test_what_is_no_pose_is_not_written(
    tmp_path: Path, T_world_cam: FloatArray, pose: FloatArray, complaint: str
) -> None:
    T_world_cam[5] = pose
    with pytest.raises(InputError, match=f"T_world_cam: {complaint}"):
        pv.write_tum(tmp_path / "path.tum", np.arange(40) * 10**8, T_world_cam)
    with pytest.raises(InputError, match=f"T_world_cam: {complaint}"):
        pv.write_kitti_poses(tmp_path / "path.txt", T_world_cam)
    assert not list(tmp_path.iterdir())


def test_stamps_that_do_not_ascend_are_not_written(tmp_path: Path, T_world_cam: FloatArray) -> None:
    stamps_ns = np.arange(40) * 10**8
    stamps_ns[9] = stamps_ns[8]
    with pytest.raises(InputError, match=r"stamps_ns: stamp 9 \(from 0\), 800000000 ns, is not"):
        pv.write_tum(tmp_path / "path.tum", stamps_ns, T_world_cam)
