"""The robot's event log, with the paper's activity names.

Tag aliases are new each run; record ids are omitted, unlinking owners.
"""

from __future__ import annotations

import csv
import datetime
import json
import os
import secrets
from collections.abc import Iterable
from io import TextIOWrapper
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, TextIO
from xml.sax.saxutils import quoteattr

import msgspec
from msgspec import Struct

from clients.sdk.new_files import open_to_append
from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError

IMAGE_RETRIEVE = "IMAGE_RETRIEVE"
RFID_RETRIEVE = "RFID_RETRIEVE"
IMAGE_NOT_PAIRED_NOT_EXIST_RFID = "IMAGE_NOT_PAIRED_NOT_EXIST_RFID"
IMAGE_NOT_PAIRED_WITH_UNKNOWN_RFID = "IMAGE_NOT_PAIRED_WITH_UNKNOWN_RFID"
IMAGE_PAIRED = "IMAGE_PAIRED"
IMAGE_WITHHELD = "IMAGE_WITHHELD"
BLOCKCHAIN_TRANSACTION = "BLOCKCHAIN_TRANSACTION"
DATABASE_PERSISTANCE = "DATABASE_PERSISTANCE"
CLOCK_ESTIMATED = "CLOCK_ESTIMATED"
MESSAGE_REFUSED = "MESSAGE_REFUSED"
SENSE_WITHHELD = "SENSE_WITHHELD"

ACTIVITIES = (
    IMAGE_RETRIEVE,
    RFID_RETRIEVE,
    IMAGE_NOT_PAIRED_NOT_EXIST_RFID,
    IMAGE_NOT_PAIRED_WITH_UNKNOWN_RFID,
    IMAGE_PAIRED,
    IMAGE_WITHHELD,
    BLOCKCHAIN_TRANSACTION,
    DATABASE_PERSISTANCE,
    CLOCK_ESTIMATED,
    MESSAGE_REFUSED,
    SENSE_WITHHELD,
)
DEPTH = "depth"
"""The sensor whose samples are the log's frames."""

RUN_NOTES = frozenset({CLOCK_ESTIMATED, MESSAGE_REFUSED})  # about the run, not about any frame or tag
ALIASES_MAX_COUNT = 65_536
_LINE_MAX_BYTES = 64 * 1024
_BEGINNING = b'{"time_ms":'  # as `EventLog.write` begins each line


_XES_EXTENSIONS = (("Concept", "concept"), ("Time", "time"), ("Organizational", "org"))


def _draw() -> str:
    return f"tag-{secrets.token_hex(3)}"


class AliasBook:
    """Tag aliases of one run, in memory only."""

    def __init__(self) -> None:
        self._aliases: dict[bytes, str] = {}
        self._taken: set[str] = set()

    @property
    def is_full(self) -> bool:
        """Whether strangers' tags get no more aliases."""
        return len(self._aliases) >= ALIASES_MAX_COUNT

    def alias(self, tag: bytes) -> str:
        if tag not in self._aliases:
            alias = _draw()
            while alias in self._taken:  # an alias shared by two tags would mix two people
                alias = _draw()
            self._taken.add(alias)
            self._aliases[tag] = alias
        return self._aliases[tag]


class Event(Struct, frozen=True):
    """One event: wall clock in ms, and what it is about; `alias`: of a tag, where it is about one."""

    time_ms: int
    activity: str
    case: str
    alias: str = ""
    detail: dict[str, str | int | float] = {}


class EventLog:
    """Append-only JSON lines, unbuffered; opening cuts off an incomplete line."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file: TextIO | None = None
        self.counts: dict[str, int] = dict.fromkeys(ACTIVITIES, 0)

    def __enter__(self) -> EventLog:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        file = open_to_append(self._path)
        self._file = TextIOWrapper(file, encoding="utf-8", line_buffering=True)
        try:
            _end_whole(file, self._path)
        except BaseException:
            self._file.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def write(self, time_ms: int, activity: str, case: str, *, alias: str = "", **detail: str | int | float) -> None:
        """Wall clock in ms."""
        if self._file is None:
            raise ValueError("the event log is closed")
        self.counts[activity] += 1
        line: dict[str, object] = {"time_ms": time_ms, "activity": activity, "case": case}
        if alias:
            line["alias"] = alias
        if detail:
            line["detail"] = detail
        self._file.write(json.dumps(line, separators=(",", ":")) + "\n")

    def write_withheld(
        self, time_ms: int, sensor: str, sequence: int, *, alias: str, reason: str, **numbers: str | int | float
    ) -> None:
        activity, kind = (IMAGE_WITHHELD, "frame") if sensor == DEPTH else (SENSE_WITHHELD, sensor)
        self.write(time_ms, activity, f"{kind}-{sequence}", alias=alias, reason=reason, **numbers)


def _end_whole(file: BinaryIO, path: Path) -> None:
    """Cut off or end a last line. Raises EVENTS_FILE_FOREIGN."""
    file.seek(0)
    if not _may_begin(file.read(len(_BEGINNING))):
        raise BlockRobotError("EVENTS_FILE_FOREIGN", f"{path} holds something else than a robot's events.")
    content_bytes = file.seek(0, os.SEEK_END)
    file.seek(max(0, content_bytes - _LINE_MAX_BYTES))
    tail = file.read().rpartition(b"\n")[2]
    if tail and _may_begin(tail):
        file.truncate(content_bytes - len(tail))
    elif tail:  # what a power cut left
        file.write(b"\n")


def _may_begin(line: bytes) -> bool:
    return line.startswith(_BEGINNING) or _BEGINNING.startswith(line)


def read_events(path: Path) -> list[Event]:
    """Return a log's events in file order, without an incomplete last line."""
    *whole, _ = path.read_text(encoding="utf-8").split("\n")
    return [msgspec.convert(read_json_text(line), Event) for line in whole if line]


def write_csv(events: Iterable[Event], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["case", "activity", "time_ms", "alias"])
        for event in events:
            writer.writerow([event.case, event.activity, event.time_ms, event.alias])


def write_xes(events: Iterable[Event], path: Path) -> None:
    """Write events as XES (IEEE 1849-2016): trace per case, UTC, aliases as resources."""
    traces: dict[str, list[Event]] = {}
    for event in events:
        traces.setdefault(event.case, []).append(event)
    with path.open("w", encoding="utf-8") as file:
        file.write(
            '<?xml version="1.0" encoding="UTF-8"?>\n<log xes.version="1.0" xmlns="http://www.xes-standard.org/">\n'
        )
        for name, prefix in _XES_EXTENSIONS:
            uri = f"http://www.xes-standard.org/{prefix}.xesext"
            file.write(f' <extension name="{name}" prefix="{prefix}" uri="{uri}"/>\n')
        for case, rows in traces.items():
            file.write(f' <trace>\n  <string key="concept:name" value={quoteattr(case)}/>\n')
            for row in rows:
                name = quoteattr(row.activity)
                file.write(f'  <event><string key="concept:name" value={name}/>')
                if row.alias:
                    file.write(f'<string key="org:resource" value={quoteattr(row.alias)}/>')
                moment = datetime.datetime.fromtimestamp(row.time_ms / 1000, datetime.UTC)
                file.write(
                    f'<date key="time:timestamp" value="{moment.isoformat(timespec="milliseconds")}"/></event>\n'
                )
            file.write(" </trace>\n")
        file.write("</log>\n")
