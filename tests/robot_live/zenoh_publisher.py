"""A robot's ROS 2 drivers as Zenoh sees them, in a process of their own: publishes a recorded scene as `rmw_zenoh` would.

The settings are one JSON object as the only argument; with `router` it only routes, as `rmw_zenohd` does. Says one JSON
object at the end: how many of each were published.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import zenoh
from rosbags.typesys import get_types_from_msg
from zenoh.ext import Int64, z_serialize

from clients.robot.sensing.message_names import IMAGE_TYPE, SIGHTING_TYPE
from clients.robot.sensing.sensor_events import Facing, Sighting
from clients.robot.synthetic.bag_messages import MessageCodec

WAIT_S = 30.0
FLUSH_S = 0.5
INFO_TYPE = "sensor_msgs/msg/CameraInfo"
STRING_TYPE = "std_msgs/msg/String"
TYPES = {"depth": IMAGE_TYPE, "tags": SIGHTING_TYPE, "info": INFO_TYPE}
WARD_TAG = ("ward_msgs/msg/Tag", "std_msgs/Header header\nstring epc\nfloat32 range_m\n")


def open_session(mode: str, **endpoints: list[str]) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    for name in ("listen", "connect"):
        config.insert_json5(f"{name}/endpoints", json.dumps(endpoints.get(name, [])))
    return zenoh.open(config)


class Topic:
    """One publisher with its token and its numbers."""

    def __init__(
        self, session: zenoh.Session, name: str, type_name: str, type_hash: str, settings: dict[str, Any]
    ) -> None:
        package, _, kind = type_name.split("/")
        mangled = f"{package}::msg::dds_::{kind}_"
        domain = settings.get("domain", 0)
        self.publisher = session.declare_publisher(
            f"{domain}/{name.lstrip('/')}/{mangled}/{type_hash}", congestion_control=zenoh.CongestionControl.BLOCK
        )
        self.number = 0
        self.gid = name.encode().ljust(16, b"\0")[:16]
        self.skip_every = settings.get("skip_every", 0)
        self.numbered = settings.get("numbered", True)
        place = f"{session.zid()}/0/{len(name)}/MP/%/%/drivers/{name.replace('/', '%')}"
        token = f"@ros2_lv/{domain}/{place}/{mangled}/{type_hash}/::,10:,:,:,,"
        self.token = session.liveliness().declare_token(token) if settings.get("announce", True) else None

    def put(self, data: bytes) -> None:
        self.number += 1
        if self.skip_every and self.number % self.skip_every == 0:
            return
        told = z_serialize((Int64(self.number), Int64(time.time_ns()), self.gid)) if self.numbered else None
        self.publisher.put(data, attachment=told)


class Drivers:
    def __init__(self, session: zenoh.Session, settings: dict[str, Any]) -> None:
        self.settings = settings
        self.scene = json.loads(Path(settings["scene"]).read_text(encoding="utf-8"))
        shape = (self.scene["count"], self.scene["height"], self.scene["width"])
        self.frames = np.fromfile(self.scene["frames"], dtype=np.uint16).reshape(shape)
        self.codec = MessageCodec()
        self.store: Any = self.codec.store
        self.store.register(get_types_from_msg(WARD_TAG[1], WARD_TAG[0]))
        types = {**TYPES, **settings.get("types", {})}
        names = {"depth": "/camera/depth/image_raw", "tags": "/rfid/sightings", "info": "/camera/depth/camera_info"}
        hashes = {what: self.store.hash_rihs01(kind) for what, kind in types.items()} | settings.get("hashes", {})
        wanted = settings.get("only", list(names))
        self.types = types
        self.topics = {what: Topic(session, names[what], types[what], hashes[what], settings) for what in wanted}
        self.counts = {"frames": 0, "readings": 0}

    def wait_for_robot(self) -> None:
        ends = time.monotonic() + WAIT_S
        while not all(topic.publisher.matching_status.matching for topic in self.topics.values()):
            if time.monotonic() > ends:
                sys.exit("nobody subscribes")
            time.sleep(0.02)

    def image(self, index: int, at_ms: int) -> bytes:
        if self.types["depth"] == STRING_TYPE:
            return self.text("no image at all")
        variants = self.settings.get("images", [{}])
        told = variants[self.counts["frames"] % len(variants)]
        data = bytes(self.codec.encode_image(self.frames[index], at_ms))
        if not told:
            return data
        message = self.store.deserialize_cdr(data, IMAGE_TYPE)
        for name, value in told.items():
            object.__setattr__(message, name, value)
        return bytes(self.store.serialize_cdr(message, IMAGE_TYPE))

    def text(self, data: str) -> bytes:
        return bytes(self.store.serialize_cdr(self.store.types[STRING_TYPE](data), STRING_TYPE))

    def reading(self, told: dict[str, Any], at_ms: int) -> bytes:
        if self.types["tags"] == WARD_TAG[0]:
            kinds = self.store.types
            stamp = kinds["builtin_interfaces/msg/Time"](at_ms // 1000, at_ms % 1000 * 1_000_000)
            message = kinds[WARD_TAG[0]](kinds["std_msgs/msg/Header"](stamp, ""), self.scene["uid"], told["distance_m"])
            return bytes(self.store.serialize_cdr(message, WARD_TAG[0]))
        facing = Facing.FRONT if told["antenna"] == 1 else Facing.BACK
        sighting = Sighting(
            at_ms,
            at_ms,
            self.scene["uid"],
            told["antenna"],
            facing,
            told.get("rssi_dbm", -50.0),
            told["distance_m"],
            0.1,
            received_at_ms=at_ms,
        )
        return bytes(self.codec.encode_sighting(sighting, at_ms))

    def tell_focal(self) -> None:
        if "info" in self.topics:
            info = self.store.types[INFO_TYPE]
            kinds = self.store.types
            focal, none = self.scene["focal_px"], np.zeros(9)
            message = info(
                *(self.codec._stamped(0, ""), self.scene["height"], self.scene["width"], "plumb_bob", np.zeros(5)),
                *(np.array([focal, 0, 0, 0, focal, 0, 0, 0, 1.0]), none, np.zeros(12), 0, 0),
                kinds["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
            )
            self.topics["info"].put(bytes(self.store.serialize_cdr(message, INFO_TYPE)))

    def publish(self) -> None:
        """The scene at `rate` frames a second for `seconds`, back and forth, with its tag read `reads_per_s` times."""
        rate, seconds, reads = self.settings["rate"], self.settings["seconds"], self.settings.get("reads_per_s", 5)
        laps = [*range(self.scene["count"]), *range(self.scene["count"] - 2, 0, -1)]
        timeline = [(i / rate, "depth", laps[i % len(laps)]) for i in range(round(rate * seconds))]
        timeline += [
            (i / reads, "tags", laps[round(i / reads * rate) % len(laps)]) for i in range(round(reads * seconds))
        ]
        timeline += [(float(second), "info", 0) for second in range(int(seconds))]
        begin, began_ms = time.monotonic(), time.time_ns() // 1_000_000
        for at_s, what, index in sorted(timeline):
            if what not in self.topics:
                continue
            time.sleep(max(0.0, begin + at_s - time.monotonic()))
            at_ms = began_ms + round(1000 * at_s)
            if what == "depth":
                self.topics[what].put(self.image(index, at_ms))
                self.counts["frames"] += 1
            elif what == "tags":
                self.topics[what].put(self.reading(self.scene["readings"][index], at_ms))
                self.counts["readings"] += 1
            else:
                self.tell_focal()


def main() -> None:
    settings = json.loads(sys.argv[1])
    where = f"tcp/127.0.0.1:{settings['port']}"
    if settings.get("router"):
        with open_session("router", listen=[where]):
            time.sleep(3_600)
        return
    with open_session("peer", connect=[where]) as session:
        drivers = Drivers(session, settings)
        if settings.get("wait", True):
            drivers.wait_for_robot()
        drivers.publish()
        time.sleep(FLUSH_S)
    sys.stdout.write(json.dumps(drivers.counts) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
