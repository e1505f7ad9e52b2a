"""Plain grey PNG files decode as OpenCV decodes them; all others are left to it."""

from __future__ import annotations

import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from probevo.sequences.png import PNG_MAGIC, DamagedError, chunks_of, plain_grey


def chunk(kind: bytes, body: bytes) -> bytes:
    return len(body).to_bytes(4, "big") + kind + body + zlib.crc32(kind + body).to_bytes(4, "big")


def png(
    rows: np.ndarray,
    width: int,
    *,
    end: bytes = bytes([8, 0, 0, 0, 0]),
    more: bytes = b"",
    parts: int = 1,
) -> bytes:
    """A file of rows as they are stored: the filter, then what it left of the pixels."""
    header = width.to_bytes(4, "big") + len(rows).to_bytes(4, "big") + end
    deflated = zlib.compress(rows.tobytes())
    length = -(-len(deflated) // parts)
    body = b"".join(
        chunk(b"IDAT", deflated[k : k + length]) for k in range(0, len(deflated), length)
    )
    return PNG_MAGIC + chunk(b"IHDR", header) + more + body + chunk(b"IEND", b"")


def random_rows(kinds: list[int], height: int, width: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, 256, (height, width + 1), np.uint8)
    rows[:, 0] = rng.choice(kinds, height)
    return rows


@pytest.mark.parametrize("kinds", [[0], [1], [2], [3], [4], [0, 1, 2, 3, 4]])
@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 1), (23, 31)])
def test_every_filter_is_undone_as_opencv_undoes_it(
    kinds: list[int], size: tuple[int, int]
) -> None:
    for seed in range(5):
        data = png(random_rows(kinds, *size, seed), size[1], parts=1 + seed)
        image = plain_grey(chunks_of(data))
        assert image is not None
        assert np.array_equal(
            image, cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
        )


def test_a_written_picture_comes_back(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (50, 40), np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), picture)
    assert np.array_equal(plain_grey(chunks_of((tmp_path / "a.png").read_bytes())), picture)


def test_a_comment_changes_nothing() -> None:
    rows = random_rows([1], 4, 5, 0)
    assert np.array_equal(
        plain_grey(chunks_of(png(rows, 5, more=chunk(b"tEXt", b"Author\0me")))),
        plain_grey(chunks_of(png(rows, 5))),
    )


NOT_PLAIN = {
    "16 bits": png(random_rows([0], 4, 10, 0), 5, end=bytes([16, 0, 0, 0, 0])),
    "colour": png(random_rows([0], 4, 15, 0), 5, end=bytes([8, 2, 0, 0, 0])),
    "interlaced": png(random_rows([0], 4, 5, 0), 5, end=bytes([8, 0, 0, 0, 1])),
    "transparent": png(random_rows([0], 4, 5, 0), 5, more=chunk(b"tRNS", b"\0\0")),
    "no such filter": png(random_rows([5], 4, 5, 0), 5),
    "rows are missing": png(random_rows([0], 4, 5, 0)[:3], 5).replace(
        chunk(b"IHDR", bytes([0, 0, 0, 5, 0, 0, 0, 3, 8, 0, 0, 0, 0])),
        chunk(b"IHDR", bytes([0, 0, 0, 5, 0, 0, 0, 4, 8, 0, 0, 0, 0])),
    ),
    "no width": png(np.zeros((4, 1), np.uint8), 0),
    "no height": png(np.zeros((0, 6), np.uint8), 5),
    "nothing inflates": PNG_MAGIC
    + chunk(b"IHDR", bytes([0, 0, 0, 5, 0, 0, 0, 4, 8, 0, 0, 0, 0]))
    + chunk(b"IDAT", b"not deflated")
    + chunk(b"IEND", b""),
    "no memory holds it": PNG_MAGIC
    + chunk(b"IHDR", bytes([255] * 8 + [8, 0, 0, 0, 0]))
    + chunk(b"IDAT", zlib.compress(bytes(9)))
    + chunk(b"IEND", b""),
    "no picture": PNG_MAGIC
    + chunk(b"IHDR", bytes([0, 0, 0, 5, 0, 0, 0, 4, 8, 0, 0, 0, 0]))
    + chunk(b"IEND", b""),
    "no header": PNG_MAGIC + chunk(b"IEND", b""),
}


@pytest.mark.parametrize("data", NOT_PLAIN.values(), ids=NOT_PLAIN.keys())
def test_what_is_not_plain_is_left_to_opencv(data: bytes) -> None:
    assert plain_grey(chunks_of(data)) is None


def test_a_picture_that_inflates_without_end_is_not_inflated_whole() -> None:
    endless = zlib.compress(bytes(10**8))
    header = chunk(b"IHDR", bytes([0, 0, 0, 5, 0, 0, 0, 4, 8, 0, 0, 0, 0]))
    image = plain_grey(
        chunks_of(PNG_MAGIC + header + chunk(b"IDAT", endless) + chunk(b"IEND", b""))
    )
    assert np.array_equal(image, np.zeros((4, 5), np.uint8))


def test_damage_is_named() -> None:
    data = png(random_rows([0], 4, 5, 0), 5)
    with pytest.raises(DamagedError, match="its end is missing"):
        chunks_of(data[:-1])
    flipped = bytearray(data)
    flipped[-20] ^= 1
    with pytest.raises(DamagedError, match="checksum of the chunk at byte 33 is wrong"):
        chunks_of(bytes(flipped))
