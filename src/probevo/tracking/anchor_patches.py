"""Anchor patches: the windows in which features were first seen, aligned to later images.

A window that is tracked from one frame to the next drifts where it approaches, rotates or is
slanted, since its edges do not move as its centre does; and the drift accumulates along a track. An
alignment with the anchor patch, the window of the first observation, does not drift. Its map is a
plane's: affine, as found in the image, under the perspective that the motion and the slope of the
disparity predict (``surface_motion``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, Image, IntArray, concatenated
from probevo.sequences.prepared_images import NONE_SATURATED, SplineImage
from probevo.tracking.anchor_patches_numba import (
    Anchors,
    PatchAlignment,
    align_patches,
    compose_perspectives,
    cut_patches,
    divide_maps,
    multiply_maps,
)
from probevo.tracking.surface_motion import SurfaceMotion

SIGMA_IN_TIME = 0.03
"""Standard deviation of an affine map's change from frame to frame, beyond what is predicted."""
SIGMA_IN_STEREO = 0.1
"""Standard deviation of the change of the affine map between left and right image."""
MAX_GROWTH = 1.5
"""A patch that has grown or shrunk by more than this is cut anew."""


class AlignedPatches(NamedTuple):
    """The result of aligning the anchor patches of N features with an image."""

    pixels: FloatArray
    """Features (u, v) in the image, [N, 2], px; as predicted where the alignment failed."""
    difference: FloatArray
    """Mean absolute difference of image and patch, [N], grey levels; ∞ where it failed."""
    patches: AnchorPatches
    """The patches with the maps found, and cut anew where the anchor does not hold any more."""
    cov_px2: FloatArray
    """Covariance of the place by the scatter of the brightness, [N, 2, 2], px²; ∞ where image and
    patch have nothing in common, NaN where the alignment failed."""


@dataclass(frozen=True)
class AnchorPatches:
    """Anchor patches of N features: the left image around each, in the frame that first saw it."""

    patch: AnyArray
    """Grey levels around a whole pixel, [N, side + 2, side + 2], uint8; the margin of one pixel is
    for gradients."""
    saturated: AnyArray
    """1 where a pixel of the patch is saturated, else 0, [N, side, side], uint8."""
    offset_px: FloatArray
    """Offset of the feature from that whole pixel, (u, v), [N, 2], px."""
    affine: FloatArray
    """Affine map of each patch to the last left image, about the feature, [N, 2, 2]."""
    perspective: FloatArray
    """Perspective of each patch in the last images, about the feature, [N, 2], 1/px."""
    right_from_left: FloatArray
    """Affine map of the last left image to the last right image, about the feature, [N, 2, 2]."""

    @staticmethod
    def cut(
        left: Image, pixels: FloatArray, side: int, *, saturated: Image = NONE_SATURATED
    ) -> AnchorPatches:
        """Cut patches out of a left image.

        Args:
            left: the image, [height, width], uint8.
            pixels: features (u, v), [N, 2], px.
            side: of the patches, without their margin, px; odd.
            saturated: 1 where a pixel of the image is saturated, else 0, [height, width], uint8;
                empty if none is.
        """
        center = np.round(pixels).astype(np.int64)
        patch = np.empty((len(pixels), side + 2, side + 2), np.uint8)
        cut_patches(left, center, patch)
        is_saturated = np.zeros((len(pixels), side, side), np.uint8)
        if saturated.size:
            cut_patches(saturated, center, is_saturated)
        # Until it is aligned, a right image is assumed to show the same: a surface that faces the
        # camera.
        identity = np.tile(np.eye(2), (len(pixels), 1, 1))
        return AnchorPatches(
            patch=patch,
            saturated=is_saturated,
            offset_px=pixels - center,
            affine=identity,
            perspective=np.zeros((len(pixels), 2)),
            right_from_left=identity,
        )

    def __len__(self) -> int:
        """Return the number of features, N."""
        return len(self.offset_px)

    @property
    def disparity_slope(self) -> FloatArray:
        """Derivatives of the disparity by (u, v) around each feature, [N, 2]."""
        # With u_r = u_l − d, the first row of the map is (1 − ∂d/∂u, −∂d/∂v).
        return np.array([1.0, 0.0]) - self.right_from_left[:, 0]

    def subset(self, keep: BoolArray | IntArray) -> AnchorPatches:
        """Select some features by a mask, [N], or by indices."""
        return AnchorPatches(
            patch=self.patch[keep],
            saturated=self.saturated[keep],
            offset_px=self.offset_px[keep],
            affine=self.affine[keep],
            perspective=self.perspective[keep],
            right_from_left=self.right_from_left[keep],
        )

    def joined(self, others: AnchorPatches) -> AnchorPatches:
        """Append the patches of M other features, [N + M]."""
        return concatenated([self, others])

    def align_left(
        self, left: SplineImage, pixels: FloatArray, motion: SurfaceMotion
    ) -> AlignedPatches:
        """Align the patches with the next left image.

        Where the patch has grown or shrunk too much, a new anchor patch is cut out of this image.

        Args:
            left: the image.
            pixels: predicted features (u, v), [N, 2], px.
            motion: predicted motion of the windows since the previous frame.
        """
        # Bound the predicted magnification: a wrong prediction may have any. A has the growth as a
        # factor, so that the ratio of bounded and predicted growth scales it.
        growth = np.clip(motion.growth, 1 / MAX_GROWTH, MAX_GROWTH)
        growth_ratio = growth / motion.growth
        # Compose the map so far with the predicted motion: anchor → previous → current left image.
        predicted = np.empty((len(self), 2, 2))
        multiply_maps(growth_ratio[:, None, None] * motion.affine, self.affine, predicted)
        perspective = np.empty((len(self), 2))
        compose_perspectives(motion.perspective, self.affine, self.perspective, perspective)
        aligned = self._align(left, pixels, predicted, perspective, sigma=SIGMA_IN_TIME)
        affine = aligned.affine
        # Find the patches that have grown or shrunk too much, by the growth of their area.
        area = affine[:, 0, 0] * affine[:, 1, 1] - affine[:, 0, 1] * affine[:, 1, 0]
        outgrown = (area > MAX_GROWTH**2) | (area < MAX_GROWTH**-2)
        # Replace them by patches of this image, whose map is the identity; drift begins anew there.
        side = self.patch.shape[1] - 2
        fresh = AnchorPatches.cut(
            left.pixels, aligned.pixels[outgrown], side, saturated=left.saturated
        )
        patch = self.patch.copy()
        saturated = self.saturated.copy()
        offset_px = self.offset_px.copy()
        patch[outgrown] = fresh.patch
        saturated[outgrown] = fresh.saturated
        offset_px[outgrown] = fresh.offset_px
        affine[outgrown] = fresh.affine
        perspective[outgrown] = fresh.perspective
        patches = replace(
            self,
            patch=patch,
            saturated=saturated,
            offset_px=offset_px,
            affine=affine,
            perspective=perspective,
        )
        return AlignedPatches(aligned.pixels, aligned.difference, patches, aligned.cov_px2)

    def align_right(self, right: SplineImage, pixels: FloatArray) -> AlignedPatches:
        """Align the patches with the right image of the frame whose left image came last.

        Where the alignment fails, the feature stays at its predicted place, and its map between
        left and right image as it was.

        Args:
            right: the image.
            pixels: predicted features (u, v), [N, 2], px.
        """
        # The map to the right image is that to the left one, then from left to right, which hardly
        # changes from frame to frame: the angle between both views of a surface stays.
        predicted = np.empty((len(self), 2, 2))
        multiply_maps(self.right_from_left, self.affine, predicted)
        # Both images have the same depths, and so the same perspective.
        aligned = self._align(right, pixels, predicted, self.perspective, sigma=SIGMA_IN_STEREO)
        right_from_left = self.right_from_left.copy()
        divide_maps(aligned.affine, self.affine, aligned.difference, right_from_left)
        patches = replace(self, right_from_left=right_from_left)
        return AlignedPatches(aligned.pixels, aligned.difference, patches, aligned.cov_px2)

    def _align(
        self,
        image: SplineImage,
        pixels: FloatArray,
        predicted_affine: FloatArray,
        perspective: FloatArray,
        *,
        sigma: float,
    ) -> PatchAlignment:
        anchors = Anchors(
            patch=self.patch,
            saturated=self.saturated,
            offset_px=self.offset_px,
            predicted_affine=predicted_affine,
            perspective=perspective,
        )
        alignment = PatchAlignment(
            pixels=pixels.copy(),
            affine=np.empty((len(self), 2, 2)),
            difference=np.empty(len(self)),
            cov_px2=np.empty((len(self), 2, 2)),
        )
        align_patches(image.coefficients, image.saturated, anchors, sigma, alignment)
        return alignment
