"""What a recording is said to hold, and the topics file that is drafted from it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from clients.robot.cli.topics_commands import topics
from clients.robot.sources.messages.topics import parse_topics
from clients.robot.sources.recordings.recording import Recording
from clients.robot.sources.recordings.topic_listing import describe, draft_topics, list_topics, next_steps
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.sources.recordings import FORMATS, Topic, image, record, storage_file

TYPES = {
    "ward_msgs/msg/Tag": "string epc\nuint8 antenna\nfloat32 rssi_dbm\nfloat32 range_cm",
    "ward_msgs/msg/TagArray": "std_msgs/Header header\nward_msgs/Tag[] tags",
}
DEPTH = np.full((4, 6), 1500, np.uint16)
EPC = "E280116060000001"


@pytest.fixture(params=FORMATS)
def recording(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    colour = np.zeros((4, 6, 3), np.uint8)
    tags = [(i * 100, {"tags": [{"epc": EPC, "antenna": 1, "rssi_dbm": -40.0, "range_cm": 180.0}]}) for i in range(11)]
    found = [
        Topic("/kinect/depth", "sensor_msgs/msg/Image", [(i * 100, image(DEPTH)) for i in range(11)]),
        Topic("/kinect/rgb", "sensor_msgs/msg/Image", [(0, image(colour, "rgb8"))]),
        Topic("/kinect/mystery", "sensor_msgs/msg/Image", [(0, image(DEPTH, "bayer_rggb16"))]),
        Topic("/rfid", "ward_msgs/msg/TagArray", tags),
        Topic("/emotion", "std_msgs/msg/String", [(0, {"data": "calm"})]),
        Topic("/chatter", "std_msgs/msg/String", [(0, {"data": EPC})]),
        Topic("/pose", "geometry_msgs/msg/Pose2D", [(0, {})]),
    ]
    return record(tmp_path / "bag", request.param, found, TYPES)


def test_each_topic_is_listed_with_what_it_could_be(recording: Path) -> None:
    listed = {item.figures.name: item for item in list_topics(Recording(recording))}
    assert {name: item.could_be for name, item in listed.items()} == {
        "/chatter": ("tags", "labels"),
        "/emotion": ("labels",),
        "/kinect/depth": ("depth",),
        "/kinect/mystery": (),
        "/kinect/rgb": ("rgb",),
        "/pose": (),
        "/rfid": ("tags",),
    }
    assert listed["/kinect/mystery"].encoding == "bayer_rggb16"
    assert (listed["/rfid"].figures.count, listed["/rfid"].figures.rate_hz) == (11, pytest.approx(11, abs=0.1))


def test_nothing_that_a_message_says_is_shown(recording: Path) -> None:
    opened = Recording(recording)
    assert EPC not in describe(opened) + draft_topics(opened, list_topics(opened))


def test_a_draft_is_a_topics_file_that_finds_fields_in_nested_messages(recording: Path) -> None:
    opened = Recording(recording)
    only = [item for item in list_topics(opened) if item.figures.name != "/chatter"]
    drafted = parse_topics(draft_topics(opened, only))
    assert drafted.depth == "/kinect/depth"
    assert drafted.tags[0].map.epc == "tags[].epc"
    assert drafted.tags[0].map.rssi == "tags[].rssi_dbm"
    assert "not named so far: tags[].range_cm" in draft_topics(opened, only)


def test_the_command_lists_drafts_once_and_says_where_a_recording_breaks_off(recording: Path, tmp_path: Path) -> None:
    draft = str(tmp_path / "topics.toml")
    done = CliRunner().invoke(topics, [str(recording), "--draft", draft])
    assert done.exit_code == 0
    assert "/kinect/depth" in done.output
    again = CliRunner().invoke(topics, [str(recording), "--draft", draft, "--json"])
    assert again.exit_code != 0
    assert json.loads(again.output)["error"]["code"] == "FILE_EXISTS"
    file = storage_file(recording)
    file.write_bytes(file.read_bytes()[:-40])
    told = json.loads(CliRunner().invoke(topics, [str(recording), "--json"]).output)
    assert told["ok"] is True
    assert {row["topic"] for row in told["topics"]} >= {"/rfid", "/emotion"}


OWN = {
    "acme_msgs/msg/Hit": "uint8 port\nstring code\nfloat32 distance",
    "acme_msgs/msg/Inventory": "std_msgs/Header header\nacme_msgs/Hit[] hits",
    "acme_msgs/msg/Reading": "string serial\nfloat32 tag",
    "acme_msgs/msg/Wheels": "float64 left\nfloat64 right",
}


HOSTILE_NAMES = (
    '/q"\n[odometry]\nkeep = true\n#',
    "/depth\x1b]0;other\x07",
    "/a[bold red]x[/bold red][red]y[/red]",
    "/tag\u202e\u009b31m\ttab",
    "/n\r\u2028\u0085line",
)


def test_a_name_that_holds_ends_of_lines_or_controls_is_listed_on_one_line(tmp_path: Path) -> None:
    """A listing is read line by line, and its lines are copied into a topics file."""
    path = recorded(tmp_path, *((name, "std_msgs/msg/String") for name in HOSTILE_NAMES))
    plain = recorded(
        tmp_path / "plain", *((f"/t{number}", "std_msgs/msg/String") for number in range(len(HOSTILE_NAMES)))
    )
    shown, expected = (CliRunner().invoke(topics, [str(one)]).output.splitlines() for one in (path, plain))
    assert len(shown) == len(expected)
    assert "".join(shown).isprintable()
    assert any(line.startswith('/q"\\u000a[odometry]\\u000akeep = true\\u000a#  ') for line in shown)
    assert any("/a[bold red]x[/bold red][red]y[/red]" in line for line in shown)
    told = json.loads(CliRunner().invoke(topics, [str(path), "--json"]).output)
    assert {row["topic"] for row in told["topics"]} >= set(HOSTILE_NAMES)


def recorded(folder: Path, *topics: tuple[str, str], types: Mapping[str, str] = OWN) -> Path:
    """Record one message each of these topics, as (name, type), beside depth."""
    found = [Topic("/depth", "sensor_msgs/msg/Image", [(0, image(DEPTH))])]
    found += [Topic(name, kind, [(0, {})]) for name, kind in topics]
    return record(folder / "bag", "mcap", found, types)


def drafted(recording: Path) -> tuple[str, str]:
    """What the command says, and the draft."""
    draft = recording.parent / "draft.toml"
    done = CliRunner().invoke(topics, [str(recording), "--draft", str(draft)])
    assert done.exit_code == 0
    return done.output, draft.read_text(encoding="utf-8")


def test_a_topic_of_ones_own_type_is_named_with_what_to_write(tmp_path: Path) -> None:
    said, draft = drafted(
        recorded(tmp_path, ("/reader", "acme_msgs/msg/Inventory"), ("/wheels", "acme_msgs/msg/Wheels"))
    )
    assert "/reader carries acme_msgs/msg/Inventory, a type of your own." in said
    assert 'write under [[tags]] in the topics file: topic = "/reader"' in said
    assert 'perhaps epc = "hits[].code". It has hits[].port, hits[].code, hits[].distance.' in said
    assert "/wheels carries acme_msgs/msg/Wheels" in said
    assert "It has left, right." in said
    assert parse_topics(draft).depth == "/depth"
    marked = draft[draft.index('# [[tags]]\n# topic = "/reader"') : draft.index("# /wheels")]
    taken = parse_topics("\n".join(line.removeprefix("# ") for line in marked.splitlines()))
    assert (taken.tags[0].topic, taken.tags[0].map.epc) == ("/reader", "hits[].code")


LAB = {
    "uhf_lab_msgs/msg/Hit": "string chip\nfloat32 metres\nfloat32 rssi_dbm",
    "uhf_lab_msgs/msg/Inventory": "string reader\nuhf_lab_msgs/Hit[] hits",
}


def test_a_map_is_drafted_from_one_list_and_not_from_what_stands_beside_it(tmp_path: Path) -> None:
    said, draft = drafted(recorded(tmp_path, ("/lab", "uhf_lab_msgs/msg/Inventory"), types=LAB))
    assert 'perhaps epc = "hits[].chip"' in said
    assert '# epc = "hits[].chip"' in draft
    assert '# rssi = "hits[].rssi_dbm"' in draft
    assert '# # distance = "hits[].metres"  # only with distance_sigma' in draft
    assert "not named so far: reader" in draft


def test_a_map_goes_through_one_list_only(tmp_path: Path) -> None:
    types = {
        "uhf_lab_msgs/msg/Hit": "string epc\nfloat32 rssi",
        "uhf_lab_msgs/msg/Port": "string id\nuint8 antenna",
        "uhf_lab_msgs/msg/Inventory": "uhf_lab_msgs/Port[] ports\nuhf_lab_msgs/Hit[] hits\nuint64 first_seen",
    }
    _, draft = drafted(recorded(tmp_path, ("/lab", "uhf_lab_msgs/msg/Inventory"), types=types))
    made = parse_topics(draft).tags[0].map
    assert (made.epc, made.rssi, made.first_seen, made.antenna) == ("hits[].epc", "hits[].rssi", "first_seen", "")


def test_a_draft_asks_for_the_focal_length_that_no_camera_info_tells(tmp_path: Path) -> None:
    _, draft = drafted(recorded(tmp_path))
    assert '[depth]\ntopic = "/depth"\n# focal_px = 525.0  # the camera\'s own' in draft
    assert parse_topics(draft.replace("# focal_px", "focal_px")).focal_px == 525
    told = tmp_path / "told"
    told.mkdir()
    fields = {"k": np.array([570.0, 0, 3, 0, 570, 2, 0, 0, 1]), "r": np.zeros(9), "p": np.zeros(12)}
    info = Topic("/camera_info", "sensor_msgs/msg/CameraInfo", [(0, fields)])
    depth = Topic("/depth", "sensor_msgs/msg/Image", [(0, image(DEPTH))])
    opened = Recording(record(told / "bag", "mcap", [depth, info], {}))
    assert "focal_px" not in draft_topics(opened, list_topics(opened))


def test_a_type_that_the_recording_does_not_define_is_named_too(tmp_path: Path) -> None:
    path = recorded(tmp_path, ("/reader", "acme_msgs/msg/Reading"))
    opened = Recording(path)
    opened.topics["/reader"].type = "acme_msgs/msg/Unheard"
    listed = list_topics(opened)
    (step,) = next_steps(opened, listed)
    assert "which the recording does not define" in step
    assert "[definitions]" in step
    assert parse_topics(draft_topics(opened, listed)).depth == "/depth"


def test_tags_without_a_field_called_as_uids_are_wait_for_the_user(tmp_path: Path) -> None:
    said, draft = drafted(recorded(tmp_path, ("/rfid", "acme_msgs/msg/Reading")))
    assert "/rfid could be tags: write into epc in which field the tag's UID stands. It has serial, tag." in said
    with pytest.raises(BlockRobotError, match=r"tags\[0\]\.epc is missing"):
        parse_topics(draft)


def test_where_tags_are_found_no_other_topic_is_asked_about(tmp_path: Path) -> None:
    types = (("/reader", "blockrobot_msgs/msg/RfidDetection"), ("/wheels", "acme_msgs/msg/Wheels"))
    said, draft = drafted(recorded(tmp_path, *types))
    assert "/wheels carries" not in said
    assert "# /wheels carries" in draft


def test_a_distance_waits_for_how_far_off_it_is(tmp_path: Path) -> None:
    """Without it the file would be refused, and what it is nobody can guess."""
    types = {name: text.replace("code", "epc") for name, text in OWN.items()}
    said, draft = drafted(recorded(tmp_path, ("/reader", "acme_msgs/msg/Inventory"), types=types))
    assert "carries" not in said
    assert '# distance = "hits[].distance"  # only with distance_sigma' in draft
    assert parse_topics(draft).tags[0].map.epc == "hits[].epc"


def test_a_draft_finds_fields_in_json_text_and_shows_no_other_name(tmp_path: Path) -> None:
    text = json.dumps({EPC: 1, "tags": [{"uid": EPC, "range": 2.5, "dbs": -40, "patient": "Ann"}]})
    found = [
        Topic("/depth", "sensor_msgs/msg/Image", [(0, image(DEPTH))]),
        Topic("/reader", "std_msgs/msg/String", [(0, {"data": text})]),
    ]
    opened = Recording(record(tmp_path / "bag", FORMATS[0], found, TYPES))
    listed = list_topics(opened)
    assert [item.could_be for item in listed] == [("depth",), ("tags",)]
    draft = draft_topics(opened, listed)
    assert EPC not in draft
    assert "patient" not in draft
    drafted = parse_topics(draft).tags[0].map
    assert (drafted.epc, drafted.rssi) == ("data{}.tags[].uid", "data{}.tags[].dbs")
    assert '# distance = "data{}.tags[].range"' in draft
