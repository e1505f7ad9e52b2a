"""The content of a calibration file: its keys, numbers and matrices; every error names the key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from probevo.arrays import FloatArray
from probevo.errors import InputError, brief
from probevo.geometry import se3
from probevo.sequences.text import read_text
from probevo.sequences.yaml_file import NoKeyTwice, load_yaml

MAX_NUMBER = 1e300
MAX_KEYS = 8
"""Keys of a file of no known kind that its message lists."""
_CURE = "Name a calibration of both cameras, as of Kalibr or OpenCV: see docs/recordings.md."


class CalibrationContent:
    """A mapping of a calibration file, or a section of one."""

    def __init__(self, values: dict[str, Any], path: Path, section: str = "") -> None:
        self.values = values
        self.path = path
        self.section = section

    def __contains__(self, key: str) -> bool:
        """Return whether there is such a key."""
        return key in self.values

    @property
    def keys_text(self) -> str:
        """The first keys, for messages."""
        keys = [str(key) for key in self.values]
        more = ", …" if len(keys) > MAX_KEYS else ""
        return ", ".join(keys[:MAX_KEYS]) + more

    def where(self, key: str = "") -> str:
        """Return the file and the key, for messages."""
        name = ".".join(part for part in (self.section, key) if part)
        return f"{self.path}: {name}" if name else str(self.path)

    def value(self, key: str) -> Any:
        """Return the value of a key.

        Raises:
            InputError: there is no such key.
        """
        if key not in self.values:
            raise InputError(self.path, f"the key {self.where(key).split(': ')[-1]} is missing.")
        return self.values[key]

    def inner(self, key: str) -> CalibrationContent:
        """Return a section.

        Raises:
            InputError: there is no such key, or it is no section.
        """
        values = self.value(key)
        if not isinstance(values, dict):
            raise InputError(self.where(key), "is not a section of `key: value` lines.")
        return CalibrationContent(values, self.path, key)

    def text(self, key: str) -> str:
        """Return a value as text.

        Raises:
            InputError: there is no such key.
        """
        return str(self.value(key))

    def number(self, key: str) -> float:
        """Return a finite number.

        Raises:
            InputError: there is no such key, or its value is no finite number.
        """
        value = self.value(key)
        if isinstance(value, str):  # YAML 1.1 takes 1e-5, without a point, for text
            value = _number_of_text(value)
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not abs(value) <= MAX_NUMBER:
            raise InputError(self.where(key), f"is {brief(value)}; expected a finite number.")
        return float(value)

    def numbers(self, key: str) -> FloatArray:
        """Return a list or matrix of finite numbers in one row, however it is written.

        Raises:
            InputError: there is no such key, or a value is no finite number.
        """
        value = self.value(key)
        if isinstance(value, dict):  # ROS writes rows, cols and data
            value = value.get("data", value)
        try:
            numbers = np.array(value, dtype=float).ravel()
        except (TypeError, ValueError, OverflowError):
            raise InputError(self.where(key), "is not a list of numbers.") from None
        if not np.isfinite(numbers).all():
            raise InputError(self.where(key), "has a number that is not finite.")
        return numbers

    def matrix(self, key: str, rows: int, cols: int) -> FloatArray:
        """Return a matrix, [rows, cols].

        Raises:
            InputError: there is no such key, or it has another number of entries.
        """
        numbers = self.numbers(key)
        if len(numbers) != rows * cols:
            what = f"has {len(numbers)} numbers; expected {rows}×{cols}."
            raise InputError(self.where(key), what)
        return numbers.reshape(rows, cols)

    def transform(self, key: str) -> FloatArray:
        """Return a rigid transform, [4, 4].

        Raises:
            InputError: there is no such key, or it is no rigid transform.
        """
        return se3.check_transform(self.matrix(key, 4, 4), self.where(key))

    def size_px(self, key: str) -> tuple[int, int]:
        """Return width and height.

        Raises:
            InputError: there is no such key, or it has another number of entries.
        """
        width, height = self.matrix(key, 1, 2)[0]
        return int(width), int(height)


def _number_of_text(text: str) -> float | str:
    """Return the number that a text holds; the text itself if it holds none."""
    try:
        return float(text)
    except ValueError:
        return text


def load_calibration(path: Path) -> CalibrationContent:
    """Read a calibration file: YAML, also as OpenCV writes it, or OpenCV's XML.

    Raises:
        InputError: the file is missing, is neither, or holds no ``key: value`` lines.
    """
    if path.suffix.lower() == ".xml":
        return CalibrationContent(_read_xml(path), path)
    content = load_yaml(path, _CURE, loader=_OpenCVLoader)
    if not isinstance(content, dict):
        raise InputError(path, "this is not a calibration: it has no `key: value` lines.")
    return CalibrationContent(content, path)


class _OpenCVLoader(NoKeyTwice):
    """A loader that knows the matrices of OpenCV."""


def _opencv_matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> Any:
    """Return the numbers of a matrix, row by row."""
    return loader.construct_mapping(node, deep=True).get("data")


for _kind in ("opencv-matrix", "opencv-nd-matrix"):  # the second for vectors, by OpenCV 5
    _OpenCVLoader.add_constructor(f"tag:yaml.org,2002:{_kind}", _opencv_matrix)


def _read_xml(path: Path) -> dict[str, Any]:
    """Read the numbers, texts and matrices of a file that OpenCV wrote as XML.

    Raises:
        InputError: the file is missing, or not as OpenCV writes them.
    """
    text = read_text(path, _CURE)
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        nodes = {key: root.getNode(key) for key in root.keys()}  # noqa: SIM118 (no dict)
        return {key: _node_value(node) for key, node in nodes.items()}
    except (cv2.error, SystemError) as error:
        raise InputError(path, "this is not an XML file as OpenCV writes them.") from error


def _node_value(node: Any) -> Any:
    """Return the value of a node: a number, a text, a list of numbers, or a matrix row by row."""
    if node.isReal() or node.isInt():
        return node.real()
    if node.isString():
        return node.string()
    if node.isMap():
        matrix = node.mat()
        return None if matrix is None else matrix.ravel().tolist()
    return [node.at(index).real() for index in range(node.size())]
