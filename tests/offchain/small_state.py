"""A finalized state of the privacy contracts, put together by hand, as a custodian reads it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from consensus.primitives.encoding import encode_value
from consensus.primitives.hashing import sha256
from consensus.records.commitments import ciphertext_root, commitment_root
from consensus.state import access, erasure
from consensus.state.access import GRANT, RELEASE, GrantRow
from consensus.state.audit import ENTRY
from consensus.state.erasure import ErasureReceiptRow
from consensus.state.identity import CUSTODIANS
from consensus.state.records import RECORD
from consensus.state.rights import QUARANTINE
from contracts.state.view import MemoryState
from node.custody.chain_facts import ChainFacts
from node.custody.stores.custody_store import Checkpoint
from tests.offchain.house import ACCESS_ID, ERASURE_ID
from tests.offchain.small_chain import ALICE, CUSTODIAN, EXPIRES_MS, OTHER_CUSTODIAN, START_MS, RecordedClip
from tests.state_rows import row_of

BOTH = [CUSTODIAN, OTHER_CUSTODIAN]


class State:
    """A finalized state of the privacy contracts, put together by hand."""

    def __init__(self) -> None:
        self.rows: dict[bytes, Any] = {CUSTODIANS.flat: BOTH}
        self._audited: dict[bytes, int] = {}

    def record(self, clip: RecordedClip, owner: bytes = ALICE, height: int = 5, **changes: Any) -> None:
        entry = {
            "owner": owner,
            "robot": b"",
            "commitment_root": commitment_root(clip.upload.commitment_leaves),
            "ciphertext_root": ciphertext_root(clip.leaves),
            "sealed_metadata": b"",
            "bucket_ms": 0,
            "expires_at_ms": EXPIRES_MS,
            "height": height,
            "txid": sha256(clip.record_id),
            "status": "active",
            "erased_frames": [],
            "awaited": [],
        }
        if changes.get("status") in {"erased", "expired"}:
            entry |= {"commitment_root": b"", "ciphertext_root": b""}
        self.rows[RECORD.key(clip.record_id)] = entry | changes

    def access(self, *clips: RecordedClip, owner: bytes = ALICE, height: int = 6, **changes: Any) -> None:
        entry = {"owner": owner, "records": [clip.record_id for clip in clips], "purpose": "demo", "time": 0}
        self.rows[access.REQUEST.key(ACCESS_ID)] = entry | {"released": {}, "refused": {}} | changes
        self._audit(owner, "access_requested", {"access_id": ACCESS_ID}, height)

    def grant(self, grant_id: bytes, *clips: RecordedClip, owner: bytes = ALICE, **changes: Any) -> None:
        fields = {"owner": owner, "records": [clip.record_id for clip in clips], "until_ms": EXPIRES_MS, "height": 6}
        self.rows[GRANT.key(grant_id)] = row_of(GrantRow, **fields) | changes

    def quarantine(self, owner: bytes = ALICE) -> None:
        self.rows[QUARANTINE.key(owner)] = bytes(32)

    def released(self, *clips: RecordedClip, custodian: bytes = CUSTODIAN) -> None:
        for clip in clips:
            self.rows[RELEASE.key(ACCESS_ID, custodian, clip.record_id)] = True

    def erasure(self, *clips: RecordedClip, frames: tuple[int, ...] = (), receipts: Any = (), **changes: Any) -> None:
        entry = {
            "owner": ALICE,
            "records": [clip.record_id for clip in clips],
            "frames": list(frames),
            "custodians": BOTH,
            "receipts": {custodian: row_of(ErasureReceiptRow) for custodian in receipts},
            "status": "requested",
            "time": 0,
        }
        self.rows[erasure.REQUEST.key(ERASURE_ID)] = entry | changes
        self._audit(ALICE, "erasure_requested", {"erasure_id": ERASURE_ID}, 7)

    def said(self, kind: str, height: int, *, owner: bytes = ALICE, **data: Any) -> None:
        """What somebody said of a visit, and nothing that stands of it."""
        self._audit(owner, kind, data, height)

    def _audit(self, owner: bytes, kind: str, data: dict[str, Any], height: int) -> None:
        number = self._audited[owner] = self._audited.get(owner, -1) + 1
        entry = {"record_id": b"", "kind": kind, "time": 0, "height": height, "data": data}
        self.rows[ENTRY.key(owner, number)] = entry

    def facts(self, height: int = 100, at_ms: int = START_MS + 500_000) -> ChainFacts:
        state = MemoryState()
        state.apply({key: encode_value(value) for key, value in self.rows.items()})
        return ChainFacts(state, Checkpoint(height, sha256(b"block %d" % height), at_ms))

    @contextmanager
    def open(self, height: int, at_ms: int) -> Iterator[ChainFacts]:
        yield self.facts(height, at_ms)
