"""A scene on disk: complete, resumable, and never mixed with another one."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from probevo.errors import InputError
from probevo.sequences import open_sequence
from probevo.sequences.formats.folder import SUN_FILE
from probevo_sim.scene.config import RigConfig, SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene
from probevo_sim.scene.writer import LAST_FILE, SETTINGS_FILE, write_scene

CONFIG = SceneConfig(
    preset="road", distance_m=8.0, rig=RigConfig(width_px=96, height_px=48, focal_px=60.0)
)


@pytest.fixture(scope="module")
def rendered() -> SceneRecording:
    return open_scene(CONFIG)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write the whole scene once; tests must not change it."""
    return write_scene(CONFIG, tmp_path_factory.mktemp("written") / "scene")


@pytest.fixture
def scene(written: Path, tmp_path: Path) -> Path:
    """Copy the scene for a test that changes it."""
    return Path(shutil.copytree(written, tmp_path / "scene"))


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_what_is_written_is_what_is_rendered(written: Path, rendered: SceneRecording) -> None:
    read = open_sequence(written)
    assert read.camera == rendered.camera
    np.testing.assert_array_equal(read.stamps_ns, rendered.stamps_ns)
    assert read.truth is not None
    assert rendered.truth is not None
    np.testing.assert_allclose(read.truth.T_world_cam, rendered.truth.T_world_cam, atol=1e-13)
    for there, here in zip(read, rendered, strict=True):
        np.testing.assert_array_equal(there.left, here.left)
        np.testing.assert_array_equal(there.right, here.right)
        assert (there.imu is None) == (here.imu is None)
        if there.imu is not None and here.imu is not None:
            np.testing.assert_array_equal(there.imu.gyro_rad_s, here.imu.gyro_rad_s)
            np.testing.assert_array_equal(there.imu.accel_m_s2, here.imu.accel_m_s2)


def test_the_sun_is_written_with_the_poses(scene: Path, rendered: SceneRecording) -> None:
    found = np.loadtxt(scene / SUN_FILE)
    np.testing.assert_array_equal(found, rendered.to_sun)
    write_scene(CONFIG.model_copy(update={"truth": "none"}), scene)
    assert not (scene / SUN_FILE).exists()


def test_pixel_truth_on_request(tmp_path: Path, rendered: SceneRecording) -> None:
    write_scene(CONFIG, tmp_path / "scene", pixel_truth=True)
    files = sorted((tmp_path / "scene" / "pixel_truth").iterdir())
    assert len(files) == len(rendered)
    with np.load(files[2]) as arrays:
        truth = rendered.pixel_truth(2)
        np.testing.assert_allclose(arrays["flow_px"], truth.flow_px, rtol=1e-6)
        np.testing.assert_allclose(arrays["disparity_px"], truth.disparity_px, rtol=1e-6)
        np.testing.assert_array_equal(arrays["moving"], truth.moving)


def test_a_stopped_call_is_resumed_and_ends_in_the_same_bytes(
    written: Path, rendered: SceneRecording, tmp_path: Path
) -> None:
    def stop(done: int, total: int) -> None:
        if done == 2:
            raise KeyboardInterrupt

    stopped = tmp_path / "stopped"
    with pytest.raises(KeyboardInterrupt):
        write_scene(CONFIG, stopped, jobs=1, on_frame=stop)
    assert not (stopped / LAST_FILE).exists()
    before = {path: path.stat().st_mtime_ns for path in (stopped / "left").iterdir()}
    assert 2 <= len(before) < len(rendered)
    progress: list[int] = []
    write_scene(CONFIG, stopped, on_frame=lambda done, total: progress.append(done))
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert progress[-1] == len(rendered)
    assert contents(stopped) == contents(written)


def test_a_complete_scene_is_not_rendered_again(written: Path) -> None:
    calls: list[int] = []
    write_scene(CONFIG, written, on_frame=lambda done, total: calls.append(done))
    assert calls == []


def test_the_number_of_threads_changes_nothing(written: Path, tmp_path: Path) -> None:
    """Of one thread, the resumed call has shown it."""
    assert contents(write_scene(CONFIG, tmp_path / "other", jobs=3)) == contents(written)


def test_a_folder_with_another_scene_is_refused_and_left_alone(scene: Path) -> None:
    before = contents(scene)
    with pytest.raises(InputError, match=SETTINGS_FILE):
        write_scene(CONFIG.model_copy(update={"seed": 5}), scene)
    assert contents(scene) == before


def test_truth_can_be_withheld_later_without_rendering_again(scene: Path) -> None:
    calls: list[int] = []
    write_scene(
        CONFIG.model_copy(update={"truth": "none"}),
        scene,
        on_frame=lambda done, total: calls.append(done),
    )
    assert open_sequence(scene).truth is None
    write_scene(CONFIG, scene, on_frame=lambda done, total: calls.append(done))
    assert open_sequence(scene).truth is not None
    assert calls == []


def test_what_a_killed_call_left_half_written_is_no_obstacle(
    rendered: SceneRecording, tmp_path: Path
) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    (folder / f"{SETTINGS_FILE}.part").write_text("rend")
    write_scene(CONFIG, folder)
    assert len(open_sequence(folder)) == len(rendered)


def test_a_folder_with_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match="not empty"):
        write_scene(CONFIG, tmp_path)
    (tmp_path / SETTINGS_FILE).write_bytes(b"\xff\xfe no text")
    with pytest.raises(InputError, match="not empty"):
        write_scene(CONFIG, tmp_path)
