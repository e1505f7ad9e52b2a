"""A PNG decoder for plain grey images, and a check that a PNG file is complete.

It takes half of OpenCV's time. Nearly all of that time is decompression, and ISA-L decompresses two
to three times as fast as the zlib that OpenCV is built with.
"""

from __future__ import annotations

import numpy as np
from isal import isal_zlib

from probevo.arrays import AnyArray, Image
from probevo.compiled import compiled

PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
PLAIN = bytes([8, 0, 0, 0, 0])
"""Last five bytes of the header of a plain image: 8 bits, grey, deflated, filtered by rows, not
interlaced."""
NEEDED = {b"IHDR", b"IDAT", b"IEND"}
"""Chunks that every plain image has."""
IGNORED = {b"tEXt", b"zTXt", b"iTXt", b"tIME", b"pHYs"}
"""Further chunks, which do not change the pixels."""


class DamagedError(ValueError):
    """A file is damaged; the message says how."""


def chunks_of(data: bytes) -> list[tuple[bytes, memoryview]]:
    """Return the type and the body of each chunk of a PNG file.

    Raises:
        DamagedError: a checksum is wrong, or the end is missing.
    """
    view = memoryview(data)
    chunks = []
    start = len(PNG_MAGIC)
    # A chunk is: length of its body (4 bytes), type (4), body, checksum of type and body (4).
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
    """Decode the chunks of a file to an image, [height, width], uint8.

    Returns:
        The image; None if it is not a plain grey one of 8 bits, or damaged.
    """
    kinds = {kind for kind, _ in chunks}
    header = bytes(chunks[0][1])
    if not NEEDED <= kinds <= NEEDED | IGNORED or chunks[0][0] != b"IHDR" or header[8:] != PLAIN:
        return None
    width = int.from_bytes(header[:4], "big")
    height = int.from_bytes(header[4:8], "big")
    size = height * (width + 1)
    deflated = b"".join(body for kind, body in chunks if kind == b"IDAT")
    try:
        # The limit guards against data that inflate without end; 0 would mean no limit.
        inflated = isal_zlib.decompressobj().decompress(deflated, max(size, 1))
    except (isal_zlib.IsalError, OverflowError):  # type: ignore[misc]  # wrong in isal's stub
        return None
    if 0 in (width, height) or len(inflated) != size:
        return None
    image = np.empty((height, width), np.uint8)
    rows = np.frombuffer(inflated, np.uint8).reshape(height, width + 1)
    return image if _unfilter(rows, image) else None


@compiled
def _unfilter(rows: AnyArray, image: Image) -> bool:
    """Undo the filters of the rows; a row stores each pixel minus a prediction from its neighbours.

    Args:
        rows: [height, 1 + width]; the first byte of a row is the kind of its filter.
        image: receives the pixels, [height, width].

    Returns:
        False if a filter is not one of the five of PNG.
    """
    height, width = image.shape
    zeros = np.zeros(width, np.uint8)
    for y in range(height):
        kind = rows[y, 0]
        row = rows[y, 1:]
        above = image[y - 1] if y > 0 else zeros
        left = 0
        upper_left = 0
        if kind == 0 or kind == 2:  # nothing, or the pixel above
            for x in range(width):
                image[y, x] = row[x] + (above[x] if kind == 2 else 0)
        elif kind == 1:  # the pixel to the left
            for x in range(width):
                left = (left + row[x]) & 255
                image[y, x] = left
        elif kind == 3:  # the mean of both
            for x in range(width):
                left = (row[x] + (left + above[x]) // 2) & 255
                image[y, x] = left
        elif kind == 4:  # Paeth's predictor
            for x in range(width):
                left = (row[x] + _paeth(left, int(above[x]), upper_left)) & 255
                image[y, x] = left
                upper_left = int(above[x])
        else:
            return False
    return True


@compiled
def _paeth(left: int, upper: int, upper_left: int) -> int:
    """Return the neighbour nearest to left + upper − upper_left (Paeth's predictor)."""
    left_distance = abs(upper - upper_left)
    upper_distance = abs(left - upper_left)
    upper_left_distance = abs(left + upper - 2 * upper_left)
    nearest = upper if upper_distance <= upper_left_distance else upper_left
    return left if left_distance <= min(upper_distance, upper_left_distance) else nearest
