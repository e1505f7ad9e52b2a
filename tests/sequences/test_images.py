"""Image files: what is read, and the damage that is noticed."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from probevo.errors import InputError
from probevo.sequences.images import list_pairs, read_gray
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


@pytest.mark.parametrize("byte", [20, 60, 1000, 2500])
def test_a_flipped_bit_in_a_png_is_noticed(byte: int, tmp_path: Path) -> None:
    data = bytearray(cv2.imencode(".png", image(0))[1].tobytes())
    data[byte] ^= 1
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        read_gray(tmp_path / "a.png")
