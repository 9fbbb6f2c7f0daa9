"""Event logs of every form are read into one table; a line that cannot be read is named and never guessed at."""

from __future__ import annotations

from pathlib import Path

import pytest

from clients.robot.recording.event_log import (
    IMAGE_PAIRED,
    IMAGE_RETRIEVE,
    RFID_RETRIEVE,
    EventLog,
    read_events,
    write_csv,
    write_xes,
)
from consensus.errors import BlockRobotError
from network.experiments.log_files import parse_log, read_log
from network.experiments.pages.event_table import EventTable, LoggedEvent, follow
from network.experiments.published_log import DAY_MS, parse_published_log

HASH_A, HASH_B, TXID = "a1" * 32, "b2" * 32, "c3" * 32
PUBLISHED = f"""\
10:00:00:07, IMAGE_RETRIEVE, 41
10:00:00:10, RFID_RETRIEVE, 123,0,0, {HASH_A}
10:00:00:900, IMAGE_PAIRED, 41, {HASH_A}
10:00:01:2, BLOCKCHAIN_TRANSACTION, 41, {HASH_A}, {TXID}
10:00:01:40, RFID_RETRIEVE, 4,5,6, {HASH_B}

"""


def refusal(text: str) -> str:
    with pytest.raises(BlockRobotError) as caught:
        parse_log(text)
    assert caught.value.code == "EVENT_LOG_INVALID"
    return caught.value.detail


def test_a_published_log_has_frames_and_tags_as_cases_and_times_without_padding() -> None:
    table = parse_log(PUBLISHED)
    ten = 10 * 3600 * 1000
    assert table.form == "published"
    assert table.events == (
        LoggedEvent(ten + 7, IMAGE_RETRIEVE, "frame-41"),
        LoggedEvent(ten + 10, RFID_RETRIEVE, "tag-1", "tag-1"),
        LoggedEvent(ten + 900, IMAGE_PAIRED, "frame-41", "tag-1"),
        LoggedEvent(ten + 1002, "BLOCKCHAIN_TRANSACTION", "frame-41", "tag-1"),
        LoggedEvent(ten + 1040, RFID_RETRIEVE, "tag-2", "tag-2"),
    )


def test_nothing_that_names_a_tag_or_a_transaction_is_passed_on() -> None:
    told = repr(parse_log(PUBLISHED))
    assert not any(secret in told for secret in (HASH_A, HASH_B, TXID, "123,0,0"))


def test_events_are_ordered_by_time_and_a_late_line_stays_on_the_day_before_midnight() -> None:
    lines = ["23:59:59:990, IMAGE_RETRIEVE, 1", "00:00:00:10, IMAGE_RETRIEVE, 2", "23:59:59:995, IMAGE_RETRIEVE, 3"]
    table = parse_published_log(lines)
    assert [(event.sequence, event.time_ms - DAY_MS) for event in table.events] == [(1, -10), (3, -5), (2, 10)]
    table = EventTable.of("x", [LoggedEvent(5, "B", "c"), LoggedEvent(5, "A", "c"), LoggedEvent(1, "C", "c")])
    assert [event.activity for event in table.events] == ["C", "B", "A"]


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("24:00:00:1, IMAGE_RETRIEVE, 1", "time"),
        ("10:00:00.001, IMAGE_RETRIEVE, 1", "time"),
        ("10:00:00:0001, IMAGE_RETRIEVE, 1", "time"),
        ("10:00:00:1", "activity"),
        ("10:00:00:1, image retrieve, 1", "activity"),
        ("10:00:00:1, IMAGE_RETRIEVE", "sequence number"),
        ("10:00:00:1, IMAGE_RETRIEVE, one", "sequence number"),
        ("10:00:00:1, IMAGE_PAIRED, 1, nothash", "tag's hash"),
        (f"10:00:00:1, IMAGE_PAIRED, 1, {HASH_A}, {TXID}, more", "tag's hash"),
        (f"10:00:00:1, RFID_RETRIEVE, {HASH_A}", "reading"),
        ("10:00:00:1, RFID_RETRIEVE, 1,2,3, short", "reading"),
    ],
)
def test_a_bad_line_of_a_published_log_is_named(line: str, reason: str) -> None:
    told = refusal(PUBLISHED + line + "\n")
    assert "Line 7 " in told
    assert reason in told


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ('{"time_ms": 1, "activity": "A", "case": "x"}\n{"time_ms": 1,', 2, "JSON"),
        ('{"time_ms": 1, "activity": "A", "case": "x"}\n[1]', 2, "object"),
        ('{"time_ms": 1.5, "activity": "A", "case": "x"}', 1, "whole number"),
        ('{"time_ms": true, "activity": "A", "case": "x"}', 1, "whole number"),
        ('{"time_ms": -1, "activity": "A", "case": "x"}', 1, "whole number"),
        ('{"time_ms": 1, "activity": "", "case": "x"}', 1, "activity"),
        ('{"time_ms": 1, "activity": "A"}', 1, "case"),
        ('{"time_ms": 1, "activity": "A\\u001b[2J", "case": "x"}', 1, "control character"),
        ('{"time_ms": 1, "activity": "A", "case": "\\ud800"}', 1, "it is not JSON"),
        ('{"time_ms": 1, "activity": "A", "case": "x", "alias": 3}', 1, "alias"),
        ("case,activity,time_ms\nframe-1,A,1", 1, "alias is missing"),
        ("case,activity,time_ms,alias\nframe-1,A,soon,", 2, "whole number"),
        ("case,activity,time_ms,alias\nframe-1,A,5,\nframe-1", 3, "whole number"),
        ("<log><trace>\n<event>", 2, "XML"),
        ('<log><trace><string key="concept:name" value="x"/>\n<event/></trace></log>', 2, "time:timestamp"),
        ('<!DOCTYPE log [<!ENTITY a "b">]><log/>', 1, "document type"),
    ],
)
def test_a_bad_line_of_our_forms_is_named(text: str, line: int, reason: str) -> None:
    told = refusal(text)
    assert f"Line {line} " in told
    assert reason in told


def test_our_log_is_the_same_table_in_all_three_forms(tmp_path: Path) -> None:
    with EventLog(tmp_path / "events.jsonl") as log:
        log.write(1_700_000_000_123, IMAGE_RETRIEVE, "frame-1")
        log.write(1_700_000_000_150, RFID_RETRIEVE, "tag-aa", alias="tag-aa")
        log.write(1_700_000_006_200, IMAGE_PAIRED, "frame-1", alias="tag-aa", note="<&>")
    events = read_events(tmp_path / "events.jsonl")
    write_csv(events, tmp_path / "events.csv")
    write_xes(events, tmp_path / "events.xes")
    tables = [read_log(tmp_path / f"events.{form}") for form in ("jsonl", "csv", "xes")]
    assert [table.form for table in tables] == ["json lines", "CSV", "XES"]
    assert tables[0].events == tables[1].events == tables[2].events
    assert tables[0].events[2] == LoggedEvent(1_700_000_006_200, IMAGE_PAIRED, "frame-1", "tag-aa")


def test_a_file_without_events_or_of_bytes_is_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").write_bytes(b" \n")
    (tmp_path / "bytes").write_bytes(b"\xff\xfe\x00")
    for name, code in (("empty", "EVENT_LOG_INVALID"), ("bytes", "FILE_UNUSABLE"), ("none", "FILE_UNUSABLE")):
        with pytest.raises(BlockRobotError, match=f"^{code}:"):
            read_log(tmp_path / name)


def test_what_is_done_for_one_owner_of_a_frame_follows_what_was_done_for_her() -> None:
    case = "frame-1"
    events = [
        LoggedEvent(0, "SEEN", case),
        LoggedEvent(1, "PAIRED", case, "a"),
        LoggedEvent(2, "PAIRED", case, "b"),
        LoggedEvent(3, "STORED", case, "b"),
        LoggedEvent(9, "STORED", case, "a"),
        LoggedEvent(10, "CLOSED", case),
        LoggedEvent(11, "ERASED", case, "a"),
    ]
    told = [(None if before is None else before.time_ms, event.time_ms) for before, event in follow(events)]
    assert told == [(None, 0), (0, 1), (0, 2), (2, 3), (1, 9), (9, 10), (10, 11)]
