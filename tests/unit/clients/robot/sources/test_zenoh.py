"""What of the Zenoh feed needs no Zenoh: what strangers announce is not kept, and an odd sample ends nothing."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from clients.robot.sources.live.zenoh import ZenohFeed, _Subscription
from clients.robot.sources.live.zenoh_keys import parse_key
from clients.robot.sources.messages.message_types import Message
from consensus.errors import BlockRobotError

HASH = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"
TAGS = "/rfid/sightings"


class Notes:
    """A listener that keeps what it is told."""

    def __init__(self) -> None:
        self.messages: list[Message] = []
        self.failures: list[BlockRobotError] = []

    def deliver(self, message: Message, definition: str = "") -> None:
        assert definition == ""
        self.messages.append(message)

    def fail(self, error: BlockRobotError) -> None:
        self.failures.append(error)


def test_of_types_that_nobody_knows_here_no_hash_is_kept() -> None:
    feed = ZenohFeed()
    for number in range(1000):
        key = parse_key(f"0/camera/depth/x_msgs::msg::dds_::T{number}_/{HASH}")
        assert key is not None
        assert feed.differs(key) is False
    image = parse_key(f"0/camera/depth/sensor_msgs::msg::dds_::Image_/{HASH}")
    assert image is not None
    assert feed.differs(image) is False
    assert list(feed._hashes) == ["sensor_msgs/msg/Image"]


@pytest.mark.parametrize("attachment", [None, b"", b"\xff" * 40])
def test_a_sample_that_cannot_be_taken_counts_as_a_message_of_no_type_and_ends_nothing(
    attachment: bytes | None,
) -> None:
    # Of a type that lacks a part of itself no hash can be worked out.
    feed = ZenohFeed((), 0, {"ward_msgs/msg/Tag": "ward_msgs/Nowhere part\nstring epc"})
    notes = Notes()
    heard = _Subscription(TAGS, feed, notes)  # type: ignore[arg-type]
    key = f"0{TAGS}/ward_msgs::msg::dds_::Tag_/{HASH}"
    heard.take(SimpleNamespace(key_expr=key, attachment=attachment, payload=b"\0\1\0\0"))
    assert [(one.topic, one.type, one.data) for one in notes.messages] == [(TAGS, "", b"")]
    assert notes.failures == []


def test_a_definition_that_names_a_type_nobody_defines_is_refused_by_name() -> None:
    feed = ZenohFeed(definitions={"ward_msgs/msg/TagArray": "ward_msgs/Tag[] tags"})
    key = parse_key(f"0/rfid/ward_msgs::msg::dds_::TagArray_/{HASH}")
    assert key is not None
    with pytest.raises(BlockRobotError, match="ward_msgs/msg/TagArray") as caught:
        feed.differs(key)
    assert caught.value.code == "TOPICS_INVALID"
