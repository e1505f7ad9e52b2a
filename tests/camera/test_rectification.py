from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from probevo.arrays import FloatArray, Image
from probevo.camera.rectification import PinholeCamera, Rectification
from probevo.errors import InputError
from probevo.geometry import se3, so3

RADTAN = (
    PinholeCamera(
        458.7,
        457.3,
        367.2,
        cv_px=248.4,
        distortion_model="radtan",
        distortion=(-0.283, 0.074, 2e-4, 2e-5),
        size_px=(752, 480),
    ),
    PinholeCamera(
        457.6,
        456.1,
        380.0,
        cv_px=255.2,
        distortion_model="radtan",
        distortion=(-0.284, 0.075, -1e-4, -4e-5, 1e-3),
        size_px=(752, 480),
    ),
)
EQUIDISTANT = (
    PinholeCamera(
        190.9,
        191.0,
        254.9,
        cv_px=256.9,
        distortion_model="equidistant",
        distortion=(0.0035, 0.0007, -0.002, 0.0002),
        size_px=(512, 512),
    ),
    PinholeCamera(
        190.4,
        190.4,
        252.5,
        cv_px=255.0,
        distortion_model="equidistant",
        distortion=(0.0034, 0.0018, -0.0027, 0.0003),
        size_px=(512, 512),
    ),
)
T_RIGHT_LEFT = se3.from_parts(
    so3.exp(np.array([0.007, -0.015, 0.014])), np.array([-0.11, 0.002, -0.001])
)

DATA = Path(os.environ.get("PROBEVO_DATA", Path(__file__).parents[3] / "shared" / "data"))
EUROC = DATA / "euroc" / "V1_01_micro" / "mav0"

pairs = pytest.mark.parametrize("pair", [RADTAN, EQUIDISTANT], ids=["radtan", "equidistant"])


def raw_projection(camera: PinholeCamera, points: FloatArray) -> FloatArray:
    """Pixels, [N, 2], of points in the camera's frame, [N, 3], by OpenCV's distortion models."""
    no_motion = np.zeros(3)
    project = (
        cv2.projectPoints if camera.distortion_model == "radtan" else cv2.fisheye.projectPoints
    )
    arguments = (no_motion, no_motion, camera.matrix, np.array(camera.distortion))
    return project(points[:, None, :], *arguments)[0][:, 0]


def draw_blob(camera: PinholeCamera, pixel: FloatArray) -> Image:
    u, v = np.meshgrid(np.arange(camera.size_px[0]), np.arange(camera.size_px[1]))
    return np.round(
        250.0 * np.exp(-((u - pixel[0]) ** 2 + (v - pixel[1]) ** 2) / (2.0 * 3.0**2))
    ).astype(np.uint8)


def centroid(image: Image) -> FloatArray:
    v, u = np.indices(image.shape)
    return np.array([np.average(u, weights=image), np.average(v, weights=image)])


@pairs
def test_blobs_land_where_the_rectified_camera_projects_them(
    pair: tuple[PinholeCamera, PinholeCamera],
) -> None:
    """Points drawn in the raw images through the distortion: rectified, they are where y = f(p)
    says, to 0.1 px."""
    left, right = pair
    rectification = Rectification.from_calibration(left, right, T_RIGHT_LEFT)
    rng = np.random.default_rng(0)
    points_rect = np.column_stack(
        [rng.uniform(-1.5, 1.5, 12), rng.uniform(-1.0, 1.0, 12), rng.uniform(3.0, 6.0, 12)]
    )
    points_left = points_rect @ rectification.C_rect_left
    raw_left = raw_projection(left, points_left)
    raw_right = raw_projection(right, se3.transform(T_RIGHT_LEFT, points_left))
    for expected, in_left, in_right in zip(
        rectification.camera.project(points_rect), raw_left, raw_right, strict=True
    ):
        rectified = rectification.rectify(draw_blob(left, in_left), draw_blob(right, in_right))
        seen = np.concatenate([centroid(image) for image in rectified])
        np.testing.assert_allclose(seen, expected, atol=0.1)


@pairs
def test_every_rectified_pixel_lies_inside_the_raw_image(
    pair: tuple[PinholeCamera, PinholeCamera],
) -> None:
    rectification = Rectification.from_calibration(*pair, T_RIGHT_LEFT)
    white = np.full(pair[0].size_px[::-1], 255, np.uint8)
    for image in rectification.rectify(white, white):
        assert np.mean(image == 255) > 0.995


@pairs
def test_images_without_black_areas_have_no_mask(pair: tuple[PinholeCamera, PinholeCamera]) -> None:
    rectification = Rectification.from_calibration(*pair, T_RIGHT_LEFT)
    assert rectification.left_mask is None
    assert rectification.right_mask is None


def test_what_lies_outside_of_the_raw_image_is_masked() -> None:
    """A fisheye pair whose cameras look inwards by 10° each keeps its focal length."""
    left, right = (dataclasses.replace(camera, fu_px=500.0, fv_px=500.0) for camera in EQUIDISTANT)
    inwards = se3.from_parts(so3.exp(np.array([0.0, np.deg2rad(20.0), 0.0])), np.zeros(3))
    inwards[:3, 3] = -inwards[:3, :3] @ [0.1 * np.cos(0.17), 0.0, 0.1 * np.sin(0.17)]
    rectification = Rectification.from_calibration(left, right, inwards)
    rng = np.random.default_rng(0)
    raw = rng.integers(1, 256, size=left.size_px[::-1]).astype(np.uint8)
    images = rectification.rectify(raw, raw)
    masks = (rectification.left_mask, rectification.right_mask)
    for image, mask in zip(images, masks, strict=True):
        assert mask is not None
        assert 0.02 < np.mean(mask == 0) < 0.5
        assert set(np.unique(mask)) == {0, 255}
        assert (image[mask == 255] > 0).all()
        # But for the line between both, which is partly masked.
        assert np.mean(image[mask == 0] == 0) > 0.95


@pairs
def test_rectification_keeps_the_baseline(pair: tuple[PinholeCamera, PinholeCamera]) -> None:
    camera = Rectification.from_calibration(*pair, T_RIGHT_LEFT).camera
    assert camera.baseline_m == pytest.approx(np.linalg.norm(T_RIGHT_LEFT[:3, 3]), rel=1e-9)
    assert camera.size_px == pair[0].size_px


def test_the_rectified_x_axis_points_at_the_right_camera() -> None:
    rectification = Rectification.from_calibration(*RADTAN, T_RIGHT_LEFT)
    right_in_left = se3.inverse(T_RIGHT_LEFT)[:3, 3]
    expected = [rectification.camera.baseline_m, 0.0, 0.0]
    np.testing.assert_allclose(rectification.C_rect_left @ right_in_left, expected, atol=1e-9)


def test_an_ideal_pair_stays_as_it_is() -> None:
    ideal = PinholeCamera(
        400.0,
        400.0,
        319.5,
        cv_px=239.5,
        distortion_model="radtan",
        distortion=(0.0, 0.0, 0.0, 0.0),
        size_px=(640, 480),
    )
    T_right_left = se3.from_parts(np.eye(3), np.array([-0.2, 0.0, 0.0]))
    rectification = Rectification.from_calibration(ideal, ideal, T_right_left)
    camera = rectification.camera
    np.testing.assert_allclose(rectification.C_rect_left, np.eye(3), atol=1e-12)
    np.testing.assert_allclose([camera.fu_px, camera.fv_px], 400.0, rtol=5e-3)
    np.testing.assert_allclose([camera.cu_px, camera.cv_px], [319.5, 239.5], atol=1.0)


def shifted(t: list[float]) -> FloatArray:
    return se3.from_parts(np.eye(3), np.array(t))


def turned(angle_rad: float) -> FloatArray:
    return se3.from_parts(so3.exp(np.array([0.0, angle_rad, 0.0])), np.array([-0.1, 0.0, 0.0]))


def rolled(angle_deg: float) -> FloatArray:
    """Return T_right_left of a right camera beside the left one, turned about its optical axis."""
    C_right_left = so3.exp(np.array([0.0, 0.0, np.deg2rad(angle_deg)]))
    return se3.from_parts(C_right_left, C_right_left @ np.array([-0.1, 0.0, 0.0]))


@pytest.mark.parametrize(
    ("right", "T_right_left", "message"),
    [
        (RADTAN[1], shifted([0.0, 0.0, 0.0]), "the same file"),
        (RADTAN[1], shifted([0.1, 0.0, 0.0]), "swapped"),
        (RADTAN[1], shifted([0.0, -0.1, 0.0]), r"below the left one(.|\n)*90° anticlockwise, and"),
        (RADTAN[1], shifted([0.01, 0.1, 0.0]), r"above the left one(.|\n)*90° clockwise, and"),
        (RADTAN[1], shifted([0.1, 0.1001, 0.0]), r"inclined by 45°(.|\n)*mount them so"),
        (RADTAN[1], rolled(180.0), r"by 180° about its optical axis .*\n *Turn its images by 180°"),
        (RADTAN[1], rolled(-178.0), r"by 178° about its optical axis .*\n *Turn its images by 180"),
        (RADTAN[1], shifted([np.nan, 0.0, 0.0]), "not finite"),
        (RADTAN[1], shifted([-0.1, 0.0, 0.0]) * [2.0, 2.0, 2.0, 1.0], "no.* rotation matrix"),
        (RADTAN[1], turned(0.9), "outside the image of"),
        (RADTAN[1], turned(np.pi), "opposite directions"),
        (
            EQUIDISTANT[1],
            T_RIGHT_LEFT,
            "distortion_model is radtan on the left and equidistant on the right",
        ),
        (dataclasses.replace(RADTAN[1], size_px=(640, 480)), T_RIGHT_LEFT, "size_px"),
        (
            dataclasses.replace(RADTAN[1], distortion=(0.1,)),
            T_RIGHT_LEFT,
            r"right camera: distortion is \(0.1,\)",
        ),
        (dataclasses.replace(RADTAN[1], fu_px=0.0), T_RIGHT_LEFT, "right camera: fu_px is 0 px"),
        (
            dataclasses.replace(RADTAN[1], distortion_model="plumb_bob"),
            T_RIGHT_LEFT,
            "right camera: distortion_model is 'plumb_bob'.*\n *Give radtan, which is ROS's",
        ),
        (
            dataclasses.replace(RADTAN[1], distortion=None),
            T_RIGHT_LEFT,
            "right camera: distortion is None",
        ),
        (RADTAN[1], None, "T_right_left is None"),
        (RADTAN[1], [[1.0, 0.0, 0.0, -0.1]], r"T_right_left is \[\[1.0, 0.0, 0.0, -0.1\]\]"),
    ],
)
def test_an_impossible_pair_is_refused(
    right: PinholeCamera, T_right_left: FloatArray, message: str
) -> None:
    with pytest.raises(InputError, match=rf"sensor\.yaml: (.|\n)*{message}"):
        Rectification.from_calibration(RADTAN[0], right, T_right_left, where="sensor.yaml")


def test_a_transform_may_be_a_list() -> None:
    camera = Rectification.from_calibration(*RADTAN, T_RIGHT_LEFT.tolist()).camera
    assert camera == Rectification.from_calibration(*RADTAN, T_RIGHT_LEFT).camera


def test_a_camera_that_is_upside_down_is_rectified_once_its_image_is_turned() -> None:
    """As the message says: turned by half a turn, the right camera is one beside the left."""
    left, right = RADTAN
    half_turn = se3.from_parts(so3.exp(np.array([0.0, 0.0, np.pi])), np.zeros(3))
    camera = Rectification.from_calibration(left, right, half_turn @ rolled(180.0)).camera
    assert camera.baseline_m == pytest.approx(0.1)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_vertical_pair_is_rectified_once_its_images_are_turned_as_the_message_says(
    sign: float,
) -> None:
    left, right = RADTAN
    T_right_left = shifted([0.01, sign * 0.1, 0.0])
    with pytest.raises(InputError) as caught:
        Rectification.from_calibration(left, right, T_right_left)
    # Anticlockwise, as np.rot90 turns an image, (u, v) becomes (v, −u).
    quarter = -90.0 if "anticlockwise" in caught.value.cure else 90.0
    C_turned_raw = so3.exp(np.array([0.0, 0.0, np.deg2rad(quarter)]))
    turn = se3.from_parts(C_turned_raw, np.zeros(3))
    turned_pair = turn @ T_right_left @ se3.inverse(turn)
    camera = Rectification.from_calibration(left, right, turned_pair).camera
    assert camera.baseline_m == pytest.approx(np.hypot(0.01, 0.1))


def test_a_pair_with_an_inclined_baseline_keeps_its_view() -> None:
    """Zoomed until only valid pixels are left, images that turn by 30° would have half of it."""
    camera = dataclasses.replace(RADTAN[0], distortion=(-0.1, 0.02, 0.0, 0.0))
    inclined = shifted([-0.1 * np.cos(np.pi / 6.0), -0.1 * np.sin(np.pi / 6.0), 0.0])
    rectification = Rectification.from_calibration(camera, camera, inclined)
    assert rectification.camera.fu_px == pytest.approx(RADTAN[0].fv_px)
    for mask in (rectification.left_mask, rectification.right_mask):
        assert mask is not None
        assert 0.6 < np.mean(mask == 255) < 0.95


def test_a_pair_that_is_nearly_level_has_no_border() -> None:
    camera = dataclasses.replace(RADTAN[0], distortion=(0.0, 0.0, 0.0, 0.0))
    rectification = Rectification.from_calibration(camera, camera, shifted([-0.1, -0.008, 0.0]))
    assert rectification.camera.fu_px > 1.05 * RADTAN[0].fu_px
    assert rectification.left_mask is None


def test_pixels_where_the_distortion_folds_over_are_masked() -> None:
    """With k1 = −0.3 alone, distorted radii grow up to r = √(1 / 0.9), and shrink from there on:
    pixels beyond it show what is nearer to the centre a second time."""
    focal_px = 320.0
    lens = PinholeCamera(
        focal_px,
        focal_px,
        375.5,
        cv_px=239.5,
        distortion_model="radtan",
        distortion=(-0.3, 0.0, 0.0, 0.0),
        size_px=(752, 480),
    )
    rectification = Rectification.from_calibration(lens, lens, shifted([-0.1, 0.0, 0.0]))
    camera = rectification.camera
    v, u = np.indices((480, 752))
    radius = np.hypot(*camera.normalized(u, v))
    fold = np.sqrt(1.0 / 0.9)
    mask = rectification.left_mask
    assert mask is not None
    assert (mask[radius > fold + 0.01] == 0).all()
    assert (mask[radius < fold - 0.01] == 255).all()


def test_known_projections_of_two_sizes_are_refused() -> None:
    """Raw images of one of the sizes would be remapped by the maps of the other."""
    left, right = RADTAN
    camera = Rectification.from_calibration(left, right, T_RIGHT_LEFT).camera
    other = dataclasses.replace(right, size_px=(1504, 960))
    with pytest.raises(InputError, match=r"left\.yaml: size_px is \(752, 480\) on the left"):
        Rectification.from_projections(
            left,
            other,
            camera,
            C_rect_left=np.eye(3),
            C_rect_right=np.eye(3),
            where="left.yaml",
        )


def test_images_of_another_size_are_refused() -> None:
    rectification = Rectification.from_calibration(*RADTAN, T_RIGHT_LEFT)
    width_px, height_px = RADTAN[0].size_px
    raw = np.zeros((height_px, width_px), np.uint8)
    assert rectification.rectify(raw, raw)[0].shape == raw.shape
    for pair in ((raw[:100], raw), (raw, raw.T)):
        with pytest.raises(InputError, match="image has shape"):
            rectification.rectify(*pair)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (
            np.full((480, 752), 30_000, np.uint16),
            r"the right image is uint16 of shape \(480, 752\)",
        ),
        (np.full((480, 752), 0.5), "the right image is float64"),
        (np.full((480, 752), True), "the right image is bool"),
        (np.zeros((480, 752, 3), np.uint8), r"the right image is uint8 of shape \(480, 752, 3\)"),
        ([[0, 1]], r"the right image is \[\[0, 1\]\]"),
    ],
)
def test_images_of_another_kind_are_refused(image: Image, message: str) -> None:
    """Their grey levels would be cut to 8 bits."""
    rectification = Rectification.from_calibration(*RADTAN, T_RIGHT_LEFT)
    with pytest.raises(InputError, match=f"rectification: {message}(.|\n)*type uint8"):
        rectification.rectify(np.zeros((480, 752), np.uint8), image)


def euroc_camera(folder: Path) -> tuple[PinholeCamera, FloatArray]:
    """A camera and its T_body_cam, as EuRoC calibrated them."""
    text = (folder / "sensor.yaml").read_text().removeprefix("%YAML:1.0")
    sensor = yaml.safe_load(text)
    size_px = tuple(sensor["resolution"])
    fu_px, fv_px, cu_px, cv_px = sensor["intrinsics"]
    coefficients = tuple(sensor["distortion_coefficients"])
    camera = PinholeCamera(fu_px, fv_px, cu_px, cv_px, "radtan", coefficients, size_px)
    return camera, np.array(sensor["T_BS"]["data"]).reshape(4, 4)


def match(left: Image, right: Image) -> FloatArray:
    """(u_l, v_l, u_r, v_r) of corners that optical flow finds in both images, there and back, [N,
    4], px."""
    corners = cv2.goodFeaturesToTrack(left, 500, 0.01, 8)
    found, _, _ = cv2.calcOpticalFlowPyrLK(left, right, corners, None, maxLevel=5)
    back, _, _ = cv2.calcOpticalFlowPyrLK(right, left, found, None, maxLevel=5)
    pixels = np.hstack([corners.reshape(-1, 2), found.reshape(-1, 2)])
    return pixels[np.linalg.norm((back - corners).reshape(-1, 2), axis=1) < 0.3]


@pytest.mark.data
@pytest.mark.skipif(
    not EUROC.exists(), reason="EuRoC V1_01_micro is not in PROBEVO_DATA or ../shared/data"
)
def test_the_rows_of_euroc_align() -> None:
    """Matched corners lie on the same row to 0.2 px in the median; in the raw images they are 13 px
    apart."""
    (left, T_body_left), (right, T_body_right) = (
        euroc_camera(EUROC / "cam0"),
        euroc_camera(EUROC / "cam1"),
    )
    rectification = Rectification.from_calibration(
        left, right, se3.inverse(T_body_right) @ T_body_left
    )
    name = min(path.name for path in (EUROC / "cam0" / "data").glob("*.png"))
    raw = [
        cv2.imread(str(EUROC / cam / "data" / name), cv2.IMREAD_GRAYSCALE)
        for cam in ("cam0", "cam1")
    ]
    pixels = match(*rectification.rectify(*raw))
    assert len(pixels) > 100
    assert np.median(np.abs(pixels[:, 1] - pixels[:, 3])) < 0.2
