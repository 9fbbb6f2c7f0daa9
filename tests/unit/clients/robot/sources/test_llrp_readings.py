"""The reports of a tag reader, as its protocol writes them, become sightings of this machine's clock."""

from __future__ import annotations

from typing import Any

import pytest
from llrpkit.protocol import BitStr, params

from clients.robot.sensing.sensor_events import Facing, RefusedMessage, Sighting
from clients.robot.sources.live.llrp_readings import GATHER_MS, GATHERED_MAX_COUNT, LlrpReadings
from clients.robot.sources.messages.topics import LlrpReader

EPC = bytes.fromhex("e28011606000020512345678")
NOW_MS = 1_800_000_000_000
READER = LlrpReader("10.0.0.7", front=(1,), back=(2, 3))


def report(at_us: int | None = NOW_MS * 1000, *, epc: bytes = EPC, antenna: int | None = 1, **changes: Any) -> Any:
    """One tag's report, stamped in UTC."""
    fields: dict[str, Any] = {
        "epc_parameter": params.EPC_96(epc=epc) if len(epc) == 12 else params.EPCData(epc=BitStr.from_bytes(epc)),
        "antenna_id": None if antenna is None else params.AntennaID(antenna_id=antenna),
        "peak_rssi": params.PeakRSSI(peak_rssi=-61),
        "tag_seen_count": params.TagSeenCount(tag_count=3),
    }
    if at_us is not None:
        fields["first_seen_timestamp_utc"] = params.FirstSeenTimestampUTC(microseconds=at_us)
        fields["last_seen_timestamp_utc"] = params.LastSeenTimestampUTC(microseconds=at_us)
    return params.TagReportData(**{**fields, **changes})


def sightings(made: list[Sighting | RefusedMessage]) -> list[Sighting]:
    """What was made, if all of it are sightings."""
    assert all(isinstance(one, Sighting) for one in made), made
    return [one for one in made if isinstance(one, Sighting)]


def test_a_report_is_a_sighting_without_a_distance() -> None:
    readings = LlrpReadings(READER)
    assert readings.convert_report(report(), NOW_MS) == []
    (sighting,) = sightings(readings.flush())
    assert sighting.uid == "E28011606000020512345678"
    assert (sighting.antenna, sighting.facing, sighting.rssi_dbm, sighting.read_count) == (1, Facing.FRONT, -61.0, 3)
    assert (sighting.distance_m, sighting.sigma_m, sighting.origin) == (None, None, READER.address)
    assert (sighting.first_seen_ms, sighting.last_seen_ms, sighting.received_at_ms) == (NOW_MS, NOW_MS, NOW_MS)


@pytest.mark.parametrize(
    ("antenna", "facing"), [(1, Facing.FRONT), (3, Facing.BACK), (4, Facing.UNKNOWN), (None, Facing.UNKNOWN)]
)
def test_the_topics_file_says_which_way_an_antenna_looks(antenna: int | None, facing: Facing) -> None:
    readings = LlrpReadings(READER)
    readings.convert_report(report(antenna=antenna), NOW_MS)
    assert sightings(readings.flush())[0].facing is facing


def test_readings_of_one_tag_by_one_antenna_are_gathered_and_those_of_others_are_not() -> None:
    readings = LlrpReadings(READER)
    for ms in (0, 40, 80):
        assert readings.convert_report(report((NOW_MS + ms) * 1000), NOW_MS + ms) == []
    readings.convert_report(report((NOW_MS + 81) * 1000, antenna=2), NOW_MS + 81)
    readings.convert_report(report((NOW_MS + 82) * 1000, epc=bytes(12)), NOW_MS + 82)
    first, behind, other = sightings(readings.flush())
    assert (first.first_seen_ms, first.last_seen_ms, first.read_count) == (NOW_MS, NOW_MS + 80, 9)
    assert (behind.antenna, behind.read_count, other.uid) == (2, 3, "0" * 24)
    assert readings.flush() == []


def test_readings_far_apart_are_not_gathered_into_a_stretch_in_which_nobody_was_there() -> None:
    readings = LlrpReadings(READER)
    later_ms = NOW_MS + GATHER_MS + 1
    readings.convert_report(report(), NOW_MS)
    made = sightings(readings.convert_report(report(later_ms * 1000), later_ms)) + sightings(readings.flush())
    assert [(one.first_seen_ms, one.last_seen_ms) for one in made] == [(NOW_MS, NOW_MS), (later_ms, later_ms)]


def test_a_storm_of_tags_is_held_within_bounds_and_loses_none() -> None:
    readings = LlrpReadings(READER)
    made: list[Sighting | RefusedMessage] = []
    for index in range(GATHERED_MAX_COUNT + 10):
        made += readings.convert_report(report(epc=index.to_bytes(12, "big")), NOW_MS)
    assert len(made) == GATHERED_MAX_COUNT
    assert len({one.uid for one in sightings(made + readings.flush())}) == GATHERED_MAX_COUNT + 10


@pytest.mark.parametrize("clock_off_ms", [-NOW_MS + 5_000, -86_400_000, 0, 86_400_000 * 365])
def test_whatever_the_readers_clock_says_sightings_are_of_the_time_in_which_they_came(clock_off_ms: int) -> None:
    readings = LlrpReadings(READER)
    made: list[Sighting] = []
    for ms in range(0, 5_000, 250):
        readings.convert_report(report((NOW_MS + ms + clock_off_ms) * 1000), NOW_MS + ms + ms % 7)
        made += sightings(readings.flush())
    assert len(made) == 20
    assert all(0 <= (one.received_at_ms or 0) - one.last_seen_ms <= 20 for one in made)


def test_a_reader_that_counts_from_when_it_was_switched_on_is_understood() -> None:
    readings = LlrpReadings(READER)
    up = report(
        None,
        first_seen_timestamp_uptime=params.FirstSeenTimestampUptime(microseconds=7_000_000),
        last_seen_timestamp_uptime=params.LastSeenTimestampUptime(microseconds=7_040_000),
    )
    readings.convert_report(up, NOW_MS)
    (sighting,) = sightings(readings.flush())
    assert (sighting.first_seen_ms, sighting.last_seen_ms) == (NOW_MS - 40, NOW_MS)


def test_a_reading_that_ends_before_it_begins_or_beyond_all_calendars_is_refused() -> None:
    backwards = report(first_seen_timestamp_utc=params.FirstSeenTimestampUTC(microseconds=NOW_MS * 1000 + 5_000))
    assert LlrpReadings(READER).convert_report(backwards, NOW_MS) == [RefusedMessage(NOW_MS, "sighting", "time")]
    assert LlrpReadings(READER).convert_report(report((1 << 64) - 1), NOW_MS) == [
        RefusedMessage(NOW_MS, "sighting", "time")
    ]
    readings = LlrpReadings(READER)
    readings.convert_report(report(None), NOW_MS)
    assert sightings(readings.flush())[0].last_seen_ms == NOW_MS


def test_a_readers_clock_that_is_set_while_it_reads_loses_nothing_for_long() -> None:
    readings = LlrpReadings(READER)
    made: list[Sighting | RefusedMessage] = []
    for index in range(40):
        set_back_ms = 3_600_000 if index >= 20 else 0
        at_ms = NOW_MS + 250 * index
        readings.convert_report(report((at_ms - set_back_ms) * 1000), at_ms)
        made += readings.flush()
    assert len(sightings(made)) == 40
    assert all(abs((one.received_at_ms or 0) - one.last_seen_ms) <= 20 for one in sightings(made))


def test_one_wrong_stamp_is_refused_and_the_next_reading_is_as_good_as_ever() -> None:
    readings = LlrpReadings(READER)
    made: list[Sighting | RefusedMessage] = []
    for index in range(10):
        at_ms = NOW_MS + 250 * index
        readings.convert_report(report((at_ms + (86_400_000 if index == 5 else 0)) * 1000), at_ms)
        made += readings.flush()
    assert [one.reason for one in made if isinstance(one, RefusedMessage)] == ["time"]
    assert len([one for one in made if isinstance(one, Sighting)]) == 9


@pytest.mark.parametrize(
    "epc", [BitStr(), BitStr(12, b"\xab\xc0"), BitStr.from_bytes(bytes(34)), BitStr.from_bytes(b"\x01")]
)
def test_an_epc_that_is_empty_too_long_or_no_whole_words_is_refused(epc: BitStr) -> None:
    made = LlrpReadings(READER).convert_report(report(epc_parameter=params.EPCData(epc=epc)), NOW_MS)
    assert made == [RefusedMessage(NOW_MS, "sighting", "tag")]


def test_two_readers_with_two_clocks_end_up_on_one() -> None:
    ends = []
    for reader, began_ms in ((READER, NOW_MS - 9_999_999), (LlrpReader("10.0.0.8"), 5_000)):
        readings = LlrpReadings(reader)
        made: list[Sighting | RefusedMessage] = []
        for ms in range(0, 2_000, 100):
            readings.convert_report(report((began_ms + ms) * 1000), NOW_MS + ms)
            made += readings.flush()
        ends.append(sightings(made)[-1].last_seen_ms)
    assert ends == [NOW_MS + 1_900] * 2
