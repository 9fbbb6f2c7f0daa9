"""Test clips of people with known keys: sealed, uploaded, recorded, erased."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec
from nacl.public import PrivateKey as SealingKey

from clients.sdk.network_client import NetworkClient
from consensus.errors import BlockRobotError
from consensus.limits import RETENTION_DEFAULT_MS, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipUpload
from consensus.records.commitments import (
    ciphertext_leaves,
    ciphertext_root,
    commitment_root,
    derive_record_id,
    frame_commitment,
)
from consensus.records.envelopes import NONCE_BYTES, seal_data_key, seal_frame
from consensus.state import erasure

PURPOSE = "demo"
LIFETIME_MS = 60_000
ERASURE_TIMEOUT_S = 60.0
_DATA_KEY_BYTES = 32
_POLL_S = 0.01


@dataclass(frozen=True, slots=True)
class SealedClip:
    """A sealed clip: uploads, and its record's two roots."""

    upload: ClipUpload
    commitment_root: bytes
    ciphertext_root: bytes
    plaintexts: tuple[bytes, ...]

    @property
    def record_id(self) -> bytes:
        return self.upload.record_id

    @property
    def size_bytes(self) -> int:
        """Of all ciphertexts."""
        return sum(map(len, self.upload.ciphertexts))


def seal_clip(
    owner: bytes, frames: int, frame_bytes: int, *, txid: bytes = bytes(32), valid_until_ms: int = 0
) -> SealedClip:
    public = bytes(SealingKey.generate().public_key)
    plaintexts = tuple(secrets.token_bytes(frame_bytes) for _ in range(frames))
    keys = [secrets.token_bytes(_DATA_KEY_BYTES) for _ in plaintexts]
    pairs = list(enumerate(zip(keys, plaintexts, strict=True)))
    commitments = [frame_commitment(key, index, text) for index, (key, text) in pairs]
    root = commitment_root(commitments)
    record_id = derive_record_id(owner, root)
    upload = ClipUpload(
        record_id=record_id,
        txid=txid,
        valid_until_ms=valid_until_ms,
        ciphertexts=[
            seal_frame(key, secrets.token_bytes(NONCE_BYTES), record_id, index, text) for index, (key, text) in pairs
        ],
        sealed_keys=[seal_data_key(public, key) for key in keys],
        commitment_leaves=commitments,
        owner=owner,
    )
    leaves = ciphertext_leaves(upload.ciphertexts, upload.sealed_keys)
    return SealedClip(upload, root, ciphertext_root(leaves), plaintexts)


class ClipRobot:
    """A registered robot that records clips and requests erasures."""

    def __init__(self, key: PrivateKey, client: NetworkClient) -> None:
        self._key = key
        self.client = client

    async def open_visit(self) -> PrivateKey:
        owner = PrivateKey(secrets.token_bytes(32))
        ephemeral = PrivateKey(secrets.token_bytes(32)).public_key
        arguments = [owner.public_key, ephemeral, 0, _bucket_ms(), PURPOSE]
        await self.client.call(self._key, "records", "open_visit", arguments)
        return owner

    async def record(
        self,
        owner: PrivateKey,
        frames: int,
        frame_bytes: int,
        send: Callable[[ClipUpload], Awaitable[None]] | None = None,
    ) -> SealedClip:
        """Seal, `send` (default: to every keeper) and record a clip; waits for finality."""
        clip, bucket_ms = seal_clip(owner.public_key, frames, frame_bytes), _bucket_ms()
        arguments: list[Any] = [clip.record_id, owner.public_key, clip.commitment_root, clip.ciphertext_root]
        arguments += [secrets.token_bytes(SEALED_METADATA_BYTES), bucket_ms, bucket_ms + RETENTION_DEFAULT_MS]
        transaction = self.client.transactions.build(self._key, "records", "record", arguments, lifetime_ms=LIFETIME_MS)
        expiry = transaction.body.valid_until_ms
        upload = msgspec.structs.replace(clip.upload, txid=transaction.txid, valid_until_ms=expiry)
        await (send or self._send_to_keepers)(upload)
        receipt = await self.client.submit_and_wait(transaction)
        if not receipt.ok:
            raise BlockRobotError("CALL_REFUSED", f"records.record: {receipt.code}", contract_code=receipt.code)
        return clip

    async def _send_to_keepers(self, upload: ClipUpload) -> None:
        await self.client.find_nodes(self._key)
        keepers, _ = self.client.custody.rank(upload.record_id)
        await asyncio.gather(*(self.client.custody.upload_clip(node, upload, self._key) for node in keepers))

    async def request_erasure(
        self, owner: PrivateKey, record_ids: Sequence[bytes], frames: Sequence[int] = ()
    ) -> bytes:
        transaction = self.client.transactions.build(owner, "erasure", "request", [list(record_ids), list(frames)])
        receipt = await self.client.submit_and_wait(transaction)
        if not receipt.ok:
            raise BlockRobotError("CALL_REFUSED", f"erasure.request: {receipt.code}", contract_code=receipt.code)
        return transaction.txid

    async def wait_erased(self, owner: PrivateKey, erasure_id: bytes) -> None:
        """At every custodian. Raises TRANSACTION_NOT_FINAL_IN_TIME."""
        deadline_s = time.perf_counter() + ERASURE_TIMEOUT_S
        while True:
            entry = await self.client.state_value(erasure.REQUEST.key(erasure_id), owner)
            if entry is not None and entry["status"] == "complete":
                return
            if time.perf_counter() > deadline_s:
                raise BlockRobotError("TRANSACTION_NOT_FINAL_IN_TIME", "A custodian has not confirmed the erasure.")
            await asyncio.sleep(_POLL_S)


def _bucket_ms() -> int:
    now_ms = time.time_ns() // 1_000_000
    return now_ms - now_ms % TIME_BUCKET_MS
