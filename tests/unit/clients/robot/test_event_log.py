"""The event log: the paper's activities, aliases for tags, and three formats. A UID is never in it."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from clients.robot.recording.event_log import (
    ACTIVITIES,
    BLOCKCHAIN_TRANSACTION,
    IMAGE_PAIRED,
    IMAGE_RETRIEVE,
    RFID_RETRIEVE,
    AliasBook,
    Event,
    EventLog,
    read_events,
    write_csv,
    write_xes,
)
from consensus.errors import BlockRobotError

UID = "E2801160600002054A1B2C3D"


def test_a_tag_has_one_alias_in_a_run_which_says_nothing_of_the_uid() -> None:
    first, second = AliasBook(), AliasBook()
    alias = first.alias(UID.encode())
    assert first.alias(UID.encode()) == alias
    assert second.alias(UID.encode()) != alias
    assert first.alias(b"another") != alias
    # Were it any function of the UID, a dictionary of UIDs would undo it; two books agree on nothing.
    aliases = {AliasBook().alias(UID.encode()) for _ in range(20)}
    assert len(aliases) > 15
    assert all(part not in alias for alias in aliases for part in (UID, UID.lower(), UID[-6:].lower()))


def test_two_tags_never_share_an_alias(monkeypatch: pytest.MonkeyPatch) -> None:
    """People are told apart by alias during a run: two of one name would be recorded for each other."""
    drawn = iter(["aaaaaa", "aaaaaa", "aaaaaa", "bbbbbb"])
    monkeypatch.setattr("clients.robot.recording.event_log.secrets.token_hex", lambda size: next(drawn))
    book = AliasBook()
    assert (book.alias(b"one"), book.alias(b"two")) == ("tag-aaaaaa", "tag-bbbbbb")


def write_run(path: Path) -> str:
    book = AliasBook()
    alias = book.alias(UID.encode())
    with EventLog(path) as log:
        log.write(1_000, IMAGE_RETRIEVE, "frame-1")
        log.write(1_010, RFID_RETRIEVE, alias, alias=alias)
        log.write(1_020, IMAGE_PAIRED, "frame-1", alias=alias)
        log.write(1_500, BLOCKCHAIN_TRANSACTION, "record-00ff", size_bytes=12)
    return alias


def test_lines_say_what_happened_in_order(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "events.jsonl"
    alias = write_run(path)
    assert [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()] == [
        {"time_ms": 1_000, "activity": "IMAGE_RETRIEVE", "case": "frame-1"},
        {"time_ms": 1_010, "activity": "RFID_RETRIEVE", "case": alias, "alias": alias},
        {"time_ms": 1_020, "activity": "IMAGE_PAIRED", "case": "frame-1", "alias": alias},
        {"time_ms": 1_500, "activity": "BLOCKCHAIN_TRANSACTION", "case": "record-00ff", "detail": {"size_bytes": 12}},
    ]
    assert UID.lower() not in path.read_text(encoding="utf-8").lower()


def test_a_second_run_is_appended(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    write_run(path)
    write_run(path)
    assert len(read_events(path)) == 8


def test_what_was_logged_is_in_the_file_at_once(tmp_path: Path) -> None:
    """It can be read while the run goes on, and a robot that is killed has told what it did until then."""
    with EventLog(tmp_path / "events.jsonl") as log:
        log.write(1_000, IMAGE_RETRIEVE, "frame-1")
        assert len(read_events(tmp_path / "events.jsonl")) == 1


def test_every_known_activity_is_counted_and_a_closed_log_takes_nothing(tmp_path: Path) -> None:
    with EventLog(tmp_path / "events.jsonl") as log:
        for activity in ACTIVITIES:
            log.write(0, activity, "frame-0")
        log.write(0, IMAGE_RETRIEVE, "frame-1")
        assert log.counts == dict.fromkeys(ACTIVITIES, 1) | {IMAGE_RETRIEVE: 2}
    with EventLog(tmp_path / "events.jsonl") as log, pytest.raises(KeyError):
        log.write(0, "IMAGE_SOLD", "frame-0")
    log = EventLog(tmp_path / "events.jsonl")
    with pytest.raises(ValueError, match="closed"):
        log.write(0, IMAGE_RETRIEVE, "frame-0")


def test_csv_has_one_row_an_event_and_xes_one_trace_a_case(tmp_path: Path) -> None:
    write_run(tmp_path / "events.jsonl")
    write_csv(read_events(tmp_path / "events.jsonl"), tmp_path / "events.csv")
    with (tmp_path / "events.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["activity"] for row in rows] == [IMAGE_RETRIEVE, RFID_RETRIEVE, IMAGE_PAIRED, BLOCKCHAIN_TRANSACTION]
    assert rows[0]["alias"] == ""
    assert rows[2]["alias"].startswith("tag-")
    events = read_events(tmp_path / "events.jsonl")
    write_xes([*events, Event(5, IMAGE_RETRIEVE, "<&\"'>")], tmp_path / "events.xes")
    space = {"x": "http://www.xes-standard.org/"}
    log = ElementTree.parse(tmp_path / "events.xes").getroot()
    traces = {
        trace.find("x:string", space).attrib["value"]: [  # type: ignore[union-attr]
            event.find("x:string", space).attrib["value"]  # type: ignore[union-attr]
            for event in trace.findall("x:event", space)
        ]
        for trace in log.findall("x:trace", space)
    }
    assert traces["frame-1"] == [IMAGE_RETRIEVE, IMAGE_PAIRED]
    assert traces["<&\"'>"] == [IMAGE_RETRIEVE]


def test_xes_states_times_in_the_standards_own_attribute(tmp_path: Path) -> None:
    """Process mining tools read `time:timestamp`, a date; an attribute of our own they would ignore."""
    write_xes([Event(1_700_000_000_123, IMAGE_RETRIEVE, "frame-1")], tmp_path / "events.xes")
    space = {"x": "http://www.xes-standard.org/"}
    date = ElementTree.parse(tmp_path / "events.xes").getroot().find("x:trace/x:event/x:date", space)
    assert date is not None
    assert date.attrib == {"key": "time:timestamp", "value": "2023-11-14T22:13:20.123+00:00"}


@pytest.mark.parametrize("half", ['{"time_ms":2000,"activity":"IMAGE_RET', '{"ti', "{"])
def test_the_log_of_a_robot_that_was_killed_is_read_and_goes_on(tmp_path: Path, half: str) -> None:
    """Its last line may be half a line: no reader may stumble over it, and the next run must not write behind it."""
    path = tmp_path / "events.jsonl"
    write_run(path)
    whole = read_events(path)
    with path.open("a", encoding="utf-8") as file:
        file.write(half)
    assert read_events(path) == whole
    with EventLog(path) as log:
        log.write(3_000, IMAGE_RETRIEVE, "frame-3")
    assert read_events(path) == [*whole, Event(3_000, IMAGE_RETRIEVE, "frame-3")]
    assert len(path.read_text(encoding="utf-8").splitlines()) == len(whole) + 1


def test_a_file_that_is_no_log_loses_nothing_by_being_named_as_one(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("my notes", encoding="utf-8")
    with pytest.raises(BlockRobotError, match="EVENTS_FILE_FOREIGN"):
        write_run(path)
    assert path.read_text(encoding="utf-8") == "my notes"


def test_a_log_that_a_power_cut_spoilt_goes_on_in_a_new_line(tmp_path: Path) -> None:
    path = tmp_path / "events.jsonl"
    write_run(path)
    before = path.read_bytes()
    path.write_bytes(before + bytes(9))
    write_run(path)
    assert path.read_bytes().startswith(before + bytes(9) + b'\n{"time_ms":')


def test_a_log_is_for_its_owner_alone_and_not_where_a_link_leads(tmp_path: Path) -> None:
    path, target = tmp_path / "events.jsonl", tmp_path / "target"
    write_run(path)
    assert path.stat().st_mode & 0o777 == 0o600
    (tmp_path / "link").symlink_to(target)
    with pytest.raises(BlockRobotError, match="FILE_EXISTS"):
        write_run(tmp_path / "link")
    assert not target.exists()
    target.write_bytes(b"")
    with pytest.raises(BlockRobotError, match="FILE_EXISTS"):
        write_run(tmp_path / "link")
    assert target.read_bytes() == b"", "not even the end of a line"
