import zipfile
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from probevo.camera.focal_length import FocalLengthError
from probevo.camera.rig_calibration import RowErrors
from probevo.errors import InputError
from probevo.estimation.motion_estimate import COMMON_MODE_COLUMNS
from probevo.evaluation.accelerometer_scale import AccelerometerScale
from probevo.evaluation.ground_height import GroundHeight
from probevo.measurements.imu_calibration_errors import ImuCalibrationErrors
from probevo.measurements.imu_reason import ImuFault
from probevo.output.motions_file import read_motions, write_motions
from probevo.output.run_result import RunResult, SensorUse
from probevo.tracking.fixed_features import FixedFeatures, StepsAtRest


@pytest.mark.parametrize("outside", [None, 7])
@pytest.mark.parametrize("count", [1, 2, 30])
def test_a_run_comes_back_as_it_was(
    make_run: Callable[..., RunResult], tmp_path: Path, count: int, outside: int | None
) -> None:
    run = replace(make_run(count, outside=outside), unusable={"imu_samples_too_large": 3})
    if outside is not None:
        run = replace(run, jitter_sigma_rad=np.array([1e-5, 2e-4, 3e-5]), right_late_frames=-1)
        run = replace(run, is_interlaced=True)
        run = replace(run, focal_length=FocalLengthError(-0.02, 0.003))
        run = replace(run, fixed_features=FixedFeatures(900, 30, (300.5, 400.0), (50.0, 9.5)))
        run = replace(run, steps_at_rest=StepsAtRest(29, 20, 900, 90))
        run = replace(run, row_errors=RowErrors(sigmas=11.5, largest_px=12.9))
        run = replace(run, ground_height=GroundHeight(1.64, 0.01, 12, known_m=1.65))
        run = replace(
            run,
            right_delay_s=-0.0015,
            readout_s=0.02,
            imu_noise_factor=2.5,
            stopped="stopped by Ctrl-C.",
        )
        run = replace(run, accelerometer_scale=AccelerometerScale(1.02, 0.01, 17))
        errors = ImuCalibrationErrors(0.01 * np.arange(9.0), 0.1 * np.ones(9), np.ones(9))
        run = replace(run, imu_calibration_errors=errors)
        run = replace(
            run,
            other_camera="is wider",
            noise_is_learned=True,
            imu_left_out="contradicts the images",
            imu_fault=ImuFault.CONTRADICTION,
            imu_unused_from=7,
        )
        lying = SensorUse(4, 1, {"no fix": 2}, excluded=3, excluded_at=20, reason="is off by 5 σ")
        run = replace(run, sensors={"gps": lying, "the sun": SensorUse(used=29)})
        run = replace(run, T_world_cam=run.T_world_cam + 1e-3)
    else:
        run = replace(run, ground_height=GroundHeight(1.64, 0.01, 12))
    write_motions(tmp_path / "motions.npz", run)
    back = read_motions(tmp_path / "motions.npz")
    for field in fields(RunResult):
        expected = getattr(run, field.name)
        found = getattr(back, field.name)
        if isinstance(expected, ImuCalibrationErrors):
            expected = vars(expected)
            found = vars(found)
        np.testing.assert_equal(found, expected)


def test_names_and_types_in_the_file(make_run: Callable[..., RunResult], tmp_path: Path) -> None:
    write_motions(tmp_path / "motions.npz", make_run(5, outside=7))
    with np.load(tmp_path / "motions.npz") as archive:
        found = {name: (archive[name].shape, archive[name].dtype.str) for name in archive.files}
        about = str(archive["about"])
    assert "left perturbation [translation; rotation]" in about
    del found["about"]
    assert found == {
        "stamps_ns": ((5,), "<i8"),
        "T_curr_prev": ((4, 4, 4), "<f8"),
        "cov": ((4, 6, 6), "<f8"),
        "status": ((4,), "<i8"),
        "num_tracks": ((4,), "<i8"),
        "num_inliers": ((4,), "<i8"),
        "num_used": ((4,), "<i8"),
        "num_out_of_domain": ((4,), "<i8"),
        "noise_factor": ((4,), "<f8"),
        "common_mode": ((4, 6, COMMON_MODE_COLUMNS), "<f8"),
        "path_cross_cov": ((4, 6, 6), "<f8"),
        "total_ms": ((4,), "<f8"),
        "ms_track": ((4,), "<f8"),
        "ms_solve": ((4,), "<f8"),
        "rejected_row_offset": ((), "<i8"),
        "rejected_flow": ((), "<i8"),
    }


def test_files_from_before_the_path_was_stored(
    make_run: Callable[..., RunResult], tmp_path: Path
) -> None:
    run = make_run(5)
    corrected = replace(run, T_world_cam=run.T_world_cam + 1e-3, sensors={"gps": SensorUse(4)})
    write_motions(tmp_path / "new.npz", corrected)
    with np.load(tmp_path / "new.npz") as archive:
        old_names = set(archive.files) - {"T_world_cam", "sensors"}
        np.savez(tmp_path / "old.npz", **{name: archive[name] for name in old_names})
    old = read_motions(tmp_path / "old.npz")
    np.testing.assert_array_equal(old.T_world_cam, run.T_world_cam)
    assert old.sensors == {}


def test_files_from_before_the_features_were_counted_and_their_noise_scaled(
    make_run: Callable[..., RunResult], tmp_path: Path
) -> None:
    run = make_run(5, outside=7)
    write_motions(tmp_path / "new.npz", run)
    with np.load(tmp_path / "new.npz") as archive:
        old_names = set(archive.files) - {"num_used", "num_out_of_domain", "noise_factor"}
        np.savez(tmp_path / "old.npz", **{name: archive[name] for name in old_names})
    old = read_motions(tmp_path / "old.npz")
    np.testing.assert_array_equal(old.cov, run.cov)
    assert (old.num_used, old.num_out_of_domain, old.out_of_domain) == (None, None, None)
    assert old.noise_factor is None


def test_covariances_from_a_later_frame_are_the_same_when_read_back(
    make_run: Callable[..., RunResult], tmp_path: Path
) -> None:
    """Those of a window; the file does not hold its smoothed poses, but their covariances."""
    run = make_run(6)
    cross_cov = np.tile(1e-6 * np.eye(6), (5, 1, 1))
    smoothed_cov = np.tile(1e-4 * np.eye(6), (6, 1, 1))
    run = replace(
        run, path_cross_cov=cross_cov, smoothed=run.T_world_cam, smoothed_cov=smoothed_cov
    )
    write_motions(tmp_path / "motions.npz", run)
    back = read_motions(tmp_path / "motions.npz")
    for origin in (0, 2):
        np.testing.assert_array_equal(
            back.drift_covariances_from(origin), run.drift_covariances_from(origin)
        )


def test_only_times_differ_between_runs(make_run: Callable[..., RunResult], tmp_path: Path) -> None:
    write_motions(tmp_path / "a.npz", make_run(20))
    write_motions(tmp_path / "b.npz", make_run(20, hurry=1.5))
    with zipfile.ZipFile(tmp_path / "a.npz") as a, zipfile.ZipFile(tmp_path / "b.npz") as b:
        assert a.namelist() == b.namelist()
        differing = {name for name in a.namelist() if a.read(name) != b.read(name)}
        assert {info.date_time for info in a.infolist()} == {(1980, 1, 1, 0, 0, 0)}
    assert differing == {"ms_track.npy", "ms_solve.npy", "total_ms.npy"}


def test_the_same_run_gives_the_same_bytes(
    make_run: Callable[..., RunResult], tmp_path: Path
) -> None:
    for name in ("a", "b"):
        write_motions(tmp_path / name, make_run(20))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"cov": None}, "cov is missing"),
        ({"stamps_ns": None}, "stamps_ns is missing"),
        ({"T_curr_prev": np.zeros((3, 4, 4))}, r"T_curr_prev has shape \(3, 4, 4\)"),
        ({"cov": np.zeros((4, 6, 6))}, "cov of motion 0 is not positive definite"),
        ({"cov": np.full((4, 6, 6), np.nan)}, "cov holds values that are not finite numbers"),
        ({"status": np.array(["a"] * 4)}, "status holds values"),
        ({"num_out_of_domain": np.zeros(3)}, r"num_out_of_domain has shape \(3,\)"),
        ({"noise_factor": np.array([1.0, 0.5, 0.0, 0.5])}, "noise_factor holds a factor"),
        ({"rejected_flow": np.zeros(2)}, "rejected_flow has shape"),
        ({"T_world_cam": np.zeros((4, 4, 4))}, r"T_world_cam has shape \(4, 4, 4\)"),
        ({"sensors": np.zeros(2)}, "sensors is not text"),
        ({"sensors": np.array("[]")}, "sensors does not say how sensors were used"),
        ({"sensors": np.array('{"gps": {"used": "x"}}')}, "sensors does not say how"),
        ({"stopped": np.array(["a"])}, "stopped is not text"),
        ({"imu_fault": np.array("bad mood")}, "imu_fault is no kind of reason"),
    ],
)
def test_malformed_contents(
    make_run: Callable[..., RunResult],
    tmp_path: Path,
    change: dict[str, np.ndarray | None],
    complaint: str,
) -> None:
    write_motions(tmp_path / "good.npz", make_run(5))
    with np.load(tmp_path / "good.npz") as archive:
        arrays = dict(archive) | change
    np.savez(
        tmp_path / "bad.npz", **{name: array for name, array in arrays.items() if array is not None}
    )
    with pytest.raises(InputError, match=complaint):
        read_motions(tmp_path / "bad.npz")


def test_unreadable_files(make_run: Callable[..., RunResult], tmp_path: Path) -> None:
    write_motions(tmp_path / "good.npz", make_run(5))
    whole = (tmp_path / "good.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "text.npz").write_text("not a zip")
    (tmp_path / "empty.npz").write_bytes(b"")
    np.save(tmp_path / "single.npy", np.eye(3))
    (tmp_path / "flipped.npz").write_bytes(whole.replace(b"\x00\x00\xf0\x3f", b"\x00\x00\xf0\x3e"))
    version = whole.index(b"PK\x01\x02") + 6  # of the archive's form, as its first entry needs it
    (tmp_path / "future.npz").write_bytes(whole[:version] + b"\xff" + whole[version + 1 :])
    for name in (
        "absent.npz",
        "cut.npz",
        "text.npz",
        "empty.npz",
        "single.npy",
        "flipped.npz",
        "future.npz",
        ".",
    ):
        with pytest.raises(InputError, match="cannot be read"):
            read_motions(tmp_path / name)
