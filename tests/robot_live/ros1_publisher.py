"""A robot's drivers in a process of their own: publishes a recorded scene on a ROS 1 graph, as its settings say.

Run by Debian's Python, which has rospy and no numpy. The settings are one JSON object as the only argument. Says one JSON
object at the end: how many of each were published.
"""

import json
import sys
import time
from pathlib import Path

import genpy
import genpy.dynamic
import rospy
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import String

HEADER = "\n".join(["=" * 80, "MSG: std_msgs/Header", "uint32 seq", "time stamp", "string frame_id", ""])
TAGS = "\n".join(
    [
        "Header header",
        "Tag[] tags",
        "=" * 80,
        "MSG: ward_msgs/Tag",
        "string epc",
        "uint8 antenna",
        "float32 rssi_dbm",
        "uint16 range_mm",
        "time seen",
        HEADER,
    ]
)
OTHER_TAGS = TAGS.replace("uint16 range_mm", "float32 range_mm\nuint32 read_count")
"""The same type's name after its owner changed it: another md5."""

WAIT_S = 30.0
FLUSH_S = 0.5


def tag_class(text):
    return genpy.dynamic.generate_dynamic("ward_msgs/TagArray", text)


class Drivers:
    def __init__(self, settings):
        self.settings = settings
        self.offset_s = settings.get("clock_offset_s", 0.0)
        self.scene = json.loads(Path(settings["scene"]).read_text(encoding="utf-8"))
        self.frames = Path(self.scene["frames"]).read_bytes()
        made = tag_class(OTHER_TAGS if settings.get("other_tags") else TAGS)
        self.array, self.tag = made["ward_msgs/TagArray"], made["ward_msgs/Tag"]
        self.depth = rospy.Publisher(settings.get("depth", "/kinect/depth/image"), Image, queue_size=300)
        self.tags = rospy.Publisher(
            "/rfid", String if settings.get("tags_are_text") else self.array, queue_size=100_000
        )
        self.info = rospy.Publisher("/kinect/depth/camera_info", CameraInfo, queue_size=1, latch=True)
        self.counts = {"frames": 0, "tag_messages": 0, "readings": 0}

    def wait_for_robot(self):
        ends = time.monotonic() + WAIT_S
        while not (self.depth.get_num_connections() and self.tags.get_num_connections()):
            if time.monotonic() > ends:
                sys.exit("nobody subscribes")
            time.sleep(0.02)

    def image(self, index, at_s):
        width, height = self.scene["width"], self.scene["height"]
        size = 2 * width * height
        image = Image(height=height, width=width, encoding="16UC1", is_bigendian=0, step=2 * width)
        image.header.stamp = self.stamp(at_s)
        image.data = self.frames[index * size : (index + 1) * size]
        for name, value in self.settings.get("image", {}).items():
            setattr(image, name, value)
        image.data += bytes(self.settings.get("more_bytes", 0))
        return image

    def stamp(self, at_s):
        if self.settings.get("stamps") == "equal":
            at_s = self.began_s
        elif self.settings.get("stamps") == "backwards":
            at_s = 2 * self.began_s - at_s
        return genpy.Time.from_sec(max(0.0, at_s + self.offset_s))

    def array_of(self, readings, at_s):
        if self.settings.get("tags_are_text"):
            return String(data=readings[0]["uid"])
        array = self.array()
        array.header.stamp = self.stamp(at_s)
        for reading in readings:
            tag = self.tag(epc=reading["uid"], antenna=reading["antenna"], rssi_dbm=reading.get("rssi_dbm", -50.0))
            tag.range_mm = round(1000 * reading["distance_m"])
            tag.seen = self.stamp(at_s)
            array.tags.append(tag)
        return array

    def publish(self, events):
        """Publish (seconds from now, frame's index or readings) as they come due."""
        begin, began = time.monotonic(), time.time()
        self.began_s = began
        for at_s, what in events:
            left = begin + at_s - time.monotonic()
            if left > 0:
                time.sleep(left)
            if rospy.is_shutdown():
                return
            if isinstance(what, int):
                self.depth.publish(self.image(what, began + at_s))
                self.counts["frames"] += 1
            else:
                self.tags.publish(self.array_of(what, began + at_s))
                self.counts["tag_messages"] += 1
                self.counts["readings"] += len(what)

    def timeline(self):
        """The scene at `rate` frames a second for `seconds`, back and forth, with its tag read `reads_per_s` times."""
        rate, seconds = self.settings["rate"], self.settings["seconds"]
        count = self.scene["count"]
        laps = [*range(count), *range(count - 2, 0, -1)]
        events = [(i / rate, laps[i % len(laps)]) for i in range(round(rate * seconds))]
        reads = self.settings.get("reads_per_s", 5)
        for i in range(round(reads * seconds)):
            index = laps[round(i / reads * rate) % len(laps)]
            events.append(
                (i / reads, [reading | {"uid": self.scene["uid"]} for reading in [self.scene["readings"][index]]])
            )
        for i in range(round(self.settings.get("storm_per_s", 0) * seconds / 10)):
            ten = [{"uid": f"STORM{(10 * i + j) % 400:04}", "antenna": 1, "distance_m": 2.0} for j in range(10)]
            events.append((10 * i / self.settings["storm_per_s"], ten))
        return sorted(events, key=lambda event: (event[0], isinstance(event[1], int)))


def main():
    settings = json.loads(sys.argv[1])
    rospy.init_node(settings.get("node", "drivers"), disable_rosout=True)
    drivers = Drivers(settings)
    info = CameraInfo()
    focal = drivers.scene["focal_px"]
    info.K = [focal, 0, 0, 0, focal, 0, 0, 0, 1]
    drivers.info.publish(info)
    if settings.get("wait", True):
        drivers.wait_for_robot()
    drivers.publish(drivers.timeline())
    time.sleep(FLUSH_S)
    sys.stdout.write(json.dumps(drivers.counts) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
