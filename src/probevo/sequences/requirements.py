"""What the settings of the odometry require of a recording."""

from __future__ import annotations

from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.sequences.base import Sequence


def check_imu(sequence: Sequence, config: OdometryConfig) -> None:
    """Refuse settings that require an IMU where the recording has none.

    Raises:
        InputError: names the settings.
    """
    requiring = []
    if config.gyro.prior:
        requiring.append("--gyro.prior")
    if config.ransac.rotation_from == "gyro":
        requiring.append("--ransac.rotation-from gyro")
    if sequence.imu is None and requiring:
        raise InputError(
            " and ".join(requiring),
            f"the recording {sequence.path} has no IMU.",
            "Leave it out, or set it back in the file of --config.",
        )
