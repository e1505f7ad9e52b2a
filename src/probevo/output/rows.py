"""An array that grows row by row, for what a run keeps of each frame."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, DTypeLike


class Rows:
    """An array that grows by rows, in blocks that are never moved.

    An array that is copied to grow would fragment the memory of a long run.

    Args:
        dtype: type of its elements; structured for rows with named fields.
        shape: shape of a row.
        zeros: rows of zeros to begin with.
    """

    BLOCK = 1024
    """Rows of a block."""

    def __init__(self, dtype: DTypeLike, shape: tuple[int, ...] = (), zeros: int = 0) -> None:
        self._blocks = [
            np.zeros((self.BLOCK, *shape), dtype) for _ in range(1 + zeros // self.BLOCK)
        ]
        self._len = zeros

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._len

    def add(self, row: ArrayLike) -> None:
        """Append a row, of the shape and the type of all rows."""
        if self._len == self.BLOCK * len(self._blocks):
            self._blocks.append(np.zeros_like(self._blocks[0]))
        self._blocks[-1][self._len % self.BLOCK] = row
        self._len += 1

    def table(self) -> Any:
        """Copy all rows, [len, *shape]."""
        return np.concatenate(self._blocks)[: self._len]
