"""A spoiled recording: its frames, its record, and what it refuses."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probevo.errors import InputError
from probevo.sequences import Frame, open_sequence
from probevo_sim.spoiling.config import PresetName, SpoilConfig
from probevo_sim.spoiling.effects import strongest_barrel, texture
from probevo_sim.spoiling.plan import FramePlan
from probevo_sim.spoiling.recording import (
    RECORD,
    SpoiledRecording,
    _occluded,
    _Pair,
    write_spoiled,
)
from sequences.recordings import (
    HEIGHT_PX,
    WIDTH_PX,
    write_folder_sequence,
    write_image,
    write_tracks,
)

FRAMES = 30
FROZEN = {"preset": "frames", "severity": 1.0, "clean": 0.3, "seed": 1}


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_folder_sequence(tmp_path_factory.mktemp("original"), FRAMES)


def spoiled(path: Path, **settings: object) -> SpoiledRecording:
    return SpoiledRecording.of(open_sequence(path), SpoilConfig.model_validate(settings))


def images_of(frame: Frame) -> tuple[bytes, bytes]:
    assert frame.left is not None
    assert frame.right is not None
    return frame.left.tobytes(), frame.right.tobytes()


@pytest.mark.parametrize("preset", ["blur", "darkness", "exposure", "occluders", "dirt", "jpeg"])
def test_frames_of_a_burst_change_and_clean_ones_do_not(original: Path, preset: PresetName) -> None:
    recording = spoiled(original, preset=preset, clean=0.5, severity=1.0)
    pairs = zip(open_sequence(original), recording, recording.plans, strict=True)
    changed = []
    for before, after, plan in pairs:
        is_same = images_of(before) == images_of(after)
        if plan.effect is None:
            assert is_same
        else:
            changed.append(not is_same)
    assert changed
    assert all(changed)


def test_dropped_frames_are_missing_and_frozen_ones_repeat(original: Path) -> None:
    recording = spoiled(original, preset="frames", seed=1, clean=0.3)
    source = open_sequence(original)
    frames = list(recording)
    record = recording.record()["frames"]
    assert len(record) == FRAMES
    written = [entry for entry in record if entry["written"] is not None]
    assert 2 < len(written) == len(frames) < FRAMES
    assert source.truth is not None
    assert recording.truth is not None
    for k, (entry, frame) in enumerate(zip(written, frames, strict=True)):
        assert frame.index == entry["written"] == k
        assert frame.stamp_ns == recording.stamps_ns[k] == source.stamps_ns[entry["frame"]]
        np.testing.assert_array_equal(
            recording.truth.T_world_cam[k], source.truth.T_world_cam[entry["frame"]]
        )
        is_frozen = entry.get("effect") == "frozen"
        if k > 0:
            assert (images_of(frame) == images_of(frames[k - 1])) == is_frozen
            # The IMU goes on while frames are dropped.
            assert frame.imu is not None
            assert frame.imu.stamps_ns[0] <= frames[k - 1].stamp_ns
            assert frame.imu.stamps_ns[-1] >= frame.stamp_ns
    assert any(entry.get("effect") == "frozen" for entry in written)


def test_late_right_images_are_those_of_earlier_frames(original: Path) -> None:
    late = list(spoiled(original, preset="delay", right_late_frames=2))
    for k, frame in enumerate(open_sequence(original)):
        assert images_of(frame)[0] == images_of(late[k])[0]
        if k + 2 < FRAMES:
            assert images_of(frame)[1] == images_of(late[k + 2])[1]


def test_a_wrong_calibration_is_that_of_the_preset_or_the_one_given(original: Path) -> None:
    right = open_sequence(original).camera
    wrong = spoiled(original, preset="calibration")
    assert wrong.config.wrong_calibration == (0.03, 0.03)
    assert wrong.camera.fu_px == pytest.approx(1.03 * right.fu_px)
    assert wrong.camera.cu_px == right.cu_px
    longer = spoiled(original, preset="calibration", focal_error=-0.1)
    assert longer.config.wrong_calibration == (-0.1, 0.0)
    assert longer.camera.fv_px == pytest.approx(0.9 * right.fv_px)
    pairs = list(zip(open_sequence(original), longer, strict=True))
    assert all(images_of(before) == images_of(after) for before, after in pairs)
    distorted = zip(open_sequence(original), wrong, strict=True)
    assert all(images_of(before) != images_of(after) for before, after in distorted)


def test_an_occluder_has_one_disparity_for_a_whole_burst(original: Path) -> None:
    """What it covers in the right image is what it covers in the left one, moved to the left."""
    recording = spoiled(original, preset="occluders", clean=0.0, severity=1.0)
    source = list(open_sequence(original))
    seen: dict[int, list[int]] = {}
    for before, after, plan in zip(source, recording, recording.plans, strict=True):
        if plan.effect is None:
            continue
        columns = []
        for old, new in ((before.left, after.left), (before.right, after.right)):
            assert old is not None
            assert new is not None
            columns.append(np.flatnonzero((old != new).any(axis=0)))
        # Where it is cut by the border of neither image.
        width = recording.camera.size_px[0] if recording.camera.size_px else 0
        if all(len(c) and c[0] > 0 and c[-1] < width - 1 for c in columns):
            seen.setdefault(plan.burst, []).append(int(columns[0][-1] - columns[1][-1]))
    assert seen
    for disparities_px in seen.values():
        assert min(disparities_px) > 0
        assert np.ptp(disparities_px) <= 2


def test_an_occluder_stays_in_view_for_a_whole_burst() -> None:
    """In both images, however long the burst is: the record names the frames that it covers."""
    grey = np.zeros((60, 200), np.uint8)
    for seed in range(30):
        for position in (0, 5, 40, 300):
            plan = FramePlan("occluder", 0.3, burst=0, position=position)
            pair = _occluded(_Pair(grey, grey), plan, np.random.default_rng(seed))
            assert pair.left.any()
            assert pair.right.any()


def test_the_same_seed_gives_the_same_bytes(original: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_spoiled(tmp_path / name, spoiled(original, seed=4))
    names = sorted(path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*.*"))
    assert Path(RECORD) in names
    for file in names:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_what_is_written_is_read_back_with_its_record(original: Path, tmp_path: Path) -> None:
    recording = spoiled(original, seed=5, preset="mixed")
    write_spoiled(tmp_path / "out", recording)
    back = open_sequence(tmp_path / "out")
    np.testing.assert_array_equal(back.stamps_ns, recording.stamps_ns)
    for mine, theirs in zip(recording, back, strict=True):
        assert images_of(mine) == images_of(theirs)
    record = json.loads((tmp_path / "out" / RECORD).read_text())
    assert record == recording.record()
    assert record["settings"]["seed"] == 5


def test_blur_along_the_flow_is_where_things_are_in_the_frame(original: Path) -> None:
    """And not where they were in the frame before: here at what moves 20 px to the right."""
    rng = np.random.default_rng(0)
    background = texture((120, 240), rng)
    thing = texture((60, 80), rng)
    shown = []
    for u in (80, 100):
        image = background.copy()
        image[30:90, u : u + 80] = thing
        shown.append(_Pair(image, image))
    before, pair = shown
    plan = FramePlan("flow_blur", 1.0, burst=0)
    blurred = spoiled(original)._spoiled(pair, plan, index=1, before=before)
    change = np.abs(blurred.left.astype(float) - pair.left)[45:75].mean(axis=0)
    ahead = change[160:178].mean()
    behind = change[80:98].mean()
    assert ahead > 1.2 * behind


def test_a_distortion_that_reaches_no_corner_is_refused(original: Path) -> None:
    sequence = open_sequence(original)
    wide = replace(sequence, camera=replace(sequence.camera, fu_px=40.0, fv_px=40.0))
    strongest = strongest_barrel(wide.camera)
    config = SpoilConfig(preset="calibration", radial_distortion=-1.01 * strongest)
    with pytest.raises(InputError, match="nothing is seen in the corners"):
        SpoiledRecording.of(wide, config)
    config = SpoilConfig(preset="calibration", radial_distortion=-0.99 * strongest)
    assert len(SpoiledRecording.of(wide, config)) == FRAMES


def test_what_cannot_be_spoiled_is_refused(original: Path, tmp_path: Path) -> None:
    tracks = write_tracks(tmp_path)
    with pytest.raises(InputError, match="no images"):
        list(spoiled(tracks))
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="this folder is not empty"):
        write_spoiled(tmp_path / "full", spoiled(original))


@pytest.mark.parametrize("settings", [{"preset": "delay", "right_late_frames": 2}, FROZEN])
def test_masks_stay_with_the_images_that_they_are_of(
    settings: dict[str, object], tmp_path: Path
) -> None:
    """Each mask is black in the column whose number its images have as their grey level."""
    root = write_folder_sequence(tmp_path / "recording", 20)
    for index in range(20):
        mask = np.full((HEIGHT_PX, WIDTH_PX), 255, np.uint8)
        mask[:, index] = 0
        for side in ("left", "right"):
            name = f"{index:06d}.png"
            write_image(root / side / name, np.full((HEIGHT_PX, WIDTH_PX), index, np.uint8))
            write_image(root / f"mask_{side}" / name, mask)
    repeated = 0
    for frame in spoiled(root, **settings):
        assert frame.left is not None
        assert frame.right is not None
        assert frame.left_mask is not None
        assert frame.right_mask is not None
        for image, black in ((frame.left, frame.left_mask), (frame.right, frame.right_mask)):
            columns = np.flatnonzero(~np.asarray(black).astype(bool).all(axis=0))
            assert columns.tolist() == [image[0, 0]]
        repeated += frame.right[0, 0] != frame.index
    assert repeated


@pytest.mark.parametrize(
    ("preset", "expected"),
    [
        ("delay", {"right_late_frames": 1}),
        ("calibration", {"focal_error": 0.03, "radial_distortion": 0.03}),
    ],
)
def test_the_record_has_what_a_preset_stands_for(
    preset: PresetName, expected: dict[str, float], original: Path
) -> None:
    settings = spoiled(original, preset=preset).record()["settings"]
    assert {name: settings[name] for name in expected} == expected
