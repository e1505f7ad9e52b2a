"""The recording formats: how each is recognised and opened; ``open_sequence`` opens any of them.

A format is registered in the table below, by ``register_format``, or by another package with an
entry point in the group ``probevo.formats``. No other code asks which format a recording has.

This module imports no reader, and NumPy neither: ``probevo run --help`` lists the formats without
waiting for them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from probevo.config.settings import Settings
from probevo.entry_points import entry_points, entry_text, imported, load_entry
from probevo.errors import InputError, brief
from probevo.sequences.format_options import (
    BAG_SUFFIXES,
    VIDEO_SUFFIXES,
    EurocOptions,
    FolderOptions,
    KittiFlowOptions,
    PairOptions,
    RateOptions,
    RosbagOptions,
    VideoOptions,
)
from probevo.sequences.recordings_nearby import recordings_above, recordings_below, suggestion

if TYPE_CHECKING:
    from probevo.arrays import AnyArray
    from probevo.sequences.base import Sequence

ENTRY_POINTS = "probevo.formats"
"""Group of the entry points by which other packages add formats."""
MAX_NAMES = 8
"""Entries of an unrecognised folder that its message lists."""


class NoOptions(Settings):
    """The options of a format that has none."""


def _exists(path: Path) -> bool:
    """Return whether a file exists; False, too, in a folder that must not be looked into."""
    try:
        return path.exists()
    except OSError:
        return False


@dataclass(frozen=True)
class SequenceFormat:
    """A recording format: how it is recognised, which options it takes, and who opens it."""

    name: str
    """Name by which users ask for the format, as in ``--format kitti-raw``."""
    summary: str
    """One line on what the format is."""
    open: Callable[..., Sequence]
    """Opens a recording: called with its ``Path``, and with the options as keyword arguments."""
    folder_signs: tuple[str, ...] = ()
    """A folder that holds one of these files or folders is a recording of this format."""
    folder_sign_pairs: tuple[tuple[str, str], ...] = ()
    """A folder that holds both of one of these pairs is one, too, where one alone says nothing."""
    file_suffixes: tuple[str, ...] = ()
    """A file with one of these endings, such as ``.npz``, is a recording of this format; so is one
    with the same in capitals."""
    options: type[Settings] = NoOptions
    """Options of this format, with their defaults, bounds and descriptions."""

    def recognises(self, path: Path) -> bool:
        """Return whether an existing file or folder looks like a recording of this format."""
        if path.is_dir():
            signs: list[tuple[str, ...]] = [(sign,) for sign in self.folder_signs]
            signs += self.folder_sign_pairs
            return any(all(_exists(path / name) for name in sign) for sign in signs)
        return path.suffix.lower() in self.file_suffixes

    def check_kind(self, path: Path) -> None:
        """Refuse a folder where this format needs a file, and the reverse.

        A format without any sign takes both.

        Raises:
            InputError: names what the format needs.
        """
        is_usable = self.folder_signs if path.is_dir() else self.file_suffixes
        if is_usable or not (self.folder_signs or self.file_suffixes):
            return
        needed = "a folder" if self.folder_signs else f"an {' or '.join(self.file_suffixes)} file"
        given = "a folder" if path.is_dir() else "a file"
        raise InputError(path, f"the format {self.name} needs {needed}, but this is {given}.")

    def validated(self, options: dict[str, Any]) -> dict[str, Any]:
        """Return the values of all options, defaults included.

        Args:
            options: values by name, as the user gave them.

        Raises:
            InputError: names the option that is unknown, missing or out of bounds.
        """
        try:
            values = self.options.model_validate(options)
        except ValidationError as error:
            fault = error.errors()[0]
            name = ".".join(map(str, fault["loc"]))
            where = f"{name} ({_flag(name)}), for the format {self.name}"
            if fault["type"] == "extra_forbidden":
                known = ", ".join(self.options.model_fields)
                cure = f"Its options are {known}." if known else "This format has no options."
                others = [
                    other.name
                    for other in _BUILT_IN
                    if str(fault["loc"][0]) in other.options.model_fields
                ]
                if others:
                    cure += f" Those that have this one: {', '.join(others)}."
                raise InputError(where, "there is no such option.", cure) from error
            field = self.options.model_fields.get(str(fault["loc"][0])) if fault["loc"] else None
            cure = (field.description or "") if field else ""
            message = fault["msg"].replace("Input should", "it should")
            raise InputError(where, f"is {brief(fault['input'])}; {message}.", cure) from error
        return {name: getattr(values, name) for name in self.options.model_fields}


def _flag(name: str) -> str:
    """Return the flag of an option; the topics of a bag are a group of their own."""
    group = "topics_"
    grouped = f"topics.{name.removeprefix(group)}" if name.startswith(group) else name
    return f"--{grouped.replace('_', '-')}"


def _reader(place: str, options_type: type[Settings] | None = None) -> Callable[..., Sequence]:
    """Return what opens a recording: its reader is imported then, and needs OpenCV and SciPy.

    Args:
        place: the reader, as ``module:function`` within ``formats``.
        options_type: the type of its second argument; None if it takes the options by their names.
    """

    def open_recording(path: Path, **options: Any) -> Sequence:
        """Open a recording by the reader."""
        reader = imported(f"{__package__}.formats.{place}")
        sequence: Sequence
        if options_type is None:
            sequence = reader(path, **options)
        else:
            sequence = reader(path, options_type(**options))
        return sequence

    return open_recording


_BUILT_IN = (
    SequenceFormat(
        name="kitti-raw",
        summary="a synchronised drive of KITTI raw, with OXTS as IMU and ground truth",
        folder_signs=("image_00",),
        open=_reader("kitti_raw:open_kitti_raw"),
    ),
    SequenceFormat(
        name="kitti-flow",
        summary="a scene of KITTI 2012 or 2015, stereo or flow: --scene NUMBER",
        folder_signs=("flow_occ", "flow_noc", "calib_cam_to_cam"),
        folder_sign_pairs=(("calib", "image_0"), ("calib", "image_2")),
        open=_reader("kitti_flow:open_kitti_flow"),
        options=KittiFlowOptions,
    ),
    SequenceFormat(
        name="kitti-odometry",
        summary="a sequence of the KITTI odometry benchmark",
        folder_signs=("image_0",),
        folder_sign_pairs=(("image_2", "times.txt"),),
        open=_reader("kitti_odometry:open_kitti_odometry"),
    ),
    SequenceFormat(  # before euroc, whose sign it has, too
        name="tum-vi",
        summary="TUM-VI in its exported EuRoC layout, rectified on the fly",
        folder_signs=("dso/camchain.yaml",),
        open=_reader("tum_vi:open_tum_vi"),
        options=PairOptions,
    ),
    SequenceFormat(
        name="euroc",
        summary="EuRoC MAV data in the ASL layout, rectified on the fly",
        folder_signs=("mav0", "cam0"),
        open=_reader("euroc:open_euroc"),
        options=EurocOptions,
    ),
    SequenceFormat(
        name="4seasons",
        summary="a recording of 4Seasons with its undistorted images",
        folder_signs=("undistorted_images", "distorted_images"),
        open=_reader("four_seasons:open_four_seasons"),
    ),
    SequenceFormat(
        name="tartanair",
        summary="a trajectory of TartanAir, version 1 or 2",
        folder_signs=("image_left", "image_lcam_front"),
        open=_reader("tartan_air:open_tartan_air"),
        options=RateOptions,
    ),
    SequenceFormat(
        name="vkitti2",
        summary="a variation of a scene of Virtual KITTI 2",
        folder_signs=("frames/rgb/Camera_0",),
        open=_reader("virtual_kitti:open_virtual_kitti"),
        options=RateOptions,
    ),
    SequenceFormat(  # before folder, whose calib.yaml it has, too
        name="video",
        summary="a video with left and right image side by side, or a folder with two videos",
        folder_signs=tuple(
            f"left{ending}" for suffix in VIDEO_SUFFIXES for ending in (suffix, suffix.upper())
        ),
        file_suffixes=VIDEO_SUFFIXES,
        open=_reader("video:open_video", VideoOptions),
        options=VideoOptions,
    ),
    SequenceFormat(
        name="folder",
        summary="probevo's own layout for images from any source",
        folder_signs=("calib.yaml", "left"),
        open=_reader("folder:open_folder", FolderOptions),
        options=FolderOptions,
    ),
    SequenceFormat(
        name="tracks",
        summary="features tracked by another front end, in one .npz file without images",
        file_suffixes=(".npz",),
        open=_reader("tracks_file:open_tracks"),
    ),
    SequenceFormat(
        name="rosbag",
        summary="a bag of ROS 1 or ROS 2 with stereo images, read without ROS",
        folder_signs=("metadata.yaml",),
        file_suffixes=BAG_SUFFIXES,
        open=_reader("rosbag:open_rosbag", RosbagOptions),
        options=RosbagOptions,
    ),
)
_registered = {known.name: known for known in _BUILT_IN}
"""The formats of this process by name; entry points come on top of them."""


def register_format(new: SequenceFormat) -> None:
    """Make a format known to this process.

    A package that is installed beside probevo uses an entry point instead.

    Raises:
        InputError: a format of this name is already known.
    """
    if new.name in format_names():
        raise InputError(
            f"format {new.name}", "a format of this name is already known.", "Choose another name."
        )
    _registered[new.name] = new


def format_names() -> tuple[str, ...]:
    """Return the names of all formats, without loading any entry point."""
    entries = (entry.name for entry in entry_points(group=ENTRY_POINTS))
    return tuple(dict.fromkeys([*_registered, *entries]))


def sequence_formats() -> dict[str, SequenceFormat]:
    """Return all formats by name, in the order in which a recording is tried against them.

    Raises:
        InputError: an entry point cannot be loaded, holds no ``SequenceFormat`` of its own name, or
            has the name of another format.
    """
    formats = dict(_registered)
    for entry in entry_points(group=ENTRY_POINTS):
        if entry.name in formats:
            raise InputError(
                entry_text(entry),
                "a format of this name is already known.",
                "Uninstall one of the packages that provide it.",
            )
        formats[entry.name] = _loaded(entry)
    return formats


def _loaded(entry: EntryPoint) -> SequenceFormat:
    """Load the format that an entry point names.

    Raises:
        InputError: it cannot be loaded, or is no ``SequenceFormat`` of that name.
    """
    loaded = load_entry(entry, SequenceFormat)
    if loaded.name != entry.name:
        raise InputError(
            entry_text(entry),
            f"its format is called {loaded.name!r}, not {entry.name!r}.",
            "Update or uninstall the package that provides it.",
        )
    return loaded


def open_sequence(
    path: str | Path,
    format: str | None = None,
    *,
    mask_left: str | Path | AnyArray | None = None,
    mask_right: str | Path | AnyArray | None = None,
    **options: Any,
) -> Sequence:
    """Open a recording and check all of it that can be checked without decoding images.

    Args:
        path: folder or file of the recording.
        format: one of ``format_names()``; None to recognise the format.
        mask_left: where features of the left images are wanted, not black: an array
            [height, width] of bool or uint8, an image file, or a folder with an image for each
            frame. By default ``mask_left.png`` or ``mask_left/`` in the folder of the recording, if
            there is one.
        mask_right: the same for the right images.
        options: options of the format, by name.

    Raises:
        InputError: nothing is there, no format fits, an option is unknown or out of bounds, or the
            recording or a mask is faulty.
    """
    if not isinstance(path, str | Path):
        raise InputError(
            "path", f"is a {type(path).__name__}.", "Give the path of a recording, str or Path."
        )
    if format is not None and not isinstance(format, str):
        raise InputError("format", f"is a {type(format).__name__}.", "Give a name, or None.")
    path = Path(path)
    formats = sequence_formats()
    if format is not None and format not in formats:
        raise InputError(
            "format", f"{format!r} is not known.", f"Choose one of {', '.join(formats)}."
        )
    if not os.path.lexists(path) or not path.exists():  # lexists: a name may be too long
        raise InputError(
            path,
            "nothing is there.",
            "Give the folder of a recording, a bag, a video or a tracks file.",
        )
    if format is None:
        chosen = _recognised(path, formats)
    else:
        chosen = formats[format]
        chosen.check_kind(path)
    sequence = chosen.open(path, **chosen.validated(options))
    if mask_left is None:
        mask_left = _beside(path, "mask_left")
    if mask_right is None:
        mask_right = _beside(path, "mask_right")
    if mask_left is None and mask_right is None:
        return sequence
    from probevo.sequences.masked import with_masks

    return with_masks(sequence, mask_left, mask_right)


def _beside(path: Path, name: str) -> Path | None:
    """Return the mask of that name in the folder of a recording: a file, or a folder; or None."""
    places = (path / f"{name}.png", path / name)
    return next((place for place in places if path.is_dir() and place.exists()), None)


def _recognised(path: Path, formats: dict[str, SequenceFormat]) -> SequenceFormat:
    """Return the first format that recognises the recording.

    Raises:
        InputError: none does; says what was found and what was looked for.
    """
    for known in formats.values():
        if known.recognises(path):
            return known
    if not path.is_dir():
        kinds = [
            f"an {' or '.join(known.file_suffixes)} file ({known.name})"
            for known in formats.values()
            if known.file_suffixes
        ]
        cure = f"Give a folder, or {', or '.join(kinds)}."
        raise InputError(path, "this file is not a recording.", cure)
    below = recordings_below(path, formats.values())
    if below:
        raise InputError(path, "this folder is not a recording.", suggestion(below))
    above = recordings_above(path, formats.values())
    if above:
        raise InputError(path, "this folder is part of a recording.", suggestion(above))
    names = sorted(entry.name for entry in path.iterdir())[:MAX_NAMES]
    looked_for = [
        f"{' or '.join(_signs_in_words(known))} ({known.name})"
        for known in formats.values()
        if known.folder_signs
    ]
    raise InputError(
        path,
        f"no known format; found {', '.join(names)}." if names else "this folder is empty.",
        f"Looked for {'; '.join(looked_for)}.",
    )


def _signs_in_words(known: SequenceFormat) -> list[str]:
    """Return the signs of a folder as a message names them."""
    return [*known.folder_signs, *(" with ".join(pair) for pair in known.folder_sign_pairs)]
