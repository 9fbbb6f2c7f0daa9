"""CDR encoding of frames (sensor_msgs/Image, 16UC1) and sightings (RfidDetection)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from clients.robot.sensing.sensor_events import NS_PER_MS, Depth, Sighting

IMAGE_TYPE = "sensor_msgs/msg/Image"
SIGHTING_TYPE = "blockrobot_msgs/msg/RfidDetection"
SIGHTING_DEFINITION = """\
# One reading of an RFID tag. Times of first and last seen are the reader's; the header's stamp is the host's.
std_msgs/Header header
string epc
uint32 antenna
string antenna_facing
float32 rssi
float32 distance
float32 distance_sigma
builtin_interfaces/Time first_seen
builtin_interfaces/Time last_seen
uint32 read_count
"""
MS_PER_S = 1000


def typestore() -> Typestore:
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(SIGHTING_DEFINITION, SIGHTING_TYPE))
    return store


class MessageCodec:
    """Encodes both message types."""

    def __init__(self) -> None:
        self.store = typestore()
        types = self.store.types
        self._image: Any = types[IMAGE_TYPE]
        self._sighting: Any = types[SIGHTING_TYPE]
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

    def _stamped(self, at_ms: int, frame_id: str) -> Any:
        return self._header(self._stamp(at_ms), frame_id)

    def _stamp(self, at_ms: int) -> Any:
        return self._time(at_ms // MS_PER_S, at_ms % MS_PER_S * NS_PER_MS)
