"""OpenCV's stereo calibrations: matrices K, D of both cameras, and R, T between them.

The names are those of OpenCV's sample ``stereo_calib``, which writes ``intrinsics.yml`` and
``extrinsics.yml``, and those of the arguments of ``cv2.stereoCalibrate``.
"""

from __future__ import annotations

from probevo.camera.image_scale import SizePx
from probevo.camera.rectification import DistortionModel, PinholeCamera, without_unused
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.sequences.calibrations.calibration_content import CalibrationContent, load_calibration
from probevo.sequences.calibrations.stereo_calibration import StereoCalibration

LEFT_MATRIX = ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "left_camera_matrix", "K_left")
RIGHT_MATRIX = ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "right_camera_matrix", "K_right")
LEFT_DISTORTION = ("D1", "distCoeffs1", "dist_coeffs_1", "left_distortion_coefficients", "D_left")
RIGHT_DISTORTION = (
    "D2",
    "distCoeffs2",
    "dist_coeffs_2",
    "right_distortion_coefficients",
    "D_right",
)
SIZES = ("imageSize", "image_size", "size", "resolution")
WIDTHS = (("image_width", "image_height"), ("width", "height"))
MODEL = "distortion_model"
"""The key that names the distortion model, which OpenCV's own programs do not write."""
NUM_FISHEYE = 4
"""Coefficients of a fisheye."""
TWO_FILES = {"intrinsics": "extrinsics", "extrinsics": "intrinsics"}
"""The files of OpenCV's sample, each with the other one."""


def is_opencv(content: CalibrationContent) -> bool:
    """Return whether a file looks like OpenCV's, or like one of the two of its sample."""
    return any(key in content for key in LEFT_MATRIX) or ("R" in content and "T" in content)


def read_opencv(content: CalibrationContent, size_px: SizePx | None) -> StereoCalibration:
    """Read the cameras 1 as left and 2 as right: p_right = R p_left + T.

    Rotations and projections for rectification, which the file may hold, are computed anew. A note
    says where nothing tells an ordinary lens from a fisheye.

    Args:
        content: the file, or one of the two files of OpenCV's sample.
        size_px: (width, height) where the file does not tell.

    Raises:
        InputError: a matrix is missing or impossible, or the size is not known.
    """
    content = _with_other_file(content)
    size_px = _size_px(content) or size_px
    if size_px is None:
        what = "it does not have the size of the images."
        raise InputError(content.path, what, "Add image_width and image_height.")
    model = _model(content)
    R = so3.check_rotation(content.matrix("R", 3, 3), content.where("R"))
    T = content.matrix("T", 3, 1)[:, 0]
    left = _pinhole(content, LEFT_MATRIX, LEFT_DISTORTION, model, size_px)
    right = _pinhole(content, RIGHT_MATRIX, RIGHT_DISTORTION, model, size_px)
    return StereoCalibration(
        where=content.path,
        left=left,
        right=right,
        T_right_left=se3.from_parts(R, T),
        notes=_notes_on_model(content),
    )


def _with_other_file(content: CalibrationContent) -> CalibrationContent:
    """Return the content, joined with the other file of OpenCV's sample if there is one.

    Raises:
        InputError: the other file is damaged.
    """
    stem = content.path.stem
    for name, other_name in TWO_FILES.items():
        if not stem.startswith(name):
            continue
        other = content.path.with_name(
            f"{other_name}{stem.removeprefix(name)}{content.path.suffix}"
        )
        if other.exists():
            values = load_calibration(other).values | content.values
            return CalibrationContent(values, content.path)
    return content


def _size_px(content: CalibrationContent) -> SizePx | None:
    """Return (width, height); None if the file does not tell.

    Raises:
        InputError: it is no pair of numbers.
    """
    for key in SIZES:
        if key in content:
            return content.size_px(key)
    for width, height in WIDTHS:
        if width in content:
            return int(content.number(width)), int(content.number(height))
    return None


def _model(content: CalibrationContent) -> DistortionModel:
    """Return the distortion model; without a name it is OpenCV's ordinary one.

    Raises:
        InputError: it is another one.
    """
    if MODEL not in content:
        return "radtan"
    name = content.text(MODEL)
    if name in ("fisheye", "equidistant"):
        return "equidistant"
    if name in ("radtan", "plumb_bob", "rational_polynomial"):
        return "radtan"
    what = f"the model {name!r} is not supported."
    raise InputError(content.where(MODEL), what, "Known are plumb_bob and fisheye.")


def _notes_on_model(content: CalibrationContent) -> tuple[tuple[str, str], ...]:
    """Say that the lenses were taken for ordinary ones, where they may as well be fisheyes.

    Four coefficients are those of ``cv2.fisheye``, or the first four of ``cv2.stereoCalibrate``.
    """
    if MODEL in content:
        return ()
    sides = (LEFT_DISTORTION, RIGHT_DISTORTION)
    distortion = [content.numbers(_first_key(content, keys)) for keys in sides]
    if not any(len(each) == NUM_FISHEYE and each.any() for each in distortion):
        return ()
    text = (
        f"{content.path.name} has four distortion coefficients and no {MODEL}: they are taken for"
        f" those of ordinary lenses. If they are of cv2.fisheye, add the key {MODEL} with the value"
        " fisheye, and else with plumb_bob."
    )
    return (("! calibration", text),)


def _pinhole(
    content: CalibrationContent,
    matrix_keys: tuple[str, ...],
    distortion_keys: tuple[str, ...],
    model: DistortionModel,
    size_px: SizePx,
) -> PinholeCamera:
    """Return a camera for the rectification.

    Raises:
        InputError: a matrix is missing.
    """
    K = content.matrix(_first_key(content, matrix_keys), 3, 3)
    distortion = content.numbers(_first_key(content, distortion_keys))
    return PinholeCamera(
        fu_px=float(K[0, 0]),
        fv_px=float(K[1, 1]),
        cu_px=float(K[0, 2]),
        cv_px=float(K[1, 2]),
        distortion_model=model,
        distortion=tuple(without_unused(distortion).tolist()),
        size_px=size_px,
    )


def _first_key(content: CalibrationContent, keys: tuple[str, ...]) -> str:
    """Return the name under which the file has a matrix.

    Raises:
        InputError: it has it under none.
    """
    for key in keys:
        if key in content:
            return key
    what = f"the matrix {keys[0]} is missing; the keys are {content.keys_text}."
    cure = f"It may also be called {', '.join(keys[1:])}."
    raise InputError(content.path, what, cure)
