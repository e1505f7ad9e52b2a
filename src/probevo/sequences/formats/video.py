"""Stereo videos: left and right side by side in one file, or two files of the same recording."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np

from probevo.arrays import Image, IntArray
from probevo.errors import InputError
from probevo.sequences.format_options import VIDEO_SUFFIXES, VideoOptions
from probevo.sequences.formats.folder import read_cameras
from probevo.sequences.frame import Frame
from probevo.sequences.images import MAX_PX
from probevo.sequences.read_ahead import read_ahead
from probevo.sequences.recording import ImageRecording
from probevo.sequences.stamps import check_stamps, evenly_spaced
from probevo.storage.files import check_regular

MAX_FILE_BYTES = 1 << 42
MAX_UNPAIRED = 0.02
"""Share of the frames by which two videos may differ in length: one was stopped later."""


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class VideoRecording(ImageRecording):
    """A ``Sequence`` of the frames of one video, or of two."""

    files: tuple[Path, ...]
    """One with both images side by side, left first; or the left and the right one."""

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames from the first; raise InputError where one cannot be decoded."""
        videos = [_Video(file) for file in self.files]

        def read(index: int) -> Frame:
            """Decode one frame, and rectify it."""
            start = perf_counter()
            images = [video.read(index) for video in videos]
            left, right = images if len(images) == 2 else _halves(images[0])
            if self.rectification is not None:
                left, right = self.rectification.rectify(left, right)
            return Frame(
                index=index,
                stamp_ns=int(self.stamps_ns[index]),
                left=left,
                right=right,
                decode_ms=1e3 * (perf_counter() - start),
                left_mask=self.left_mask,
                right_mask=self.right_mask,
            )

        try:
            # A single thread: frames are decoded one after the other.
            with closing(read_ahead(read, range(len(self)), threads=1)) as frames:
                yield from frames
        finally:
            for video in videos:
                video.close()


def open_video(path: Path, options: VideoOptions | None = None) -> VideoRecording:
    """Open a video with the images side by side, or a folder with ``left`` and ``right`` videos.

    The calibration is the option, or ``calib.yaml`` beside the video or in the folder; both are
    those of one of the two images. Times are the container's, or at a rate. To find them,
    the videos are read once.

    Args:
        path: the file, or the folder.
        options: a calibration file instead of ``calib.yaml``, and frames a second.

    Raises:
        InputError: a file is missing or no video, the two do not belong together, the calibration
            is for another size, or the container has no times.
    """
    options = options or VideoOptions()
    files = (path,) if path.is_file() else _two_files(path)
    contents = [_content(file) for file in files]
    width, height = contents[0].size_px
    if len(files) == 1:
        if width % 2:
            what = f"its images are {width} px wide, which cannot be halved."
            raise InputError(path, what, "Left and right image have to lie side by side.")
        width //= 2
    elif contents[1].size_px != (width, height):
        sizes = " and ".join(f"{size[0]}×{size[1]}" for size in (c.size_px for c in contents))
        raise InputError(path, f"the sizes of the two videos differ: {sizes} px.")
    folder = path if path.is_dir() else path.parent
    cameras = read_cameras(
        folder, options.calibration, lambda: (width, height), resized=options.resized
    )
    if cameras.rectification is None and cameras.camera.size_px != (width, height):
        expected = cameras.camera.size_px or (0, 0)
        what = (
            f"it is for images of {expected[0]}×{expected[1]} px; these have {width}×{height} px."
        )
        cure = (
            "Give the calibration of one of the two images, and --resized if they were scaled since"
            " they were calibrated."
        )
        raise InputError(cameras.where, what, cure)
    count, notes = _paired(path, contents)
    if options.rate_hz is not None:
        stamps_ns = evenly_spaced(count, options.rate_hz)
    else:
        stamps_ns, note = _stamps(files[0], contents[0])
        stamps_ns = check_stamps(stamps_ns[:count], files[0])
        notes = (*notes, note)
    return VideoRecording(
        path=path,
        format="video",
        camera=cameras.camera,
        stamps_ns=stamps_ns,
        rectification=cameras.rectification,
        notes=(*notes, *cameras.notes),
        files=files,
    )


class _Video:
    """A video that is read frame by frame.

    Raises:
        InputError: the file is missing, or no video that OpenCV can decode.
    """

    def __init__(self, path: Path) -> None:
        check_regular(path, MAX_FILE_BYTES)
        self.path = path
        self._capture = cv2.VideoCapture(str(path))
        if not self._capture.isOpened():
            what = "OpenCV cannot read this as a video."
            raise InputError(path, what, "Convert it, as to H.264 in .mp4, or to images.")
        width, height = self.size_px
        if not 0 < width * height <= MAX_PX:
            self.close()
            raise InputError(path, f"its images claim {width}×{height} px.", "Is it damaged?")

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height of its images."""
        size = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        width, height = (int(self._capture.get(value)) for value in size)
        return width, height

    @property
    def rate_hz(self) -> float:
        """Frames a second that the container tells; 0 if it tells none."""
        rate = float(self._capture.get(cv2.CAP_PROP_FPS))
        return rate if np.isfinite(rate) and rate > 0.0 else 0.0

    def next_time_ms(self) -> float | None:
        """Skip to the next frame, and return its time; None at the end."""
        if not self._capture.grab():
            return None
        return float(self._capture.get(cv2.CAP_PROP_POS_MSEC))

    def read(self, index: int) -> Image:
        """Decode the next frame as grey image, [height, width].

        Raises:
            InputError: it cannot be decoded.
        """
        is_there, image = self._capture.read()
        if not is_there:
            what = f"frame {index} cannot be decoded."
            raise InputError(self.path, what, "Is the video damaged, or still being written?")
        if image.ndim == 3:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
        return np.ascontiguousarray(image, dtype=np.uint8)

    def close(self) -> None:
        """Release the file."""
        self._capture.release()


@dataclass(frozen=True)
class _Content:
    """What a video holds."""

    size_px: tuple[int, int]
    times_ms: list[float]
    rate_hz: float


def _content(path: Path) -> _Content:
    """Read through a video, without its pixels.

    Raises:
        InputError: it cannot be read, or holds less than two frames.
    """
    with closing(_Video(path)) as video:
        times_ms = []
        while (time_ms := video.next_time_ms()) is not None:
            times_ms.append(time_ms)
        if len(times_ms) < 2:
            what = f"frames that can be read: {len(times_ms)}."
            raise InputError(path, what, "Expected two at least; is the video damaged?")
        return _Content(video.size_px, times_ms, video.rate_hz)


def _stamps(path: Path, content: _Content) -> tuple[IntArray, tuple[str, str]]:
    """Return the times of the frames, ns, and what there is to report of them.

    Those of the container are taken if they ascend; otherwise the frames are equally spaced, at the
    rate of its header.

    Raises:
        InputError: it has none.
    """
    times_ms = np.array(content.times_ms)
    if np.isfinite(times_ms).all() and (np.diff(times_ms) > 0.0).all():
        rate_hz = 1e3 / float(np.median(np.diff(times_ms)))
        note = ("times", f"of the container, {rate_hz:.4g} Hz in the median")
        return np.round(1e6 * times_ms).astype(np.int64), note
    if content.rate_hz > 0.0:
        text = f"of the container, do not ascend; {content.rate_hz:.4g} Hz of its header instead"
        return evenly_spaced(len(times_ms), content.rate_hz), ("! times", text)
    raise InputError(path, "the container has no times.", "Give them: --rate-hz.")


def _two_files(folder: Path) -> tuple[Path, Path]:
    """Return the videos left and right of a folder.

    Raises:
        InputError: one is missing, or there are several.
    """
    videos = []
    for side in ("left", "right"):
        wanted = {f"{side}{suffix}" for suffix in VIDEO_SUFFIXES}
        # The ending may be in capitals: some cameras write left.MP4.
        files = [
            file for file in sorted(folder.iterdir()) if file.stem + file.suffix.lower() in wanted
        ]
        if len(files) != 1:
            names = ", ".join(file.name for file in files) or "none"
            what = f"it should hold one video called {side}; found {names}."
            raise InputError(folder, what, f"Its ending is one of {', '.join(VIDEO_SUFFIXES)}.")
        videos.append(files[0])
    return videos[0], videos[1]


def _paired(path: Path, contents: list[_Content]) -> tuple[int, tuple[tuple[str, str], ...]]:
    """Return how many frames both videos have, and what there is to report.

    Raises:
        InputError: one is much longer than the other.
    """
    lengths = [len(content.times_ms) for content in contents]
    count = min(lengths)
    if len(lengths) == 1 or max(lengths) == count:
        return count, ()
    if max(lengths) - count > max(2.0, MAX_UNPAIRED * count):
        what = f"the left video has {lengths[0]} frames, the right one {lengths[1]}."
        raise InputError(path, what, "Frames are paired by their number; are frames missing?")
    text = f"{count}, by the number of the frame; the left video has {lengths[0]}, the right one"
    return count, (("! pairs", f"{text} {lengths[1]}"),)


def _halves(image: Image) -> tuple[Image, Image]:
    """Return the left and the right half of an image, each in one piece."""
    width = image.shape[1] // 2
    return np.ascontiguousarray(image[:, :width]), np.ascontiguousarray(image[:, width:])
