"""Tables of the embedded custody store; any change needs a new format version.

Leaves of a clip come last in its row, and clips have numbers: as the key of a table without numbers a row above 1,002
bytes would take a page more for its rest.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from consensus.errors import BlockRobotError
from node.custody.stores.sqlite_shares import SHARES_SCHEMA
from node.custody.stores.sqlite_uploads import UPLOADS_SCHEMA

FORMAT_VERSION = 9

PLACES_COUNT = 256
"""A frame's id is its clip's number times this, plus its place in the clip: no index leads from a record to its frames."""

_OWN_FRAMES = f"id BETWEEN {{0}}.number * {PLACES_COUNT} AND {{0}}.number * {PLACES_COUNT} + {PLACES_COUNT - 1}"

SCHEMA = f"""
CREATE TABLE clips (number INTEGER PRIMARY KEY, record_id BLOB NOT NULL UNIQUE, txid BLOB NOT NULL,
    valid_until_ms INTEGER NOT NULL, status TEXT NOT NULL, owner BLOB NOT NULL, expires_at_ms INTEGER NOT NULL,
    height INTEGER NOT NULL, robot BLOB NOT NULL, size_bytes INTEGER NOT NULL,
    commitment_leaves BLOB NOT NULL, ciphertext_leaves BLOB NOT NULL);
CREATE INDEX clips_by_owner ON clips (owner, record_id) WHERE status = 'confirmed';
CREATE INDEX clips_by_valid_until ON clips (valid_until_ms, record_id) WHERE status = 'staged';
CREATE INDEX clips_by_expiry ON clips (expires_at_ms) WHERE status = 'confirmed';
CREATE TABLE stored_frames (id INTEGER PRIMARY KEY, slot INTEGER NOT NULL, wrapped_key BLOB NOT NULL,
    ciphertext BLOB NOT NULL);
CREATE INDEX frames_by_slot ON stored_frames (slot);
CREATE VIEW frames AS SELECT record_id, id % {PLACES_COUNT} AS place, slot, wrapped_key, ciphertext, id
    FROM clips JOIN stored_frames ON {_OWN_FRAMES.format("clips")};
CREATE TRIGGER clip_gone AFTER DELETE ON clips BEGIN DELETE FROM stored_frames WHERE {_OWN_FRAMES.format("old")}; END;
CREATE TABLE missing (record_id BLOB PRIMARY KEY, txid BLOB NOT NULL, owner BLOB NOT NULL,
    commitment_root BLOB NOT NULL, ciphertext_root BLOB NOT NULL, expires_at_ms INTEGER NOT NULL,
    height INTEGER NOT NULL, erased_frames BLOB NOT NULL, elsewhere INTEGER NOT NULL) WITHOUT ROWID;
CREATE INDEX missing_by_height ON missing (height DESC, record_id) WHERE elsewhere = 0;
CREATE INDEX missing_by_expiry ON missing (expires_at_ms);
CREATE INDEX missing_by_owner ON missing (owner, record_id);
CREATE TABLE grants (access_id BLOB PRIMARY KEY, owner BLOB NOT NULL, records BLOB NOT NULL,
    height INTEGER NOT NULL, share BLOB NOT NULL DEFAULT x'') WITHOUT ROWID;
CREATE INDEX grants_by_owner ON grants (owner, access_id);
CREATE TABLE restrictions (owner BLOB PRIMARY KEY, content BLOB NOT NULL) WITHOUT ROWID;
CREATE TABLE outbox (kind TEXT NOT NULL, subject BLOB NOT NULL, part INTEGER NOT NULL, contract TEXT NOT NULL,
    entry TEXT NOT NULL, arguments BLOB NOT NULL, height INTEGER NOT NULL, status TEXT NOT NULL,
    plan BLOB NOT NULL, PRIMARY KEY (kind, subject, part)) WITHOUT ROWID;
CREATE INDEX outbox_by_contract ON outbox (status, contract, height, kind, subject, part);
CREATE TABLE backgrounds (digest BLOB PRIMARY KEY, content BLOB NOT NULL);
CREATE TABLE checkpoint (one INTEGER PRIMARY KEY CHECK (one = 1), height INTEGER NOT NULL,
    block_id BLOB NOT NULL, timestamp_ms INTEGER NOT NULL);
{SHARES_SCHEMA}
{UPLOADS_SCHEMA}
"""  # noqa: S608

CLIP_COLUMNS = (
    "record_id, txid, valid_until_ms, status, commitment_leaves, ciphertext_leaves, owner, expires_at_ms, height, "
    "robot, size_bytes"
)
MISSING_COLUMNS = (
    "record_id, txid, owner, commitment_root, ciphertext_root, expires_at_ms, height, erased_frames, elsewhere"
)
GRANT_COLUMNS = "access_id, owner, records, height, share"
OUTBOX_COLUMNS = "kind, subject, part, contract, entry, arguments, height, status, plan"

_BY_THE_CHAIN = ("outbox", "grants", "checkpoint")
"""What a custodian without a checkpoint is given anew by the final state."""


def distrust(path: Path) -> None:
    """Make a database fit for use that others may have changed. Raises FILE_UNUSABLE for other tables, or triggers.

    It keeps what it was given to hold. What it owes, to whom it may release and what it has followed it learns anew from
    the chain, or it would sign what somebody wrote here.
    """
    refusal = BlockRobotError("FILE_UNUSABLE", f"{path.name} is no database as a custodian of this version makes one.")
    try:
        with closing(sqlite3.connect(path)) as found, closing(sqlite3.connect(":memory:")) as own:
            own.executescript(f"{SCHEMA} PRAGMA user_version = {FORMAT_VERSION};")
            found.execute("PRAGMA trusted_schema = OFF")
            if _form_of(found) != _form_of(own):
                raise refusal
            with found:
                for table in _BY_THE_CHAIN:
                    found.execute(f"DELETE FROM {table}")  # noqa: S608
    except sqlite3.Error:
        raise refusal from None


def _form_of(database: sqlite3.Connection) -> tuple[int, list[tuple[object, ...]]]:
    version = database.execute("PRAGMA user_version").fetchone()[0]
    objects = database.execute("SELECT type, name, tbl_name, sql FROM sqlite_master ORDER BY type, name")
    return version, objects.fetchall()
