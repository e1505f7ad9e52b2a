"""Fields of ROS messages as dictionaries, from the arrays that they hold."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.output.ros.bag_writer import header_fields


def vector_fields(vector: FloatArray) -> dict[str, float]:
    """Return a geometry_msgs/Vector3 or Point."""
    x, y, z = vector.tolist()
    return {"x": x, "y": y, "z": z}


def quaternion_fields(C_b_a: FloatArray) -> dict[str, float]:
    """Return a geometry_msgs/Quaternion with w ≥ 0."""
    x, y, z, w = Rotation.from_matrix(C_b_a).as_quat(canonical=True).tolist()
    return {"x": x, "y": y, "z": z, "w": w}


def pose_fields(T_b_a: FloatArray) -> dict[str, Any]:
    """Return a geometry_msgs/Pose: the pose of frame a in frame b."""
    return {
        "position": vector_fields(T_b_a[:3, 3]),
        "orientation": quaternion_fields(T_b_a[:3, :3]),
    }


def transform_fields(
    T_parent_child: FloatArray, stamp_ns: int, *, parent: str, child: str
) -> dict[str, Any]:
    """Return a geometry_msgs/TransformStamped.

    Raises:
        InputError: the stamp does not fit into a message of ROS.
    """
    return {
        "header": header_fields(stamp_ns, parent),
        "child_frame_id": child,
        "transform": {
            "translation": vector_fields(T_parent_child[:3, 3]),
            "rotation": quaternion_fields(T_parent_child[:3, :3]),
        },
    }


def camera_info_fields(camera: StereoCamera, *, is_right: bool) -> dict[str, Any]:
    """Return a sensor_msgs/CameraInfo of a rectified camera, by its names in ROS 2.

    The reader computes the baseline as −P[3] / fx. P[3] is the number that gives it back exactly,
    where there is one.
    """
    fu_px = camera.fu_px
    K = np.array([[fu_px, 0.0, camera.cu_px], [0.0, camera.fv_px, camera.cv_px], [0.0, 0.0, 1.0]])
    shift = 0.0
    if is_right:
        product = fu_px * camera.baseline_m
        candidates = (product, np.nextafter(product, 0.0), np.nextafter(product, np.inf))
        shift = -next(
            (value for value in candidates if value / fu_px == camera.baseline_m), product
        )
    width_px, height_px = camera.size_px or (0, 0)
    return {
        "height": height_px,
        "width": width_px,
        "distortion_model": "plumb_bob",
        "d": np.zeros(5),
        "k": K,
        "r": np.eye(3),
        "p": np.column_stack([K, [shift, 0.0, 0.0]]),
    }


def image_fields(pixels: Image) -> dict[str, Any]:
    """Return a sensor_msgs/Image of gray pixels, [height, width], uint8."""
    height, width = pixels.shape
    return {
        "height": height,
        "width": width,
        "encoding": "mono8",
        "step": width,
        "data": pixels,
    }


def imu_fields(gyro_rad_s: FloatArray, accel_m_s2: FloatArray) -> dict[str, Any]:
    """Return a sensor_msgs/Imu without orientation, which a covariance of −1 says."""
    unknown = np.array([-1.0, *[0.0] * 8])
    return {
        "orientation": {"w": 1.0},
        "orientation_covariance": unknown,
        "angular_velocity": vector_fields(gyro_rad_s),
        "linear_acceleration": vector_fields(accel_m_s2),
    }
