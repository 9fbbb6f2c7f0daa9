"""The ROS messages a robot reads, as bytes: sensor_msgs/Image (16UC1) and our own RfidDetection.

Turns CDR into `Frame` and `Sighting` and back. Must never trust a message: size, encoding and step are checked.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from clients.robot.events import Depth, Facing, Frame, Sighting, check_depth
from consensus.errors import BlockRobotError

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
EPC_MAX_CHARS = 64
MS_PER_S = 1000
NS_PER_MS = 1_000_000


def typestore() -> Typestore:
    """Return the message types: ROS 2's own and RfidDetection."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(SIGHTING_DEFINITION, SIGHTING_TYPE))
    return store


class MessageCodec:
    """Encodes and decodes the two message types, with one typestore."""

    def __init__(self) -> None:
        self.store = typestore()
        types = self.store.types
        self._image: Any = types[IMAGE_TYPE]
        self._sighting: Any = types[SIGHTING_TYPE]
        self._header: Any = types["std_msgs/msg/Header"]
        self._time: Any = types["builtin_interfaces/msg/Time"]

    def encode_image(self, depth: Depth, at_ms: int) -> memoryview:
        """Return the CDR bytes of a 16UC1 image."""
        height, width = depth.shape
        data = np.ascontiguousarray(depth).view(np.uint8).reshape(-1)
        message = self._image(self._stamped(at_ms, "camera"), height, width, "16UC1", 0, width * 2, data)
        return self.store.serialize_cdr(message, IMAGE_TYPE)

    def encode_sighting(self, sighting: Sighting, at_ms: int) -> memoryview:
        """Return the CDR bytes of an RfidDetection; unknown distance is NaN."""
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

    def decode_image(self, data: bytes, sequence: int, shift_ms: int = 0, received_at_ms: int | None = None) -> Frame:
        """Return the frame of CDR bytes; raises FRAME_INVALID when size, encoding or step contradict each other."""
        message = self._decode(data, IMAGE_TYPE)
        if message.encoding not in ("16UC1", "mono16"):
            raise BlockRobotError(
                "FRAME_INVALID", f"Frame {sequence} is encoded as {message.encoding[:16]!r}, not 16UC1."
            )
        height, width, step = int(message.height), int(message.width), int(message.step)
        if step < width * 2 or step % 2 or len(message.data) != step * height or not height or not width:
            raise BlockRobotError(
                "FRAME_INVALID", f"Frame {sequence}: {width}x{height}, step {step}, {len(message.data)} B."
            )
        order = ">u2" if message.is_bigendian else "<u2"
        depth = np.frombuffer(message.data, dtype=order).reshape(height, step // 2)[:, :width]
        native = np.ascontiguousarray(depth).astype(np.uint16, copy=False)
        captured_at_ms = self._ms(message.header.stamp) + shift_ms
        return Frame(captured_at_ms, sequence, check_depth(native), received_at_ms)

    def decode_sighting(self, data: bytes, shift_ms: int = 0) -> Sighting:
        """Return the sighting of CDR bytes; raises BAG_DAMAGED when it makes no sense."""
        message = self._decode(data, SIGHTING_TYPE)
        first, last = self._ms(message.first_seen), self._ms(message.last_seen)
        if last < first or not message.epc or len(message.epc) > EPC_MAX_CHARS:
            raise BlockRobotError("BAG_DAMAGED", "A tag reading has no tag, or ends before it begins.")
        known = math.isfinite(message.distance) and math.isfinite(message.distance_sigma)
        usable = known and message.distance > 0 and message.distance_sigma > 0
        facing = message.antenna_facing
        return Sighting(
            first_seen_ms=first + shift_ms,
            last_seen_ms=last + shift_ms,
            uid=message.epc,
            antenna=int(message.antenna),
            facing=Facing(facing) if facing in tuple(Facing) else Facing.UNKNOWN,
            rssi_dbm=float(message.rssi),
            distance_m=float(message.distance) if usable else None,
            sigma_m=float(message.distance_sigma) if usable else None,
            read_count=int(message.read_count),
            received_at_ms=self._ms(message.header.stamp) + shift_ms,
        )

    def _decode(self, data: bytes, name: str) -> Any:
        try:
            return self.store.deserialize_cdr(data, name)
        except Exception as error:
            raise BlockRobotError("BAG_DAMAGED", f"A message of type {name} cannot be read.") from error

    def _stamped(self, at_ms: int, frame_id: str) -> Any:
        return self._header(self._stamp(at_ms), frame_id)

    def _stamp(self, at_ms: int) -> Any:
        return self._time(at_ms // MS_PER_S, at_ms % MS_PER_S * NS_PER_MS)

    @staticmethod
    def _ms(stamp: Any) -> int:
        return int(stamp.sec) * MS_PER_S + int(stamp.nanosec) // NS_PER_MS
