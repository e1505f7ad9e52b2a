"""Bags of ROS 1 (``.bag``) and ROS 2 (a folder, ``.mcap``, ``.db3``), read without ROS."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from probevo.arrays import AnyArray, FloatArray, Image, IntArray
from probevo.camera.rectification import Rectification
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.calibrations.calibration_files import read_stereo_calibration
from probevo.sequences.calibrations.imu_noise_file import with_noise_of
from probevo.sequences.calibrations.ros_camera_info import (
    CameraInfo,
    rectification_of,
    stereo_camera,
)
from probevo.sequences.calibrations.stereo_calibration import mems_imu
from probevo.sequences.format_options import RosbagOptions
from probevo.sequences.formats.ros_images import gray_of
from probevo.sequences.formats.rosbag_file import (
    TRANSFORM_TYPES,
    Decoder,
    RawMessage,
    complete_messages,
    opened_bag,
)
from probevo.sequences.formats.rosbag_topics import NamedTopics, StereoTopics, choose_topics
from probevo.sequences.formats.rosbag_truth import TruthPoses, frame_name, rigid_matrix
from probevo.sequences.frame import Frame, GroundTruth
from probevo.sequences.given_truth import (
    CAMERA,
    IMU,
    imu_from_camera,
    truth_at,
    truth_of_file,
)
from probevo.sequences.gray_range import common_range, spread_indices
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.read_ahead import read_ahead
from probevo.sequences.recording import ImageRecording
from probevo.sequences.stamp_pairs import StampPairs, pair_stamps
from probevo.sequences.stamps import check_stamps

NO_FRAME = -1
"""Frame of an image without a partner."""
NOT_MEASURED = -1.0
"""First element of a covariance in ``sensor_msgs/Imu`` where the message does not have its
quantity."""
NO_VECTOR = (np.nan, np.nan, np.nan)
"""A vector that was not measured."""


@dataclass(frozen=True)
class _RawPair:
    """The messages of one frame, before they are decoded."""

    index: int
    left: RawMessage
    right: RawMessage
    decoder: Decoder


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class BagRecording(ImageRecording):
    """A ``Sequence`` of a bag, which is read once for each time that it is iterated over.

    Images wait in memory, as they are stored, until their partner has been read; nothing else is
    kept.
    """

    left_topic: str
    right_topic: str
    left_frames: IntArray
    """Frame of each message of the left topic, in the order of the bag; −1 without a partner."""
    right_frames: IntArray

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames from the first; raise InputError at a faulty message."""
        return read_ahead(self._decode, self._raw_pairs())

    def _raw_pairs(self) -> Iterator[_RawPair]:
        """Yield the messages of each frame, in the order of the frames.

        Raises:
            InputError: the bag is damaged.
        """
        frames_left = iter(self.left_frames.tolist())
        frames_right = iter(self.right_frames.tolist())
        left_waiting: dict[int, RawMessage] = {}
        right_waiting: dict[int, RawMessage] = {}
        next_index = 0
        with opened_bag(self.path) as bag:
            for message in bag.messages((self.left_topic, self.right_topic)):
                if message.topic == self.left_topic:
                    left_waiting[next(frames_left, NO_FRAME)] = message
                else:
                    right_waiting[next(frames_right, NO_FRAME)] = message
                # A frame is complete once both of its images have been read; they may be far apart.
                while next_index in left_waiting and next_index in right_waiting:
                    left = left_waiting.pop(next_index)
                    right = right_waiting.pop(next_index)
                    yield _RawPair(next_index, left, right, decoder=bag.decoder)
                    next_index += 1

    def _decode(self, pair: _RawPair) -> Frame:
        """Decode and rectify one frame.

        Raises:
            InputError: a message is damaged, or its image has another size than the camera.
        """
        start = time.perf_counter()
        with complete_messages(self.path):
            left = self._image(pair.left, pair)
            right = self._image(pair.right, pair)
        if self.rectification is not None:
            left, right = self.rectification.rectify(left, right)
        imu = self.imu_before(pair.index)
        elapsed_ms = 1e3 * (time.perf_counter() - start)
        return Frame(
            index=pair.index,
            stamp_ns=int(self.stamps_ns[pair.index]),
            left=left,
            right=right,
            imu=imu,
            decode_ms=elapsed_ms,
            left_mask=self.left_mask,
            right_mask=self.right_mask,
        )

    def _image(self, message: RawMessage, pair: _RawPair) -> Image:
        """Decode an image to 8 bits.

        Raises:
            InputError: the message is damaged, or its image has another depth or size than those of
                the first frames.
        """
        where = f"{self.path}: {message.topic}, frame {pair.index}"
        gray = gray_of(pair.decoder.decoded(message), where)
        if gray.dtype == np.uint16 and self.gray_range is not None:
            gray = self.gray_range.to_8_bits(gray)
        if gray.dtype != np.uint8:
            raise InputError(
                where, f"this image is {gray.dtype}, unlike those of the first frames."
            )
        if gray.shape[::-1] != self.camera.size_px:
            what = f"this image has {gray.shape[1]}×{gray.shape[0]} px"
            width_px, height_px = self.camera.size_px or (0, 0)
            raise InputError(where, f"{what}, the camera {width_px}×{height_px} px.")
        return gray


@dataclass
class _Content:
    """The result of the first pass through a bag: everything except images, of which it has a
    few."""

    decoder: Decoder
    left_ns: list[int] = field(default_factory=list)
    """Header stamp of each left image, in the order of the bag."""
    right_ns: list[int] = field(default_factory=list)
    images: dict[str, list[RawMessage]] = field(default_factory=dict)
    """The first image of both topics, and others spread over the recording."""
    infos: dict[str, CameraInfo] = field(default_factory=dict)
    """The first CameraInfo of each topic."""
    imu_ns: list[int] = field(default_factory=list)
    imu_values: list[tuple[float, ...]] = field(default_factory=list)
    """Angular rate, rad/s, and specific force, m/s², of each sample: six numbers, NaN where the
    message says that it has none."""
    imu_frame: str = ""
    """Frame of the IMU in ROS's tree of transforms."""
    transforms: dict[str, tuple[str, FloatArray]] = field(default_factory=dict)
    """Parent and T_parent_child, [4, 4], of each child frame in ``tf_static``."""
    faulty_transforms: dict[str, InputError] = field(default_factory=dict)
    """What is wrong with a transform in ``tf_static``, by its child frame."""
    truth: TruthPoses | None = None
    """True poses, if a topic has them."""
    faulty_truth: InputError | None = None
    """What is wrong with the first faulty pose of that topic; it is raised if the truth matters."""


def open_rosbag(path: Path, options: RosbagOptions) -> BagRecording:
    """Open the stereo images of a bag, and its IMU if it has one whose pose is known.

    Left and right images are paired by the stamps in their headers. The camera is the one of the
    CameraInfo: topics called "rect" hold rectified images; others are rectified by its K, D, R
    and P unless these say that nothing is to be done. A calibration file replaces the CameraInfo.

    Args:
        path: a .bag, .mcap or .db3 file, or the folder of a bag of ROS 2.
        options: topics, tolerance of the pairs, calibration file, and truth.

    Raises:
        InputError: the bag is damaged; it has no stereo images, no calibration, or several
            candidates for either (lists the topics); or a value is impossible. What is wrong with
            an IMU or truth that the options do not ask for is a note instead.
    """
    with complete_messages(path):
        return _opened(path, options)


def _opened(path: Path, options: RosbagOptions) -> BagRecording:
    """Open a bag whose messages have the fields of their types."""
    named = NamedTopics(
        left=options.topics_left,
        right=options.topics_right,
        left_info=options.topics_left_info,
        right_info=options.topics_right_info,
        imu=options.topics_imu,
        truth=options.topics_truth,
    )
    if options.truth is not None and options.topics_truth is not None:
        what = "both --truth and --topics.truth name the true poses."
        raise InputError(path, what, "Leave out one of them.")
    # First pass: stamps, CameraInfo, IMU, transforms and truth. Images are decoded in a second
    # pass, while the recording is iterated over.
    with opened_bag(path) as bag:
        topics = choose_topics(path, bag.topics, named)
        needs_imu = options.imu_noise is not None or options.truth_of == IMU
        if needs_imu and topics.candidate_imus:
            what = f"several topics are IMUs: {', '.join(topics.candidate_imus)}."
            raise InputError(path, what, "Name one with --topics.imu.")
        content = _Content(bag.decoder, images={topics.left: [], topics.right: []})
        if topics.truth is not None and options.truth is None:
            content.truth = _empty_truth(path, topics.truth, bag.topics[topics.truth].type, options)
        kept = {
            topic: frozenset(spread_indices(bag.topics[topic].count)) for topic in content.images
        }
        for message in bag.messages(topics.all):
            _gather(content, message, topics, kept=kept)
    # Pair images by the stamps of their headers; the order of messages in a bag means nothing.
    pair_tolerance_ms = options.pair_tolerance_ms
    tolerance_ns = round(1e6 * pair_tolerance_ms)
    pairs = pair_stamps(np.array(content.left_ns), np.array(content.right_ns), tolerance_ns)
    _check_pairs(path, content, pairs, pair_tolerance_ms)
    stamps_ns = np.array(content.left_ns, dtype=np.int64)[pairs.left]
    check_stamps(stamps_ns, f"{path}: {topics.left}")

    # Only a few images are decoded here, for their size and depth.
    height_px, width_px = _decoded_image(content, content.images[topics.left][0]).shape
    _decoded_image(content, content.images[topics.right][0])
    gray_range = common_range(_decodable_images(content))
    size_px = (width_px, height_px)

    calibration = _calibration(path, content, topics, options=options, size_px=size_px)
    imu = with_noise_of(calibration.imu, options.imu_noise)
    notes = (*_notes(content, topics, pairs, options=options, imu=imu), *calibration.notes)
    imu_stream: ImuStream | None = None
    if imu is not None:
        try:
            imu_stream = _imu_stream(content, topics, imu, stamps_ns, path)
        except InputError as error:
            # An IMU that nobody asked for must not make a bag unusable.
            if options.topics_imu is not None or options.imu_noise is not None:
                raise
            notes = (*notes, ("! IMU", _not_used(topics.imu, error)))
    if imu_stream is not None and not np.isfinite(imu_stream.accel_m_s2).any():
        notes = (*notes, ("IMU", f"{topics.imu} has no accelerations: only its gyro is used."))
    truth: GroundTruth | None = None
    try:
        truth = _truth(
            content, topics, options, stamps_ns, imu=imu, C_rect_left=calibration.C_rect_left
        )
    except InputError as error:
        # Truth that was only recognised by the name of its topic must not make a bag unusable.
        if options.truth is not None or options.topics_truth is not None:
            raise
        notes = (*notes, ("! truth", _not_used(topics.truth, error)))
    return BagRecording(
        path=path,
        format="rosbag",
        camera=calibration.camera,
        stamps_ns=stamps_ns,
        imu=imu if imu_stream is not None else None,
        imu_stream=imu_stream,
        truth=truth,
        rectification=calibration.rectification,
        gray_range=gray_range,
        notes=notes,
        left_topic=topics.left,
        right_topic=topics.right,
        left_frames=_frames_of(pairs.left, len(content.left_ns)),
        right_frames=_frames_of(pairs.right, len(content.right_ns)),
    )


class _Calibration(NamedTuple):
    """The calibration of the rig, from a file or from the bag."""

    camera: StereoCamera
    rectification: Rectification | None
    """None if the images are rectified."""
    C_rect_left: FloatArray
    """Rotation from the raw to the rectified left camera, [3, 3]."""
    imu: ImuCalibration | None
    """None if nothing says where the IMU is."""
    notes: tuple[tuple[str, str], ...] = ()
    """What had to be assumed of the file."""


def _calibration(
    path: Path,
    content: _Content,
    topics: StereoTopics,
    *,
    options: RosbagOptions,
    size_px: tuple[int, int],
) -> _Calibration:
    """Read the calibration file, or else CameraInfo and transforms of the bag.

    Raises:
        InputError: a part of it is missing or faulty, or it is for images of another size.
    """
    camera: StereoCamera
    rectification: Rectification | None
    notes: tuple[tuple[str, str], ...] = ()
    if options.calibration is not None:
        from_file = read_stereo_calibration(options.calibration, size_px, resized=options.resized)
        rectification = from_file.rectification()
        camera = rectification.camera
        C_rect_left = rectification.C_rect_left
        imu = from_file.imu(C_rect_left)
        notes = from_file.notes
    else:
        left_info = _info(path, content, topics.left, topics.left_info)
        right_info = _info(path, content, topics.right, topics.right_info)
        left_info = left_info.as_sent(size_px)
        right_info = right_info.as_sent(size_px)
        if options.resized:
            left_info = left_info.resized(size_px)
            right_info = right_info.resized(size_px)
        camera = stereo_camera(left_info, right_info)
        is_rectified = _is_rectified(topics.left, left_info) and _is_rectified(
            topics.right, right_info
        )
        rectification = None if is_rectified else rectification_of(left_info, right_info)
        C_rect_left = left_info.R
        imu = _imu_of_transforms(content, topics, left_info)
    if camera.size_px != size_px:
        width_px, height_px = camera.size_px or (0, 0)
        what = (
            f"its images have {size_px[0]}×{size_px[1]} px, but the CameraInfo is for"
            f" {width_px}×{height_px} px."
        )
        cure = (
            "Give the calibration of these images with --calibration FILE, or --resized if they"
            " were scaled, and not cropped, since they were calibrated."
        )
        raise InputError(f"{path}: {topics.left}", what, cure)
    return _Calibration(
        camera=camera,
        rectification=rectification,
        C_rect_left=C_rect_left,
        imu=imu,
        notes=notes,
    )


def _gather(
    content: _Content,
    message: RawMessage,
    topics: StereoTopics,
    *,
    kept: dict[str, frozenset[int]],
) -> None:
    """Add a message to the content of the bag.

    A faulty pose is kept as an error, since the truth or the frame may not be needed.

    Args:
        content: what has been read before.
        message: the next message of the bag.
        topics: the topics that are read.
        kept: which images of both topics are kept, counted from 0.

    Raises:
        InputError: the message is damaged.
    """
    decoder = content.decoder
    if message.topic in (topics.left, topics.right):
        # Only the header of an image is read here.
        stamps_ns = content.left_ns if message.topic == topics.left else content.right_ns
        if len(stamps_ns) in kept[message.topic]:
            content.images[message.topic].append(message)
        stamps_ns.append(decoder.stamp_ns(message))
    elif message.topic in (topics.left_info, topics.right_info):
        if message.topic not in content.infos:
            where = f"{decoder.path}: {message.topic}"
            content.infos[message.topic] = CameraInfo(decoder.decoded(message), where)
    elif message.topic == topics.imu:
        sample = decoder.decoded(message)
        rate = sample.angular_velocity
        force = sample.linear_acceleration
        has_rate = sample.angular_velocity_covariance[0] != NOT_MEASURED
        has_force = sample.linear_acceleration_covariance[0] != NOT_MEASURED
        rate_rad_s = (rate.x, rate.y, rate.z) if has_rate else NO_VECTOR
        force_m_s2 = (force.x, force.y, force.z) if has_force else NO_VECTOR
        content.imu_ns.append(decoder.stamp_ns(message))
        content.imu_values.append(rate_rad_s + force_m_s2)
        content.imu_frame = sample.header.frame_id
    elif message.topic == topics.truth:
        if content.truth is not None and content.faulty_truth is None:
            try:
                content.truth.add(decoder.decoded(message))
            except InputError as error:
                content.faulty_truth = error
    else:
        for transform in decoder.decoded(message).transforms:
            parent = frame_name(transform.header.frame_id)
            child = frame_name(transform.child_frame_id)
            pose = transform.transform
            where = f"{decoder.path}: {message.topic}"
            try:
                T_parent_child = rigid_matrix(pose.translation, pose.rotation, where)
            except InputError as error:
                # ROS ignores such a transform, too; it may be of a frame that nobody needs.
                content.faulty_transforms[child] = error
            else:
                content.transforms[child] = (parent, T_parent_child)


def _check_pairs(
    path: Path, content: _Content, pairs: StampPairs, pair_tolerance_ms: float
) -> None:
    """Refuse a bag whose images rarely have a partner.

    Raises:
        InputError: less than half of the images have one; gives the nearest stamps.
    """
    num_left = len(content.left_ns)
    num_right = len(content.right_ns)
    if len(pairs) and 2 * len(pairs) >= max(num_left, num_right):
        return
    if min(num_left, num_right) > 1 and len(set(content.left_ns + content.right_ns)) == 1:
        what = f"the headers of all images have one stamp, {content.left_ns[0]} ns."
        raise InputError(path, what, "The driver has to fill in the stamps of the headers.")
    what = (
        f"only {len(pairs)} of {num_left} left and {num_right} right images have a partner within"
        f" {pair_tolerance_ms:g} ms."
    )
    apart = pair_stamps(np.array(content.left_ns), np.array(content.right_ns), 10**15).offsets_ns
    if len(apart):
        what += f" Nearest stamps are {1e-6 * np.median(np.abs(apart)):.1f} ms apart in the median."
    cure = "Are the cameras triggered together? Otherwise raise --pair-tolerance-ms."
    raise InputError(path, what, cure)


def _frames_of(images: IntArray, count: int) -> IntArray:
    """Return the frame of each of ``count`` images, −1 for none; ``images`` are those of frames."""
    frames = np.full(count, NO_FRAME)
    frames[images] = np.arange(len(images))
    return frames


def _decoded_image(content: _Content, message: RawMessage) -> AnyArray:
    """Return an image as grayscale, of the depth that it is stored in.

    Raises:
        InputError: it is damaged, or of an unknown encoding.
    """
    decoder = content.decoder
    return gray_of(decoder.decoded(message), f"{decoder.path}: {message.topic}")


def _decodable_images(content: _Content) -> Iterator[AnyArray]:
    """Yield the images that were kept; one that is damaged is left to the reading of its frame."""
    for messages in content.images.values():
        for message in messages:
            with suppress(InputError):
                yield _decoded_image(content, message)


def _info(path: Path, content: _Content, images: str, topic: str | None) -> CameraInfo:
    """Return the CameraInfo of a topic of images.

    Raises:
        InputError: the bag has none.
    """
    if topic is None:
        what = f"the topic {images} has no CameraInfo beside it, and so no calibration."
        cure = (
            "Name its topic with --topics.left-info or --topics.right-info, or give a calibration"
            " file with --calibration."
        )
        raise InputError(path, what, cure)
    if topic not in content.infos:
        what = f"the topic {topic} holds no CameraInfo that can be read."
        cure = "Give a calibration file with --calibration."
        raise InputError(path, what, cure)
    return content.infos[topic]


def _is_rectified(topic: str, info: CameraInfo) -> bool:
    """Return whether a topic's images are rectified, by its name or by the CameraInfo."""
    parts = topic.split("/")
    return any(part.startswith("image_rect") for part in parts) or info.is_rectified


def _imu_of_transforms(
    content: _Content, topics: StereoTopics, left_info: CameraInfo
) -> ImuCalibration | None:
    """Return the IMU's calibration by ``tf_static``; None if its pose is not there.

    A frame of images, z forward, is not an IMU's: headers that name one frame for both, or
    none, say nothing of its pose. Its noise is a consumer IMU's, because bags do not contain
    it.
    """
    if not content.imu_ns:
        return None
    image = content.decoder.decoded(content.images[topics.left][0])
    if frame_name(image.header.frame_id) == frame_name(content.imu_frame):
        return None
    T_root_cam, camera_root = _from_root(content, image.header.frame_id)
    T_root_imu, imu_root = _from_root(content, content.imu_frame)
    if camera_root != imu_root:
        return None
    # R rotates from the camera's own frame to the frame of its rectified images.
    T_rect_cam = se3.from_parts(left_info.R, np.zeros(3))
    return mems_imu(T_rect_cam @ se3.inverse(T_root_cam) @ T_root_imu)


def _from_root(content: _Content, frame: str) -> tuple[FloatArray, str]:
    """Return T_root_frame, [4, 4], and the name of the root of the frame's tree."""
    T_root_frame = np.eye(4)
    name = frame_name(frame)
    seen = {name}
    while name in content.transforms:
        name, T_parent_child = content.transforms[name]
        T_root_frame = T_parent_child @ T_root_frame
        if name in seen:  # a faulty tree with a loop
            return T_root_frame, f"{name} in a loop of {frame}"
        seen.add(name)
    return T_root_frame, name


def _truth(
    content: _Content,
    topics: StereoTopics,
    options: RosbagOptions,
    stamps_ns: IntArray,
    *,
    imu: ImuCalibration | None,
    C_rect_left: FloatArray,
) -> GroundTruth | None:
    """Return the truth of a file or of a topic at the frames; None without any.

    Raises:
        InputError: the poses are faulty, cover no frame, or are those of an unknown body.
    """
    if options.truth is not None:
        return truth_of_file(options.truth, stamps_ns, truth_of=options.truth_of, imu=imu)
    if content.truth is None:
        return None
    if content.faulty_truth is not None:
        raise content.faulty_truth
    poses_ns, T_world_body = content.truth.arrays()
    T_body_cam = _body_from_camera(
        content, content.truth, topics, truth_of=options.truth_of, imu=imu, C_rect_left=C_rect_left
    )
    return truth_at(stamps_ns, poses_ns, T_world_body @ T_body_cam, where=content.truth.where)


def _empty_truth(path: Path, topic: str, type_name: str, options: RosbagOptions) -> TruthPoses:
    """Return what collects the true poses of a topic.

    Raises:
        InputError: the topic has the poses of many frames, and none is named.
    """
    where = f"{path}: {topic}"
    child = None if options.truth_of in (None, CAMERA, IMU) else options.truth_of
    if type_name in TRANSFORM_TYPES and child is None:
        what = "it has the transforms of many frames."
        raise InputError(where, what, "Name the frame whose poses are the truth: --truth-of.")
    return TruthPoses(where, child=None if child is None else frame_name(child))


def _body_from_camera(
    content: _Content,
    poses: TruthPoses,
    topics: StereoTopics,
    *,
    truth_of: str | None,
    imu: ImuCalibration | None,
    C_rect_left: FloatArray,
) -> FloatArray:
    """Return T_body_cam, [4, 4], m, of the body whose poses are the truth; rectified left camera.

    Raises:
        InputError: neither a setting nor ``tf_static`` gives the pose of the body in the camera.
    """
    if truth_of == CAMERA:
        return np.eye(4)
    if truth_of == IMU:
        return imu_from_camera(imu, poses.where)
    body = poses.child or poses.named
    image = content.decoder.decoded(content.images[topics.left][0])
    T_root_cam, camera_root = _from_root(content, image.header.frame_id)
    T_root_body, body_root = _from_root(content, body)
    if not body or camera_root != body_root:
        frame = f"the frame {body}" if body else "a frame that it does not name"
        what = (
            f"its poses are those of {frame}, and tf_static does not have the camera's pose in it."
        )
        for root in (camera_root, body_root):
            if root in content.faulty_transforms:
                what += f" Its transform of {root}: {content.faulty_transforms[root].what}"
        cure = "Say whose poses they are: --truth-of camera, imu, or a frame of tf_static."
        raise InputError(poses.where, what, cure)
    T_cam_rect = se3.from_parts(C_rect_left.T, np.zeros(3))
    return se3.inverse(T_root_body) @ T_root_cam @ T_cam_rect


def _imu_stream(
    content: _Content,
    topics: StereoTopics,
    imu: ImuCalibration,
    frames_ns: IntArray,
    path: Path,
) -> ImuStream | None:
    """Return the IMU's samples on the clock of the images; None if the bag has none.

    Raises:
        InputError: there are too few samples, they are on another clock, or none has an angular
            rate.
    """
    if not content.imu_ns:
        return None
    where = f"{path}: {topics.imu}"
    # Some drivers occasionally send two samples with the same stamp: use the first of them.
    stamps_ns, first = np.unique(np.array(content.imu_ns, dtype=np.int64), return_index=True)
    values = np.array(content.imu_values)[first]
    gyro_rad_s = values[:, :3]
    accel_m_s2 = values[:, 3:]
    if not _is_measured(gyro_rad_s):
        what = "it has no angular rates: all of them are zero, or said to be unknown."
        if _is_measured(accel_m_s2):
            what += " It is the topic of an accelerometer."
        raise InputError(where, what, "Name the topic of the gyro with --topics.imu.")
    if not _is_measured(accel_m_s2):
        accel_m_s2 = np.full_like(accel_m_s2, np.nan)
    return ImuStream.checked(
        imu.on_image_clock(stamps_ns),
        gyro_rad_s=gyro_rad_s,
        accel_m_s2=accel_m_s2,
        frames_ns=frames_ns,
        where=where,
    )


def _is_measured(vectors: FloatArray) -> bool:
    """Return whether a sensor measured any of the vectors, [J, 3]; NaN where not recorded.

    Drivers fill with zeros what they do not measure. The noise of a sensor is never zero throughout
    a recording.
    """
    return bool(np.nan_to_num(vectors).any())


def _not_used(topic: str | None, error: InputError) -> str:
    """Return the text of a note on a topic that the user did not name, and that is faulty."""
    return f"{topic} is not used: {error.what} {error.cure}".rstrip()


def _notes(
    content: _Content,
    topics: StereoTopics,
    pairs: StampPairs,
    *,
    options: RosbagOptions,
    imu: ImuCalibration | None,
) -> tuple[tuple[str, str], ...]:
    """Return what ``info`` reports on the topics, the pairs, the transforms and the IMU."""
    largest_ms = 1e-6 * float(np.abs(pairs.offsets_ns).max())
    num_left = len(content.left_ns) - len(pairs)
    num_right = len(content.right_ns) - len(pairs)
    notes = [
        ("topics", f"{topics.left} and {topics.right}"),
        (
            "pairs" if num_left + num_right == 0 else "! pairs",
            f"{len(pairs)}, stamps at most {largest_ms:.3f} ms apart (within"
            f" {options.pair_tolerance_ms:g} ms); without a partner: {num_left} left,"
            f" {num_right} right",
        ),
    ]
    for child, error in content.faulty_transforms.items():
        text = _not_used(f"the transform of {child}", error)
        notes.append(("! tf_static", text))
    if topics.candidate_imus:
        text = (
            f"none is used: several topics are IMUs: {', '.join(topics.candidate_imus)}. Name one"
            " with --topics.imu."
        )
        notes.append(("! IMU", text))
    if content.imu_ns and imu is None:
        calibrated_by = "tf_static" if options.calibration is None else options.calibration
        text = (
            f"{topics.imu} is not used: {calibrated_by} does not have its pose in the camera's"
            " frame. Give a Kalibr camchain with T_cam_imu as --calibration."
        )
        notes.append(("! IMU", text))
    return tuple(notes)
