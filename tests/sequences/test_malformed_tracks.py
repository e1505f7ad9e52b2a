"""Malformed tracks files: each is refused with the array and what is wrong with it."""

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from probevo.arrays import AnyArray
from probevo.errors import InputError
from probevo.sequences import open_sequence
from sequences.damage import assert_refused, cut
from sequences.recordings import tracks_arrays, write_tracks


def changed(name: str, index: Any, value: float) -> dict[str, AnyArray]:
    array = tracks_arrays()[name].astype(float if np.isnan(value) else tracks_arrays()[name].dtype)
    array[index] = value
    return {name: array}


TRACKS: dict[str, tuple[dict[str, AnyArray | None], list[str]]] = {
    "array missing": ({"uv": None}, ["the array uv is missing"]),
    "gyro without its place": ({"C_cam_imu": None}, ["omega", "C_cam_imu"]),
    "wrong shape": ({"uv": np.zeros((24, 3))}, [": uv", "(24, 3)", "[n, 4]"]),
    "lengths differ": ({"track": np.arange(23)}, [": track", "(23,)"]),
    "scalar": ({"frame": np.array(3)}, [": frame", "()"]),
    "no times": ({"t": np.zeros(0)}, [": t", "empty"]),
    "times duplicate": ({"t": np.array([1.0, 2.0, 2.0, 3.0])}, [": t", "stamp 2", "duplicate"]),
    "times in ns": ({"t": 1.4e18 + 1e8 * np.arange(4)}, [": t", "seconds"]),
    "NaN pixel": (changed("uv", (5, 1), np.nan), [": uv", "row 5", "not finite"]),
    "NaN rate": (changed("omega", (2, 0), np.nan), [": omega", "row 2"]),
    "fractional frames": ({"frame": tracks_arrays()["frame"] + 0.5}, [": frame", "whole numbers"]),
    "words": ({"t": np.array(["a", "b", "c", "d"])}, [": t", "numbers"]),
    "pickled objects": ({"uv": np.array([None] * 24)}, ["plain arrays"]),
    "frames unsorted": ({"frame": tracks_arrays()["frame"][::-1]}, [": frame", "Sort"]),
    "frame beyond the times": (changed("frame", -1, 4), [": frame", "4 times"]),
    "track twice in a frame": (changed("track", 1, 0), [": track", "track 0", "twice", "frame 0"]),
    "baseline negative": (changed("camera", 4, -0.5), [": camera", "baseline_m"]),
    "p_imu_cam too long": ({"p_imu_cam": np.zeros(4)}, [": p_imu_cam", "(4,)", "[3]"]),
    "p_imu_cam not finite": (changed("p_imu_cam", 1, np.nan), [": p_imu_cam", "not finite"]),
    "C_cam_imu no rotation": ({"C_cam_imu": np.ones((3, 3))}, [": C_cam_imu", "rotation"]),
    "array of objects": ({"track": np.arange(24).astype(object)}, ["pickled", "whole numbers"]),
    "truth infinite": (changed("T_world_cam", (1, 0, 3), np.inf), [": T_world_cam", "pose 1"]),
}


@pytest.mark.parametrize("case", TRACKS)
def test_malformed_tracks(case: str, tmp_path: Path) -> None:
    changes, fragments = TRACKS[case]
    assert_refused(write_tracks(tmp_path, **changes), ["tracks.npz", *fragments])


@pytest.mark.parametrize("kept", [0.0, 0.3, 0.9])
def test_cut_tracks_file(kept: float, tmp_path: Path) -> None:
    write_tracks(tmp_path)
    cut("tracks.npz", kept)(tmp_path)
    assert_refused(tmp_path / "tracks.npz", ["tracks.npz", "not a readable .npz"])


def test_nobody_is_advised_to_load_a_damaged_file_unsafely(tmp_path: Path) -> None:
    (tmp_path / "tracks.npz").write_bytes(b"x")
    with pytest.raises(InputError) as raised:
        open_sequence(tmp_path / "tracks.npz")
    assert "not a readable .npz" in str(raised.value)
    assert "pickle" not in str(raised.value)


def test_a_single_array_is_no_tracks_file(tmp_path: Path) -> None:
    with (tmp_path / "tracks.npz").open("wb") as file:
        np.save(file, np.zeros(3))
    assert_refused(tmp_path / "tracks.npz", ["tracks.npz", "not a readable .npz"])


def test_a_recording_without_a_single_feature_opens(tmp_path: Path) -> None:
    """A blind camera is a fact, not a fault of the file."""
    nothing = {"frame": np.zeros(0, int), "track": np.zeros(0, int), "uv": np.zeros((0, 4))}
    frames = list(open_sequence(write_tracks(tmp_path, **nothing)))
    assert len(frames) == 4
    assert all(frame.features is not None and len(frame.features.ids) == 0 for frame in frames)


def npy_claiming(shape: tuple[int, ...], type_: str = "<f8", more: str = "") -> bytes:
    """Return the header of an array of that shape, without any of its values."""
    header = f"{{'descr': '{type_}', 'fortran_order': False, 'shape': {shape}{more}}}".encode()
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header


MEMBERS: dict[str, tuple[str, bytes]] = {
    "text": ("uv", b"1 2 3 4"),
    "empty": ("uv.npy", b""),
    "no array": ("uv.npy", b"1 2 3 4"),
    "huge": ("uv.npy", npy_claiming((10**12, 4))),
    "overflowing": ("uv.npy", npy_claiming((2**62, 2**62))),
    "negative": ("uv.npy", npy_claiming((-1, 4))),
    "no type": ("uv.npy", npy_claiming((24, 4), "nonsense")),
    "nested": ("uv.npy", npy_claiming((24, 4), more=", 'x': " + "[" * 3_000 + "]" * 3_000)),
    "huge stamps": ("t.npy", npy_claiming((10**12,))),
    "too small": ("t.npy", npy_claiming((1,)) + bytes(16)),
    "complex": ("t.npy", npy_claiming((2,), "<c16") + bytes(31)),
    "version": ("t.npy", b"\x93NUMPY\x09\x00" + bytes(80)),
}


@pytest.mark.parametrize("case", MEMBERS)
@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_member_that_claims_what_it_does_not_hold(case: str, method: int, tmp_path: Path) -> None:
    name, content = MEMBERS[case]
    path = tmp_path / "tracks.npz"
    with zipfile.ZipFile(write_tracks(tmp_path)) as archive:
        members = {each.filename: archive.read(each) for each in archive.infolist()}
    members.pop(name.removesuffix(".npy") + ".npy")
    with zipfile.ZipFile(path, "w", method) as archive:
        for other, data in (members | {name: content}).items():
            archive.writestr(other, data)
    assert_refused(path, ["tracks.npz", "not a readable .npz"])


def test_a_bomb_is_refused_before_it_is_inflated(tmp_path: Path) -> None:
    """An array of zeros takes a thousandth of its size."""
    path = tmp_path / "tracks.npz"
    rows = 500_000_000
    header = npy_claiming((rows,))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("frame.npy", header)
    # The directory at the end, and the member itself, say how large the member is.
    data = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):
        start = data.index(signature) + offset
        data[start : start + 4] = (len(header) + 8 * rows).to_bytes(4, "little")
    path.write_bytes(data)
    assert_refused(path, ["not a readable .npz"])


def test_an_encrypted_member_is_refused(tmp_path: Path) -> None:
    path = write_tracks(tmp_path)
    data = bytearray(path.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        start = data.find(signature)
        while start >= 0:
            data[start + offset] |= 1
            start = data.find(signature, start + 1)
    path.write_bytes(data)
    assert_refused(path, ["not a readable .npz"])


@pytest.mark.parametrize("version", [(1, 0), (2, 0), (3, 0)])
@pytest.mark.parametrize("order", ["C", "F"])
def test_all_versions_of_arrays_are_read(
    version: tuple[int, int], order: str, tmp_path: Path
) -> None:
    pixels = tracks_arrays()["uv"]
    buffer = io.BytesIO()
    np.lib.format.write_array(buffer, np.asarray(pixels, order=order), version=version)
    path = write_tracks(tmp_path, uv=None)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("uv.npy", buffer.getvalue())
    frames = list(open_sequence(path))
    assert frames[1].features is not None
    np.testing.assert_array_equal(frames[1].features.pixels, pixels[6:12])
