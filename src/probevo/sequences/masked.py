"""A recording with masks: the parts of its images where no feature is wanted, such as a bonnet."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from probevo.arrays import AnyArray, BoolArray, Image
from probevo.camera.rectification import Rectification
from probevo.errors import InputError, brief
from probevo.sequences.base import Sequence
from probevo.sequences.frame import WHITE, Frame
from probevo.sequences.frame_checks import is_too_dark
from probevo.sequences.images import list_images, read_gray
from probevo.sequences.recording import ImageRecording, StereoRecording

CURE = "A mask is a grey image of the size of the recording's: black where no feature is wanted."


class Masks(Protocol):
    """The masks of one camera."""

    @property
    def is_fixed(self) -> bool:
        """Whether all frames have the same one."""

    def of_frame(self, index: int) -> Image:
        """Return the mask of a frame, [height, width], uint8: 0 where no feature is wanted.

        Raises:
            InputError: its file is missing, damaged, or of another size than the images.
        """


@dataclass(frozen=True)
class SameMask:
    """One mask for all frames."""

    mask: Image
    is_fixed: bool = True

    def of_frame(self, index: int) -> Image:
        """Return the mask."""
        del index
        return self.mask


@dataclass(frozen=True)
class MaskOfEachFrame:
    """A file for each frame."""

    files: tuple[Path, ...]
    size_px: tuple[int, int]
    is_fixed: bool = False

    def of_frame(self, index: int) -> Image:
        """Read the mask of a frame.

        Raises:
            InputError: also if it is of 0 and 1 instead of black and white.
        """
        mask = _read(self.files[index], self.size_px)
        if is_too_dark(mask):
            what = f"this mask is nowhere brighter than {mask.max()}, and leaves no feature."
            raise InputError(
                self.files[index], what, f"Features may be where it is {WHITE} or more."
            )
        return _black_and_white(mask)


@dataclass(frozen=True)
class RectifiedMasks:
    """The masks of raw images, for the rectified ones."""

    raw: Masks
    rectification: Rectification
    is_right: bool
    is_fixed: bool = False

    def of_frame(self, index: int) -> Image:
        """Rectify the mask of a frame; where a rectified image has no raw one, it is masked."""
        raw = self.raw.of_frame(index)
        pair = self.rectification.rectify(raw, raw)
        # Between black and white, it is partly masked.
        mask = pair[1] if self.is_right else pair[0]
        return np.where(mask == 255, 255, 0).astype(np.uint8)


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class MaskedRecording(ImageRecording):
    """A ``Sequence`` with the frames of another one, and masks."""

    original: Sequence
    left_masks: Masks | None = None
    right_masks: Masks | None = None

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames from the first; raise InputError at a faulty image or mask."""
        for frame in self.original:
            yield replace(
                frame,
                left_mask=_both(frame.left_mask, _of(self.left_masks, frame.index)),
                right_mask=_both(frame.right_mask, _of(self.right_masks, frame.index)),
            )


def with_masks(
    sequence: Sequence, left: str | Path | AnyArray | None, right: str | Path | AnyArray | None
) -> Sequence:
    """Return a recording with masks; the recording itself if there are none.

    Args:
        sequence: a recording of images.
        left: mask of the left images, black where no feature is wanted: an array [height, width],
            an image file, or a folder with an image for each frame, of the same names as the left
            images where these are files. Of raw images, if these are rectified on the fly.
        right: the same for the right images.

    Raises:
        InputError: the recording has no images, a mask is missing or of a wrong size, or leaves
            nothing.
    """
    if left is None and right is None:
        return sequence
    if sequence.camera.size_px is None:
        what = f"the recording {sequence.path} has no images."
        raise InputError("mask", what, "Leave out the features that are not wanted.")
    if isinstance(sequence, ImageRecording):
        imu_stream = sequence.imu_stream
        rectification = sequence.rectification
        notes = sequence.notes
    else:
        imu_stream = None
        rectification = None
        notes = ()
    return MaskedRecording(
        path=sequence.path,
        format=sequence.format,
        camera=sequence.camera,
        stamps_ns=sequence.stamps_ns,
        imu=sequence.imu,
        imu_stream=imu_stream,
        truth=sequence.truth,
        rectification=rectification,
        notes=notes,
        original=sequence,
        left_masks=None if left is None else _masks(left, sequence, is_right=False),
        right_masks=None if right is None else _masks(right, sequence, is_right=True),
    )


def mask_of_array(values: object, size_px: tuple[int, int] | None, where: str) -> Image:
    """Check a mask, and return it as black and white, [height, width], uint8.

    Args:
        values: an array of bool, True where features are wanted, or of uint8, from ``WHITE`` on.
        size_px: (width, height) that it must have; None for any.
        where: what it is, for messages.

    Raises:
        InputError: it is of another kind or size.
    """
    if not isinstance(values, np.ndarray) or values.dtype not in (np.bool_, np.uint8):
        found = f"of type {values.dtype}" if isinstance(values, np.ndarray) else brief(values)
        raise InputError(where, f"is {found}.", "Give an array of bool or uint8, or a path.")
    if values.ndim != 2 or (size_px is not None and values.shape != size_px[::-1]):
        needed = "2 axes" if size_px is None else f"shape {size_px[::-1]}"
        raise InputError(where, f"has shape {values.shape}; expected {needed}.", CURE)
    if values.dtype == np.bool_:
        return np.where(values, 255, 0).astype(np.uint8)
    return _black_and_white(values)


def _masks(given: Path | str | AnyArray, sequence: Sequence, *, is_right: bool) -> Masks:
    """Return the masks of one camera, as ``with_masks`` takes them.

    Raises:
        InputError: as there.
    """
    size_px = sequence.camera.size_px
    where = "mask_right" if is_right else "mask_left"
    masks: Masks
    if not isinstance(given, str | Path):
        masks = SameMask(_not_black(mask_of_array(given, size_px, where), where))
    elif Path(given).is_dir():
        masks = MaskOfEachFrame(_files(Path(given), sequence, is_right=is_right), size_px or (0, 0))
    else:
        path = Path(given)
        masks = SameMask(_not_black(_black_and_white(_read(path, size_px)), path))
    if isinstance(sequence, ImageRecording) and sequence.rectification is not None:
        masks = RectifiedMasks(masks, sequence.rectification, is_right)
        if isinstance(masks.raw, SameMask):
            masks = SameMask(masks.of_frame(0))
    return masks


def _files(folder: Path, sequence: Sequence, *, is_right: bool) -> tuple[Path, ...]:
    """Return the mask file of each frame.

    Raises:
        InputError: the folder holds none, or not one for each frame.
    """
    files = list_images(folder)
    if isinstance(sequence, StereoRecording):
        file_by_stem = {file.stem: file for file in files}
        images = sequence.right_files if is_right else sequence.left_files
        missing = [image.name for image in images if image.stem not in file_by_stem]
        if missing:
            what = f"the mask of {missing[0]} is missing ({len(missing)} of {len(images)} are)."
            raise InputError(folder, what, "Give one of each image, of the same name.")
        return tuple(file_by_stem[image.stem] for image in images)
    if len(files) != len(sequence):
        what = f"it holds {len(files)} masks; the recording has {len(sequence)} frames."
        raise InputError(folder, what, "Give one of each frame, in their order.")
    return tuple(files)


def _not_black(mask: Image, where: str | Path) -> Image:
    """Return a mask that leaves something.

    Raises:
        InputError: it does not.
    """
    if not mask.any():
        raise InputError(where, "this mask is all black, and leaves no feature.", CURE)
    return mask


def _black_and_white(mask: Image) -> Image:
    return np.where(mask >= WHITE, 255, 0).astype(np.uint8)


def _both(first: Image | BoolArray | None, second: Image | None) -> Image | BoolArray | None:
    """Return the mask of where features are wanted by both; None means everywhere."""
    if first is None:
        return second
    if second is None:
        return first
    is_wanted = first if first.dtype == np.bool_ else first >= WHITE
    return np.where(is_wanted & (second >= WHITE), 255, 0).astype(np.uint8)


def _of(masks: Masks | None, index: int) -> Image | None:
    return None if masks is None else masks.of_frame(index)


def _read(file: Path, size_px: tuple[int, int] | None) -> Image:
    """Read a mask.

    Raises:
        InputError: the file is missing or damaged, or of another size than the images.
    """
    try:
        return read_gray(file, size_px)
    except InputError as error:
        raise InputError(error.where, error.what, CURE) from error
