"""PNG files: whether they are whole, and plain grey pictures out of them in half of OpenCV's time.

Nearly all of that time is inflating, which ISA-L does two to three times as fast as the zlib that
OpenCV is built with.
"""

from __future__ import annotations

import numpy as np
from isal import isal_zlib

from probevo.arrays import AnyArray, Image
from probevo.compiled import compiled

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
PLAIN = bytes([8, 0, 0, 0, 0])
"""End of the header of a picture of 8 bits, grey, deflated, filtered row by row, not interlaced."""
NEEDED = {b"IHDR", b"IDAT", b"IEND"}
IGNORED = {b"tEXt", b"zTXt", b"iTXt", b"tIME", b"pHYs"}
"""Chunks of a plain picture, and those that do not change what it shows."""


class DamagedError(ValueError):
    """The file is not what was once written; says in what."""


def chunks_of(data: bytes) -> list[tuple[bytes, memoryview]]:
    """Type and body of each chunk of a PNG file, up to its end.

    Raises:
        DamagedError: a checksum is wrong, or the end is missing.
    """
    view = memoryview(data)
    chunks = []
    start = len(PNG_MAGIC)
    while start + 12 <= len(data):
        end = start + 12 + int.from_bytes(view[start : start + 4], "big")
        if end > len(data):
            break
        if isal_zlib.crc32(view[start + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            raise DamagedError(f"the checksum of the chunk at byte {start} is wrong")
        chunks.append((bytes(view[start + 4 : start + 8]), view[start + 8 : end - 4]))
        if chunks[-1][0] == b"IEND":
            return chunks
        start = end
    raise DamagedError("its end is missing")


def plain_grey(chunks: list[tuple[bytes, memoryview]]) -> Image | None:
    """The picture in the chunks of a file, [height, width], uint8; None if it is none of 8 bits
    grey, or damaged."""
    kinds = {kind for kind, _ in chunks}
    header = bytes(chunks[0][1])
    if not NEEDED <= kinds <= NEEDED | IGNORED or chunks[0][0] != b"IHDR" or header[8:] != PLAIN:
        return None
    width = int.from_bytes(header[:4], "big")
    height = int.from_bytes(header[4:8], "big")
    size = height * (width + 1)
    deflated = b"".join(body for kind, body in chunks if kind == b"IDAT")
    try:
        inflated = isal_zlib.decompressobj().decompress(deflated, max(size, 1))  # 0 is no limit
    except (isal_zlib.IsalError, OverflowError):  # type: ignore[misc]  # its stub calls the class an exception
        return None
    if 0 in (width, height) or len(inflated) != size:
        return None
    image = np.empty((height, width), np.uint8)
    rows = np.frombuffer(inflated, np.uint8).reshape(height, width + 1)
    return image if _unfilter(rows, image) else None


@compiled
def _unfilter(rows: AnyArray, image: Image) -> bool:
    """Undo the filter of each row, which its first byte tells: of a pixel, what is left of a guess
    from its neighbours.

    False if a filter is none of the five of PNG.
    """
    height, width = image.shape
    nothing = np.zeros(width, np.uint8)
    for y in range(height):
        kind = rows[y, 0]
        row = rows[y, 1:]
        above = image[y - 1] if y > 0 else nothing
        left = 0
        upper_left = 0
        if kind == 0 or kind == 2:
            for x in range(width):
                image[y, x] = row[x] + (above[x] if kind == 2 else 0)
        elif kind == 1:
            for x in range(width):
                left = (left + row[x]) & 255
                image[y, x] = left
        elif kind == 3:
            for x in range(width):
                left = (row[x] + (left + above[x]) // 2) & 255
                image[y, x] = left
        elif kind == 4:
            for x in range(width):
                left = (row[x] + _paeth(left, int(above[x]), upper_left)) & 255
                image[y, x] = left
                upper_left = int(above[x])
        else:
            return False
    return True


@compiled
def _paeth(left: int, upper: int, upper_left: int) -> int:
    """The neighbour nearest to left + upper − upper_left."""
    by_left = abs(upper - upper_left)
    by_upper = abs(left - upper_left)
    by_both = abs(left + upper - 2 * upper_left)
    nearest = upper if by_upper <= by_both else upper_left
    return left if by_left <= min(by_upper, by_both) else nearest
