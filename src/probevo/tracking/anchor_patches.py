"""How features looked when they were first seen, and where an image shows that again.

From one frame to the next a window seems to slip where it comes nearer, turns or slants, since its
edges do not move as its middle does; and what slips is added up along a track. Fitted by an affine
map to the first sight, it does not.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, Image, IntArray
from probevo.tracking.anchor_patches_numba import apply, cut_windows, fit, undo

TIME_SPREAD = 0.03
STEREO_SPREAD = 0.1
"""How far an affine map changes from frame to frame beyond its scale; how far from the left to the
right image."""
MAX_GROWTH = 1.5
"""A window that has grown or shrunk by more than this is cut anew."""


@dataclass(frozen=True)
class Windows:
    """Windows of N features: the part of the left image around each, in the frame that saw it
    first."""

    first_sight: AnyArray
    """[N, side + 2, side + 2], uint8, around a whole pixel."""
    offset: FloatArray
    """Of the feature from that pixel, [N, 2], px."""
    affine: FloatArray
    """What the window has become in the last left image, [N, 2, 2]."""
    slant: FloatArray
    """What the last left image becomes in the last right image, about each feature, [N, 2, 2]."""

    @staticmethod
    def cut(left: Image, pixels: FloatArray, side: int) -> Windows:
        """Windows around features seen at (u, v), [N, 2], px, of a left image."""
        center = np.round(pixels).astype(np.int64)
        first_sight = np.empty((len(pixels), side + 2, side + 2), np.uint8)
        cut_windows(left, center, first_sight)
        as_it_is = np.tile(np.eye(2), (len(pixels), 1, 1))
        return Windows(first_sight, pixels - center, as_it_is, slant=as_it_is)

    def __len__(self) -> int:
        """Number of features, N."""
        return len(self.offset)

    def kept(self, keep: BoolArray | IntArray) -> Windows:
        """Only those of these features: a mask [N], or indices."""
        return Windows(*(getattr(self, each.name)[keep] for each in fields(self)))

    def joined(self, others: Windows) -> Windows:
        """These and the others, [N + M]."""
        return Windows(
            *(
                np.concatenate([getattr(w, each.name) for w in (self, others)])
                for each in fields(self)
            )
        )

    def found_in_left(
        self, left: Image, pixels: FloatArray, growth: FloatArray
    ) -> tuple[FloatArray, FloatArray, Windows]:
        """Where the next left image has the features, how different they look there, and their
        windows now.

        Where the first sight does not fit any more, the feature stays where it was thought to be
        and is cut anew.

        Args:
            left: the image.
            pixels: about where, (u, v), [N, 2], px.
            growth: of the distance of two points of a surface that faces the camera, since the
                frame before, [N].

        Returns:
            (u, v), [N, 2], px; mean absolute difference from the first sight, [N], grey levels,
            infinite where that does not fit; the windows.
        """
        grown = np.clip(growth, 1 / MAX_GROWTH, MAX_GROWTH)[:, None, None] * self.affine
        found_px, affine, difference = self._fitted(left, pixels, grown, spread=TIME_SPREAD)
        area = affine[:, 0, 0] * affine[:, 1, 1] - affine[:, 0, 1] * affine[:, 1, 0]
        anew = ~np.isfinite(difference) | (area > MAX_GROWTH**2) | (area < MAX_GROWTH**-2)
        fresh = Windows.cut(left, found_px[anew], self.first_sight.shape[1] - 2)
        now = replace(
            self, first_sight=self.first_sight.copy(), offset=self.offset.copy(), affine=affine
        )
        now.first_sight[anew] = fresh.first_sight
        now.offset[anew] = fresh.offset
        now.affine[anew] = fresh.affine
        return found_px, difference, now

    def found_in_right(
        self, right: Image, pixels: FloatArray
    ) -> tuple[FloatArray, FloatArray, Windows]:
        """The same in the right image; features that do not fit stay where they were thought to be.

        Args:
            right: the image.
            pixels: about where, (u, v), [N, 2], px.
        """
        expected = np.empty((len(self), 2, 2))
        slant = self.slant.copy()
        apply(self.slant, self.affine, expected)
        found_px, affine, difference = self._fitted(right, pixels, expected, spread=STEREO_SPREAD)
        undo(affine, self.affine, difference, maps=slant)
        return found_px, difference, replace(self, slant=slant)

    def _fitted(
        self, image: Image, pixels: FloatArray, expected: FloatArray, spread: float
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        found_px = pixels.copy()
        affine = np.empty((len(self), 2, 2))
        difference = np.empty(len(self))
        fit(
            image,
            self.first_sight,
            self.offset,
            expected=expected,
            spread=spread,
            pixels=found_px,
            affine=affine,
            difference=difference,
        )
        return found_px, affine, difference
