"""Reads where the robot says that it is: nav_msgs/Odometry, and transforms of tf and tf2."""

from __future__ import annotations

import math
from typing import Any

from clients.robot.sensing.message_names import ODOMETRY_TYPE
from clients.robot.sensing.sensor_events import Odometry
from clients.robot.sources.messages.field_map import header_ms
from clients.robot.sources.messages.image_decoding import refuse
from clients.robot.sources.messages.topics import OdometryTopic
from consensus.visible_text import printable

TRANSFORM_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
ODOMETRY_TYPES = (ODOMETRY_TYPE, *TRANSFORM_TYPES)
PLACE_MAX_M = 100_000.0
TRANSFORMS_MAX_COUNT = 1_000
ODOMETRY_MAX_BYTES = 300_000
"""Of a message: more than a thousand transforms take; decoding a larger one would hold up all others for seconds."""


def read_odometry(topic: OdometryTopic, content: Any, came_ms: int, *, stamped: bool) -> list[Odometry]:
    """Return where the robot is, by the message's stamp if `stamped`, else when it came; a message of tf may tell of other
    frames only.

    Raises FRAME_INVALID: other frames than the topics file names, or no finite numbers.
    """
    transforms = getattr(content, "transforms", None)
    if transforms is None:
        _check_frames(topic, content)
        parts = [(content, content.pose.pose.position, content.pose.pose.orientation)]
    else:
        wanted = _name(topic.parent), _name(topic.child)
        found = [one for one in transforms[:TRANSFORMS_MAX_COUNT] if frames_of(one) == wanted]
        parts = [(one, one.transform.translation, one.transform.rotation) for one in found]
    return [_odometry(*part, came_ms, stamped=stamped) for part in parts]


def frames_of(message: Any) -> tuple[str, str]:
    """Return from which frame to which a message speaks."""
    return _name(message.header.frame_id), _name(message.child_frame_id)


def _check_frames(topic: OdometryTopic, content: Any) -> None:
    found = frames_of(content)
    for wanted, name in zip((topic.parent, topic.child), found, strict=True):
        if wanted and _name(wanted) != name:
            told = " -> ".join(printable(name) for name in found)
            raise refuse("frame", f"The odometry is of {told}; the topics file names {printable(wanted)}.")


def _odometry(message: Any, position: Any, rotation: Any, came_ms: int, *, stamped: bool) -> Odometry:
    at_ms = header_ms(message) if stamped else None
    numbers = [float(value) for value in (position.x, position.y, rotation.x, rotation.y, rotation.z, rotation.w)]
    if not all(math.isfinite(number) and abs(number) < PLACE_MAX_M for number in numbers):
        raise refuse("field", "The odometry has no finite place.")
    ahead, left, x, y, z, w = numbers
    length = x * x + y * y + z * z + w * w
    if length < 0.5:
        raise refuse("field", "The odometry has no rotation: its quaternion is zero.")
    yaw = math.atan2(2 * (w * z + x * y), length - 2 * (y * y + z * z))
    return Odometry(came_ms if at_ms is None else at_ms, ahead, left, yaw)


def _name(frame_id: str) -> str:
    """Without the slash of old versions of tf."""
    return frame_id.removeprefix("/")
