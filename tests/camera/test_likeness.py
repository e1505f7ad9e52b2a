"""Whether two cameras are alike: within a tenth, either way round, in all that a model may have
learned from."""

from dataclasses import replace

import pytest

from probevo.camera.likeness import TOLERANCE, difference_text
from probevo.camera.stereo import StereoCamera
from worlds import CAMERA

PROPERTIES = [
    ("fu_px", "focal length", "px"),
    ("fv_px", "vertical focal length", "px"),
    ("baseline_m", "baseline", "m"),
]


def scaled(name: str, factor: float) -> StereoCamera:
    return replace(CAMERA, **{name: factor * getattr(CAMERA, name)})


def test_a_camera_is_like_itself() -> None:
    assert difference_text(CAMERA, CAMERA) == ""


@pytest.mark.parametrize(("name", "words", "unit"), PROPERTIES)
@pytest.mark.parametrize("factor", [1.0 - 1.1 * TOLERANCE, 1.0 / (1.0 - 1.1 * TOLERANCE), 2.0])
def test_a_property_that_is_off_by_more_is_said(
    name: str, words: str, unit: str, factor: float
) -> None:
    other = scaled(name, factor)
    expected = (
        f"its {words} is {getattr(other, name):g} {unit}, not {getattr(CAMERA, name):g} {unit}"
    )
    assert difference_text(other, CAMERA) == expected


@pytest.mark.parametrize(("name", "words", "unit"), PROPERTIES)
@pytest.mark.parametrize("factor", [0.91, 0.98, 1.02, 1.09])
def test_small_differences_are_none(name: str, words: str, unit: str, factor: float) -> None:
    assert (
        difference_text(scaled(name, factor), CAMERA)
        == difference_text(CAMERA, scaled(name, factor))
        == ""
    )


def test_it_does_not_matter_which_is_which() -> None:
    for factor in (0.5, 0.89, 0.899, 0.901, 0.95, 1.05, 1.09, 1.11, 1.12, 3.0):
        other = scaled("baseline_m", factor)
        assert bool(difference_text(other, CAMERA)) == bool(difference_text(CAMERA, other))


def test_where_the_axes_meet_the_image_is_no_matter() -> None:
    assert (
        difference_text(replace(CAMERA, cu_px=0.5 * CAMERA.cu_px, cv_px=2.0 * CAMERA.cv_px), CAMERA)
        == ""
    )


@pytest.mark.parametrize(
    ("size_px", "what"),
    [
        ((640, 370), "its image width is 640 px, not 1226 px"),
        ((1226, 480), "its image height is 480 px, not 370 px"),
    ],
)
def test_the_resolution_matters_where_both_are_known(size_px: tuple[int, int], what: str) -> None:
    other = replace(CAMERA, size_px=size_px)
    assert difference_text(other, CAMERA) == what
    assert difference_text(replace(other, size_px=None), CAMERA) == ""
    assert difference_text(other, replace(CAMERA, size_px=None)) == ""


def test_the_first_difference_is_said() -> None:
    assert "focal length" in difference_text(
        StereoCamera(100.0, 100.0, 50.0, cv_px=50.0, baseline_m=0.1, size_px=(100, 100)), CAMERA
    )
