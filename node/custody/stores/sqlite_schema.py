"""Tables of the embedded custody store; any change needs a new format version."""

from __future__ import annotations

from node.custody.stores.sqlite_shares import SHARES_SCHEMA
from node.custody.stores.sqlite_uploads import UPLOADS_SCHEMA

FORMAT_VERSION = 8

SCHEMA = f"""
CREATE TABLE clips (record_id BLOB PRIMARY KEY, txid BLOB NOT NULL, valid_until_ms INTEGER NOT NULL,
    status TEXT NOT NULL, commitment_leaves BLOB NOT NULL, ciphertext_leaves BLOB NOT NULL,
    owner BLOB NOT NULL, expires_at_ms INTEGER NOT NULL, height INTEGER NOT NULL,
    robot BLOB NOT NULL DEFAULT x'', size_bytes INTEGER NOT NULL DEFAULT 0) WITHOUT ROWID;
CREATE INDEX clips_by_owner ON clips (owner, record_id);
CREATE INDEX clips_by_valid_until ON clips (status, valid_until_ms);
CREATE INDEX clips_by_expiry ON clips (status, expires_at_ms);
CREATE TABLE frames (record_id BLOB NOT NULL, place INTEGER NOT NULL, slot INTEGER NOT NULL,
    wrapped_key BLOB NOT NULL, ciphertext BLOB NOT NULL, UNIQUE (record_id, place));
CREATE INDEX frames_by_slot ON frames (slot);
CREATE TABLE missing (record_id BLOB PRIMARY KEY, txid BLOB NOT NULL, owner BLOB NOT NULL,
    commitment_root BLOB NOT NULL, ciphertext_root BLOB NOT NULL, expires_at_ms INTEGER NOT NULL,
    height INTEGER NOT NULL, erased_frames BLOB NOT NULL, elsewhere INTEGER NOT NULL) WITHOUT ROWID;
CREATE INDEX missing_by_height ON missing (elsewhere, height, record_id);
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
"""

CLIP_COLUMNS = (
    "record_id, txid, valid_until_ms, status, commitment_leaves, ciphertext_leaves, owner, expires_at_ms, height, "
    "robot, size_bytes"
)
MISSING_COLUMNS = (
    "record_id, txid, owner, commitment_root, ciphertext_root, expires_at_ms, height, erased_frames, elsewhere"
)
GRANT_COLUMNS = "access_id, owner, records, height, share"
OUTBOX_COLUMNS = "kind, subject, part, contract, entry, arguments, height, status, plan"
