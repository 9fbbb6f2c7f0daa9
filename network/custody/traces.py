"""Traces of a record: pieces of its id, ciphertexts, keys and roots on the chain.

Pieces can be taken only while a record is kept, so they can be written to a file before erasure.
"""

from __future__ import annotations

import asyncio
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import msgspec
from pymongo import MongoClient
from pymongo.errors import PyMongoError

from clients.bundle.layout import PICTURE_MAX_BYTES
from clients.sdk.new_files import read_given_file, write_new_file
from consensus.bounded_text import JSON_MAX_BYTES, read_json_as
from consensus.chain.block import Block
from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, decode_value
from consensus.state.access import GRANT
from consensus.state.records import RECORD
from consensus.state.rights import QUARANTINE
from network.custody.searching import PREFIX_BYTES, spread
from node.clips_place import ClipsPlace
from node.config import NodeConfig
from node.custody.blobs.blob_backed_store import with_ciphertexts
from node.custody.blobs.place_file import open_names
from node.custody.erase_keys import (
    ERASE_KEY_BYTES,
    ERASE_KEYS_FILE_NAME,
    HEADER_BYTES,
    PAGE_SLOTS_COUNT,
    unwrap_key,
)
from node.custody.shares import PART_PLACE, HeldPart
from node.custody.stores.custody_store import FrameRow
from node.custody.stores.open_store import MONGO_SCHEMES, open_blobs
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME
from node.storage.ledger_store import LedgerSnapshot

FORMAT_VERSION = 1
CIPHERTEXT_PIECES_COUNT = 4
PLAINTEXT_PIECES_COUNT = 16
SERVER_MAX_MS = 5_000
_PAGE_BYTES = PAGE_SLOTS_COUNT * (1 + ERASE_KEY_BYTES)


@dataclass
class Trace:
    """Pieces of one record by kind: id, root, metadata, leaf, ciphertext, wrapped-key, sealed-key, erase-key,
    plaintext, and if shared wrapped-part, package, key-part.

    `status` in the finalized state: active, erasing, erased, expired, or unknown. `grants`: the grant of each piece of
    a key part; `ended`: grants of which nothing may remain.
    """

    record_id: bytes
    status: str = "unknown"
    pieces: dict[str, set[bytes]] = field(default_factory=dict)
    grants: dict[bytes, bytes] = field(default_factory=dict)
    ended: set[bytes] = field(default_factory=set)

    def add(self, kind: str, content: bytes, count: int = 1, *, grant: bytes = b"") -> None:
        """Of a long enough byte string; for a key part with its grant."""
        pieces = spread(content, count)
        self.pieces.setdefault(kind, set()).update(pieces)
        if grant:
            self.grants.update(dict.fromkeys(pieces, grant))

    def is_over(self, piece: bytes) -> bool:
        """Nothing may remain: record erased or grant ended."""
        return self.is_gone or self.grants.get(piece) in self.ended

    @property
    def is_gone(self) -> bool:
        """Erasure is done or under way."""
        return self.status in {"erasing", "erased", "expired"}

    @property
    def is_compared(self) -> bool:
        return not self.is_gone or any(self.pieces.get(kind) for kind in ("ciphertext", "plaintext"))


class _Kept(msgspec.Struct):
    format: int
    records: dict[str, dict[str, list[str]]]
    grants: dict[str, dict[str, str]] = {}


def write_traces(path: Path, traces: Sequence[Trace]) -> None:
    """Atomically, to a new file only its owner can read. Raises as `new_file`."""
    records = {
        trace.record_id.hex(): {kind: sorted(piece.hex() for piece in pieces) for kind, pieces in trace.pieces.items()}
        for trace in traces
    }
    grants = {
        trace.record_id.hex(): {piece.hex(): grant.hex() for piece, grant in sorted(trace.grants.items())}
        for trace in traces
    }
    write_new_file(path, msgspec.json.encode(_Kept(FORMAT_VERSION, records, grants)))


def read_traces(path: Path) -> list[Trace]:
    """Raises FILE_UNUSABLE for another kind of file."""
    try:
        kept = read_json_as(read_given_file(path, JSON_MAX_BYTES), _Kept)
        traces = [
            Trace(bytes.fromhex(name), pieces={kind: {bytes.fromhex(piece) for piece in found} for kind, found in each})
            for name, each in ((name, each.items()) for name, each in kept.records.items())
        ]
        for trace in traces:
            grant_of_piece = kept.grants.get(trace.record_id.hex(), {})
            trace.grants = {bytes.fromhex(piece): bytes.fromhex(grant) for piece, grant in grant_of_piece.items()}
    except ValueError:
        raise BlockRobotError("FILE_UNUSABLE", f"{path.name} is no file of traces that custody hunt wrote.") from None
    if kept.format != FORMAT_VERSION:
        raise BlockRobotError("FILE_UNUSABLE", f"{path.name} was written by another version.")
    return traces


def trace_chain(trace: Trace, ledger: LedgerSnapshot) -> None:
    trace.add("id", trace.record_id)
    row = RECORD.at(ledger, trace.record_id)
    if row is None:
        return
    trace.status = row.status
    body = ledger.block(row.height)
    if body is None:
        return
    for wire in decode(body, Block).transactions:
        transaction = decode_transaction(wire)
        if transaction.txid == row.txid:
            arguments = decode_value(transaction.body.args)
            for kind, content in (("root", arguments[2]), ("root", arguments[3]), ("metadata", arguments[4])):
                trace.add(kind, content)


def trace_grants(trace: Trace, ledger: LedgerSnapshot) -> None:
    record = RECORD.at(ledger, trace.record_id)
    at_ms = 0 if ledger.position is None else ledger.position.timestamp_ms
    is_denied = record is not None and QUARANTINE.has(ledger, record.owner)
    for grant_id in set(trace.grants.values()):
        grant = GRANT.at(ledger, grant_id)
        if is_denied or (grant is not None and not grant.is_open(at_ms)):
            trace.ended.add(grant_id)


def trace_store(trace: Trace, config: NodeConfig) -> None:
    """What one custodian keeps. Raises STORE_UNAVAILABLE."""
    is_mongo = config.custody_store.startswith(MONGO_SCHEMES)
    frames, leaves = (_read_mongo if is_mongo else _read_sqlite)(config, trace.record_id)
    if config.clips is not None:
        frames = asyncio.run(_with_ciphertexts(config, config.clips, trace.record_id, frames))
    for leaf in leaves:
        trace.add("leaf", leaf)
    for frame in frames:
        trace.add("ciphertext", frame.ciphertext, CIPHERTEXT_PIECES_COUNT)
        trace.add("wrapped-key", frame.wrapped_key[-PREFIX_BYTES:])
        erase_key = _read_erase_key(config, frame.slot)
        trace.add("erase-key", erase_key[:PREFIX_BYTES])
        try:
            sealed_key = unwrap_key(erase_key, trace.record_id, frame.index, frame.wrapped_key)
        except BlockRobotError:
            continue
        trace.add("sealed-key", sealed_key[-PREFIX_BYTES:])
    for grant, slot, wrapped in (_read_mongo_parts if is_mongo else _read_sqlite_parts)(config, trace.record_id):
        _trace_part(trace, grant, _read_erase_key(config, slot), wrapped)


async def _with_ciphertexts(
    config: NodeConfig, place: ClipsPlace, record_id: bytes, rows: list[FrameRow]
) -> list[FrameRow]:
    async with open_blobs(place) as blobs:
        return await with_ciphertexts(blobs, open_names(config.custody_dir, place), record_id, rows)


def _trace_part(trace: Trace, grant: bytes, erase_key: bytes, wrapped: bytes) -> None:
    trace.add("wrapped-part", wrapped[-PREFIX_BYTES:], grant=grant)
    try:
        held = decode(unwrap_key(erase_key, trace.record_id, PART_PLACE, wrapped), HeldPart)
    except BlockRobotError:
        return  # its slot may be another's by now: that key is not of this part
    trace.add("erase-key", erase_key[:PREFIX_BYTES], grant=grant)
    trace.add("package", held.package[-PREFIX_BYTES:], grant=grant)
    for part in held.parts:
        trace.add("key-part", part.value[:PREFIX_BYTES], grant=grant)


def _read_erase_key(config: NodeConfig, slot: int) -> bytes:
    page, place = divmod(slot, PAGE_SLOTS_COUNT)
    offset = HEADER_BYTES + page * _PAGE_BYTES + PAGE_SLOTS_COUNT + place * ERASE_KEY_BYTES
    with (config.erase_keys_dir / ERASE_KEYS_FILE_NAME).open("rb") as file:
        file.seek(offset)
        return file.read(ERASE_KEY_BYTES)


def _read_sqlite(config: NodeConfig, record_id: bytes) -> tuple[list[FrameRow], list[bytes]]:
    path = config.custody_dir / DATABASE_FILE_NAME
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5)) as database:
            select = "SELECT record_id, place, ciphertext, wrapped_key, slot FROM frames WHERE record_id = ?"
            frames = [FrameRow(*row) for row in database.execute(select, (record_id,))]
            select = "SELECT commitment_leaves, ciphertext_leaves FROM clips WHERE record_id = ?"
            joined = b"".join(part for row in database.execute(select, (record_id,)) for part in row)
    except sqlite3.Error as error:
        raise BlockRobotError("STORE_UNAVAILABLE", f"The store of {config.name} cannot be read: {error}.") from None
    return frames, [joined[start : start + 32] for start in range(0, len(joined), 32)]


def _read_sqlite_parts(config: NodeConfig, record_id: bytes) -> list[tuple[bytes, int, bytes]]:
    path = config.custody_dir / DATABASE_FILE_NAME
    try:
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True, timeout=5)) as database:
            select = "SELECT grant_id, slot, wrapped FROM parts WHERE record_id = ?"
            return database.execute(select, (record_id,)).fetchall()
    except sqlite3.Error as error:
        raise BlockRobotError("STORE_UNAVAILABLE", f"The store of {config.name} cannot be read: {error}.") from None


def _read_mongo_parts(config: NodeConfig, record_id: bytes) -> list[tuple[bytes, int, bytes]]:
    try:
        with MongoClient[dict[str, Any]](config.custody_store, serverSelectionTimeoutMS=SERVER_MAX_MS) as client:
            database = client[urlsplit(config.custody_store).path.lstrip("/")]
            found = database["parts"].find({"record_id": record_id})
            return [(row["grant_id"], row["slot"], row["wrapped"]) for row in found]
    except PyMongoError as error:
        raise BlockRobotError(
            "STORE_UNAVAILABLE", f"The store's server of {config.name} failed ({type(error).__name__})."
        ) from None


def _read_mongo(config: NodeConfig, record_id: bytes) -> tuple[list[FrameRow], list[bytes]]:
    leaves: list[bytes] = []
    try:
        with MongoClient[dict[str, object]](config.custody_store, serverSelectionTimeoutMS=SERVER_MAX_MS) as client:
            database = client[urlsplit(config.custody_store).path.lstrip("/")]
            frames = [
                FrameRow(record_id, row["index"], row["ciphertext"], row["wrapped_key"], row["slot"])  # type: ignore[arg-type]
                for row in database["frames"].find({"record_id": record_id})
            ]
            for row in database["clips"].find({"_id": record_id}):
                leaves += [*row["commitment_leaves"], *row["ciphertext_leaves"]]  # type: ignore[misc]
    except PyMongoError as error:
        raise BlockRobotError(
            "STORE_UNAVAILABLE", f"The store's server of {config.name} failed ({type(error).__name__})."
        ) from None
    return frames, leaves


def mongo_documents(config: NodeConfig) -> Iterator[tuple[str, bytes]]:
    """(collection, BSON bytes). Raises STORE_UNAVAILABLE."""
    from bson.raw_bson import RawBSONDocument  # noqa: PLC0415 - only where there is a server

    try:
        with MongoClient[RawBSONDocument](
            config.custody_store, document_class=RawBSONDocument, serverSelectionTimeoutMS=SERVER_MAX_MS
        ) as client:
            database = client[urlsplit(config.custody_store).path.lstrip("/")]
            for name in sorted(database.list_collection_names()):
                for document in database[name].find():
                    yield name, bytes(document.raw)
    except PyMongoError as error:
        raise BlockRobotError(
            "STORE_UNAVAILABLE", f"The store's server of {config.name} failed ({type(error).__name__})."
        ) from None


def trace_plaintext(trace: Trace, path: Path) -> None:
    """A picture's file and, for images, its pixels. Raises OSError."""
    import cv2  # noqa: PLC0415 - slow to import, and only for pictures
    import numpy as np  # noqa: PLC0415

    content = read_given_file(path, PICTURE_MAX_BYTES)
    trace.add("plaintext", content, PLAINTEXT_PIECES_COUNT)
    image = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    if image is not None:
        for pixels in (image, image.byteswap()):
            trace.add("plaintext", pixels.tobytes(), PLAINTEXT_PIECES_COUNT)
