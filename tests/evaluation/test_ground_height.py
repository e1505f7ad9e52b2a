from pathlib import Path

import numpy as np
import pytest

import probevo as pv
from probevo.camera.stereo import StereoCamera
from probevo.cli.calibrate_check import report_lines
from probevo.evaluation.ground_height import MIN_BLOCKS, GroundHeight, GroundHeights
from probevo.geometry import se3
from probevo.output.run_warnings import height_warning
from probevo.runs.calibration_check import check_calibration
from probevo.runs.runner import run_sequence

CAMERA = StereoCamera(
    fu_px=720.0, fv_px=720.0, cu_px=610.0, cv_px=170.0, baseline_m=0.54, size_px=(1240, 370)
)
STEP_NS = 100_000_000


def driven(
    seed: int,
    camera: StereoCamera = CAMERA,
    *,
    height_m: float = 1.65,
    steps: int = 80,
    bounce_m: float = 0.0,
    sigma_px: float = 0.1,
    turn_rad: float = 0.01,
    pavement_m: float = 0.15,
) -> GroundHeight | None:
    """Drive over a lane with pavements on both sides, 1 m a step; the camera looks down by 3°.

    What is seen with CAMERA is triangulated with ``camera``, whose motions are scaled likewise.
    """
    rng = np.random.default_rng(seed)
    heading_rad = turn_rad * np.arange(steps)
    x_m = np.cumsum(np.sin(heading_rad))
    z_m = np.cumsum(np.cos(heading_rad))
    # Points of the ground around the path; those beside it lie higher.
    at = rng.integers(0, steps, 6000)
    aside_m = rng.uniform(-4.0, 4.0, 6000)
    ground = np.column_stack(
        [
            x_m[at] + aside_m * np.cos(heading_rad[at]),
            np.where(np.abs(aside_m) > 1.5, -pavement_m, 0.0),
            z_m[at] - aside_m * np.sin(heading_rad[at]) + rng.uniform(0.0, 1.0, 6000),
        ]
    )
    pitch = se3.exp(np.array([0.0, 0.0, 0.0, np.deg2rad(3.0), 0.0, 0.0]))
    scale = camera.baseline_m / CAMERA.baseline_m
    heights = GroundHeights(camera)
    T_world_prev = np.eye(4)
    for k in range(steps):
        T_world_cam = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, heading_rad[k], 0.0])) @ pitch
        bounce = bounce_m * np.sin(0.7 * k)
        T_world_cam[:3, 3] = [x_m[k], -height_m + bounce, z_m[k]]
        points = se3.transform(se3.inverse(T_world_cam), ground)
        ahead = points[:, 2] > 3.0
        pixels = CAMERA.project(points[ahead])
        inside = (pixels >= 0.0).all(axis=1) & (pixels[:, 1] < 370.0) & (pixels[:, 0] < 1240.0)
        pixels = pixels[inside] + rng.normal(0.0, sigma_px, (int(inside.sum()), 4))
        T_curr_prev = se3.inverse(T_world_cam) @ T_world_prev if k else np.eye(4)
        T_curr_prev[:3, 3] *= scale
        heights.add(k * STEP_NS, T_curr_prev, np.flatnonzero(ahead)[inside], pixels, is_ok=k > 0)
        T_world_prev = T_world_cam
    return heights.height()


def test_the_height_is_found_within_its_standard_deviation() -> None:
    found = [driven(seed) for seed in range(8)]
    errors = np.array([height.height_m - 1.65 for height in found if height is not None])
    sigmas = np.array([height.sigma_m for height in found if height is not None])
    assert len(errors) == 8
    # An offset of all disparities, which σ counts with, is not part of the simulation.
    assert np.abs(errors).max() < 2.0 * sigmas.max()
    assert sigmas.max() < 0.01


def test_pavements_do_not_count() -> None:
    low = driven(1, pavement_m=0.0)
    high = driven(1, pavement_m=0.5)
    assert low is not None
    assert high is not None
    assert high.height_m == pytest.approx(low.height_m, abs=0.002)


def test_a_wrong_baseline_is_the_ratio_of_the_heights() -> None:
    right = driven(2)
    wide = driven(2, camera=with_factor(baseline=1.05))
    assert right is not None
    assert wide is not None
    assert wide.height_m / right.height_m == pytest.approx(1.05, abs=1e-3)


def test_a_camera_whose_height_varies_has_none() -> None:
    assert driven(3, bounce_m=0.5) is None


def test_a_camera_at_rest_or_with_few_frames_has_none() -> None:
    assert driven(4, steps=5 * MIN_BLOCKS // 2) is None
    heights = GroundHeights(CAMERA)
    pixels = CAMERA.project(np.array([[0.0, 1.65, 8.0]]))
    for k in range(100):
        heights.add(k * STEP_NS, np.eye(4), np.array([0]), pixels, is_ok=True)
    assert heights.height() is None


def test_a_step_that_is_not_solved_forgets_the_points_ahead() -> None:
    heights = GroundHeights(CAMERA)
    pixels = CAMERA.project(np.array([[0.0, 1.65, 4.0], [0.1, 1.65, 4.2], [0.0, 1.65, 4.3]]))
    forward = se3.exp(np.array([0.0, 0.0, -5.0, 0.0, 0.0, 0.0]))
    none = (np.zeros(0, np.int64), np.zeros((0, 4)))
    heights.add(0, np.eye(4), np.arange(3), pixels, is_ok=True)
    heights.add(STEP_NS, forward, *none, is_ok=False)
    assert len(heights._ids) == 0
    assert heights._block == []


def with_factor(baseline: float) -> StereoCamera:
    return StereoCamera(
        fu_px=CAMERA.fu_px,
        fv_px=CAMERA.fv_px,
        cu_px=CAMERA.cu_px,
        cv_px=CAMERA.cv_px,
        baseline_m=baseline * CAMERA.baseline_m,
        size_px=CAMERA.size_px,
    )


@pytest.mark.parametrize(
    ("height_m", "sigma_m", "known_m", "warned"),
    [
        (1.73, 0.01, 1.65, True),
        (1.73, 0.03, 1.65, False),  # within 3 σ
        (1.68, 0.001, 1.65, False),  # a load
        (1.65, 0.01, None, False),
    ],
)
def test_a_known_height_warns_beyond_chance_and_loads(
    height_m: float, sigma_m: float, known_m: float | None, *, warned: bool
) -> None:
    text = height_warning(GroundHeight(height_m, sigma_m, 20, known_m=known_m))
    assert (text is not None) == warned
    if text is not None:
        assert "1.730 ± 0.010 m above the ground" in text
        assert "divide baseline_m by 1.048" in text


@pytest.mark.parametrize(("recording", "error_m"), [("06", 0.02), ("39", 0.03)])
def test_kitti_is_as_high_as_its_set_up_says(
    recording: str, error_m: float, data_root: Path, tmp_path: Path, undrawn: None
) -> None:
    path = {"06": "kitti_odometry/sequences/06", "39": "kitti_0039/sequences/39"}[recording]
    sequence = pv.open_sequence(data_root / path)
    run = run_sequence(sequence, {"camera_height_m": 1.5}, tmp_path)
    height = run.result.ground_height
    assert height is not None
    assert height.height_m == pytest.approx(1.65, abs=error_m)
    assert height.p_value is not None
    assert height.p_value < 1e-3
    assert "Scale by the camera&#39;s height" in (tmp_path / "report.html").read_text()


def test_calibrate_check_says_the_height(data_root: Path) -> None:
    sequence = pv.open_sequence(data_root / "kitti_odometry" / "sequences" / "06")
    lines = report_lines(sequence.path, check_calibration(sequence, 60))
    said = [line for line in lines if line.startswith("Height: ")]
    assert len(said) == 1
    assert "the left camera is 1.65" in said[0]
