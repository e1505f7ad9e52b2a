"""Image files: lists of stereo pairs, and a decoder that refuses damaged files.

PNG files have checksums; of other files, only length or end can be checked.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

from probevo.arrays import AnyArray, Image
from probevo.errors import InputError
from probevo.sequences.gray_range import GrayRange, common_range, spread_indices
from probevo.sequences.image_files import JPEG_START, check_complete
from probevo.sequences.png import PNG_MAGIC, DamagedError, chunks_of, plain_grey
from probevo.storage.files import check_regular

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".tif", ".tiff", ".webp", ".bmp"})
JPEG_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of the segments (SOF) that give the size of an image; the three others are tables."""
JPEG_BARE = frozenset({0x01, *range(0xD0, 0xD9)})
"""Markers without a segment behind them."""
JPEG_PIXELS = 0xDA
"""Marker (SOS) of the segment that the pixels follow."""
MAX_FILE_BYTES = 500_000_000
_TWO_FOLDERS = "Left and right images lie in one folder each; there is no monocular mode."
MAX_PX = 100_000_000
"""Pixels of the largest image that is decoded where its size is not known beforehand."""


def list_pairs(left: Path, right: Path) -> tuple[list[Path], list[Path]]:
    """Return the image files of two folders, paired by name, in the natural order of their names.

    Raises:
        InputError: a folder is missing or holds no image, or an image lacks its partner.
    """
    left_files = {file.name: file for file in list_images(left)}
    right_files = {file.name: file for file in list_images(right)}
    unpaired = sorted(left_files.keys() ^ right_files.keys(), key=natural_order)
    if unpaired:
        name = unpaired[0]
        folder, other = (left, right) if name in left_files else (right, left)
        what = (
            f"the partner of {folder.name}/{name} is missing"
            f" ({left.name} has {len(left_files)} images, {right.name} {len(right_files)})."
        )
        cure = (
            "Left and right images must have the same names. Remove those without a partner, with"
            " their lines of times and poses; images that are named by their stamps need no times."
        )
        raise InputError(other / name, what, cure)
    return list(left_files.values()), list(right_files.values())


def list_images(folder: Path) -> list[Path]:
    """Return the image files of a folder, in the natural order of their names.

    Raises:
        InputError: the folder is missing, or holds no image.
    """
    if not folder.is_dir():
        raise InputError(folder, "this image folder is missing.", _TWO_FOLDERS)
    # Hidden files are no images: macOS puts a ._img.png beside each img.png on foreign disks.
    files = {
        path.name: path
        for path in folder.iterdir()
        if path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
    }
    if not files:
        raise InputError(
            folder, "this folder holds no image.", f"Looked for {', '.join(sorted(SUFFIXES))}."
        )
    return [files[name] for name in sorted(files, key=natural_order)]


def natural_order(name: str) -> tuple[tuple[str | int, ...], str]:
    """Return a sort key that compares digits as numbers: img_2 comes before img_10."""
    # Text and numbers alternate, so that text is compared with text and numbers with numbers.
    parts = re.split("([0-9]+)", name)
    return tuple(int(part) if index % 2 else part for index, part in enumerate(parts)), name


def read_gray(
    path: Path, size_px: tuple[int, int] | None = None, gray_range: GrayRange | None = None
) -> Image:
    """Decode one image file to grayscale, [height, width], uint8.

    Colour is converted to gray (Rec. 601 luma, as OpenCV does), since everything downstream uses
    gray values only. Images of 16 bits are refused without a range: how they are reduced to 8
    decides which features appear. The size that the file claims is checked before decoding.

    Args:
        path: an image file.
        size_px: (width, height) that the image must have; None to accept any size up to MAX_PX.
        gray_range: the range of 16-bit values that becomes 0 to 255; None to refuse such images.

    Raises:
        InputError: missing, not a regular file, damaged, of 16 bits without a range, or of another
            size.
    """
    gray = decode_gray(_read_bytes(path), path, size_px)
    if gray.dtype == np.uint16 and gray_range is not None:
        gray = gray_range.to_8_bits(gray)
    if gray.dtype != np.uint8:
        raise InputError(
            path, f"this image is {gray.dtype}; expected 8 bits.", "Convert the images to 8 bits."
        )
    height, width = gray.shape
    _check_size((width, height), size_px, path)
    return np.asarray(gray, dtype=np.uint8)


def read_gray_of_any_depth(path: Path) -> AnyArray:
    """Decode one image file to grayscale, [height, width], of the type that it is stored in.

    Raises:
        InputError: the image is missing, not a regular file, or damaged.
    """
    return decode_gray(_read_bytes(path), path)


def range_of_files(left_files: list[Path], right_files: list[Path]) -> GrayRange | None:
    """Return the range of images spread over a recording; None if they have 8 bits.

    An image that is missing or damaged is left to the reading of its frame.
    """
    files = [
        one_side[index]
        for one_side in (left_files, right_files)
        for index in spread_indices(len(one_side))
    ]
    return common_range(_readable(files))


def _readable(files: list[Path]) -> Iterator[AnyArray]:
    """Yield the images that are neither missing nor damaged, as grayscale."""
    for file in files:
        with suppress(InputError):
            yield read_gray_of_any_depth(file)


def decode_gray(data: bytes, where: str | Path, size_px: tuple[int, int] | None = None) -> AnyArray:
    """Decode the bytes of an image file to grayscale, [height, width], of the type stored.

    Args:
        data: the bytes.
        where: the file or message that holds them, for messages.
        size_px: (width, height) that the image must have; None to accept any size up to MAX_PX.

    Raises:
        InputError: the image is damaged, claims another size, or has colours of floats.
    """
    try:
        chunks = _checked_chunks(data)
        _check_size(_claimed_size_px(data), size_px, where)
        image = _decoded(data, chunks)
        if image is None:
            raise DamagedError("it cannot be decoded")
    except DamagedError as damage:
        raise InputError(
            where, f"this image is damaged: {damage}.", "Copy the file anew."
        ) from None
    if image.ndim == 3 and image.dtype in (np.uint8, np.uint16):
        code = cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
        return np.asarray(cv2.cvtColor(image, code))
    if image.ndim != 2:
        what = f"this image has {image.shape[2]} channels of type {image.dtype}."
        raise InputError(where, what, "Give grey images, or colour images of 8 or 16 bits.")
    return image


def read_size_px(path: Path) -> tuple[int, int] | None:
    """Return the (width, height) that an image file claims; None if it claims none.

    Raises:
        InputError: the file is missing, or not a regular file.
    """
    return _claimed_size_px(_read_bytes(path))


def pair_size_px(left: Path, right: Path) -> tuple[int, int]:
    """Return the (width, height) of the images of a pair.

    Raises:
        InputError: an image is missing or damaged, or their sizes differ.
    """
    height, width = read_gray(left).shape
    right_px = read_size_px(right)
    if right_px is not None and right_px != (width, height):
        what = f"this image has {width}×{height} px, its partner {right_px[0]}×{right_px[1]} px."
        raise InputError(left, what, "Both must have the size of the calibration.")
    return width, height


def _read_bytes(path: Path) -> bytes:
    """Return the content of an image file.

    Raises:
        InputError: it is missing, too large, or not a regular file.
    """
    check_regular(path, MAX_FILE_BYTES)
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(path, f"this image cannot be read ({error.strerror}).") from error


def _check_size(
    claimed_px: tuple[int, int] | None, size_px: tuple[int, int] | None, where: str | Path
) -> None:
    """Refuse an image of another size than expected, or of an implausible one.

    A file that claims no size is left to the decoder.

    Raises:
        InputError: gives both sizes.
    """
    if claimed_px is None or claimed_px == size_px:
        return
    width, height = claimed_px
    if size_px is not None:
        what = f"this image has {width}×{height} px; expected {size_px[0]}×{size_px[1]} px."
        cure = (
            "All images must have the size that the calibration was made for. If all were scaled"
            " since, --resized scales that of a folder, a bag, a video or EuRoC's layout; other"
            " formats need theirs scaled."
        )
        raise InputError(where, what, cure)
    if width * height > MAX_PX:
        what = f"this image has {width}×{height} px; at most {MAX_PX:,} px are decoded."
        raise InputError(where, what)


def _claimed_size_px(data: bytes) -> tuple[int, int] | None:
    """Return the (width, height) in the header of a PNG or JPEG file; None without such a header.

    None is decoded either: both decoders need the header.
    """
    if data.startswith(PNG_MAGIC):
        # The first chunk is the header: its length, its type, width and height, 4 bytes each.
        header = data[len(PNG_MAGIC) : len(PNG_MAGIC) + 16]
        if len(header) < 16 or header[4:8] != b"IHDR":
            return None
        return int.from_bytes(header[8:12], "big"), int.from_bytes(header[12:16], "big")
    if data.startswith(JPEG_START):
        return _jpeg_size_px(data)
    return None


def _jpeg_size_px(data: bytes) -> tuple[int, int] | None:
    """Return the (width, height) in the frame header (SOF) of a JPEG file; None without one."""
    position = len(JPEG_START)
    while True:
        # A marker is 0xFF, any number of times, and a byte that is neither 0xFF nor 0.
        position = data.find(b"\xff", position)
        while 0 <= position < len(data) and data[position] == 0xFF:
            position += 1
        if not 0 <= position < len(data) - 8:
            return None
        marker = data[position]
        position += 1
        if marker in JPEG_SIZES:
            # Length of the segment (2 bytes), bits of a sample (1), height (2), width (2).
            height = int.from_bytes(data[position + 3 : position + 5], "big")
            return int.from_bytes(data[position + 5 : position + 7], "big"), height
        if marker == JPEG_PIXELS:
            return None
        if marker not in JPEG_BARE and marker != 0:
            position += int.from_bytes(data[position : position + 2], "big")


def _checked_chunks(data: bytes) -> list[tuple[bytes, memoryview]] | None:
    """Return the chunks of a PNG file, None of any other, and refuse a damaged one, as far as it
    shows without decoding.

    OpenCV may return the undamaged part of a damaged file.

    Raises:
        DamagedError: the file is incomplete, or of an unknown kind.
    """
    if data.startswith(PNG_MAGIC):
        return chunks_of(data)  # verifies the checksums
    check_complete(data)
    return None


def _decoded(data: bytes, chunks: list[tuple[bytes, memoryview]] | None) -> AnyArray | None:
    """Decode an image file to [height, width] or [height, width, channels].

    Args:
        data: the file.
        chunks: its chunks if it is a PNG file.

    Returns:
        The image; None if it cannot be decoded.
    """
    # OpenCV decodes what is not plain grey.
    image = None if chunks is None else plain_grey(chunks)
    if image is not None:
        return image
    with suppress(cv2.error):  # raised for images that are too large
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return None
