"""A recording as a bag: rectified images, CameraInfo, IMU with its pose, and true poses."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from probevo.output.recording_parts import StereoPair, imu_samples, stereo_pairs
from probevo.output.ros.bag_writer import BagWriter, written_bag
from probevo.output.ros.ros_fields import (
    camera_info_fields,
    image_fields,
    imu_fields,
    pose_fields,
    transform_fields,
)
from probevo.sequences import ImuSamples, Sequence

SIDES = ("left", "right")
IMU = "/imu/data"
TRUTH = "/ground_truth"
CAMERA_FRAME = "camera_left_optical"
IMU_FRAME = "imu_link"
WORLD_FRAME = "world"


def write_recording_bag(
    path: Path,
    sequence: Sequence,
    *,
    num_frames: int,
    is_compressed: bool = False,
    on_frame: Callable[[int], None] = lambda index: None,
) -> None:
    """Write a recording as a bag that ``open_sequence`` reads back.

    Topics: ``/left/image_rect`` and ``/right/image_rect`` (with ``/compressed`` for PNG) with their
    ``camera_info``, ``/imu/data`` with the IMU's pose in ``/tf_static``, and ``/ground_truth``
    (nav_msgs/Odometry of the left camera). Messages come in the order of their stamps. The noise of
    the IMU and masks have no place in a bag.

    Args:
        path: a file .bag (ROS 1), .mcap or .db3 (ROS 2).
        sequence: the recording.
        num_frames: how many frames to write, from the first.
        is_compressed: write the images as PNG, which loses nothing.
        on_frame: called with the index of each frame that was written.

    Raises:
        InputError: rosbags is missing, the recording has no images, one of its files is damaged,
            a stamp does not fit into a message of ROS, or the file cannot be written.
    """
    samples = imu_samples(sequence)
    with written_bag(path) as bag:
        if sequence.imu is not None and samples is not None:
            start_ns = min(int(sequence.stamps_ns[0]), int(samples.stamps_ns[0]))
            mounting = transform_fields(
                sequence.imu.T_cam_imu, start_ns, parent=CAMERA_FRAME, child=IMU_FRAME
            )
            bag.write_transforms("/tf_static", start_ns, [mounting])
        # Two ascending streams, merged by their stamps.
        last_ns = int(sequence.stamps_ns[num_frames - 1])
        pairs = ((pair.stamp_ns, 1, pair) for pair in _pairs(sequence, num_frames))
        for _, _, item in heapq.merge(_imu_rows(samples), pairs, key=lambda entry: entry[:2]):
            if isinstance(item, StereoPair):
                _write_pair(bag, sequence, item, is_compressed=is_compressed)
                on_frame(item.index)
            elif samples is not None:
                stamp_ns = int(samples.stamps_ns[item])
                fields = imu_fields(samples.gyro_rad_s[item], samples.accel_m_s2[item])
                bag.write(IMU, "sensor_msgs/msg/Imu", stamp_ns, fields, frame=IMU_FRAME)
                if stamp_ns >= last_ns:
                    samples = None  # the first sample after the last frame is the last one needed


def _pairs(sequence: Sequence, num_frames: int) -> Iterator[StereoPair]:
    return stereo_pairs(islice(sequence, num_frames), sequence)


def _imu_rows(samples: ImuSamples | None) -> Iterator[tuple[int, int, int | StereoPair]]:
    """Yield stamp, rank among equal stamps, and row of each sample."""
    stamps_ns = [] if samples is None else samples.stamps_ns.tolist()
    return ((stamp_ns, 0, row) for row, stamp_ns in enumerate(stamps_ns))


def _write_pair(
    bag: BagWriter, sequence: Sequence, pair: StereoPair, *, is_compressed: bool
) -> None:
    """Add the images of a frame, their CameraInfo, and its true pose if that is known."""
    stamp_ns = pair.stamp_ns
    for side, pixels in zip(SIDES, (pair.left, pair.right), strict=True):
        info = camera_info_fields(sequence.camera, is_right=side == "right")
        topic = f"/{side}/image_rect"
        bag.write(
            f"/{side}/camera_info",
            "sensor_msgs/msg/CameraInfo",
            stamp_ns,
            info,
            frame=CAMERA_FRAME,
        )
        if is_compressed:
            data = np.asarray(cv2.imencode(".png", pixels)[1])
            fields = {"format": "mono8; png compressed ", "data": data}
            topic += "/compressed"
            bag.write(
                topic, "sensor_msgs/msg/CompressedImage", stamp_ns, fields, frame=CAMERA_FRAME
            )
        else:
            image = image_fields(pixels)
            bag.write(topic, "sensor_msgs/msg/Image", stamp_ns, image, frame=CAMERA_FRAME)
    if sequence.truth is not None and sequence.truth.known[pair.index]:
        truth = {
            "child_frame_id": CAMERA_FRAME,
            "pose": {"pose": pose_fields(sequence.truth.T_world_cam[pair.index])},
        }
        bag.write(TRUTH, "nav_msgs/msg/Odometry", stamp_ns, truth, frame=WORLD_FRAME)
