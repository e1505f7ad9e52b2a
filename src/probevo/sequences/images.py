"""Image files: lists of stereo pairs, and a decoder that refuses damaged files.

PNG files have checksums; of other files, only length or end can be checked.
"""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

from probevo.arrays import AnyArray, Image
from probevo.errors import InputError
from probevo.sequences.gray_range import GrayRange
from probevo.sequences.image_files import check_complete
from probevo.sequences.png import PNG_MAGIC, DamagedError, chunks_of, plain_grey

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".pgm", ".ppm", ".tif", ".tiff", ".webp", ".bmp"})


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
        cure = "Left and right images must have the same names."
        raise InputError(other / name, what, cure)
    return list(left_files.values()), list(right_files.values())


def list_images(folder: Path) -> list[Path]:
    """Return the image files of a folder, in the natural order of their names.

    Raises:
        InputError: the folder is missing, or holds no image.
    """
    if not folder.is_dir():
        raise InputError(
            folder, "this image folder is missing.", "Left and right images lie in one folder each."
        )
    files = {path.name: path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES}
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
    decides which features appear.

    Args:
        path: an image file.
        size_px: (width, height) that the image must have; None to accept any size.
        gray_range: the range of 16-bit values that becomes 0 to 255; None to refuse such images.

    Raises:
        InputError: missing, damaged, of 16 bits without a range, or of another size.
    """
    gray = read_gray_of_any_depth(path)
    if gray.dtype == np.uint16 and gray_range is not None:
        gray = gray_range.to_8_bits(gray)
    if gray.dtype != np.uint8:
        raise InputError(
            path, f"this image is {gray.dtype}; expected 8 bits.", "Convert the images to 8 bits."
        )
    height, width = gray.shape
    if size_px is not None and (width, height) != size_px:
        what = f"this image has {width}×{height} px; expected {size_px[0]}×{size_px[1]} px."
        raise InputError(
            path, what, "All images must have the size that the calibration was made for."
        )
    return np.asarray(gray, dtype=np.uint8)


def read_gray_of_any_depth(path: Path) -> AnyArray:
    """Decode one image file to grayscale, [height, width], of the type that it is stored in.

    Raises:
        InputError: the image is missing or damaged.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"this image cannot be read ({error.strerror}).") from error
    return decode_gray(data, path)


def decode_gray(data: bytes, where: str | Path) -> AnyArray:
    """Decode the bytes of an image file to grayscale, [height, width], of the type stored.

    Args:
        data: the bytes.
        where: the file or message that holds them, for messages.

    Raises:
        InputError: the image is damaged.
    """
    try:
        image = _decoded(data)
        if image is None:
            raise DamagedError("it cannot be decoded")
    except DamagedError as damage:
        raise InputError(
            where, f"this image is damaged: {damage}.", "Copy the file anew."
        ) from None
    if image.ndim == 3 and image.dtype in (np.uint8, np.uint16):
        code = cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
        return np.asarray(cv2.cvtColor(image, code))
    return image


def _decoded(data: bytes) -> AnyArray | None:
    """Decode an image file to [height, width] or [height, width, channels].

    OpenCV may return the undamaged part of a damaged file, so that damage is looked for first.

    Returns:
        The image; None if it cannot be decoded.

    Raises:
        DamagedError: the file is incomplete, or of an unknown kind.
    """
    if data.startswith(PNG_MAGIC):
        # chunks_of verifies the checksums; OpenCV decodes what is not plain grey.
        image = plain_grey(chunks_of(data))
        if image is not None:
            return image
    else:
        check_complete(data)
    with suppress(cv2.error):  # raised for images that are too large
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return None
