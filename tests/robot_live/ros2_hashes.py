"""Publishes on a topic of every message type that Python finds, and compares the hash that ROS 2 announces with ours."""

import importlib
import json
import sys
from pathlib import Path

import rclpy

from clients.robot.sources.live import ros2_types


def main():
    rclpy.init()
    node = rclpy.create_node("hashes")
    count, others = 0, []
    for folder in sorted(Path(rclpy.__file__).parents[1].glob("*/msg")):
        package = importlib.import_module(f"{folder.parent.name}.msg")
        for name in sorted(vars(package)):
            found = getattr(package, name)
            if not hasattr(found, "get_fields_and_field_types"):
                continue
            type_name = f"{folder.parent.name}/msg/{name}"
            topic = f"/{type_name}"
            publisher = node.create_publisher(found, topic, 1)
            announced = str(node.get_publishers_info_by_topic(topic)[0].topic_type_hash)
            node.destroy_publisher(publisher)
            count += 1
            if ros2_types.load(type_name).hash != announced:
                others.append(type_name)
    sys.stdout.write(json.dumps({"types": count, "others": others}) + "\n")
    rclpy.shutdown()


if __name__ == "__main__":
    main()
