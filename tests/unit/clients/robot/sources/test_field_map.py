"""Tag readings out of the message types that exist, by a map of fields; nonsense is refused one reading at a time."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from clients.robot.sensing.sensor_events import Facing, Sighting
from clients.robot.sources.messages.field_map import TagMap, header_ms, stamp_ms
from consensus.errors import BlockRobotError

AT_MS, SHIFT_MS, RECEIVED_MS = 5_000, 100, 5_110


def message(**fields: Any) -> SimpleNamespace:
    return SimpleNamespace(**fields)


def read(made: TagMap, content: Any) -> tuple[list[Sighting], list[str]]:
    return made.read(content, AT_MS, SHIFT_MS, RECEIVED_MS)


def one(made: TagMap, content: Any) -> Sighting:
    sightings, reasons = read(made, content)
    assert reasons == []
    (sighting,) = sightings
    return sighting


def test_a_bare_text_is_a_tag_and_a_path_goes_on_through_json() -> None:
    sighting = one(TagMap(epc="data"), message(data=" E2000017 "))
    assert (sighting.uid, sighting.first_seen_ms, sighting.last_seen_ms) == ("E2000017", 5_100, 5_100)
    assert sighting.received_at_ms == RECEIVED_MS
    assert sighting.distance_m is None
    made = TagMap(epc="data{}.uid", rssi="data{}.signal.dbm", distance="data{}.range", distance_sigma=0.1)
    sighting = one(made, message(data='{"uid": "E2", "signal": {"dbm": -41}, "range": 2.5}'))
    assert (sighting.uid, sighting.rssi_dbm, sighting.distance_m) == ("E2", -41, 2.5)


def test_readings_in_one_message_stand_in_lists_or_are_messages_of_their_own() -> None:
    made = TagMap(epc="ids[]", rssi="dbs[]")
    sightings, _ = read(made, message(ids=["A", "B", "C"], dbs=np.array([-40, -50, -60], np.float32)))
    assert [(sighting.uid, sighting.rssi_dbm) for sighting in sightings] == [("A", -40), ("B", -50), ("C", -60)]
    made = TagMap(epc="tags[].epc", rssi="tags[].power.dbm", antenna="antenna")
    tags = [message(epc="A", power=message(dbm=-41.5)), message(epc="B", power=message(dbm=-42.5))]
    sightings, _ = read(made, message(tags=tags, antenna=2))
    assert [(sighting.uid, sighting.rssi_dbm, sighting.antenna) for sighting in sightings] == [
        ("A", -41.5, 2),
        ("B", -42.5, 2),
    ]
    assert read(TagMap(epc="ids[]"), message(ids=[])) == ([], [])


@pytest.mark.parametrize(("value", "uid"), [(np.array([0xE2, 0, 0x17], np.uint8), "E20017"), (b"\x01\xff", "01FF")])
def test_a_uid_of_bytes_is_written_in_hexadecimal(value: Any, uid: str) -> None:
    assert one(TagMap(epc="uid"), message(uid=value)).uid == uid


def test_antennas_by_name_or_number_tell_which_way_the_tag_is() -> None:
    made = TagMap(epc="id", antenna="antenna", front=("left_ear", "1"), back=("2",))
    facing = [one(made, message(id="A", antenna=antenna)).facing for antenna in ("left_ear", 1, 2, "tail")]
    assert facing == [Facing.FRONT, Facing.FRONT, Facing.BACK, Facing.UNKNOWN]


@pytest.mark.parametrize("word", ["front", "back"])
def test_a_reader_that_always_looks_one_way_says_so_once(word: str) -> None:
    assert one(TagMap(epc="data", facing=word), message(data="A")).facing is Facing(word)


@pytest.mark.parametrize(("path", "text"), [("data{}.tags[].uid", '{"tags": [{"uid": "A"}, {"uid": 7}]}'),
                                            ("data{}[].uid", '[{"uid": "A"}, {"uid": 7}]')])  # fmt: skip
def test_a_list_in_json_holds_a_reading_each(path: str, text: str) -> None:
    sightings, _ = read(TagMap(epc=path), message(data=text))
    assert [sighting.uid for sighting in sightings] == ["A", "7"]


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('{"uid": ', "json"),
        ("not JSON", "json"),
        (7, "json"),
        ("[" * 100_000, "json"),
        ('{"uid": NaN}', "json"),
        ('"' + "x" * (256 * 1024) + '"', "json"),
        ('{"id": "A"}', "field"),
        ('{"uid": {}}', "field"),
        ('{"uid": true}', "field"),
        ('["uid"]', "field"),
    ],
)
def test_what_is_no_json_or_has_no_such_field_is_refused_by_reason(text: Any, reason: str) -> None:
    made = TagMap(epc="data{}.uid")
    try:
        sightings, reasons = read(made, message(data=text))
    except BlockRobotError as error:
        sightings, reasons = [], [error.context["reason"]]
    assert (sightings, reasons) == ([], [reason])


@pytest.mark.parametrize("text", ['{"uid": "E2000017"}', '  [{"uid": "E2000017"}]'])
def test_json_where_a_uid_is_expected_is_refused_by_its_name(text: str) -> None:
    assert read(TagMap(epc="data"), message(data=text)) == ([], ["json"])


def test_units_are_turned_into_metres_dbm_and_milliseconds() -> None:
    made = TagMap(
        epc="id",
        rssi="rssi",
        rssi_unit="cdBm",
        distance="range",
        distance_sigma=30,
        distance_unit="cm",
        first_seen="first",
        last_seen="last",
        time_unit="us",
    )
    sighting = one(made, message(id="A", rssi=-5512, range=185.0, first=4_000_000, last=4_500_000))
    assert sighting.rssi_dbm == pytest.approx(-55.12)
    assert (sighting.distance_m, sighting.sigma_m) == (pytest.approx(1.85), pytest.approx(0.3))
    assert (sighting.first_seen_ms, sighting.last_seen_ms) == (4_100, 4_600)


@pytest.mark.parametrize("distance", [math.nan, math.inf, 0.0, -1.0, 1.1e6, 1e154, 1e200])
def test_a_distance_that_is_none_is_unknown(distance: float) -> None:
    made = TagMap(epc="id", distance="range", distance_sigma=0.3)
    assert one(made, message(id="A", range=distance)).distance_m is None


def test_a_distance_whose_own_error_is_larger_than_a_room_is_unknown() -> None:
    made = TagMap(epc="id", distance="range", distance_sigma="sigma", distance_unit="cm")
    assert one(made, message(id="A", range=250.0, sigma=200.0)).distance_m == pytest.approx(2.5)
    assert one(made, message(id="A", range=250.0, sigma=200.1)).distance_m is None


@pytest.mark.parametrize(
    ("fields", "reason"),
    [
        ({"id": ""}, "tag"),
        ({"id": "x" * 65}, "tag"),
        ({"id": "\x00\x01"}, "tag"),
        ({"id": 1.5}, "field"),
        ({"id": True}, "field"),
        ({"first": 9_000, "last": 8_000}, "time"),
        ({"first": 0, "last": 3_600_000}, "time"),
        ({"first": -1}, "time"),
        ({"first": math.nan}, "time"),
        ({"first": "noon"}, "field"),
        ({"rssi": "strong"}, "field"),
    ],
)
def test_a_reading_that_makes_no_sense_is_refused_with_a_reason(fields: dict[str, Any], reason: str) -> None:
    made = TagMap(epc="id", rssi="rssi", first_seen="first", last_seen="last", time_unit="ms")
    good = {"id": "A", "rssi": -40.0, "first": 4_000, "last": 4_001}
    assert read(made, message(**{**good, **fields})) == ([], [reason])


def test_nanoseconds_lose_nothing() -> None:
    assert stamp_ms(1_700_000_000_123_456_789) == 1_700_000_000_123


def test_one_bad_reading_leaves_its_fellows_alone_and_an_unstamped_header_has_no_time() -> None:
    sightings, reasons = read(TagMap(epc="ids[]"), message(ids=["A", "", "B"]))
    assert ([sighting.uid for sighting in sightings], reasons) == (["A", "B"], ["tag"])
    assert header_ms(message(header=message(stamp=message(sec=0, nanosec=0)))) is None
    assert header_ms(message(header=message(stamp=message(sec=2, nanosec=5_000_000)))) == 2_005
    assert header_ms(message(data="A")) is None


@pytest.mark.parametrize(
    ("made", "content", "reason"),
    [
        (TagMap(epc="epc"), message(other="A"), "field"),
        (TagMap(epc="epc[]"), message(epc="A"), "field"),
        (TagMap(epc="ids[]", rssi="dbs[]"), message(ids=["A"], dbs=[1.0, 2.0]), "field"),
        (TagMap(epc="ids[]"), message(ids=["A"] * 16_385), "size"),
    ],
)
def test_a_message_that_does_not_fit_its_map_is_refused(made: TagMap, content: Any, reason: str) -> None:
    with pytest.raises(BlockRobotError) as refused:
        read(made, content)
    assert (refused.value.code, refused.value.context["reason"]) == ("FRAME_INVALID", reason)


@pytest.mark.parametrize(
    ("unit", "positive", "told", "bearing_deg"),
    [
        ("deg", "right", 20.0, 20.0),
        ("deg", "left", 20.0, -20.0),
        ("rad", "left", math.pi / 6, -30.0),
        ("deg", "right", 350.0, -10.0),
        ("deg", "right", math.nan, None),
    ],
)
def test_a_readers_angle_becomes_a_bearing_to_the_right(
    unit: str, positive: str, told: float, bearing_deg: float | None
) -> None:
    sigma = 4.0 if unit == "deg" else 0.1
    made = TagMap(epc="epc", bearing="angle", bearing_sigma=sigma, bearing_unit=unit, bearing_positive=positive)
    sighting = one(made, message(epc="E2", angle=told))
    expected = None if bearing_deg is None else sigma * (1.0 if unit == "deg" else 180 / math.pi)
    assert sighting.bearing_deg == (None if bearing_deg is None else pytest.approx(bearing_deg))
    assert sighting.bearing_sigma_deg == (None if expected is None else pytest.approx(expected))


def test_an_angles_error_may_be_a_field_and_must_be_below_a_pictures_width() -> None:
    made = TagMap(epc="epc", bearing="angle", bearing_sigma="error", bearing_positive="right")
    assert one(made, message(epc="E2", angle=5.0, error=3.0)).bearing_sigma_deg == 3.0
    assert one(made, message(epc="E2", angle=5.0, error=60.0)).bearing_deg is None
