"""Reads event logs: published text, JSON lines, CSV, XES."""

from __future__ import annotations

import csv
import datetime
import re
from collections.abc import Iterator
from pathlib import Path
from xml.parsers import expat

from clients.sdk.new_files import read_given_text
from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError
from consensus.visible_text import split_lines
from network.experiments.pages.event_table import EventTable, LoggedEvent
from network.experiments.published_log import invalid_line, parse_published_log

EVENT_LOG_MAX_BYTES = 256 * 1024 * 1024
FIELD_MAX_CHARS = 200
TIME_MAX_MS = 253_402_300_799_999
"""The end of the year 9999."""
CSV_COLUMNS = ("case", "activity", "time_ms", "alias")
_WHOLE = re.compile(r"\d{1,15}")


def read_log(path: Path) -> EventTable:
    """The form is detected by its first characters. Raises EVENT_LOG_INVALID with the line, also if without events;
    FILE_UNUSABLE.
    """
    try:
        text = read_given_text(path, EVENT_LOG_MAX_BYTES, encoding="utf-8-sig")
    except OSError as error:
        raise BlockRobotError("FILE_UNUSABLE", f"{path}: {error.strerror or type(error).__name__}.") from None
    table = parse_log(text)
    if not table.events:
        raise BlockRobotError("EVENT_LOG_INVALID", f"{path.name} holds no event.")
    return table


def parse_log(text: str) -> EventTable:
    """Raises EVENT_LOG_INVALID."""
    beginning = text.lstrip()[:64]
    if beginning.startswith("{"):
        return EventTable.of("json lines", _parse_json_lines(text))
    if beginning.startswith("<"):
        return EventTable.of("XES", _XesReader().read(text))
    if beginning.startswith("case,"):
        return EventTable.of("CSV", _parse_csv(text))
    return parse_published_log(split_lines(text))


def _event(time_ms: object, activity: object, case: object, alias: object, number: int) -> LoggedEvent:
    if not isinstance(time_ms, int) or isinstance(time_ms, bool) or not 0 <= time_ms <= TIME_MAX_MS:
        raise invalid_line(number, "the time is not a whole number of milliseconds")
    for name, value in (("activity", activity), ("case", case), ("alias", alias)):
        if not isinstance(value, str) or len(value) > FIELD_MAX_CHARS or not (value or name == "alias"):
            raise invalid_line(number, f"the {name} is not a text of 1 to {FIELD_MAX_CHARS} characters")
        if not value.isprintable():  # neither a terminal nor XML takes such characters
            raise invalid_line(number, f"the {name} holds a control character")
    return LoggedEvent(time_ms, str(activity), str(case), str(alias))


def _parse_json_lines(text: str) -> Iterator[LoggedEvent]:
    for number, line in enumerate(split_lines(text), 1):
        if not line.strip():
            continue
        try:
            row = read_json_text(line)
        except ValueError:
            raise invalid_line(number, "it is not JSON") from None
        if not isinstance(row, dict):
            raise invalid_line(number, "it is not a JSON object")
        yield _event(row.get("time_ms"), row.get("activity"), row.get("case"), row.get("alias", ""), number)


def _parse_csv(text: str) -> Iterator[LoggedEvent]:
    reader = csv.DictReader(split_lines(text))
    missing = [name for name in CSV_COLUMNS if name not in (reader.fieldnames or ())]
    if missing:
        raise invalid_line(1, f"the column {missing[0]} is missing")
    try:
        for row in reader:
            time_ms = row["time_ms"] or ""
            number = reader.line_num
            if not _WHOLE.fullmatch(time_ms):
                raise invalid_line(number, "the time is not a whole number of milliseconds")
            yield _event(int(time_ms), row["activity"], row["case"], row["alias"] or "", number)
    except csv.Error as error:
        raise invalid_line(reader.line_num, f"it is not CSV ({error})") from None


class _XesReader:
    """Reads XES with a parser that refuses document types, against entity expansion."""

    def __init__(self) -> None:
        self._parser = expat.ParserCreate(namespace_separator=" ")
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.StartDoctypeDeclHandler = self._refuse
        self._events: list[LoggedEvent] = []
        self._in: list[str] = []
        self._trace = ""
        self._fields: dict[str, str] = {}

    def read(self, text: str) -> list[LoggedEvent]:
        try:
            self._parser.Parse(text, True)
        except expat.ExpatError as error:
            raise invalid_line(error.lineno, "it is not well-formed XML") from None
        return self._events

    def _refuse(self, *_: object) -> None:
        raise invalid_line(self._parser.CurrentLineNumber, "a document type is not read")

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        tag = name.rsplit(" ", 1)[-1]
        within = self._in[-1] if self._in else ""
        self._in.append(tag)
        if tag == "trace":
            self._trace = ""
        elif tag == "event":
            self._fields = {}
        elif within == "trace" and attributes.get("key") == "concept:name":
            self._trace = attributes.get("value", "")
        elif within == "event":
            self._fields[attributes.get("key", "")] = attributes.get("value", "")

    def _end(self, name: str) -> None:
        self._in.pop()
        if name.rsplit(" ", 1)[-1] == "event":
            number = self._parser.CurrentLineNumber
            try:
                moment = datetime.datetime.fromisoformat(self._fields.get("time:timestamp", ""))
            except ValueError:
                raise invalid_line(number, "an event has no time:timestamp") from None
            if moment.tzinfo is None:
                moment = moment.replace(tzinfo=datetime.UTC)
            time_ms = round(moment.timestamp() * 1000)
            activity, alias = self._fields.get("concept:name"), self._fields.get("org:resource", "")
            self._events.append(_event(time_ms, activity, self._trace, alias, number))
