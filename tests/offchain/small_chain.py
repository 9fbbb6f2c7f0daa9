"""A chain reduced to what a custodian hears of it: clips of one owner, and finalized blocks with their events."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from typing import Any

from nacl.public import PrivateKey as SealingKey

from consensus.chain.block import ContractEvent, Receipt
from consensus.primitives.encoding import encode_value
from consensus.primitives.hashing import sha256
from consensus.records.clips import ClipUpload
from consensus.records.commitments import (
    ciphertext_leaves,
    ciphertext_root,
    commitment_root,
    derive_record_id,
    frame_commitment,
)
from consensus.records.envelopes import seal_data_key, seal_frame
from node.custody.finalized_events import FinalizedEvents, collect_events

CUSTODIAN, OTHER_CUSTODIAN = b"\x02" + b"\xcc" * 32, b"\x02" + b"\xdd" * 32
ALICE, BOB = b"\x02" + b"\xaa" * 32, b"\x02" + b"\xbb" * 32
ROBOT = b"\x03" + b"\xee" * 32
START_MS = 1_800_000_000_000
EXPIRES_MS = START_MS + 3_600_000


@dataclass(frozen=True)
class RecordedClip:
    """A clip as a robot makes it, and the key that opens it (held by the owner's wallet alone)."""

    upload: ClipUpload
    plaintexts: tuple[bytes, ...]
    data_keys: tuple[bytes, ...]
    sealing: SealingKey

    @property
    def record_id(self) -> bytes:
        return self.upload.record_id

    @property
    def leaves(self) -> list[bytes]:
        return ciphertext_leaves(self.upload.ciphertexts, self.upload.sealed_keys)


def record_clip(frames: int = 3, *, valid_until_ms: int = START_MS + 60_000, owner: bytes = ALICE) -> RecordedClip:
    """Seal a clip of a few frames to a fresh person."""
    name, sealing = secrets.token_hex(16), SealingKey.generate()
    plaintexts = tuple(f"frame {index} of {name}".encode() for index in range(frames))
    data_keys = tuple(secrets.token_bytes(32) for _ in range(frames))
    pairs = list(enumerate(zip(data_keys, plaintexts, strict=True)))
    leaves = [frame_commitment(key, index, plaintext) for index, (key, plaintext) in pairs]
    record_id = derive_record_id(owner, commitment_root(leaves))
    upload = ClipUpload(
        record_id=record_id,
        txid=sha256(record_id),
        valid_until_ms=valid_until_ms,
        ciphertexts=[
            seal_frame(key, secrets.token_bytes(24), record_id, index, plaintext) for index, (key, plaintext) in pairs
        ],
        sealed_keys=[seal_data_key(bytes(sealing.public_key), key) for key in data_keys],
        commitment_leaves=leaves,
        owner=owner,
    )
    return RecordedClip(upload, plaintexts, data_keys, sealing)


@dataclass
class SmallChain:
    """Makes finalized blocks, one second apart."""

    height: int = 0
    time_ms: int = START_MS
    blocks: list[FinalizedEvents] = field(default_factory=list)

    def block(self, *events: tuple[str, str, dict[str, Any]], at_ms: int | None = None) -> FinalizedEvents:
        """Return the next block; events are (contract, name, data), each by a transaction of its own."""
        self.height += 1
        self.time_ms = at_ms if at_ms is not None else self.time_ms + 1000
        receipts = []
        for contract, name, data in events:
            txid = next((data[key] for key in ("access_id", "erasure_id") if key in data), None)
            txid = txid or sha256(data.get("record_id", b""))
            event = ContractEvent(contract, name, encode_value(data))
            receipts.append(Receipt(txid, True, "OK", "", None, 0, (event,)))
        made = collect_events(self.height, sha256(b"block %d" % self.height), self.time_ms, receipts)
        self.blocks.append(made)
        return made


def recorded(clip: RecordedClip, owner: bytes = ALICE, **changes: Any) -> tuple[str, str, dict[str, Any]]:
    data = {
        "record_id": clip.record_id,
        "owner": owner,
        "commitment_root": commitment_root(clip.upload.commitment_leaves),
        "ciphertext_root": ciphertext_root(clip.leaves),
        "expires_at_ms": EXPIRES_MS,
        "robot": ROBOT,
    }
    return "records", "recorded", data | changes


def empty_frames_withdrawn(*frames: bytes, gone: tuple[bytes, ...] = ()) -> tuple[str, str, dict[str, Any]]:
    """Return the event that a robot's empty frames are approved no more; no robot has those that are `gone`."""
    return "records", "empty_frames_withdrawn", {"robot": bytes(33), "frames": list(frames), "gone": list(gone)}


def access(access_id: bytes, *clips: RecordedClip, owner: bytes = ALICE) -> tuple[str, str, dict[str, Any]]:
    ids = [clip.record_id for clip in clips]
    return "access", "requested", {"access_id": access_id, "owner": owner, "records": ids, "purpose": "demo"}


def erasure(
    erasure_id: bytes, *clips: RecordedClip, frames: tuple[int, ...] = (), owner: bytes = ALICE
) -> tuple[str, str, dict[str, Any]]:
    ids = [clip.record_id for clip in clips]
    data = {"erasure_id": erasure_id, "owner": owner, "records": ids, "frames": list(frames)}
    return "erasure", "requested", data
