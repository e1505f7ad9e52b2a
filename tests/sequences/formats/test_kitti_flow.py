"""Scenes of KITTI 2012 and 2015: their frames, their truth, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from probevo.cli.main import main
from probevo.errors import InputError
from probevo.run_config import read_config
from probevo.sequences import open_sequence
from probevo.sequences.formats.kitti_flow import read_flow_truth, scene_numbers
from sequences.recordings import BASELINE_M, FU_PX, HEIGHT_PX, WIDTH_PX, image, write_kitti_flow


@pytest.mark.parametrize("year", [2012, 2015])
def test_a_scene_is_recognised_and_read(year: int, tmp_path: Path) -> None:
    sequence = open_sequence(write_kitti_flow(tmp_path, year=year))
    assert sequence.format == "kitti-flow"
    assert sequence.camera.baseline_m == pytest.approx(BASELINE_M)
    assert sequence.camera.fu_px == FU_PX
    assert sequence.camera.size_px == (WIDTH_PX, HEIGHT_PX)
    np.testing.assert_array_equal(sequence.stamps_ns, np.arange(8, 12) * 100_000_000)
    for index, frame in enumerate(sequence):
        np.testing.assert_array_equal(frame.left, image(index))
        np.testing.assert_array_equal(frame.right, image(index, right=True))


def test_a_frame_that_is_missing_leaves_a_gap(tmp_path: Path) -> None:
    write_kitti_flow(tmp_path)
    for camera in (0, 1):
        (tmp_path / f"image_{camera}" / "000027_09.png").unlink()
    stamps_ns = open_sequence(tmp_path, rate_hz=5.0).stamps_ns
    np.testing.assert_array_equal(stamps_ns, np.array([8, 10, 11]) * 200_000_000)


@pytest.mark.parametrize("year", [2012, 2015])
@pytest.mark.parametrize("with_occluded", [True, False])
def test_the_truth_is_that_of_the_files(year: int, with_occluded: bool, tmp_path: Path) -> None:
    write_kitti_flow(tmp_path, year=year)
    truth = read_flow_truth(tmp_path, 27, with_occluded=with_occluded)
    assert np.isnan(truth.disparity_px[0]).all()
    assert np.isnan(truth.flow_px[0]).all()
    columns = np.arange(1, WIDTH_PX)
    np.testing.assert_array_equal(truth.disparity_px[1:, 1:], np.tile(columns / 2, (47, 1)))
    np.testing.assert_array_equal(truth.flow_px[1:], np.full((47, WIDTH_PX, 2), [-1.5, 2.25]))


@pytest.mark.usefixtures("undrawn")
def test_of_several_scenes_one_is_named(tmp_path: Path) -> None:
    write_kitti_flow(tmp_path, scenes=(3, 27))
    assert scene_numbers(tmp_path) == [3, 27]
    assert len(open_sequence(tmp_path, scene=3)) == 4
    with pytest.raises(InputError, match="holds 2 scenes, and none is named"):
        open_sequence(tmp_path)
    with pytest.raises(InputError, match="has no scene 4"):
        open_sequence(tmp_path, scene=4)
    out = tmp_path / "out"
    assert main(["run", str(tmp_path), "--scene", "27", "--out", str(out)]) == 0
    assert read_config(out / "config.yaml").scene == 27
    assert main(["run", "--config", str(out / "config.yaml"), "--out", str(out)]) == 0


@pytest.mark.parametrize(
    ("file", "content", "words"),
    [
        ("image_1/000027_09.png", None, "image_1/000027_09.png"),
        ("calib/000027.txt", None, "calib/000027.txt"),
        ("calib/000027.txt", "P0: 1 2 3\n", "P0: 3 numbers; expected 12"),
        ("disp_occ/000027_10.png", None, "disp_occ/000027_10.png"),
        ("disp_occ/000027_10.png", "", "not a PNG of 16 bits with 1 channels"),
        ("flow_occ/000027_10.png", "no picture", "not a PNG of 16 bits with 3 channels"),
    ],
)
def test_what_is_missing_or_damaged_is_named(
    file: str, content: str | None, words: str, tmp_path: Path
) -> None:
    write_kitti_flow(tmp_path)
    if content is None:
        (tmp_path / file).unlink()
    else:
        (tmp_path / file).write_text(content)

    def read_all() -> None:
        open_sequence(tmp_path)
        read_flow_truth(tmp_path, 27)

    with pytest.raises(InputError) as caught:
        read_all()
    assert words in str(caught.value)


def test_folders_of_another_kind_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="neither image_0 and image_1 nor image_2 and image_3"):
        open_sequence(tmp_path, "kitti-flow")
    write_kitti_flow(tmp_path)
    for camera in (0, 1):
        for file in (tmp_path / f"image_{camera}").iterdir():
            file.rename(file.with_name(f"{file.stem[-2:]}.png"))
    with pytest.raises(InputError, match="no image is called such as"):
        open_sequence(tmp_path)


@pytest.mark.data
def test_the_real_scenes(data_root: Path) -> None:
    """Matches of the images agree with the truth: it is read with the right signs and scales."""
    import cv2

    folder = data_root / "kitti_2012"
    for scene in scene_numbers(folder):
        sequence = open_sequence(folder, scene=scene)
        truth = read_flow_truth(folder, scene)
        assert 0.1 < np.isfinite(truth.disparity_px).mean() < 0.6
        frames = {frame.stamp_ns // 100_000_000: frame for frame in sequence}
        known = np.isfinite(truth.disparity_px) & np.isfinite(truth.flow_px[..., 0])
        corners = cv2.goodFeaturesToTrack(
            frames[10].left, 500, 0.01, 8, mask=known.astype(np.uint8)
        )
        columns, rows = np.rint(corners[:, 0]).astype(int).T
        ways = (
            (frames[11].left, truth.flow_px[rows, columns]),
            (
                frames[10].right,
                np.column_stack([-truth.disparity_px[rows, columns], np.zeros(len(rows))]),
            ),
        )
        for image_there, way in ways:
            start = corners + way[:, None].astype(np.float32)
            found, status, _ = cv2.calcOpticalFlowPyrLK(
                frames[10].left,
                image_there,
                corners,
                start.copy(),
                flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
                maxLevel=0,
            )
            off = np.abs(found - start)[status[:, 0] > 0]
            assert np.median(off) < 0.6
