"""CDR encoding of frames (sensor_msgs/Image, 16UC1), sightings (RfidDetection) and odometry (nav_msgs/Odometry)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from clients.robot.sensing.message_names import IMAGE_TYPE, ODOMETRY_TYPE, SIGHTING_TYPE, typestore
from clients.robot.sensing.sensor_events import NS_PER_MS, Depth, Odometry, Sighting

MS_PER_S = 1000
_GEOMETRY = ("Point", "Pose", "PoseWithCovariance", "Quaternion", "Twist", "TwistWithCovariance", "Vector3")


class MessageCodec:
    """Encodes the types of a recording."""

    def __init__(self) -> None:
        self.store = typestore()
        types = self.store.types
        self._image: Any = types[IMAGE_TYPE]
        self._sighting: Any = types[SIGHTING_TYPE]
        self._odometry: Any = types[ODOMETRY_TYPE]
        self._geometry = {name: types[f"geometry_msgs/msg/{name}"] for name in _GEOMETRY}
        self._header: Any = types["std_msgs/msg/Header"]
        self._time: Any = types["builtin_interfaces/msg/Time"]

    def encode_image(self, depth: Depth, at_ms: int) -> memoryview:
        height, width = depth.shape
        data = np.ascontiguousarray(depth).view(np.uint8).reshape(-1)
        message = self._image(self._stamped(at_ms, "camera"), height, width, "16UC1", 0, width * 2, data)
        return self.store.serialize_cdr(message, IMAGE_TYPE)

    def encode_sighting(self, sighting: Sighting, at_ms: int) -> memoryview:
        """Return an RfidDetection's CDR bytes; unknown distance is NaN."""
        message = self._sighting(
            self._stamped(at_ms, f"antenna_{sighting.antenna}"),
            sighting.uid,
            sighting.antenna,
            sighting.facing.value,
            sighting.rssi_dbm,
            math.nan if sighting.distance_m is None else sighting.distance_m,
            math.nan if sighting.sigma_m is None else sighting.sigma_m,
            self._stamp(sighting.first_seen_ms),
            self._stamp(sighting.last_seen_ms),
            sighting.read_count,
        )
        return self.store.serialize_cdr(message, SIGHTING_TYPE)

    def encode_odometry(self, odometry: Odometry) -> memoryview:
        """Return nav_msgs/Odometry's CDR bytes, from `odom` to `base_link`; its speeds are zero."""
        made = self._geometry
        turned = made["Quaternion"](0.0, 0.0, math.sin(odometry.yaw / 2), math.cos(odometry.yaw / 2))
        pose = made["Pose"](made["Point"](odometry.ahead_m, odometry.left_m, 0.0), turned)
        still = made["Vector3"](0.0, 0.0, 0.0)
        message = self._odometry(
            self._stamped(odometry.at_ms, "odom"),
            "base_link",
            made["PoseWithCovariance"](pose, np.zeros(36)),
            made["TwistWithCovariance"](made["Twist"](still, still), np.zeros(36)),
        )
        return self.store.serialize_cdr(message, ODOMETRY_TYPE)

    def _stamped(self, at_ms: int, frame_id: str) -> Any:
        return self._header(self._stamp(at_ms), frame_id)

    def _stamp(self, at_ms: int) -> Any:
        return self._time(at_ms // MS_PER_S, at_ms % MS_PER_S * NS_PER_MS)
