"""A recorded drive: what is kept of steps that were solved, and of those that were not."""

from dataclasses import replace
from pathlib import Path

import numpy as np

import probevo as pv
from probevo.noise import StudentT
from probevo.predictors import prediction_space
from probevo.sequences.without_imu import WithoutImu
from probevo.training.drive import joined, load_drive, save_drive
from probevo.training.extraction import Extraction
from probevo_sim.point_world import write_points
from training.supervised_drives import point_world

SPACE = prediction_space(["place", "row_offset"])
CONFIG = pv.OdometryConfig()
REFUSED = 9
"""A frame whose features swapped places: no motion leads there, and none away from it."""


def write_drive(path: Path, *, swapped: bool) -> Path:
    write_points(point_world(frames=16), path)
    if swapped:
        with np.load(path) as archive:
            arrays = dict(archive)
        rows = np.flatnonzero(arrays["frame"] == REFUSED)
        arrays["uv"][rows] = arrays["uv"][np.random.default_rng(0).permutation(rows)]
        np.savez(path, **arrays)
    return path


def test_nothing_is_learned_from_a_step_that_was_not_solved(tmp_path: Path) -> None:
    """Its features are kept, but none of them counts as used."""
    sequence = pv.open_sequence(write_drive(tmp_path / "drive.npz", swapped=True))
    drive = joined(Extraction(sequence, SPACE, CONFIG, num_frames=len(sequence)))
    odometry = pv.StereoOdometry(sequence.camera, config=CONFIG)
    status = [odometry.step(frame).status for frame in sequence][1:]
    refused = [step for step, each in enumerate(status) if each is not pv.Status.OK]
    assert refused == [REFUSED - 1, REFUSED]
    for step in range(len(status)):
        used = drive.used[drive.rows(step)]
        assert len(used) > 50
        assert used.any() == (step not in refused)


def test_nothing_is_learned_from_frames_that_repeat(tmp_path: Path) -> None:
    """Their errors do, too: they would be learned as none at all."""
    write_points(point_world(frames=6), tmp_path / "drive.npz")
    sequence = WithoutImu.of(pv.open_sequence(tmp_path / "drive.npz"))
    frames = list(sequence)
    frames[3] = replace(frames[3], features=frames[2].features)
    sequence = replace(sequence, frames=frames)
    drive = joined(Extraction(sequence, SPACE, CONFIG, num_frames=6))
    used = [bool(drive.used[drive.rows(step)].any()) for step in range(5)]
    assert used[:3] == [True, True, False]


def test_it_keeps_what_the_odometry_saw(tmp_path: Path) -> None:
    """Motion, features and predictors of every step under the static noise; and how many frames are
    done, as it goes."""
    sequence = pv.open_sequence(write_drive(tmp_path / "drive.npz", swapped=False))
    done = list[int]()
    drive = joined(
        Extraction(sequence, SPACE, CONFIG, num_frames=len(sequence), on_frame=done.append)
    )
    assert done == list(range(1, 17))
    solver = CONFIG.solver.model_copy(update={"noise_scale": "model"})
    static = CONFIG.model_copy(update={"solver": solver})
    odometry = pv.StereoOdometry(sequence.camera, StudentT(), config=static, predictors=SPACE)
    for step, frame in enumerate(sequence, start=-1):
        motion = odometry.step(frame)
        if step >= 0:
            np.testing.assert_array_equal(drive.T_curr_prev[step], motion.T_curr_prev)
            np.testing.assert_array_equal(drive.tracks(step).curr_px, odometry.tracks.curr_px)
            np.testing.assert_array_equal(drive.phi[drive.rows(step)], odometry.phi)
            np.testing.assert_array_equal(drive.used[drive.rows(step)], odometry.used)


def test_a_drive_comes_back_from_disk_with_the_largest_of_identities(tmp_path: Path) -> None:
    """Whoever writes a tracks file may number tracks as he likes, up to 2⁶³ − 1."""
    write_points(point_world(frames=4), tmp_path / "drive.npz")
    with np.load(tmp_path / "drive.npz") as archive:
        arrays = dict(archive)
    arrays["track"] = np.iinfo(np.int64).max - arrays["track"]
    np.savez(tmp_path / "drive.npz", **arrays)
    sequence = pv.open_sequence(tmp_path / "drive.npz")
    drive = joined(Extraction(sequence, SPACE, CONFIG, num_frames=len(sequence)))
    save_drive(tmp_path / "part.npz", drive)
    read = load_drive(tmp_path / "part.npz")
    assert drive.ids.max() > 2**62
    for name in ("ids", "first_of_step", "numbers", "T_curr_prev", "used"):
        np.testing.assert_array_equal(getattr(read, name), getattr(drive, name))
    for name in ("prev_px", "curr_px", "phi"):
        np.testing.assert_allclose(getattr(read, name), getattr(drive, name), rtol=1e-6)
