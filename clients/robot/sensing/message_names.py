"""ROS types and topics of a recording in the project's own form, and the definition of its RFID message."""

from __future__ import annotations

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

DEPTH_TOPIC = "/camera/depth/image_raw"
EMPTY_TOPIC = "/camera/depth/empty"
ODOMETRY_TOPIC = "/odom"
SIGHTING_TOPIC = "/rfid/sightings"
IMAGE_TYPE = "sensor_msgs/msg/Image"
ODOMETRY_TYPE = "nav_msgs/msg/Odometry"
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


def typestore() -> Typestore:
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(SIGHTING_DEFINITION, SIGHTING_TYPE))
    return store
