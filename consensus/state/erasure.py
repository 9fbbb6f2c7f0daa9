"""What the contract `erasure` keeps: requests for erasure, and the receipts of custodians."""

from __future__ import annotations

from typing import Literal

from consensus.state.keys import HASH, Prefix, Row

ERASURE = "erasure"


class ErasureReceiptRow(Row, frozen=True):
    """What a custodian confirmed: what it destroyed, what remains, and until when (ms)."""

    destroyed_frames: int
    remains: str
    remains_until_ms: int
    digest: bytes
    time: int


class ErasureRow(Row, frozen=True):
    """A request for the erasure of records, or of frames of one; `receipts` are by custodian."""

    owner: bytes
    records: list[bytes]
    frames: list[int]
    custodians: list[bytes]
    receipts: dict[bytes, ErasureReceiptRow]
    status: Literal["requested", "complete"]
    time: int


REQUEST: Prefix[ErasureRow] = Prefix(ERASURE, "erasure/", (HASH,), ErasureRow)
LAYOUT = (REQUEST,)
