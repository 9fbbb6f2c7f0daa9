"""Rows of the embedded custody store, read and written in the caller's transaction."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Sequence
from typing import Any

from consensus.primitives.encoding import encode
from consensus.primitives.hashing import HASH_SIZE_BYTES
from consensus.records.envelopes import RECORD_ID_BYTES
from node.custody.stores.custody_store import BlockEffects, ClipRow, FrameRow, Grant, OutboxRow, RecordFacts
from node.custody.stores.sqlite_schema import CLIP_COLUMNS, PLACES_COUNT


def split(joined: bytes, size: int) -> tuple[bytes, ...]:
    return tuple(joined[start : start + size] for start in range(0, len(joined), size))


def read_clip(row: Sequence[Any]) -> ClipRow:
    """In the order of `CLIP_COLUMNS`."""
    leaves = (split(row[4], HASH_SIZE_BYTES), split(row[5], HASH_SIZE_BYTES))
    return ClipRow(row[0], row[1], row[2], row[3], *leaves, *row[6:11])


def read_missing(row: Sequence[Any]) -> RecordFacts:
    """In the order of `MISSING_COLUMNS`."""
    return RecordFacts(row[0], row[1], row[2], row[3], row[4], row[5], row[6], tuple(row[7]), bool(row[8]))


def read_grant(row: Sequence[Any]) -> Grant:
    """In the order of `GRANT_COLUMNS`."""
    return Grant(row[0], row[1], split(row[2], RECORD_ID_BYTES), *row[3:])


def insert_outbox(database: sqlite3.Connection, rows: Iterable[OutboxRow]) -> None:
    """Existing rows stay as they are."""
    database.executemany(
        "INSERT INTO outbox VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT DO NOTHING",
        [
            (row.kind, row.subject, row.part, row.contract, row.entry, row.arguments, row.height, row.status, row.plan)
            for row in rows
        ],
    )


def write_effects(database: sqlite3.Connection, effects: BlockEffects) -> None:
    """In the order that `BlockEffects` defines."""
    insert_outbox(database, effects.outbox)
    database.executemany(
        "INSERT OR REPLACE INTO restrictions VALUES (?, ?)",
        [(row.owner, encode(row)) for row in effects.visit_restrictions],
    )
    database.executemany(
        "UPDATE clips SET expires_at_ms = ? WHERE record_id = ? AND status = 'confirmed'",
        [(expires_at_ms, record_id) for record_id, expires_at_ms in effects.expiries],
    )
    database.executemany(
        "UPDATE clips SET status = 'confirmed', txid = ?, owner = ?, expires_at_ms = ?, height = ? "
        "WHERE record_id = ? AND status = 'staged'",
        [(facts.txid, facts.owner, facts.expires_at_ms, facts.height, facts.record_id) for facts in effects.confirmed],
    )
    found = [*(facts.record_id for facts in effects.confirmed), *effects.found]
    database.executemany("DELETE FROM missing WHERE record_id = ?", [(record_id,) for record_id in found])
    database.executemany(
        "INSERT OR REPLACE INTO missing VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)",
        [
            (
                facts.record_id,
                facts.txid,
                facts.owner,
                facts.commitment_root,
                facts.ciphertext_root,
                facts.expires_at_ms,
                facts.height,
                bytes(facts.erased_frames),
                facts.elsewhere,
            )
            for facts in effects.missing
        ],
    )
    database.executemany(
        "INSERT OR REPLACE INTO grants VALUES (?, ?, ?, ?, ?)",
        [(row.access_id, row.owner, b"".join(row.records), row.height, row.share) for row in effects.grants],
    )
    database.executemany("DELETE FROM outbox WHERE kind = ? AND subject = ? AND part = ?", effects.settled)
    if effects.checkpoint is not None:
        point = effects.checkpoint
        database.execute("DELETE FROM missing WHERE expires_at_ms <= ?", (point.timestamp_ms,))
        database.execute(
            "INSERT OR REPLACE INTO checkpoint VALUES (1, ?, ?, ?)", (point.height, point.block_id, point.timestamp_ms)
        )


def write_frames(database: sqlite3.Connection, number: int, frames: Sequence[FrameRow]) -> None:
    """Of the clip with this number, which has none."""
    database.executemany(
        "INSERT INTO stored_frames VALUES (?, ?, ?, ?)",
        [(number * PLACES_COUNT + row.index, row.slot, row.wrapped_key, row.ciphertext) for row in frames],
    )


def replace_frames(database: sqlite3.Connection, record_id: bytes, frames: Sequence[FrameRow]) -> None:
    for (number,) in database.execute("SELECT number FROM clips WHERE record_id = ?", (record_id,)).fetchall():
        first = number * PLACES_COUNT
        database.execute("DELETE FROM stored_frames WHERE id BETWEEN ? AND ?", (first, first + PLACES_COUNT - 1))
        write_frames(database, number, frames)


def write_clip(database: sqlite3.Connection, clip: ClipRow, frames: Sequence[FrameRow]) -> None:
    database.execute("DELETE FROM clips WHERE record_id = ?", (clip.record_id,))
    values = (
        clip.record_id,
        clip.txid,
        clip.valid_until_ms,
        clip.status,
        b"".join(clip.commitment_leaves),
        b"".join(clip.ciphertext_leaves),
        clip.owner,
        clip.expires_at_ms,
        clip.height,
        clip.robot,
        clip.size_bytes,
    )
    query = f"INSERT INTO clips ({CLIP_COLUMNS}) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"  # noqa: S608
    number = database.execute(query, values).lastrowid
    assert number is not None, "a row was inserted"
    write_frames(database, number, frames)


def delete_clip(database: sqlite3.Connection, record_id: bytes) -> None:
    """Its frames and missing entry too; keep the erased mark."""
    database.execute("DELETE FROM missing WHERE record_id = ?", (record_id,))
    write_clip(database, ClipRow(record_id, b"", 0, "erased", (), ()), [])
