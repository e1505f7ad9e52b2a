"""The choice of a bag's topics: left and right images, their CameraInfo, IMU, and true poses."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from probevo.errors import InputError
from probevo.sequences.formats.rosbag_file import (
    IMAGE_TYPES,
    IMU_TYPE,
    INFO_TYPE,
    POSE_TYPES,
    TRANSFORM_TYPES,
    Topic,
)

SIDES = (
    ("left", "right"),
    ("infra1", "infra2"),
    *((f"{word}0", f"{word}1") for word in ("cam", "camera", "image")),
    *((f"{word}_0", f"{word}_1") for word in ("cam", "camera", "image")),
)
"""What a left topic is called, and what its right partner has in that place."""
TRANSPORTS = ("compressed",)
"""Last parts of a topic's name that name how its images are sent."""
MAX_LISTED = 20
"""Topics that a message lists; more only if all of them have a type that is read."""
TRUTH_NAMES = ("ground_truth", "groundtruth", "gt")
"""Parts of the name of a topic of poses that is taken for the truth without being named."""


@dataclass(frozen=True)
class NamedTopics:
    """The topics that the user named; None where the bag has to tell."""

    left: str | None = None
    right: str | None = None
    left_info: str | None = None
    right_info: str | None = None
    imu: str | None = None
    truth: str | None = None


@dataclass(frozen=True)
class StereoTopics:
    """The topics that are read."""

    left: str
    right: str
    left_info: str | None
    """None if the bag has no CameraInfo of this camera."""
    right_info: str | None
    imu: str | None
    """None if the bag has no IMU, or several of which none is named."""
    candidate_imus: tuple[str, ...]
    """The topics of several IMUs of which none is named; they are not read."""
    truth: str | None
    """True poses; None if no topic has them."""
    static_transforms: tuple[str, ...]
    """Topics ``tf_static``, which may have the pose of the IMU."""

    @property
    def all(self) -> tuple[str, ...]:
        """Names of all topics that are read."""
        named = (self.left, self.right, self.left_info, self.right_info, self.imu, self.truth)
        return (*(name for name in named if name is not None), *self.static_transforms)


def choose_topics(path: Path, topics: dict[str, Topic], named: NamedTopics) -> StereoTopics:
    """Return the topics to read: those that the user named, or else those that are unique.

    Raises:
        InputError: there is no such topic, it has another type, or the bag has no stereo images or
            several candidates; lists the topics.
    """
    filled = {name: topic for name, topic in topics.items() if topic.count > 0}
    for option, name in vars(named).items():
        if name is not None:
            types = _types_of(option)
            _check_named(path, filled, name, option=option, types=types)
    left, right = _stereo_pair(path, filled, named)
    imus = tuple(topic.name for topic in filled.values() if topic.type == IMU_TYPE)
    return StereoTopics(
        left=left,
        right=right,
        left_info=named.left_info or _camera_info(filled, left),
        right_info=named.right_info or _camera_info(filled, right),
        imu=named.imu or (imus[0] if len(imus) == 1 else None),
        candidate_imus=imus if named.imu is None and len(imus) > 1 else (),
        truth=named.truth or _only_truth(filled),
        static_transforms=tuple(
            topic.name
            for topic in filled.values()
            if topic.type in TRANSFORM_TYPES and topic.name.endswith("tf_static")
        ),
    )


def topic_list(topics: Iterable[Topic]) -> str:
    """Return the topics with types and counts, for messages; those that may be read first."""
    ranks = [*IMAGE_TYPES, INFO_TYPE, IMU_TYPE, *POSE_TYPES, *TRANSFORM_TYPES]
    ordered = sorted(topics, key=lambda topic: (_rank(topic.type, ranks), topic.name))
    num_read = sum(topic.type in ranks for topic in ordered)
    num_listed = max(num_read, MAX_LISTED)
    lines = [_described(topic) for topic in ordered[:num_listed]]
    if len(ordered) > num_listed:
        lines.append(f"… and {len(ordered) - num_listed} more, of types that are not read")
    return "\n         ".join(["Its topics are:", *lines]) if lines else "It has no topics."


def _rank(kind: str, ranks: list[str]) -> int:
    """Return the place of a type among those that are read; behind them all if it is not read."""
    return ranks.index(kind) if kind in ranks else len(ranks)


def _described(topic: Topic) -> str:
    """Return name, type and number of messages of a topic."""
    noun = "message" if topic.count == 1 else "messages"
    return f"{topic.name} ({topic.type}, {topic.count} {noun})"


def _types_of(option: str) -> tuple[str, ...]:
    """Return the types that the topic of an option may have."""
    if option == "imu":
        return (IMU_TYPE,)
    if option == "truth":
        return (*POSE_TYPES, *TRANSFORM_TYPES)
    return (INFO_TYPE,) if option.endswith("info") else IMAGE_TYPES


def _check_named(
    path: Path, topics: dict[str, Topic], name: str, *, option: str, types: tuple[str, ...]
) -> None:
    """Refuse a name that is no topic of the type that its option needs.

    Raises:
        InputError: says which.
    """
    flag = f"--topics.{option.replace('_', '-')} {name}"
    if name not in topics:
        what = f"{flag}: there is no such topic, or it has no messages."
        raise InputError(path, what, topic_list(topics.values()))
    if topics[name].type not in types:
        what = f"{flag}: its type is {topics[name].type}; expected {' or '.join(types)}."
        raise InputError(path, what, topic_list(topics.values()))


def _stereo_pair(path: Path, topics: dict[str, Topic], named: NamedTopics) -> tuple[str, str]:
    """Return the topics of the left and right images.

    Raises:
        InputError: there are no two image topics, or their names do not tell which are meant.
    """
    if named.left is not None and named.right is not None:
        return named.left, named.right
    images = [topic.name for topic in topics.values() if topic.type in IMAGE_TYPES]
    pairs = [
        (left, right)
        for left in images
        for right in images
        if _is_partner(left, right) and named.left in (None, left) and named.right in (None, right)
    ]
    if len(pairs) == 1:
        return pairs[0]
    listed = topic_list(topics.values())
    if len(images) < 2:
        found = f"one topic of images ({images[0]})" if images else "no topic of images"
        what = f"this bag has {found}; stereo odometry needs a left and a right one."
        raise InputError(path, what, listed)
    if pairs:
        names = "; ".join(f"{left} and {right}" for left, right in pairs)
        what = f"several topics could be the stereo images: {names}."
    else:
        what = "no two topics of images are named like left and right."
    cure = f"Name them with --topics.left and --topics.right. {listed}"
    raise InputError(path, what, cure)


def _is_partner(left: str, right: str) -> bool:
    """Return whether two names differ in the word for the side only."""
    return left != right and any(
        left_word in left and left.replace(left_word, right_word) == right
        for left_word, right_word in SIDES
    )


def _camera_info(topics: dict[str, Topic], images: str) -> str | None:
    """Return the CameraInfo beside a topic of images: ``camera_info`` in the same namespace."""
    parts = images.split("/")
    if parts[-1] in TRANSPORTS:
        parts.pop()
    name = "/".join([*parts[:-1], "camera_info"])
    return name if name in topics and topics[name].type == INFO_TYPE else None


def _only_truth(topics: dict[str, Topic]) -> str | None:
    """Return the only topic of poses that is called ground truth; None if there is none.

    Other poses may be those of wheels or of another odometry: these have to be named.
    """
    names = [
        topic.name
        for topic in topics.values()
        if topic.type in POSE_TYPES and set(topic.name.lower().split("/")) & set(TRUTH_NAMES)
    ]
    return names[0] if len(names) == 1 else None
