from pathlib import Path

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.output.files import write_json, write_tum


@pytest.fixture
def T_world_cam() -> FloatArray:
    return se3.exp(np.random.default_rng(0).normal(scale=[100, 100, 100, 1, 1, 1], size=(40, 6)))


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


def test_json_keeps_order_and_precision(tmp_path: Path) -> None:
    write_json(tmp_path / "metrics.json", {"b": 0.1 + 0.2, "a": None})
    assert (
        tmp_path / "metrics.json"
    ).read_text() == '{\n  "b": 0.30000000000000004,\n  "a": null\n}\n'
