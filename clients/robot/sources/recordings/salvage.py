"""Salvage truncated MCAP, ROS 1 and SQLite recordings, front to back.

Scans raise `BrokenOffError` at the break; they modify nothing and yield only whole records.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import apsw
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1.reader import decompressors
from rosbags.rosbag2.storage_mcap import decompress
from rosbags.typesys.msg import normalize_msgtype

from clients.robot.sources.messages.message_types import DEFINITION_MAX_CHARS, DEFINITIONS_MAX_COUNT
from clients.robot.sources.recordings.bounded_chunks import ChunkTooLargeError
from clients.robot.sources.recordings.budget import current_budget
from clients.robot.sources.recordings.database import open_database
from consensus.errors import BlockRobotError

RECORD_MAX_BYTES = 1 << 30
ROS1_FIELDS_MAX_COUNT = 64
"""Of a header; recorders write up to seven."""
MCAP_MAGIC = b"\x89MCAP0\r\n"
ROS1_MAGIC = b"#ROSBAG V2.0\n"
SQLITE_MAGIC = b"SQLite format 3\x00"
_NO_DEFINITION = MessageDefinition(MessageDefinitionFormat.NONE, "")
_FORMATS = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}


class BrokenOffError(Exception):
    """The file is truncated or damaged at this position."""


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic as the file declares it, before its first message."""

    number: int
    topic: str
    msgtype: str
    definition: MessageDefinition


@dataclass(frozen=True, slots=True)
class SalvagedMessage:
    """One whole message: channel number, recording time, bytes."""

    channel: int
    at_ns: int
    data: bytes


Scan = Iterator[Channel | SalvagedMessage]


def scan_file(path: Path) -> Scan:
    """By its first bytes. Raises `BrokenOffError` for non-recordings, RECORDING_TOO_LARGE."""
    current_budget().open_once(path)
    with path.open("rb") as file:
        begins = file.read(len(SQLITE_MAGIC))
        if begins.startswith(MCAP_MAGIC):
            file.seek(len(MCAP_MAGIC))
            yield from _guarded(_mcap_records(file, inside=False))
        elif begins.startswith(ROS1_MAGIC):
            file.seek(len(ROS1_MAGIC))
            yield from _guarded(_ros1_records(file, inside=False))
        elif begins == SQLITE_MAGIC:
            yield from scan_sqlite(path)
        else:
            raise BrokenOffError("It does not begin as a recording does.")


def _guarded(scan: Scan) -> Scan:
    try:
        yield from scan
    except (BrokenOffError, BlockRobotError):
        raise
    except ChunkTooLargeError as error:
        raise BrokenOffError(str(error)) from error
    except Exception as error:
        raise BrokenOffError("A record is damaged.") from error


def _read(file: BinaryIO, size: int, *, may_end: bool = False) -> bytes:
    if size > RECORD_MAX_BYTES:
        raise BrokenOffError("A record says that it is larger than any.")
    data = file.read(size)
    if len(data) != size and not may_end:
        raise BrokenOffError("The last record is not whole.")
    return data


def _in_time_order(scan: Scan) -> Scan:
    found: list[SalvagedMessage] = []
    broken: BrokenOffError | None = None
    try:
        for item in _guarded(scan):
            if isinstance(item, SalvagedMessage):
                found.append(item)
            else:
                yield item
    except BrokenOffError as error:
        broken = error
    yield from sorted(found, key=lambda item: item.at_ns)
    if broken is not None:
        raise broken


def _definition(kind: MessageDefinitionFormat | None, text: str) -> MessageDefinition:
    return _NO_DEFINITION if kind is None else MessageDefinition(kind, text[: DEFINITION_MAX_CHARS + 1])


# MCAP: an opcode, a length of 8 bytes, the record


def _mcap_records(
    file: BinaryIO, *, inside: bool, schemas: dict[int, tuple[str, MessageDefinition]] | None = None
) -> Scan:
    schemas = {} if schemas is None else schemas
    while opcode := file.read(1):
        (length,) = struct.unpack("<Q", _read(file, 8))
        data = _read(file, length, may_end=opcode == b"\x06")
        record = BytesIO(data)
        if opcode == b"\x03":
            (number,) = struct.unpack("<H", _read(record, 2))
            name, kind, text = _mcap_text(record), _mcap_text(record), _mcap_text(record)
            schemas[number] = (name, _definition(_FORMATS.get(kind), text))
            if len(schemas) > DEFINITIONS_MAX_COUNT:
                raise BrokenOffError("It defines more types than anybody records.")
        elif opcode == b"\x04":
            number, schema = struct.unpack("<HH", _read(record, 4))
            name, definition = schemas.get(schema, ("", _NO_DEFINITION))
            topic, encoding = _mcap_text(record), _mcap_text(record)
            if encoding != "cdr":
                raise BrokenOffError(f"Its messages are written as {encoding[:16]!r}, not as ROS 2 does (cdr).")
            yield Channel(number, topic, name, definition)
        elif opcode == b"\x05":
            number, _, at_ns, _ = struct.unpack("<HIQQ", _read(record, 22))
            yield SalvagedMessage(number, at_ns, record.read())
        elif opcode == b"\x06" and not inside:
            _, _, size, crc = struct.unpack("<QQQI", _read(record, 28))
            compression = _mcap_text(record)
            (packed_size,) = struct.unpack("<Q", _read(record, 8))
            packed = record.read(packed_size)
            whole = len(data) == length and len(packed) == packed_size
            if not whole and compression:
                raise BrokenOffError("The last chunk is not whole.")
            chunk = BytesIO(decompress(packed, compression, size, crc) if whole else packed)
            yield from _in_time_order(_mcap_records(chunk, inside=True, schemas=schemas))
            if not whole:
                raise BrokenOffError("The last chunk is not whole.")
        elif opcode in (b"\x0f", b"\x02"):  # what follows is index, no more messages
            return
    if not inside:
        raise BrokenOffError("It has no end.")


def _mcap_text(record: BinaryIO) -> str:
    return _read(record, *struct.unpack("<I", _read(record, 4))).decode()


# ROS 1: a header of name=value fields, then data; lengths of 4 bytes before each


def _ros1_records(file: BinaryIO, *, inside: bool) -> Scan:
    while lead := file.read(4):
        if len(lead) != 4:
            raise BrokenOffError("The last record is not whole.")
        current_budget().count_records(1)
        header = ros1_fields(_read(file, *struct.unpack("<I", lead)))
        (length,) = struct.unpack("<I", _read(file, 4))
        opcode = header["op"]
        data = _read(file, length, may_end=opcode == b"\x05")
        if opcode == b"\x07":
            fields = ros1_fields(data)
            definition = _definition(MessageDefinitionFormat.MSG, fields["message_definition"].decode())
            (number,) = struct.unpack("<I", header["conn"])
            yield Channel(number, header["topic"].decode(), normalize_msgtype(fields["type"].decode()), definition)
        elif opcode == b"\x02":
            (number,) = struct.unpack("<I", header["conn"])
            seconds, rest = struct.unpack("<II", header["time"])
            yield SalvagedMessage(number, seconds * 10**9 + rest, data)
        elif opcode == b"\x05" and not inside:
            compression, whole = header["compression"].decode(), len(data) == length
            if not whole and compression != "none":
                raise BrokenOffError("The last chunk is not whole.")
            yield from _in_time_order(_ros1_records(BytesIO(decompressors[compression](data)), inside=True))
            if not whole:
                raise BrokenOffError("The last chunk is not whole.")
        elif opcode == b"\x06":  # what follows is index, no more messages
            return
    if not inside:
        raise BrokenOffError("It has no end.")


def ros1_fields(data: bytes) -> dict[str, bytes]:
    """Raises `BrokenOffError`."""
    fields: dict[str, bytes] = {}
    place = 0
    for _ in range(ROS1_FIELDS_MAX_COUNT):
        if place == len(data):
            return fields
        (size,) = struct.unpack_from("<I", data, place)
        name, mark, value = data[place + 4 : place + 4 + size].partition(b"=")
        if not mark or place + 4 + size > len(data):
            raise BrokenOffError("A record's header is damaged.")
        fields[name.decode()] = value
        place += 4 + size
    raise BrokenOffError("A record's header has more fields than recorders write.")


# SQLite: rows in the order in which they were written


def scan_sqlite(path: Path) -> Scan:
    try:
        base = open_database(path, cut_off=True)
    except (apsw.Error, OSError, ValueError, MemoryError) as error:  # a text that is no Unicode is a ValueError
        raise BrokenOffError("The database is damaged, or no recorder wrote it.") from error
    try:
        definitions = _sqlite_definitions(base)
        for number, name, kind in base.execute("SELECT id, name, type FROM topics ORDER BY id"):
            yield Channel(int(number), str(name), str(kind), definitions.get(str(kind), _NO_DEFINITION))
        for number, at_ns, data in base.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id"):
            yield SalvagedMessage(int(number), int(at_ns), bytes(data))
    except (apsw.Error, ValueError, TypeError, OverflowError, MemoryError) as error:
        raise BrokenOffError("The database is damaged or cut off.") from error
    finally:
        base.close()


def _sqlite_definitions(base: apsw.Connection) -> dict[str, MessageDefinition]:
    tables = {name for (name,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if "message_definitions" not in tables:
        return {}
    rows = base.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
    return {str(name): _definition(_FORMATS.get(kind), str(text)) for name, kind, text in rows}
