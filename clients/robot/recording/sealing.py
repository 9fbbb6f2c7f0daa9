"""Seals one owner's frames as a clip: data keys, ciphertexts, commitments.

Data keys live for one call.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass

from clients.robot.recording.spool import SpooledClip
from consensus.limits import RETENTION_DEFAULT_MS, TIME_BUCKET_MS
from consensus.primitives.encoding import encode
from consensus.records.clips import ClipUpload
from consensus.records.commitments import (
    ciphertext_leaves,
    ciphertext_root,
    commitment_root,
    derive_record_id,
    frame_commitment,
)
from consensus.records.envelopes import DATA_KEY_BYTES, NONCE_BYTES, seal_data_key, seal_frame, seal_metadata
from consensus.records.metadata import RecordMetadata, compute_metadata_hash
from consensus.records.renditions import Rendition, encode_rendition


@dataclass(slots=True)
class VisitChain:
    """An open visit; `sealing`: owner's X25519 key, `previous_hash`: last metadata hash."""

    owner: bytes
    ephemeral: bytes
    view_tag: int
    purpose: str
    bucket_ms: int
    sealing: bytes
    record_count: int = 0
    previous_hash: bytes = bytes(32)


@dataclass(frozen=True, slots=True)
class ClipContent:
    """One record's content; `withheld` counts by reason since the last record.

    `person`: spool tag (nobody: 32 zeros); `taken_by`: consent's sensor if different; `offset_ms`: host clock minus
    stamps'.
    """

    renditions: tuple[Rendition, ...]
    withheld: tuple[tuple[str, int], ...]
    sensor: str
    decided_at_ms: int
    person: bytes = bytes(32)
    taken_by: str = ""
    offset_ms: int = 0


def compute_time_bucket(time_ms: int) -> int:
    """Return the start of the five-minute bucket published on chain."""
    return time_ms - time_ms % TIME_BUCKET_MS


def compute_expiry(now_ms: int, retention_ms: int) -> int:
    """On full five minutes, hiding the exact time."""
    return max(compute_time_bucket(now_ms + retention_ms), compute_time_bucket(now_ms) + TIME_BUCKET_MS)


def seal_clip(
    content: ClipContent, chain: VisitChain, *, now_ms: int, retention_ms: int = RETENTION_DEFAULT_MS
) -> SpooledClip:
    """Seal 1-64 renditions to `chain`'s owner and advance the chain."""
    plaintexts = [encode_rendition(rendition) for rendition in content.renditions]
    data_keys = [secrets.token_bytes(DATA_KEY_BYTES) for _ in plaintexts]
    frames = list(enumerate(zip(data_keys, plaintexts, strict=True)))
    leaves = [frame_commitment(key, index, plaintext) for index, (key, plaintext) in frames]
    root = commitment_root(leaves)
    record_id = derive_record_id(chain.owner, root)
    ciphertexts = [
        seal_frame(key, secrets.token_bytes(NONCE_BYTES), record_id, index, plaintext)
        for index, (key, plaintext) in frames
    ]
    sealed_keys = [seal_data_key(chain.sealing, key) for key in data_keys]
    first, last = content.renditions[0], content.renditions[-1]
    metadata = RecordMetadata(
        sensor=content.sensor,
        started_at_ms=first.captured_at_ms,
        ended_at_ms=last.captured_at_ms,
        frame_count=len(content.renditions),
        index_in_visit=chain.record_count,
        previous_hash=chain.previous_hash,
        withheld=content.withheld,
        width=first.width,
        height=first.height,
    )
    chain.record_count += 1
    chain.previous_hash = compute_metadata_hash(metadata)
    upload = ClipUpload(
        record_id=record_id,
        txid=bytes(32),
        valid_until_ms=0,
        ciphertexts=ciphertexts,
        sealed_keys=sealed_keys,
        commitment_leaves=leaves,
        owner=chain.owner,
    )
    return SpooledClip(
        upload=upload,
        owner=chain.owner,
        ephemeral=chain.ephemeral,
        view_tag=chain.view_tag,
        purpose=chain.purpose,
        visit_bucket_ms=chain.bucket_ms,
        commitment_root=root,
        ciphertext_root=ciphertext_root(ciphertext_leaves(ciphertexts, sealed_keys)),
        sealed_metadata=seal_metadata(chain.sealing, encode(metadata)),
        bucket_ms=compute_time_bucket(now_ms),
        expires_at_ms=compute_expiry(now_ms, retention_ms),
        frame_count=len(content.renditions),
        decided_at_ms=content.decided_at_ms,
        person=content.person,
        sensor=content.taken_by or content.sensor,
        captured_from_ms=min(rendition.captured_at_ms for rendition in content.renditions) + content.offset_ms,
        captured_until_ms=max(rendition.captured_at_ms for rendition in content.renditions) + content.offset_ms,
    )
