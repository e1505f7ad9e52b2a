"""Calibrations of images that were scaled to another size after they had been calibrated."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from probevo.errors import InputError

SizePx = tuple[int, int]
"""Width and height of images."""
ROUNDING_PX = 1.0
"""How far a side may be from what the scale of the other one makes of it: sizes are whole pixels,
and some tools cut the fraction off."""


@dataclass(frozen=True)
class ImageScale:
    """How places and focal lengths change where images are scaled."""

    along_u: float
    along_v: float

    @staticmethod
    def between(calibrated_px: SizePx, size_px: SizePx, where: str | Path) -> ImageScale:
        """Return the scale between two sizes of the same images.

        Args:
            calibrated_px: (width, height) that they were calibrated with.
            size_px: (width, height) that they have now.
            where: the calibration, for the message.

        Raises:
            InputError: their aspect ratios differ, so that these are other images, or cropped.
        """
        along_u = size_px[0] / calibrated_px[0]
        along_v = size_px[1] / calibrated_px[1]
        differs = abs(along_u - along_v)
        if differs * calibrated_px[0] > ROUNDING_PX and differs * calibrated_px[1] > ROUNDING_PX:
            what = (
                f"it is for images of {calibrated_px[0]}×{calibrated_px[1]} px; these, of"
                f" {size_px[0]}×{size_px[1]} px, have a different aspect ratio."
            )
            raise InputError(where, what, "Scaling keeps it: were these images cropped?")
        return ImageScale(along_u, along_v)

    def place(self, u_px: float, v_px: float) -> tuple[float, float]:
        """Return where a point of the image lies in the scaled one, px.

        Pixel (0, 0) has its centre at the origin, so that the corner of the image, which stays
        where it is, lies at −½.
        """
        return (u_px + 0.5) * self.along_u - 0.5, (v_px + 0.5) * self.along_v - 0.5

    def intrinsics(self, fu_px: float, fv_px: float, cu_px: float, cv_px: float) -> dict[str, Any]:
        """Return focal lengths and principal point of the scaled image by their names, px."""
        cu_scaled_px, cv_scaled_px = self.place(cu_px, cv_px)
        return {
            "fu_px": fu_px * self.along_u,
            "fv_px": fv_px * self.along_v,
            "cu_px": cu_scaled_px,
            "cv_px": cv_scaled_px,
        }
