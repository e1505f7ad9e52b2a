"""Writers of tiny recordings, one function a format.

Each returns the path to open. The vehicle drives 1 m along z in each frame.

Other tests use them too: ``from sequences.recordings import write_folder_sequence``.
"""

from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import AnyArray, Image, IntArray

WIDTH_PX = 64
HEIGHT_PX = 48
FU_PX = 50.0
CU_PX = 31.5
CV_PX = 23.5
BASELINE_M = 0.5
C_CAM_IMU = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""IMU axes forward, left, up to camera axes right, down, forward."""
T_CAM_IMU = np.block([[C_CAM_IMU, np.array([[0.1], [-0.2], [0.3]])], [np.eye(4)[3]]])
START_NS = 1_400_000_000_123_456_789
FRAME_NS = 100_000_000
LATITUDE_DEG = 49.0
LONGITUDE_DEG = 8.0
EARTH_RADIUS_M = 6378137.0


def stamps_ns(frames: int) -> IntArray:
    return START_NS + FRAME_NS * np.arange(frames)


def image(index: int, right: bool = False) -> Image:
    """A random image that differs between frames and sides."""
    return np.random.default_rng([index, right]).integers(
        0, 256, (HEIGHT_PX, WIDTH_PX), dtype=np.uint8
    )


def write_image(path: Path, pixels: AnyArray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(path.suffix, pixels)[1].tobytes())


def write_lines(path: Path, lines: list[str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def numbers(values: AnyArray | list[float], separator: str = " ") -> str:
    return separator.join(repr(float(value)) for value in np.ravel(values))


def poses(frames: int) -> AnyArray:
    T_world_cam = np.tile(np.eye(4), (frames, 1, 1))
    T_world_cam[:, 2, 3] = np.arange(frames)
    return T_world_cam


def write_folder_sequence(
    root: Path, frames: int = 4, *, imu: bool = True, truth: bool = True
) -> Path:
    """The layout of ``open_folder``.

    The IMU rotates at 0.1 rad/s about its up axis and is sampled every 10 ms.
    """
    for index in range(frames):
        write_image(root / "left" / f"{index:06d}.png", image(index))
        write_image(root / "right" / f"{index:06d}.png", image(index, right=True))
    calibration = [f"fu_px: {FU_PX}", f"fv_px: {FU_PX}", f"cu_px: {CU_PX}", f"cv_px: {CV_PX}"]
    calibration += [f"baseline_m: {BASELINE_M}", f"width_px: {WIDTH_PX}", f"height_px: {HEIGHT_PX}"]
    if imu:
        calibration += [
            "imu:",
            f"  T_cam_imu: {T_CAM_IMU.tolist()}",
            "  gyro_noise_rad_s_sqrt_hz: 1.0e-4",
        ]
        calibration += ["  gyro_bias_sigma_rad_s: 0.01"]
        samples = np.arange(START_NS - 5_000_000, START_NS + frames * FRAME_NS, 10_000_000)
        rows = [f"{stamp},0,0,0.1,0,0,9.81" for stamp in samples]
        write_lines(root / "imu.csv", ["stamp_ns,wx,wy,wz,ax,ay,az", *rows])
    write_lines(root / "calib.yaml", calibration)
    write_lines(
        root / "times.txt", [f"{stamp // 10**9}.{stamp % 10**9:09d}" for stamp in stamps_ns(frames)]
    )
    if truth:
        write_lines(root / "poses.txt", [numbers(T[:3]) for T in poses(frames)])
    return root


def projection(shift_px_m: float = 0.0) -> str:
    return numbers([FU_PX, 0.0, CU_PX, shift_px_m, 0.0, FU_PX, CV_PX, 0.0, 0.0, 0.0, 1.0, 0.0])


def write_kitti_odometry(root: Path, frames: int = 4, *, truth: bool = True) -> Path:
    """``sequences/07`` and ``poses/07.txt``."""
    sequence = root / "sequences" / "07"
    for index in range(frames):
        write_image(sequence / "image_0" / f"{index:06d}.png", image(index))
        write_image(sequence / "image_1" / f"{index:06d}.png", image(index, right=True))
    write_lines(
        sequence / "calib.txt", [f"P0: {projection()}", f"P1: {projection(-FU_PX * BASELINE_M)}"]
    )
    write_lines(sequence / "times.txt", [f"{0.1 * index:.6e}" for index in range(frames)])
    if truth:
        write_lines(root / "poses" / "07.txt", [numbers(T[:3]) for T in poses(frames)])
    return sequence


def kitti_time(stamp_ns: int) -> str:
    return str(np.datetime64(int(stamp_ns), "ns")).replace("T", " ")


def write_kitti_raw(
    root: Path, frames: int = 4, *, oxts: bool = True, packet_delay_ns: int = 0
) -> Path:
    """A drive to the east, and the calibration of its date. The packets lag the images by
    ``packet_delay_ns``."""
    date = root / "2011_09_26"
    drive = date / "2011_09_26_drive_0099_sync"
    for index in range(frames):
        write_image(drive / "image_00" / "data" / f"{index:010d}.png", image(index))
        write_image(drive / "image_01" / "data" / f"{index:010d}.png", image(index, right=True))
    times = [kitti_time(stamp) for stamp in stamps_ns(frames)]
    write_lines(drive / "image_00" / "timestamps.txt", times)
    write_lines(drive / "image_01" / "timestamps.txt", times)
    rectified = [
        f"S_rect_00: {WIDTH_PX} {HEIGHT_PX}",
        f"R_rect_00: {numbers(np.eye(3))}",
        f"P_rect_00: {projection()}",
    ]
    rectified += [f"P_rect_01: {projection(-FU_PX * BASELINE_M)}"]
    write_lines(date / "calib_cam_to_cam.txt", ["calib_time: 09-Jan-2012 13:57:47", *rectified])
    write_lines(date / "calib_velo_to_cam.txt", [f"R: {numbers(C_CAM_IMU)}", "T: 0.4 0 -0.1"])
    t_velo_imu = C_CAM_IMU.T @ (T_CAM_IMU[:3, 3] - [0.4, 0.0, -0.1])
    imu_to_velo = [f"R: {numbers(np.eye(3))}", f"T: {numbers(t_velo_imu)}"]
    write_lines(date / "calib_imu_to_velo.txt", imu_to_velo)
    if oxts:
        metre_deg = np.degrees(1 / (EARTH_RADIUS_M * np.cos(np.radians(LATITUDE_DEG))))
        for index in range(frames):
            packet = np.zeros(30)
            packet[:3] = LATITUDE_DEG, LONGITUDE_DEG + index * metre_deg, 100.0
            packet[11:14] = (0.0, 0.0, 9.81)
            packet[17:20] = (0.01, 0.02, 0.03 + index)
            write_lines(drive / "oxts" / "data" / f"{index:010d}.txt", [numbers(packet)])
        times = [kitti_time(stamp + packet_delay_ns) for stamp in stamps_ns(frames)]
        write_lines(drive / "oxts" / "timestamps.txt", times)
    return drive


def sensor_yaml(T_body_sensor: AnyArray, *more: str) -> list[str]:
    matrix = f"  data: [{numbers(T_body_sensor, ', ')}]"
    return ["%YAML:1.0", "# comment", "T_BS:", "  cols: 4", "  rows: 4", matrix, *more]


def write_euroc(root: Path, frames: int = 4) -> Path:
    """``mav0`` with ideal cameras side by side, a body looking along +z, and truth every 50 ms."""
    mav = root / "mav0"
    stamps = stamps_ns(frames)
    for side, camera in enumerate(("cam0", "cam1")):
        for index, stamp in enumerate(stamps):
            write_image(mav / camera / "data" / f"{stamp}.png", image(index, right=bool(side)))
        T_body_cam = np.eye(4)
        T_body_cam[0, 3] = side * BASELINE_M
        intrinsics = f"intrinsics: [{FU_PX}, {FU_PX}, {CU_PX}, {CV_PX}] #fu, fv, cu, cv"
        model = [
            "distortion_model: radial-tangential",
            "distortion_coefficients: [0.0, 0.0, 0.0, 0.0]",
        ]
        more = [
            "camera_model: pinhole",
            f"resolution: [{WIDTH_PX}, {HEIGHT_PX}]",
            intrinsics,
            *model,
        ]
        write_lines(mav / camera / "sensor.yaml", sensor_yaml(T_body_cam, *more))
        write_lines(
            mav / camera / "data.csv",
            ["#timestamp [ns],filename", *(f"{s},{s}.png" for s in stamps)],
        )
    T_body_imu = T_CAM_IMU
    noise = ["gyroscope_noise_density: 1.7e-04", "gyroscope_random_walk: 1.9e-05"]
    noise += ["accelerometer_noise_density: 2.0e-03", "accelerometer_random_walk: 4.0e-03"]
    write_lines(mav / "imu0" / "sensor.yaml", sensor_yaml(T_body_imu, *noise))
    samples = np.arange(START_NS - 5_000_000, stamps[-1] + 5_000_001, 5_000_000)
    write_lines(
        mav / "imu0" / "data.csv",
        ["#timestamp [ns],w,a", *(f"{s},0,0,0.1,0,0,9.81" for s in samples)],
    )
    truth = np.arange(START_NS - 30_000_000, stamps[-1] + FRAME_NS, 50_000_000)
    rows = [f"{s},0,0,{float((s - START_NS) / FRAME_NS)!r},1,0,0,0,0,0,10" for s in truth]
    write_lines(
        mav / "state_groundtruth_estimate0" / "data.csv",
        ["#time(ns),px,py,pz,qw,qx,qy,qz,v", *rows],
    )
    return root


def camchain_yaml(T_left_imu: AnyArray) -> list[str]:
    """Kalibr's file of two ideal fisheye cameras side by side, and the pose of the IMU."""
    T_right_left = np.eye(4)
    T_right_left[0, 3] = -BASELINE_M
    lines = []
    for camera, T_cam_imu in (("cam0", T_left_imu), ("cam1", T_right_left @ T_left_imu)):
        lines += [
            f"{camera}:",
            "  T_cam_imu:",
            *(f"  - [{numbers(row, ', ')}]" for row in T_cam_imu),
            "  camera_model: pinhole",
            "  distortion_coeffs: [0.0, 0.0, 0.0, 0.0]",
            "  distortion_model: equidistant",
            f"  intrinsics: [{FU_PX}, {FU_PX}, {CU_PX}, {CV_PX}]",
            f"  resolution: [{WIDTH_PX}, {HEIGHT_PX}]",
        ]
    rows = [f"  - [{numbers(row, ', ')}]" for row in T_right_left]
    return [*lines, "  T_cn_cnm1:", *rows]


def write_tum_vi(root: Path, frames: int = 4) -> Path:
    """``mav0`` without any sensor.yaml, images of 16 bits, and ``dso`` with the calibration."""
    path = root / "dataset-room9_512_16"
    stamps = stamps_ns(frames)
    for side, camera in enumerate(("cam0", "cam1")):
        for index, stamp in enumerate(stamps):
            pixels = image(index, right=bool(side)).astype(np.uint16) * 256
            write_image(path / "mav0" / camera / "data" / f"{stamp}.png", pixels)
        lines = ["#timestamp [ns],filename", *(f"{s},{s}.png" for s in stamps)]
        write_lines(path / "mav0" / camera / "data.csv", lines)
    samples = np.arange(START_NS - 5_000_000, stamps[-1] + 5_000_001, 5_000_000)
    rows = [f"{s},0,0,0.1,0,0,9.81" for s in samples]
    write_lines(path / "mav0" / "imu0" / "data.csv", ["#timestamp [ns],w,a", *rows])
    write_lines(path / "dso" / "camchain.yaml", camchain_yaml(T_CAM_IMU))
    noise = ["accelerometer_noise_density: 0.0028", "accelerometer_random_walk: 0.00086"]
    noise += ["gyroscope_noise_density: 0.00016", "gyroscope_random_walk: 0.000022"]
    write_lines(path / "dso" / "imu_config.yaml", ["rostopic: /imu0", *noise])
    # Poses of the IMU: the camera drives along its own z axis, and looks along the world's.
    rows = []
    for stamp in np.arange(START_NS - 30_000_000, stamps[-1] + FRAME_NS, 50_000_000):
        T_world_cam = np.eye(4)
        T_world_cam[2, 3] = (stamp - START_NS) / FRAME_NS
        T_world_imu = T_world_cam @ T_CAM_IMU
        quaternion = Rotation.from_matrix(T_world_imu[:3, :3]).as_quat(scalar_first=True)
        rows.append(f"{stamp},{numbers(T_world_imu[:3, 3], ',')},{numbers(quaternion, ',')}")
    write_lines(path / "mav0" / "mocap0" / "data.csv", ["#timestamp [ns], p_RS_R_x [m]", *rows])
    return path


def write_four_seasons(root: Path, frames: int = 4) -> Path:
    """A recording with undistorted images, and ``calibration`` beside it.

    Positions of the truth are to be multiplied by the scale of 2.
    """
    path = root / "recording_2020-03-24_17-36-22"
    for index, stamp in enumerate(stamps_ns(frames)):
        for side, camera in enumerate(("cam0", "cam1")):
            file = path / "undistorted_images" / camera / f"{stamp}.png"
            write_image(file, image(index, right=bool(side)))
    times = [f"{s} {s // 10**9}.{s % 10**9:09d} 1.5" for s in stamps_ns(frames)]
    write_lines(path / "times.txt", times)
    for side in (0, 1):
        model = f"Pinhole {FU_PX} {FU_PX} {CU_PX} {CV_PX} 0.0 0.0 0.0 0.0"
        size = f"{WIDTH_PX} {HEIGHT_PX}"
        write_lines(root / "calibration" / f"undistorted_calib_{side}.txt", [model, size, "crop"])
    stereo = np.eye(4)
    stereo[0, 3] = -BASELINE_M
    file = root / "calibration" / "undistorted_calib_stereo.txt"
    write_lines(file, [numbers(row) for row in stereo])
    quaternion = Rotation.from_matrix(C_CAM_IMU).as_quat()
    transformations = [
        "# transform_S_AS: translation vector, rotation quaternion",
        "0.0,0.0,0.0,0.0,0.0,0.0,1.0",
        "",
        "# TS_cam_imu: translation vector, rotation quaternion",
        f"{numbers(T_CAM_IMU[:3, 3], ',')},{numbers(quaternion, ',')}",
        "",
        "# GNSS scale",
        "0.969397",
    ]
    write_lines(path / "Transformations.txt", transformations)
    samples = np.arange(START_NS - 5_000_000, stamps_ns(frames)[-1] + 5_000_001, 5_000_000)
    write_lines(path / "imu.txt", [f"{s} 0 0 0.1 0 0 9.81" for s in samples])
    keyframes = [
        f"{stamp},0,0,{0.5 * index},0,0,0,1,2.0,1.0,0"
        for index, stamp in enumerate(stamps_ns(frames))
    ]
    write_lines(path / "GNSSPoses.txt", ["# frame_id, tx, ty, tz, qx, qy, qz, qw", *keyframes])
    return path


def write_tartan_air(root: Path, frames: int = 4, *, version: int = 1) -> Path:
    """A trajectory ``P000`` of either version; the aircraft's axes are forward, right, down."""
    path = root / "P000"
    folders = (
        ("image_left", "image_right") if version == 1 else ("image_lcam_front", "image_rcam_front")
    )
    suffixes = ("left", "right") if version == 1 else ("lcam_front", "rcam_front")
    height = 480 if version == 1 else 640
    for index in range(frames):
        for side, (folder, suffix) in enumerate(zip(folders, suffixes, strict=True)):
            rng = np.random.default_rng([index, side])
            pixels = rng.integers(0, 256, (height, 640, 3), dtype=np.uint8)
            write_image(path / folder / f"{index:06d}_{suffix}.png", pixels)
    # Forward by one metre a frame, and a quaternion of no rotation: x is ahead.
    name = "pose_left.txt" if version == 1 else "pose_lcam_front.txt"
    write_lines(path / name, [f"{index} 0 0 0 0 0 1" for index in range(frames)])
    return path


def write_virtual_kitti(root: Path, frames: int = 4) -> Path:
    """``Scene01/clone`` with colour JPEGs, and both text files."""
    path = root / "Scene01" / "clone"
    intrinsics = ["frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]"]
    extrinsics = ["frame cameraID r1,1 r1,2 r1,3 t1 r2,1 r2,2 r2,3 t2 r3,1 r3,2 r3,3 t3 0 0 0 1"]
    for index in range(frames):
        for side in (0, 1):
            file = path / "frames" / "rgb" / f"Camera_{side}" / f"rgb_{index:05d}.jpg"
            write_image(file, np.repeat(image(index, right=bool(side))[..., None], 3, axis=2))
            intrinsics.append(f"{index} {side} {FU_PX} {FU_PX} {CU_PX} {CV_PX}")
            T_cam_world = np.eye(4)
            T_cam_world[:3, 3] = -side * BASELINE_M, 0.0, -index
            extrinsics.append(f"{index} {side} {numbers(T_cam_world)}")
    write_lines(path / "intrinsic.txt", intrinsics)
    write_lines(path / "extrinsic.txt", extrinsics)
    return path


def tracks_arrays(frames: int = 4, points: int = 6) -> dict[str, AnyArray]:
    """The arrays of a tracks file; every point is seen in every frame."""
    uv = np.random.default_rng(0).uniform(0.0, 40.0, (frames * points, 4))
    uv[:, 2] = uv[:, 0] - 5.0
    return {
        "frame": np.repeat(np.arange(frames, dtype=np.int32), points),
        "track": np.tile(np.arange(points, dtype=np.int32), frames),
        "uv": uv.astype(np.float32),
        "t": 1_400_000_000.0 + 0.1 * np.arange(frames),
        "omega": np.arange(frames)[:, None] * [0.0, 0.0, 0.1],
        "velocity": np.tile([10.0, 0.0, 0.0], (frames, 1)),
        "C_cam_imu": C_CAM_IMU,
        "p_imu_cam": -C_CAM_IMU.T @ T_CAM_IMU[:3, 3],
        "T_world_cam": poses(frames),
        "camera": np.array([FU_PX, FU_PX, CU_PX, CV_PX, BASELINE_M]),
    }


def write_tracks(root: Path, frames: int = 4, **changes: AnyArray | None) -> Path:
    """``tracks.npz``; ``changes`` replaces arrays, None leaves one out."""
    arrays = tracks_arrays(frames) | changes
    np.savez(
        root / "tracks.npz", **{name: array for name, array in arrays.items() if array is not None}
    )
    return root / "tracks.npz"


def write_kitti_flow(root: Path, *, year: int = 2012, scenes: tuple[int, ...] = (27,)) -> Path:
    """Scenes of frames 8 to 11 in the layout of KITTI 2012 or 2015, with truth at frame 10: the
    disparity is 0.5 times the column, the flow (−1.5, 2.25); row 0 is unknown."""
    cameras = (0, 1) if year == 2012 else (2, 3)
    for scene in scenes:
        for index in range(4):
            name = f"{scene:06d}_{index + 8:02d}.png"
            write_image(root / f"image_{cameras[0]}" / name, image(index))
            write_image(root / f"image_{cameras[1]}" / name, image(index, right=True))
        field = "P{}" if year == 2012 else "P_rect_0{}"
        lines = [
            f"{field.format(camera)}: {projection(-FU_PX * BASELINE_M * (camera % 2))}"
            for camera in cameras
        ]
        folder = "calib" if year == 2012 else "calib_cam_to_cam"
        write_lines(root / folder / f"{scene:06d}.txt", lines)
        disparity = np.tile(128 * np.arange(WIDTH_PX), (HEIGHT_PX, 1)).astype(np.uint16)
        disparity[0] = 0
        flow = np.zeros((HEIGHT_PX, WIDTH_PX, 3), np.uint16)
        flow[1:] = [1, 2**15 + 144, 2**15 - 96]  # OpenCV's order: valid, v, u
        name = f"{scene:06d}_10.png"
        for which in ("occ", "noc"):
            of_first = "" if year == 2012 else "_0"
            write_image(root / f"disp_{which}{of_first}" / name, disparity)
            write_image(root / f"flow_{which}" / name, flow)
    return root
