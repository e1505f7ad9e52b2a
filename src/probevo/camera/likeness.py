"""Comparison of two cameras: whether a noise model learned with one is valid for the other."""

from __future__ import annotations

from probevo.camera.stereo import StereoCamera

TOLERANCE = 0.1
"""Largest relative difference of two similar cameras. Those of KITTI differ by 2 % from day to day.
"""


def difference_text(camera: StereoCamera, other: StereoCamera, *, owner: str = "its") -> str:
    """Describe the first property in which two cameras differ; return "" if they are similar.

    The resolution matters as much as the lens, since patch sizes and errors are in pixels.

    Args:
        camera: the camera that is described.
        other: the one that it is compared with.
        owner: whose the property is, in the text.
    """
    pairs = {
        "focal length": (camera.fu_px, other.fu_px, "px"),
        "vertical focal length": (camera.fv_px, other.fv_px, "px"),
        "baseline": (camera.baseline_m, other.baseline_m, "m"),
    }
    if camera.size_px and other.size_px:
        pairs["image width"] = (camera.size_px[0], other.size_px[0], "px")
        pairs["image height"] = (camera.size_px[1], other.size_px[1], "px")
    for name, (value, other_value, unit) in pairs.items():
        if abs(value - other_value) > TOLERANCE * max(abs(value), abs(other_value)):
            return f"{owner} {name} is {value:g} {unit}, not {other_value:g} {unit}"
    return ""
