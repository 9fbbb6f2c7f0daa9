"""State of the contract `erasure`: requests and custodians' receipts."""

from __future__ import annotations

from typing import Literal

from consensus.state.keys import HASH_BYTES, Prefix, Row

ERASURE = "erasure"


class ErasureReceiptRow(Row, frozen=True):
    """A custodian's confirmation: what was destroyed, what remains, until when (ms)."""

    destroyed_frames: int
    remains: str
    remains_until_ms: int
    digest: bytes
    time: int


class ErasureRow(Row, frozen=True):
    """An erasure request for records or one's frames; `receipts` are by custodian."""

    owner: bytes
    records: list[bytes]
    frames: list[int]
    custodians: list[bytes]
    receipts: dict[bytes, ErasureReceiptRow]
    status: Literal["requested", "complete"]
    time: int


REQUEST: Prefix[ErasureRow] = Prefix(ERASURE, "erasure/", (HASH_BYTES,), ErasureRow)
LAYOUT = (REQUEST,)
