"""Whether an image file is complete, as far as its kind tells: by its length, or by its end.

Whatever follows the end is ignored, as by decoders: some cameras append data of their own.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from probevo.sequences.png import DamagedError

JPEG_START = b"\xff\xd8"
JPEG_SEGMENT = re.compile(rb"\xff+([^\x00\x01\xd0-\xd8\xff])")
"""A marker other than those without a segment behind them. Among pixels, a byte 0xFF is followed by
0 or by a restart marker, 0xD0 to 0xD7."""
JPEG_END = b"\xd9"
RIFF_HEADER_BYTES = 8
PNM_HEADER = re.compile(
    rb"P[56](?:\s|#[^\n]*\n)+(\d+)(?:\s|#[^\n]*\n)+(\d+)(?:\s|#[^\n]*\n)+(\d+)\s"
)
"""Width, height and the largest value of a binary PGM or PPM file."""


def check_complete(data: bytes) -> None:
    """Refuse a file that was cut off: OpenCV may return the part of the image that is there.

    Raises:
        DamagedError: the file is incomplete, or of an unknown kind.
    """
    for magic, check in _CHECKS.items():
        if data.startswith(magic):
            check(data)
            return
    raise DamagedError(
        "it is neither PNG nor JPEG, PGM, TIFF, WebP or BMP" if data else "it is empty"
    )


def _check_jpeg(data: bytes) -> None:
    """Check that the end marker (EOI) is there.

    Segments are skipped by their length, so that the end of a thumbnail inside one does not count.
    """
    position = len(JPEG_START)
    while marker := JPEG_SEGMENT.search(data, position):
        if marker[1] == JPEG_END:
            return
        position = marker.end() + int.from_bytes(data[marker.end() : marker.end() + 2], "big")
    raise DamagedError("its end is missing")


def _check_pnm(data: bytes) -> None:
    header = PNM_HEADER.match(data)
    if header is None:
        raise DamagedError("its header is incomplete")
    width, height, largest = (int(number) for number in header.groups())
    channels = 1 if data.startswith(b"P5") else 3
    num_bytes = width * height * channels * (1 if largest < 256 else 2)
    if len(data) < header.end() + num_bytes:
        raise DamagedError("its end is missing")


def _check_webp(data: bytes) -> None:
    if len(data) < RIFF_HEADER_BYTES + int.from_bytes(data[4:8], "little"):
        raise DamagedError("its end is missing")


def _check_bmp(data: bytes) -> None:
    if len(data) < int.from_bytes(data[2:6], "little"):
        raise DamagedError("its end is missing")


def _check_tiff(data: bytes) -> None:
    """Check that the directory is inside the file; OpenCV refuses a file whose strips are not."""
    directory = int.from_bytes(data[4:8], "little" if data.startswith(b"II") else "big")
    if not 8 <= directory < len(data):
        raise DamagedError("its directory is missing")


_CHECKS: dict[bytes, Callable[[bytes], None]] = {
    JPEG_START: _check_jpeg,
    b"P5": _check_pnm,
    b"P6": _check_pnm,
    b"RIFF": _check_webp,
    b"BM": _check_bmp,
    b"II*\0": _check_tiff,
    b"MM\0*": _check_tiff,
}
"""The check of each kind of file, by its first bytes."""
