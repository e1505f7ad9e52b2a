"""Our FAST corners are OpenCV's."""

import cv2
import numpy as np
import pytest

from probevo.arrays import Image
from probevo.tracking.fast_corners import CornerGrid, strongest_of_cells

BORDER_PX = 8
PER_CELL = 3


def textures() -> dict[str, Image]:
    """Noise, blobs, few grey levels (many corners as strong as their neighbour), straight edges."""
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (97, 130), dtype=np.uint8)
    blobs = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX)
    squares = np.zeros((150, 200), np.uint8)
    for u, v, side, grey in rng.integers((0, 0, 3, 0), (190, 140, 40, 256), (60, 4)):
        squares[v : v + side, u : u + side] = grey
    return {
        "noise": noise,
        "blobs": blobs.astype(np.uint8),
        "levels": noise // 64 * 60,
        "squares": squares,
    }


def opencv_strengths(image: Image, threshold: int) -> dict[tuple[int, int], int]:
    """Of all OpenCV's corners away from the border: the largest threshold under which each would be
    one."""
    keypoints = cv2.FastFeatureDetector.create(threshold).detect(image)
    corners = {(int(k.pt[0]), int(k.pt[1])): round(k.response) for k in keypoints}
    last_u = image.shape[1] - BORDER_PX - 1
    last_v = image.shape[0] - BORDER_PX - 1
    return {
        (u, v): s
        for (u, v), s in corners.items()
        if BORDER_PX <= u <= last_u and BORDER_PX <= v <= last_v
    }


@pytest.mark.parametrize("threshold", [1, 10, 60])
@pytest.mark.parametrize("cell_px", [31.75, 2.25])  # with the smaller, whole cells are border
@pytest.mark.parametrize("name", textures())
def test_each_cell_holds_the_strongest_of_opencv_in_order(
    name: str, cell_px: float, threshold: int
) -> None:
    image = textures()[name]
    strengths = opencv_strengths(image, threshold)
    rows, columns = (int(np.ceil(side / cell_px)) for side in image.shape)
    grid = CornerGrid(cell_px=cell_px, rows=rows, columns=columns)
    found = strongest_of_cells(
        image, grid, threshold=threshold, per_cell=PER_CELL, border_px=BORDER_PX
    )
    assert strengths
    cells: dict[tuple[float, float], list[tuple[int, int]]] = {}
    for corner in strengths:
        cells.setdefault((corner[1] // cell_px, corner[0] // cell_px), []).append(corner)
    for row in range(rows):
        for column in range(columns):
            inside = cells.get((row, column), [])
            best = sorted(inside, key=lambda corner: (-strengths[corner], corner[1], corner[0]))[
                :PER_CELL
            ]
            of_cell = found[row, column]
            assert [tuple(corner) for corner in of_cell[np.isfinite(of_cell[:, 0])]] == best


@pytest.mark.parametrize("shape", [(1, 1), (16, 200), (17, 17)])
def test_an_image_that_is_hardly_more_than_border_is_no_error(shape: tuple[int, int]) -> None:
    found = strongest_of_cells(
        np.zeros(shape, np.uint8),
        CornerGrid(cell_px=31.75, rows=1, columns=7),
        threshold=10,
        per_cell=PER_CELL,
        border_px=BORDER_PX,
    )
    assert np.isnan(found).all()


def test_a_view_of_an_image_gives_the_corners_of_a_copy() -> None:
    image = textures()["blobs"]
    view = np.repeat(np.repeat(image, 2, axis=0), 2, axis=1)[::2, ::2]
    grid = CornerGrid(cell_px=31.75, rows=4, columns=5)
    first, second = (
        strongest_of_cells(each, grid, threshold=10, per_cell=PER_CELL, border_px=BORDER_PX)
        for each in (image, view)
    )
    np.testing.assert_array_equal(first, second)
