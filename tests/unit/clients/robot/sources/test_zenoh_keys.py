"""What ROS 2 writes into Zenoh's keys, tokens and attachments, and what strangers write there."""

from __future__ import annotations

import pytest

from clients.robot.sources.live.zenoh_keys import (
    GAP_MAX_COUNT,
    PUBLISHERS_MAX_COUNT,
    SequenceGaps,
    TopicKey,
    parse_key,
    parse_numbers,
    parse_token,
    subscription_key,
)
from consensus.errors import BlockRobotError

HASH = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
KEY = f"0/camera/depth/image_raw/sensor_msgs::msg::dds_::Image_/{HASH}"
NODE = "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/camera"
TOKEN = f"{NODE}/%camera%depth%image_raw/sensor_msgs::msg::dds_::Image_/{HASH}/::,10:,:,:,,"
IMAGES = TopicKey("/camera/depth/image_raw", "sensor_msgs/msg/Image", HASH)
GID = bytes(range(16))


def numbered(number: int, publisher: bytes = GID) -> bytes:
    """An attachment as rmw_zenoh writes it today: number, source time, length and bytes of the publisher's id."""
    return number.to_bytes(8, "little", signed=True) + bytes(8) + b"\x10" + publisher


def named(number: int) -> bytes:
    """An attachment as the first versions wrote it, with the name before each value."""
    parts = b"\x0fsequence_number" + number.to_bytes(8, "little") + b"\x10source_timestamp" + bytes(8)
    return parts + b"\x0asource_gid\x10" + GID


def test_a_key_and_a_publishers_token_tell_topic_type_and_hash() -> None:
    assert parse_key(KEY) == IMAGES
    assert parse_token(TOKEN) == IMAGES
    assert subscription_key("/camera/depth", 7) == "7/camera/depth/*/*"
    assert subscription_key("camera/depth", 7) == "7/camera/depth/*/*"


@pytest.mark.parametrize(
    "token",
    [
        TOKEN.replace("/MP/", "/MS/"),
        TOKEN.replace("/MP/", "/SS/"),
        "@ros2_lv/0/aac3/0/0/NN/%/%/camera",
        TOKEN + "/more",
        TOKEN.replace("::msg::", "::srv::"),
        TOKEN.replace("%camera%depth", "%../x"),
        "@ros2_lv/0",
        "",
    ],
)
def test_a_token_of_anything_but_a_publisher_of_messages_says_nothing(token: str) -> None:
    assert parse_token(token) is None


@pytest.mark.parametrize(
    "key",
    [
        "0/camera/depth",
        "0/camera/Image/hash",
        KEY.replace("::dds_", ""),
        "/" * 2000,
        f"0/{'a' * 2000}/b/c",
        "0//a/b",
        "",
    ],
)
def test_a_key_of_another_layout_is_no_topic(key: str) -> None:
    assert parse_key(key) is None


@pytest.mark.parametrize(
    "topic", ["/camera/**", "/a*b", "", "/", "/a//b", "/a$*", "/a?b", "/a#b", "/ä", "/" + "a" * 2000]
)
def test_what_is_no_name_of_a_topic_is_not_subscribed_to(topic: str) -> None:
    with pytest.raises(BlockRobotError, match=r"^TOPICS_INVALID:"):
        subscription_key(topic, 0)


@pytest.mark.parametrize("attachment", [numbered(7), named(7), numbered(7)[:16] + GID])
def test_an_attachment_of_either_layout_tells_publisher_and_number(attachment: bytes) -> None:
    assert parse_numbers(attachment) == (GID, 7)


@pytest.mark.parametrize("attachment", [b"", b"abc", bytes(200), named(7)[:-3], b"\x0fsequence_number", named(7)[:40]])
def test_an_attachment_of_anything_else_tells_nothing(attachment: bytes) -> None:
    assert parse_numbers(attachment) is None


def test_gaps_are_counted_for_each_publisher_until_it_begins_again() -> None:
    gaps = SequenceGaps()
    other = bytes(16)
    assert [gaps.take(numbered(number)) for number in (41, 42, 45)] == [0, 0, 2]
    assert [gaps.take(numbered(number, other)) for number in (3, 4)] == [0, 0]
    assert gaps.take(numbered(46)) == 0
    assert gaps.take(b"") == 0
    gaps = SequenceGaps()
    assert [gaps.take(numbered(number)) for number in (900, 1, 2)] == [0, 0, 0]
    assert gaps.take(numbered(2 + GAP_MAX_COUNT + 2)) == 0
    assert gaps.take(numbered(-(1 << 63))) == 0
    assert gaps.take(numbered((1 << 63) - 1)) == 0


def test_of_too_many_publishers_those_heard_longest_ago_are_forgotten() -> None:
    gaps = SequenceGaps()
    gaps.take(numbered(1))
    for index in range(PUBLISHERS_MAX_COUNT):
        gaps.take(numbered(1, index.to_bytes(16, "big")))
    assert gaps.take(numbered(9)) == 0
    assert gaps.take(numbered(9, (PUBLISHERS_MAX_COUNT - 1).to_bytes(16, "big"))) == 7
