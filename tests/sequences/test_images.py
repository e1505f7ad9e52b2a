"""Image files: what is read, and the damage that is noticed."""

import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from probevo.errors import InputError
from probevo.sequences import open_sequence
from probevo.sequences.images import list_pairs, read_gray, read_size_px
from probevo.sequences.png import PNG_MAGIC
from probevo.sequences.text import read_text
from sequences.recordings import image, write_image


@pytest.mark.parametrize(
    "names",
    [
        [f"img_{k}.png" for k in range(12)],
        [f"{k:06d}.png" for k in range(12)],
        ["2_9.png", "2_10.png", "10_1.png", "a.png"],
        ["img_01.png", "img_1.png", "img_02.png"],
    ],
)
def test_pictures_come_in_the_order_of_their_numbers(names: list[str], tmp_path: Path) -> None:
    for name in reversed(names):
        for side in ("left", "right"):
            write_image(tmp_path / side / name, image(0))
    for files in list_pairs(tmp_path / "left", tmp_path / "right"):
        assert [file.name for file in files] == names


def test_gray_png_comes_back_exactly(tmp_path: Path) -> None:
    write_image(tmp_path / "a.png", image(0))
    np.testing.assert_array_equal(read_gray(tmp_path / "a.png", (64, 48)), image(0))


@pytest.mark.parametrize("alpha", [False, True])
def test_colour_becomes_luma(alpha: bool, tmp_path: Path) -> None:
    """Pure blue, green and red weigh 0.114, 0.587 and 0.299 (Rec. 601)."""
    pixels = np.full((3, 4, 4 if alpha else 3), 255, dtype=np.uint8)
    pixels[:, :, :3] = 255 * np.eye(3, dtype=np.uint8)[:, None]
    write_image(tmp_path / "a.png", pixels)
    np.testing.assert_array_equal(read_gray(tmp_path / "a.png"), [[29] * 4, [150] * 4, [76] * 4])


def test_jpeg_is_read(tmp_path: Path) -> None:
    write_image(tmp_path / "a.jpg", np.full((48, 64), 100, dtype=np.uint8))
    np.testing.assert_array_equal(read_gray(tmp_path / "a.jpg"), 100)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("kept", [0.0, 0.1, 0.5, 0.99])
def test_a_cut_file_is_noticed_wherever_the_cut(suffix: str, kept: float, tmp_path: Path) -> None:
    data = cv2.imencode(suffix, image(0))[1].tobytes()
    (tmp_path / f"a{suffix}").write_bytes(data[: int(kept * len(data))])
    with pytest.raises(InputError, match="damaged"):
        read_gray(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("progressive", [0, 1])
@pytest.mark.parametrize("trailer", [b"\0" * 9, b"SEFT1234", b"\xff\xd8\xff\xe1 of another image"])
def test_what_follows_the_end_of_a_jpeg_is_ignored(
    trailer: bytes, progressive: int, tmp_path: Path
) -> None:
    data = cv2.imencode(".jpg", image(0), [cv2.IMWRITE_JPEG_PROGRESSIVE, progressive])[1]
    (tmp_path / "a.jpg").write_bytes(data.tobytes())
    expected = read_gray(tmp_path / "a.jpg")
    (tmp_path / "a.jpg").write_bytes(data.tobytes() + trailer)
    np.testing.assert_array_equal(read_gray(tmp_path / "a.jpg"), expected)


@pytest.mark.parametrize("byte", [20, 60, 1000, 2500])
def test_a_flipped_bit_in_a_png_is_noticed(byte: int, tmp_path: Path) -> None:
    data = bytearray(cv2.imencode(".png", image(0))[1].tobytes())
    data[byte] ^= 1
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        read_gray(tmp_path / "a.png")


def png_of_size(width: int, height: int, *, depth: int = 8, color: int = 0) -> bytes:
    """Return a PNG file with right checksums that claims a size, and holds a few rows at most."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return (
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        )

    header = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, 0)
    pixels = zlib.compress(bytes(4_000_000))
    return PNG_MAGIC + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def jpeg_of_size(width: int, height: int) -> bytes:
    """Return a JPEG file that claims another size in its frame header."""
    data = cv2.imencode(".jpg", image(0))[1].tobytes()
    start = data.index(b"\xff\xc0") + 5
    return data[:start] + struct.pack(">HH", height, width) + data[start + 4 :]


HUGE = {
    "plain.png": png_of_size(65_000, 65_000),
    "colour.png": png_of_size(65_000, 65_000, color=2),
    "deep.png": png_of_size(65_000, 65_000, depth=16),
    "a.jpg": jpeg_of_size(65_000, 65_000),
}


@pytest.mark.parametrize("name", HUGE)
@pytest.mark.parametrize("size_px", [(64, 48), None])
def test_a_claimed_size_is_checked_before_anything_is_decoded(
    name: str, size_px: tuple[int, int] | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four megabytes could otherwise ask for 4.8 GB."""
    (tmp_path / name).write_bytes(HUGE[name])
    monkeypatch.setattr("probevo.sequences.images.plain_grey", None)
    monkeypatch.setattr("cv2.imdecode", None)
    expected = "expected 64×48 px" if size_px else "at most 100,000,000 px"
    with pytest.raises(InputError, match=f"this image has 65000×65000 px; {expected}"):
        read_gray(tmp_path / name, size_px)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("size_px", [(1, 1), (64, 48), (301, 7)])
def test_the_claimed_size_is_that_of_the_decoded_image(
    suffix: str, channels: int, size_px: tuple[int, int], tmp_path: Path
) -> None:
    path = tmp_path / f"a{suffix}"
    write_image(path, np.zeros((size_px[1], size_px[0], channels), np.uint8))
    assert read_size_px(path) == size_px
    assert read_gray(path, size_px).shape == size_px[::-1]


def jpeg_with_thumbnail() -> bytes:
    data = cv2.imencode(".jpg", image(0))[1].tobytes()
    thumbnail = cv2.imencode(".jpg", image(0)[:8, :8])[1].tobytes()
    segment = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    return data[:2] + segment + data[2:]


def test_the_end_of_a_thumbnail_in_a_jpeg_is_not_its_end(tmp_path: Path) -> None:
    data = jpeg_with_thumbnail()
    for length in range(4, len(data), 7):
        (tmp_path / "a.jpg").write_bytes(data[:length])
        with pytest.raises(InputError, match="its end is missing"):
            read_gray(tmp_path / "a.jpg")


def test_a_thumbnail_in_a_jpeg_is_not_its_size(tmp_path: Path) -> None:
    """It lies in a segment of its own, before the frame header."""
    (tmp_path / "a.jpg").write_bytes(jpeg_with_thumbnail())
    assert read_size_px(tmp_path / "a.jpg") == (64, 48)
    assert read_gray(tmp_path / "a.jpg", (64, 48)).shape == (48, 64)


@pytest.mark.parametrize("name", ["fifo", "/dev/zero"])
def test_a_pipe_or_device_is_refused(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    if name == "fifo":
        os.mkfifo(path)
    with pytest.raises(InputError, match="a pipe or a device"):
        read_gray(path)
    with pytest.raises(InputError, match="a pipe or a device"):
        read_text(path)


def test_a_pipe_is_no_recording(tmp_path: Path) -> None:
    for name in ("tracks.npz", "pipe"):
        os.mkfifo(tmp_path / name)
        with pytest.raises(InputError, match=name):
            open_sequence(tmp_path / name)
