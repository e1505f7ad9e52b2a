"""Image messages of ROS as grayscale: sensor_msgs/Image and sensor_msgs/CompressedImage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from probevo.arrays import AnyArray
from probevo.errors import InputError
from probevo.sequences.images import decode_gray


@dataclass(frozen=True)
class _Encoding:
    """How the pixels of an encoding are stored, and how they become gray."""

    bits: int
    """Bits of a channel: 8 or 16."""
    channels: int
    to_gray: int | None
    """Code of OpenCV's ``cvtColor``; None where the pixels are gray already."""


# OpenCV names a Bayer pattern by the second and third pixel of its second row: RGGB is its BG.
_BAYER = {
    "rggb": cv2.COLOR_BayerBG2GRAY,
    "bggr": cv2.COLOR_BayerRG2GRAY,
    "gbrg": cv2.COLOR_BayerGR2GRAY,
    "grbg": cv2.COLOR_BayerGB2GRAY,
}
ENCODINGS: dict[str, _Encoding] = {
    "mono8": _Encoding(bits=8, channels=1, to_gray=None),
    "8UC1": _Encoding(bits=8, channels=1, to_gray=None),
    "mono16": _Encoding(bits=16, channels=1, to_gray=None),
    "16UC1": _Encoding(bits=16, channels=1, to_gray=None),
    "8UC3": _Encoding(bits=8, channels=3, to_gray=cv2.COLOR_BGR2GRAY),
    "8UC4": _Encoding(bits=8, channels=4, to_gray=cv2.COLOR_BGRA2GRAY),
}
for _bits in (8, 16):
    ENCODINGS[f"bgr{_bits}"] = _Encoding(_bits, channels=3, to_gray=cv2.COLOR_BGR2GRAY)
    ENCODINGS[f"rgb{_bits}"] = _Encoding(_bits, channels=3, to_gray=cv2.COLOR_RGB2GRAY)
    ENCODINGS[f"bgra{_bits}"] = _Encoding(_bits, channels=4, to_gray=cv2.COLOR_BGRA2GRAY)
    ENCODINGS[f"rgba{_bits}"] = _Encoding(_bits, channels=4, to_gray=cv2.COLOR_RGBA2GRAY)
    for _pattern, _code in _BAYER.items():
        ENCODINGS[f"bayer_{_pattern}{_bits}"] = _Encoding(_bits, channels=1, to_gray=_code)


def gray_of(message: Any, where: str) -> AnyArray:
    """Return the image of a message as grayscale, [height, width], uint8 or uint16.

    Args:
        message: a deserialised Image or CompressedImage.
        where: the message, for messages of errors.

    Raises:
        InputError: the encoding is not known, the message is incomplete, or its image is damaged.
    """
    if hasattr(message, "encoding"):
        return _gray_of_raw(message, where)
    # The format reads "bayer_rggb8; png compressed": the encoding before the compression.
    encoding = ENCODINGS.get(message.format.partition(";")[0].strip())
    gray = decode_gray(np.asarray(message.data).tobytes(), where)
    if encoding is None or encoding.channels > 1 or encoding.to_gray is None:
        return gray
    # A Bayer pattern that was compressed as it is; JPEG is made of its colours.
    return np.asarray(cv2.cvtColor(gray, encoding.to_gray)) if "png" in message.format else gray


def _gray_of_raw(message: Any, where: str) -> AnyArray:
    """Return the image of a sensor_msgs/Image as grayscale.

    Raises:
        InputError: the encoding is not known, or there are fewer bytes than pixels.
    """
    encoding = ENCODINGS.get(message.encoding)
    if encoding is None:
        cure = f"Known are {', '.join(ENCODINGS)}."
        raise InputError(where, f"its encoding is {message.encoding!r}.", cure)

    # A row may be followed by unused bytes, up to the step.
    height = int(message.height)
    row_bytes = int(message.width) * encoding.channels * encoding.bits // 8
    step = int(message.step)
    data = np.asarray(message.data, dtype=np.uint8)
    if row_bytes == 0 or step < row_bytes or len(data) < height * step:
        what = (
            f"it is damaged: {len(data)} bytes for {message.width}×{height} px of"
            f" {message.encoding} with {step} bytes a row."
        )
        raise InputError(where, what, "Record or convert the bag anew.")
    rows = data[: height * step].reshape(height, step)[:, :row_bytes]

    # A copy of its own, because the odometry keeps the image longer than the message lives.
    pixels: AnyArray = np.array(rows, order="C")
    if encoding.bits == 16:
        order = ">" if message.is_bigendian else "<"
        pixels = pixels.view(f"{order}u2").astype(np.uint16)
    if encoding.channels > 1:
        pixels = pixels.reshape(height, -1, encoding.channels)
    if encoding.to_gray is None:
        return pixels
    return np.asarray(cv2.cvtColor(pixels, encoding.to_gray))
