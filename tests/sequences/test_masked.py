"""Masks of a recording: where they come from, and what is refused."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probevo.arrays import AnyArray, Image
from probevo.camera.rectification import PinholeCamera, Rectification
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.runs.runner import run_sequence
from probevo.sequences import Frame, Sequence, open_sequence
from probevo.sequences.frame_checks import check_frame
from probevo.sequences.masked import with_masks
from probevo.sequences.recording import ImageRecording
from sequences.recordings import (
    CU_PX,
    CV_PX,
    FU_PX,
    HEIGHT_PX,
    WIDTH_PX,
    write_euroc,
    write_folder_sequence,
    write_image,
    write_tracks,
)

FRAMES = 4
SHAPE = (HEIGHT_PX, WIDTH_PX)


def half(*, bottom_is_wanted: bool = False) -> Image:
    """A mask with one black half."""
    is_bottom = np.arange(HEIGHT_PX)[:, None] >= HEIGHT_PX // 2
    return np.where(np.broadcast_to(is_bottom, SHAPE) == bottom_is_wanted, 255, 0).astype(np.uint8)


def masks_of(sequence: Sequence) -> list[tuple[AnyArray | None, AnyArray | None]]:
    return [(frame.left_mask, frame.right_mask) for frame in sequence]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return write_folder_sequence(tmp_path / "recording", FRAMES)


def test_without_masks_there_are_none(recording: Path) -> None:
    assert masks_of(open_sequence(recording)) == [(None, None)] * FRAMES


@pytest.mark.parametrize("kind", ["array", "bool", "file", "beside"])
def test_one_mask_is_that_of_all_frames(kind: str, recording: Path, tmp_path: Path) -> None:
    if kind == "beside":
        write_image(recording / "mask_left.png", half())
        sequence = open_sequence(recording)
    elif kind == "file":
        write_image(tmp_path / "own.png", half())
        sequence = open_sequence(recording, mask_left=tmp_path / "own.png")
    else:
        values = half() > 0 if kind == "bool" else half()
        sequence = open_sequence(recording, mask_left=values)
    found = masks_of(sequence)
    assert len(found) == FRAMES
    for left, right in found:
        np.testing.assert_array_equal(left, half())
        assert right is None
    # Everything else is as it was.
    plain = open_sequence(recording)
    assert isinstance(sequence, ImageRecording)
    assert isinstance(plain, ImageRecording)
    assert sequence.imu is not None
    assert sequence.imu_stream is not None
    assert sequence.camera == plain.camera
    for mine, theirs in zip(sequence, plain, strict=True):
        np.testing.assert_array_equal(mine.left, theirs.left)


@pytest.mark.parametrize("is_beside", [True, False])
def test_a_mask_of_each_frame_is_found_by_its_name(
    is_beside: bool, recording: Path, tmp_path: Path
) -> None:
    folder = recording / "mask_right" if is_beside else tmp_path / "masks"
    for k in range(FRAMES):
        write_image(folder / f"{k:06d}.png", half(bottom_is_wanted=k % 2 == 1))
    write_image(folder / "another.png", half())
    sequence = open_sequence(recording, mask_right=None if is_beside else folder)
    for k, (left, right) in enumerate(masks_of(sequence)):
        assert left is None
        np.testing.assert_array_equal(right, half(bottom_is_wanted=k % 2 == 1))


def test_masks_of_raw_images_are_rectified(tmp_path: Path) -> None:
    """What a rectified image shows of the masked part, and nothing else, is masked."""
    recording = write_euroc(tmp_path / "euroc")
    plain = open_sequence(recording)
    assert isinstance(plain, ImageRecording)
    assert plain.rectification is not None
    width_px, height_px = plain.camera.size_px or (0, 0)
    mask = np.full((height_px, width_px), 255, np.uint8)
    mask[height_px // 2 :] = 0
    for left, right in masks_of(open_sequence(recording, mask_left=mask, mask_right=mask)):
        expected = plain.rectification.rectify(mask, mask)
        for found, grey in zip((left, right), expected, strict=True):
            assert found is not None
            np.testing.assert_array_equal(found, np.where(grey == 255, 255, 0))
            assert 0.2 < np.mean(found > 0) < 0.6


@pytest.mark.parametrize("given", ["none", "left", "both"])
def test_what_a_rectification_leaves_black_is_masked(given: str, tmp_path: Path) -> None:
    """Besides what the user masks: a principal point five pixels further right leaves five columns
    black."""
    ideal = PinholeCamera(
        FU_PX,
        FU_PX,
        CU_PX,
        cv_px=CV_PX,
        distortion_model="radtan",
        distortion=(0.0, 0.0, 0.0, 0.0),
        size_px=(WIDTH_PX, HEIGHT_PX),
    )
    plain = open_sequence(write_euroc(tmp_path / "euroc"))
    assert isinstance(plain, ImageRecording)
    rectification = Rectification.from_projections(
        ideal,
        ideal,
        replace(plain.camera, fu_px=FU_PX, fv_px=FU_PX, cu_px=CU_PX + 5.0, cv_px=CV_PX),
        C_rect_left=np.eye(3),
        C_rect_right=np.eye(3),
    )
    black = replace(plain, camera=rectification.camera, rectification=rectification)
    sequence = with_masks(
        black,
        left=half() if given in ("left", "both") else None,
        right=half() if given == "both" else None,
    )
    inside = np.broadcast_to(np.arange(WIDTH_PX) >= 5, SHAPE)
    for left, right in masks_of(sequence):
        assert left is not None
        assert right is not None
        expected = inside if given == "none" else inside & (half() > 0)
        np.testing.assert_array_equal(left > 0, expected)
        expected = inside & (half() > 0) if given == "both" else inside
        np.testing.assert_array_equal(right > 0, expected)


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("size of a file", "own.png"),
        ("size of a file", "A mask is a grey image of the size of the recording's"),
        ("size of an array", "mask_left: has shape"),
        ("type of an array", "float64"),
        ("black", "all black"),
        ("missing file", "nothing.png"),
        ("missing frame", "000002.png is missing (1 of 4 are)"),
        ("empty folder", "holds no image"),
        ("a number", "3"),
    ],
)
def test_faulty_masks_are_refused(what: str, words: str, recording: Path, tmp_path: Path) -> None:
    given: dict[str, object] = {
        "size of a file": tmp_path / "own.png",
        "size of an array": np.ones((3, 4), np.uint8),
        "type of an array": np.ones(SHAPE),
        "black": np.zeros(SHAPE, np.uint8),
        "missing file": tmp_path / "nothing.png",
        "missing frame": tmp_path / "masks",
        "empty folder": tmp_path / "empty",
        "a number": 3,
    }
    write_image(tmp_path / "own.png", half()[:-1])
    (tmp_path / "empty").mkdir()
    for k in (0, 1, 3):
        write_image(tmp_path / "masks" / f"{k:06d}.png", half())
    with pytest.raises(InputError) as caught:
        open_sequence(recording, mask_left=given[what])
    assert words in str(caught.value)


def test_a_mask_of_another_size_among_many_is_named(recording: Path) -> None:
    for k in range(FRAMES):
        write_image(recording / "mask_left" / f"{k:06d}.png", half()[: HEIGHT_PX - (k == 2)])
    frames = iter(open_sequence(recording))
    next(frames)
    next(frames)
    with pytest.raises(InputError, match=r"mask_left.000002\.png"):
        next(frames)


def test_a_mask_of_zeros_and_ones_among_many_is_named(recording: Path) -> None:
    """As label images are; it would leave no feature, in silence. All black it may be."""
    for k in range(FRAMES):
        mask = half() // 255 if k == 2 else np.zeros(SHAPE, np.uint8)
        write_image(recording / "mask_left" / f"{k:06d}.png", mask)
    frames = iter(open_sequence(recording))
    assert next(frames).index == 0
    with pytest.raises(InputError, match=r"000002\.png: this mask is nowhere brighter than 1,"):
        list(frames)


@pytest.mark.parametrize("grey", [1, 127])
def test_a_mask_of_zeros_and_ones_is_refused(grey: int, recording: Path) -> None:
    """Below 128, no feature is wanted: it would leave none, in silence."""
    sequence = open_sequence(recording)
    frame = replace(next(iter(sequence)), right_mask=np.minimum(half(), grey))
    words = rf"its right mask is nowhere brighter than {grey}, .*\n *Give bool, or 0 and 255"
    with pytest.raises(InputError, match=words):
        check_frame(frame, sequence.camera)


@pytest.mark.parametrize("mask", [half() * 0, np.minimum(half(), 128), half() > 255, half() > 0])
def test_a_mask_of_a_frame_may_be_black_all_over(mask: AnyArray, recording: Path) -> None:
    """What moves through the image may cover it."""
    sequence = open_sequence(recording)
    check_frame(replace(next(iter(sequence)), left_mask=mask), sequence.camera)


def test_a_recording_of_features_has_no_masks(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no images"):
        open_sequence(write_tracks(tmp_path), mask_left=half())


@pytest.mark.parametrize(
    ("mask", "words"),
    [
        (np.ones((2, 2), bool), "its left mask has shape (2, 2)"),
        (np.ones(SHAPE, np.float32), "its left mask is of type float32"),
        ("black", "its left mask is"),
    ],
)
def test_a_frame_with_a_faulty_mask_is_refused(mask: object, words: str, recording: Path) -> None:
    sequence = open_sequence(recording)
    frame = next(iter(sequence))
    faulty = Frame(0, 0, left=frame.left, right=frame.right, left_mask=mask)
    with pytest.raises(InputError) as caught:
        check_frame(faulty, sequence.camera)
    assert words in str(caught.value)


def test_a_bag_has_no_masks_and_that_is_said(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rosbags")
    words = ["convert", str(recording), "--out"]
    assert main([*words, str(tmp_path / "without.mcap")]) == 0
    assert "Masks" not in capsys.readouterr().out
    write_image(recording / "mask_left.png", half())
    assert main([*words, str(tmp_path / "with.mcap")]) == 0
    assert "Masks have no place in a bag: give them with --mask-left" in capsys.readouterr().out


@pytest.mark.parametrize("imu", [True, False])
def test_the_report_names_the_masks(
    recording: Path, tmp_path: Path, undrawn: None, imu: bool
) -> None:
    """Also of a run without the IMU."""
    write_image(recording / "mask_left.png", half())
    sequence = open_sequence(recording)
    run_sequence(sequence, {"imu": imu, "max_frames": 2}, tmp_path / "out")
    report = (tmp_path / "out" / "report.html").read_text()
    assert "left: features in 50 % of the image" in report


def test_masks_are_converted_and_described(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_image(recording / "mask_left.png", half())
    assert main(["convert", str(recording), "--out", str(tmp_path / "copy")]) == 0
    for left, right in masks_of(open_sequence(tmp_path / "copy")):
        np.testing.assert_array_equal(left, half())
        assert right is None
    assert main(["info", str(recording)]) == 0
    assert "left: features in 50 % of the image" in capsys.readouterr().out
    assert main(["info", str(tmp_path / "copy")]) == 0
    assert "another one for each frame" in " ".join(capsys.readouterr().out.split())
    shutil.rmtree(tmp_path / "copy" / "mask_left")
    assert main(["info", str(tmp_path / "copy")]) == 0
    assert "\nmasks" not in capsys.readouterr().out
