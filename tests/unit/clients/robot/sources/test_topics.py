"""The topics file: what it may say, and what it must not."""

from __future__ import annotations

from pathlib import Path

import pytest

from clients.robot.sensing.message_names import DEPTH_TOPIC, SIGHTING_TOPIC, SIGHTING_TYPE
from clients.robot.sources.messages.topics import (
    Topics,
    load_topics,
    parse_topics,
    tags_by_type,
    with_rooted_names,
    with_topic,
)
from consensus.errors import BlockRobotError

WHOLE = """
clock = "recording"

[depth]
topic = "/kinect/depth"

[empty]
topic = "/kinect/empty"

[[tags]]
topic = "/left/rfid"
type = "stdr_msgs/msg/RfidSensorMeasurementMsg"
epc = "rfid_tags_ids[]"
rssi = "rfid_tags_dbs[]"

[[tags]]
topic = "/right/rfid"
epc = "epc"
antenna = "antenna"
front = [1, "left_ear"]
distance = "range"
distance_sigma = 30
distance_unit = "cm"

[definitions]
"my_msgs/msg/Tag" = "string epc"
"""


def test_a_whole_file_is_understood() -> None:
    topics = parse_topics(WHOLE)
    assert (topics.depth, topics.empty, topics.clock) == ("/kinect/depth", "/kinect/empty", "recording")
    left, right = topics.tags
    assert (left.map.epc, left.map.rssi, left.map.distance) == ("rfid_tags_ids[]", "rfid_tags_dbs[]", "")
    assert (right.map.front, right.map.distance_sigma, right.map.distance_unit) == (("1", "left_ear"), 30, "cm")
    assert topics.wanted == {"/kinect/depth": "depth", "/left/rfid": "tags", "/right/rfid": "tags"}
    assert topics.definitions == {"my_msgs/msg/Tag": "string epc"}


@pytest.mark.parametrize("page", ["reference/topics-toml.md", "how-to/your-robot.md"])
def test_the_examples_of_the_documentation_are_understood(page: str) -> None:
    text = (Path(__file__).parents[5] / "docs" / page).read_text(encoding="utf-8")
    example = text.partition("```toml\n")[2].partition("```")[0]
    topics = parse_topics(example)
    assert topics.depth == "/kinect/depth/image"
    assert (topics.tags[0].map.epc, topics.tags[0].map.distance_sigma) == ("tags[].epc", 20)
    assert topics.rgb_registered
    assert topics.labels is not None


def test_an_empty_file_names_the_robots_own_topics_and_options_go_before_it() -> None:
    topics = parse_topics("")
    assert topics.wanted == {DEPTH_TOPIC: "depth", SIGHTING_TOPIC: "tags"}
    topics = with_topic(parse_topics(WHOLE), depth="/other", empty=None)
    assert (topics.depth, topics.empty) == ("/other", "/kinect/empty")
    assert tags_by_type("/t", SIGHTING_TYPE).map.distance == "distance"
    assert tags_by_type("/t", "std_msgs/msg/String").map.epc == "data"
    with pytest.raises(BlockRobotError, match="TOPICS_INVALID"):
        tags_by_type("/t", "my_msgs/msg/Tag")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("depth =", "TOML"),
        ("[rgb]", "rgb.topic"),
        ("[depth]\ntopic = 3", "depth.topic"),
        ("[depth]\ntopic = ''", "depth.topic is empty"),
        ("[[tags]]\ntopic = '/t'\nepc = 'id'\nantenna = ''", "tags[0].antenna is empty"),
        ("[dephts]\ntopic = '/a'", "dephts"),
        ("depth = 3", "depth"),
        ("[depth]\ntopic = '/a'\nencoding = 'x'", "depth.encoding"),
        ("[[tags]]\ntopic = '/t'", "tags[0].epc"),
        ("[[tags]]\ntopic = '/t'\nepc = 'a b'", "tags[0].epc"),
        ("[[tags]]\ntopic = '/t'\nepc = '__import__(1)'", "tags[0].epc"),
        ("[[tags]]\ntopic = '/t'\nepc = 'a[].b[]'", "tags[0].epc"),
        ("[[tags]]\ntopic = '/t'\nepc = 'id'\nrsi = 'x'", "tags[0].rsi"),
        ("[[tags]]\ntopic = '/t'\nepc = 'id'\ndistance_unit = 'm'\ndistance = 'd'", "distance_sigma"),
        (
            "[[tags]]\ntopic = '/t'\nepc = 'id'\ndistance_unit = 'm'\ndistance = 'd'\ndistance_sigma = -1",
            "distance_sigma",
        ),
        (
            "[[tags]]\ntopic = '/t'\nepc = 'id'\ndistance_unit = 'm'\ndistance = 'd'\ndistance_sigma = true",
            "distance_sigma",
        ),
        ("[[tags]]\ntopic = '/t'\nepc = 'id'\ndistance = 'd'\ndistance_sigma = 2.1\ndistance_unit = 'm'", "2.1 m"),
        ("[[tags]]\ntopic = '/t'\nepc = 'id'\ndistance = 'd'\ndistance_sigma = 201\ndistance_unit = 'cm'", "2.01 m"),
        ("[[tags]]\ntopic = '/t'\nepc = 'id'\ndistance_unit = 'ft'", "distance_unit"),
        (
            "[[tags]]\ntopic = '/t'\nepc = 'id'\ndistance = 'd'\ndistance_sigma = 0.1",
            "tags[0].distance needs distance_unit",
        ),
        ("[[tags]]\ntopic = '/t'\nepc = 'id'\nfront = [1]", "antenna"),
        ("[[tags]]\ntopic = '/t'\nepc = 'id'\nfacing = 'front'\nantenna = 'a'\nback = [1]", "alternatives"),
        ("[[tags]]\ntopic = '/t'\nepc = 'data{}.a{}.id'", "at most one"),
        ("[[tags]]\ntopic = '/t'\nepc = 'a[].id'\nrssi = 'b[].db'", "lists"),
        ("tags = 3", "tags"),
        ("clock = 'sundial'", "clock"),
        ("[depth]\ntopic = '/t'\n[[tags]]\ntopic = '/t'\nepc = 'id'", "/t"),
        ("definitions = {a = 1}", "definitions"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(text: str, named: str) -> None:
    with pytest.raises(BlockRobotError) as refused:
        parse_topics(text)
    assert refused.value.code == "TOPICS_INVALID"
    assert named in refused.value.detail


def test_files_that_are_no_topics_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (tmp_path / "large.toml").write_bytes(b"#" * 300_000)
    for name in ("missing.toml", "binary.toml", "large.toml"):
        with pytest.raises(BlockRobotError, match="TOPICS_INVALID"):
            load_topics(tmp_path / name)


def test_a_reader_of_ones_own_has_its_antennas_in_a_table_and_stands_for_the_topic_of_readings() -> None:
    topics = parse_topics(
        '[[llrp]]\nhost = "10.0.0.7"\nfront = [1, 2]\nback = [3]\n[[llrp]]\nhost = "::1"\nport = 15084'
    )
    left, right = topics.llrp
    assert (left.address, left.front, left.back) == ("10.0.0.7:5084", (1, 2), (3,))
    assert (right.address, right.front, right.back) == ("[::1]:15084", (), ())
    assert topics.tags == ()


def test_topics_go_together_with_a_reader_of_ones_own_and_a_depth_topic_has_a_name() -> None:
    topics = parse_topics('[[llrp]]\nhost = "reader"\n[[tags]]\ntopic = "/rfid"\nepc = "data"')
    assert (len(topics.llrp), topics.tags[0].topic) == (1, "/rfid")
    with pytest.raises(BlockRobotError, match="has no name"):
        with_topic(Topics(), depth="")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[llrp]]\nport = 1", "host is missing"),
        ('[[llrp]]\nhost = "a b"', "no address"),
        ('[[llrp]]\nhost = "a"\nport = 70000', "no address"),
        ('[[llrp]]\nhost = "a"\nfront = ["1"]', "numbers"),
        ('[[llrp]]\nhost = "a"\nfront = [0]', "numbers"),
        ('[[llrp]]\nhost = "a"\nback = [true]', "numbers"),
        ('[[llrp]]\nhost = "a"\nfront = [1]\nback = [1]', "same antenna"),
        ('[[llrp]]\nhost = "a"\ndistance = 3', "distance is no setting"),
        (
            '[[tags]]\ntopic = "/t"\nepc = "d"\ndistance = "d"\ndistance_unit = "m"\ndistance_sgma = 1',
            "distance_sgma is no setting that the robot knows. Did you mean distance_sigma?",
        ),
        ('[[llrp]]\nhost = "a"\n[[llrp]]\nhost = "a"', "twice"),
        ("\n".join(f'[[llrp]]\nhost = "a{n}"' for n in range(9)), "more than 8"),
        ('[llrp]\nhost = "a"', "[[llrp]]"),
    ],
)
def test_a_reader_that_makes_no_sense_is_refused(text: str, said: str) -> None:
    with pytest.raises(BlockRobotError) as caught:
        parse_topics(text)
    assert caught.value.code == "TOPICS_INVALID"
    assert said in caught.value.detail


def test_a_running_robots_topics_are_named_from_the_root_as_ros_resolves_them() -> None:
    text = "[depth]\ntopic = 'kinect/depth'\n[[tags]]\ntopic = 'rfid'\nepc = 'id'\n[labels]\ntopic = '/mood'"
    assert with_rooted_names(parse_topics(text)).wanted == {
        "/rfid": "tags",
        "/kinect/depth": "depth",
        "/mood": "labels",
    }
    assert with_rooted_names(Topics()) == Topics()
    with pytest.raises(BlockRobotError, match="named for two things"):
        with_rooted_names(parse_topics("[depth]\ntopic = 'a'\n[rgb]\ntopic = '/a'"))
