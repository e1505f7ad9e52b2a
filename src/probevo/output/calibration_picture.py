"""The picture of ``probevo calibrate-check``: errors of a rectified pair, drawn over the image."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from probevo.arrays import FloatArray
from probevo.camera.distortion_field import (
    DISPARITY_MODES,
    DISPLACEMENT_MODES,
    image_plane,
    modes_at,
    root_mean_square_px,
)
from probevo.camera.image_errors import NUM_ERRORS
from probevo.camera.rig_calibration import RigCalibration, disparity_basis, row_basis
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.evaluation.calibration_quantities import Quantity
from probevo.output.svg import BAND, BLUE, GREY, ORANGE, figure_style
from probevo.storage.files import check_folder, write_atomically

UNDATED = {".png": {"Software": None}, ".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
"""Formats by the ending of the file, and what keeps a date out of each: same input, same bytes."""
SAMPLES = 60
"""Places along each axis of the image at which the errors are drawn."""
MIN_SCALE_PX = 0.5
"""Row offset at which the colours end, if none is larger."""
ARROW_COLUMNS = 22
"""Arrows across the image that show the distortion field."""
ARROW_ROWS = 8
"""Arrows down the image."""
DPI = 150


def check_picture_path(path: Path) -> None:
    """Refuse a file that is no picture or cannot be written; nothing is created.

    Raises:
        InputError: its ending is none of ``UNDATED``, it is a folder, or its folder is not
            writable.
    """
    if path.suffix.lower() not in UNDATED:
        raise InputError(
            "--out",
            f"{path.name} is not a picture format that can be written.",
            f"Let it end in one of {', '.join(UNDATED)}.",
        )
    if path.is_dir():
        raise InputError("--out", f"{path} is a folder.", "Name a file in it.")
    check_folder(path.parent, "--out")


def write_calibration_picture(
    path: Path,
    rig: RigCalibration,
    quantities: Sequence[Quantity],
    *,
    marked: Sequence[Quantity],
    camera: StereoCamera,
    largest_z: float,
) -> None:
    """Write the picture, in the format of the file's ending.

    Args:
        path: the file.
        rig: self-calibration at the end of the recording.
        quantities: what was tested.
        marked: those of them that are further from zero than chance would have it.
        camera: the rectified camera.
        largest_z: distance from zero, in σ, up to which chance may take a quantity whose σ is
            known exactly.

    Raises:
        InputError: the ending is none of ``UNDATED``, or the file cannot be written.
    """
    check_picture_path(path)
    with figure_style():
        figure = Figure(figsize=(9.0, 6.2 + 0.16 * len(quantities)))
        heights = (3.0, 2.6, 0.16 * len(quantities) + 0.4)
        grid = figure.add_gridspec(3, 2, height_ratios=heights)
        _draw_rows(figure.add_subplot(grid[0, 0]), rig, camera)
        _draw_disparity(figure.add_subplot(grid[0, 1]), rig, camera)
        _draw_distortion(figure.add_subplot(grid[1, :]), rig, camera)
        _draw_quantities(figure.add_subplot(grid[2, :]), quantities, marked, largest_z)
        ending = path.suffix.lower()
        buffer = io.BytesIO()
        figure.savefig(
            buffer, format=ending[1:], dpi=DPI, facecolor="white", metadata=UNDATED[ending]
        )
    write_atomically(path, buffer.getvalue())


def _draw_rows(axes: Axes, rig: RigCalibration, camera: StereoCamera) -> None:
    """Draw by how much the row of a point differs between the images, over the left one."""
    width_px, height_px = image_plane(camera)
    u, v = np.meshgrid(np.linspace(0.0, width_px, SAMPLES), np.linspace(0.0, height_px, SAMPLES))
    offset_px = row_basis(_far_points(u.ravel(), v.ravel()), camera) @ rig.rows
    most_px = max(MIN_SCALE_PX, float(np.abs(offset_px).max()))
    drawn = axes.imshow(
        offset_px.reshape(u.shape),
        extent=(0.0, width_px, height_px, 0.0),
        cmap="RdBu_r",
        vmin=-most_px,
        vmax=most_px,
        aspect="auto",
        interpolation="bilinear",
    )
    axes.grid(visible=False)
    axes.figure.colorbar(drawn, ax=axes)
    axes.set_title("Row of the right image minus row of the left one, px")
    axes.set_xlabel("u, px")
    axes.set_ylabel("v, px")


def _draw_disparity(axes: Axes, rig: RigCalibration, camera: StereoCamera) -> None:
    """Draw by how much true disparities are larger than measured ones, over the image's width."""
    width_px = image_plane(camera).width
    u = np.linspace(0.0, width_px, SAMPLES)
    pixels = _far_points(u, np.full(SAMPLES, camera.cv_px))
    # The parabola, whose constant is not estimated from two frames, and the field's own modes.
    errors = rig.image
    basis = np.zeros((SAMPLES, NUM_ERRORS))
    basis[:, :2] = disparity_basis(pixels, camera)[:, 1:]
    basis[:, -len(DISPARITY_MODES) :] = modes_at(pixels, camera)[:, DISPARITY_MODES]
    error_px = basis @ errors.mean
    sigma_px = np.sqrt(np.einsum("ni,ij,nj->n", basis, errors.cov, basis))
    axes.fill_between(u, error_px - 3.0 * sigma_px, error_px + 3.0 * sigma_px, color=BAND)
    axes.plot(u, error_px, color=BLUE)
    axes.axhline(0.0, color=GREY, linewidth=0.7)
    axes.set_title("Disparity, true minus measured, with ± 3σ")
    axes.set_xlabel("u, px")
    axes.set_ylabel("px")


def _draw_distortion(axes: Axes, rig: RigCalibration, camera: StereoCamera) -> None:
    """Draw how far both views of a point have to be moved, as arrows over the left image."""
    width_px, height_px = image_plane(camera)
    u, v = np.meshgrid(
        np.linspace(0.0, width_px, ARROW_COLUMNS), np.linspace(0.0, height_px, ARROW_ROWS)
    )
    modes = modes_at(_far_points(u.ravel(), v.ravel()), camera)[:, DISPLACEMENT_MODES]
    coefficients_u, coefficients_v = rig.image.distortion[: 2 * len(DISPLACEMENT_MODES)].reshape(
        2, -1
    )
    moved_u = modes @ coefficients_u
    moved_v = modes @ coefficients_v
    longest_px = max(MIN_SCALE_PX, float(np.hypot(moved_u, moved_v).max()))
    # The longest arrow is as long as two of them are apart. Image rows count downwards.
    arrows = axes.quiver(
        u.ravel(),
        v.ravel(),
        moved_u,
        -moved_v,
        color=BLUE,
        scale=longest_px * ARROW_COLUMNS / 2.0,
        scale_units="width",
        width=0.0018,
    )
    axes.quiverkey(arrows, 0.94, 1.08, MIN_SCALE_PX, f"{MIN_SCALE_PX:g} px", labelpos="E")
    axes.set_xlim(-0.03 * width_px, 1.03 * width_px)
    axes.set_ylim(1.08 * height_px, -0.08 * height_px)
    axes.grid(visible=False)
    common_px, _ = root_mean_square_px(rig.image.distortion)
    axes.set_title(f"What the lenses' distortion has left in both images, {common_px:.2f} px rms")
    axes.set_xlabel("u, px")
    axes.set_ylabel("v, px")


def _draw_quantities(
    axes: Axes, quantities: Sequence[Quantity], marked: Sequence[Quantity], largest_z: float
) -> None:
    """Draw how far each quantity is from zero, in σ; the marked ones in another colour."""
    z = np.array([quantity.z for quantity in quantities])
    places = np.arange(len(quantities))[::-1]
    # Far beyond chance it does not matter how far.
    shown = np.clip(z, -4.0 * largest_z, 4.0 * largest_z)
    colors = [ORANGE if quantity in marked else BLUE for quantity in quantities]
    axes.axvspan(-largest_z, largest_z, color=BAND, alpha=0.6, linewidth=0.0)
    axes.barh(places, shown, height=0.6, color=colors)
    for place, length, distance in zip(places, shown, z, strict=True):
        if length != distance:
            side = "right" if length > 0.0 else "left"
            axes.text(length, place, f"{distance:.0f} ", ha=side, va="center", fontsize=7.0)
    axes.set_yticks(places, [quantity.name for quantity in quantities], fontsize=7.5)
    axes.set_xlim(-4.2 * largest_z, 4.2 * largest_z)
    axes.grid(visible=False, axis="y")
    axes.set_title("Distance from zero, in σ; what is hardly chance is orange")


def _far_points(u_px: FloatArray, v_px: FloatArray) -> FloatArray:
    """Return the observations of points without disparity, [N, 4], px."""
    return np.column_stack([u_px, v_px, u_px, v_px])
