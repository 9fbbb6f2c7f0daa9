"""A robot's drivers in a process of their own: publishes depth and tag readings on a ROS 2 graph, as its settings say.

The settings are one JSON object as the only argument; `acts` are changes to frames, one after the other. Says
`up`, and one JSON object at the end: how many of each were published. SIGTERM makes it take its leave, SIGKILL does not.
"""

import array
import json
import signal
import sys
import time
from pathlib import Path

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String

from clients.robot.sources.live import ros2_types

WAIT_S = 60.0
FLUSH_S = 0.5
WIDTH, HEIGHT = 640, 480
TAGS = "ward_msgs/msg/TagArray"


class Talker:
    def __init__(self, settings):
        self.settings = settings
        self.act = {}
        scene = settings.get("scene")
        self.scene = json.loads(Path(scene).read_text(encoding="utf-8")) if scene else None
        self.pixels = Path(self.scene["frames"]).read_bytes() if scene else bytes(range(256)) * (WIDTH * HEIGHT // 128)
        self.node = rclpy.create_node(settings.get("node", "drivers"))
        reliable = settings.get("reliable", True)
        chosen = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        self.qos = QoSProfile(depth=50, reliability=chosen)
        depth = settings.get("depth", "/kinect/depth/image")
        self.depth = self.node.create_publisher(
            Image if not settings.get("text_for_depth") else String, depth, self.qos
        )
        self.tags = self.make_tags()
        self.info = self.node.create_publisher(CameraInfo, "/kinect/depth/camera_info", 10)
        self.counts = {"frames": 0, "tag_messages": 0}

    def make_tags(self):
        if self.settings.get("tags") is None:
            return None
        if self.settings["tags"] == "text":
            return self.node.create_publisher(String, "/rfid", self.qos)
        import ward_msgs.msg

        found = ros2_types.definition_of(TAGS, ward_msgs.msg.TagArray)
        self.store = get_typestore(Stores.EMPTY)
        self.store.register(get_types_from_msg(found, TAGS))
        ward_msgs.msg.HASH = self.settings.get("tags_hash") or self.store.hash_rihs01(TAGS).removeprefix("RIHS01_")
        return self.node.create_publisher(ward_msgs.msg.TagArray, "/rfid", self.qos)

    def wait_for_robot(self):
        ends = time.monotonic() + WAIT_S
        wanted = [publisher for publisher in (self.depth, self.tags) if publisher is not None]
        while not all(publisher.get_subscription_count() for publisher in wanted):
            if time.monotonic() > ends:
                sys.exit("nobody subscribes")
            time.sleep(0.02)

    def publish_frame(self, index):
        self.counts["frames"] += 1
        if self.settings.get("text_for_depth"):
            self.depth.publish(String(data="no picture"))
            return
        if "raw" in self.act:
            self.depth.publish(bytes.fromhex(self.act["raw"]))
            return
        width, height = (self.scene["width"], self.scene["height"]) if self.scene else (WIDTH, HEIGHT)
        size = 2 * width * height
        image = Image(height=height, width=width, encoding="16UC1", step=2 * width)
        image.header.stamp = self.node.get_clock().now().to_msg()
        start = index * size if self.scene else 0
        image.data = array.array("B", self.pixels[start : start + size])
        for name, value in self.act.get("image", {}).items():
            setattr(image, name, value)
        self.depth.publish(image)
        self.info.publish(CameraInfo(k=self.k()))

    def k(self):
        focal = float(self.scene["focal_px"]) if self.scene else 525.0
        return [focal, 0.0, WIDTH / 2, 0.0, focal, HEIGHT / 2, 0.0, 0.0, 1.0]

    def publish_tag(self, index):
        self.counts["tag_messages"] += 1
        if self.settings["tags"] == "text":
            self.tags.publish(String(data="E200000000000001"))
            return
        types, now = self.store.types, time.time_ns()
        stamp = types["builtin_interfaces/msg/Time"](sec=now // 10**9, nanosec=now % 10**9)
        read = self.scene["readings"][index] if self.scene else {"antenna": 1, "distance_m": 2.0}
        tag = types["ward_msgs/msg/Tag"](
            epc=self.scene["uid"] if self.scene else "E200000000000001",
            antenna=read["antenna"],
            rssi_dbm=read.get("rssi_dbm", -50.0),
            range_mm=round(1000 * read["distance_m"]),
            seen=stamp,
        )
        header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="reader")
        self.tags.publish(bytes(self.store.serialize_cdr(types[TAGS](header=header, tags=[tag]), TAGS)))

    def run(self):
        """Publish at `rate` frames a second for `seconds`, a scene back and forth, its tag `reads_per_s` times."""
        rate, seconds, reads = (
            self.settings.get("rate", 30),
            self.settings["seconds"],
            self.settings.get("reads_per_s", 5),
        )
        count = self.scene["count"] if self.scene else 1
        laps = [*range(count), *range(count - 2, 0, -1)]
        events = [(i / rate, self.publish_frame, laps[i % len(laps)]) for i in range(round(rate * seconds))]
        if self.tags is not None:
            times = [i / reads for i in range(round(reads * seconds))]
            events += [(at_s, self.publish_tag, laps[round(at_s * rate) % len(laps)]) for at_s in times]
        begin = time.monotonic()
        for at_s, publish, index in sorted(events, key=lambda event: event[0]):
            time.sleep(max(0.0, begin + at_s - time.monotonic()))
            publish(index)


def main():
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    talker = Talker(json.loads(sys.argv[1]))
    sys.stdout.write("up\n")
    sys.stdout.flush()
    try:
        if talker.settings.get("wait", True):
            talker.wait_for_robot()
        for act in talker.settings.get("acts", [{}]):
            talker.act = act
            talker.run()
        time.sleep(FLUSH_S)
        sys.stdout.write(json.dumps(talker.counts) + "\n")
        sys.stdout.flush()
    finally:
        talker.node.destroy_node()
        rclpy.shutdown()


if __name__ == "__main__":
    main()
