"""Image files: lists of stereo pairs, and a decoder that refuses damaged files.

PNG files have checksums; of a JPEG file, only the end can be checked.
"""

from __future__ import annotations

import re
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

from probevo.arrays import AnyArray, Image
from probevo.errors import InputError
from probevo.sequences.png import PNG_MAGIC, DamagedError, chunks_of, plain_grey

SUFFIXES = frozenset({".png", ".jpg", ".jpeg"})
JPEG_MAGIC = b"\xff\xd8"
JPEG_END = b"\xff\xd9"


def list_pairs(left: Path, right: Path) -> tuple[list[Path], list[Path]]:
    """Return the image files of two folders, paired by name, in the natural order of their names.

    Raises:
        InputError: a folder is missing or holds no image, or an image lacks its partner.
    """
    left_files = _list_images(left)
    right_files = _list_images(right)
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


def _list_images(folder: Path) -> dict[str, Path]:
    """Return the image files of a folder by name, in the natural order of their names.

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
    return {name: files[name] for name in sorted(files, key=natural_order)}


def natural_order(name: str) -> tuple[tuple[str | int, ...], str]:
    """Return a sort key that compares digits as numbers: img_2 comes before img_10."""
    # Text and numbers alternate, so that text is compared with text and numbers with numbers.
    parts = re.split("([0-9]+)", name)
    return tuple(int(part) if index % 2 else part for index, part in enumerate(parts)), name


def read_gray(path: Path, size_px: tuple[int, int] | None = None) -> Image:
    """Decode one image to grayscale, [height, width], uint8.

    Colour is converted to gray (Rec. 601 luma, as OpenCV does), since everything downstream uses
    gray values only. Images of 16 bits are refused: how they are reduced to 8 decides which
    features appear.

    Args:
        path: PNG or JPEG file.
        size_px: (width, height) that the image must have; None to accept any size.

    Raises:
        InputError: missing, damaged, not 8 bits, or of another size.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, f"this image cannot be read ({error.strerror}).") from error
    try:
        image = _decoded(data)
        if image is None:
            raise DamagedError("it cannot be decoded")
    except DamagedError as damage:
        raise InputError(path, f"this image is damaged: {damage}.", "Copy the file anew.") from None
    if image.dtype != np.uint8:
        raise InputError(
            path, f"this image is {image.dtype}; expected 8 bits.", "Convert the images to 8 bits."
        )
    if image.ndim == 3:
        image = cv2.cvtColor(
            image, cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
        )
    height, width = image.shape
    if size_px is not None and (width, height) != size_px:
        what = f"this image has {width}×{height} px; expected {size_px[0]}×{size_px[1]} px."
        raise InputError(
            path, what, "All images must have the size that the calibration was made for."
        )
    return np.asarray(image, dtype=np.uint8)


def _decoded(data: bytes) -> AnyArray | None:
    """Decode a PNG or JPEG file to [height, width] or [height, width, channels].

    OpenCV may return the undamaged part of a damaged file, so that damage is looked for first.

    Returns:
        The image; None if it cannot be decoded.

    Raises:
        DamagedError: the file is incomplete, or neither PNG nor JPEG.
    """
    if data.startswith(PNG_MAGIC):
        # chunks_of verifies the checksums; OpenCV decodes what is not plain grey.
        image = plain_grey(chunks_of(data))
        if image is not None:
            return image
    elif data.startswith(JPEG_MAGIC):
        if not data.rstrip(b"\0").endswith(JPEG_END):
            raise DamagedError("its end is missing")
    else:
        raise DamagedError("it is neither PNG nor JPEG" if data else "it is empty")
    with suppress(cv2.error):  # raised for images that are too large
        return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return None
