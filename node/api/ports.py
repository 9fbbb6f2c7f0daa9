"""Protocols of what the HTTP interface needs from its node."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.records.clips import ClipDownload, ClipUpload
from consensus.records.sharing import GrantUpload, SharedDownload, SharedRequest
from node.api.access.trusted_proxies import NO_PROXIES, TrustedProxies
from node.api.explorer_documents import RoundDocument
from node.custody.coordination.consent_receipts import SignedReceipt
from node.execution.execution_machines import ViewRunner
from node.mempool.transaction_pool import TransactionPool
from node.storage.ledger_view import LedgerView, PeersWithBlock


class LedgerReader(Protocol):
    """The finalized ledger."""

    def snapshot(self) -> AbstractContextManager[LedgerView]:
        """Open the newest finalized snapshot; close soon (it holds a reader slot)."""
        ...

    async def wait_above(self, height: int, timeout_ms: int) -> bool:
        """False on timeout."""
        ...


class UploadAdmissionService(Protocol):
    """Admits a robot's uploads before their bodies, reserving room and quota."""

    def clip(self, record_id: bytes, owner: bytes, size_bytes: int, robot: bytes) -> AbstractAsyncContextManager[bool]:
        """Whether the clip is new. Raises VISIT_NOT_OPEN, UPLOAD_QUOTA_EXCEEDED, DISK_RESERVE_REACHED, RATE_LIMITED."""
        ...

    def background(self, digest: bytes, size_bytes: int, robot: bytes) -> AbstractAsyncContextManager[None]:
        """Admit an empty frame.

        Raises EMPTY_FRAME_NOT_APPROVED, UPLOAD_QUOTA_EXCEEDED, DISK_RESERVE_REACHED, RATE_LIMITED.
        """
        ...


class CustodyService(Protocol):
    """The node's custodian."""

    @property
    def admission(self) -> UploadAdmissionService: ...

    async def stage(self, upload: ClipUpload, robot: bytes, *, is_new: bool = True) -> None:
        """Store an admitted clip until its record is final. Idempotent.

        Raises UPLOAD_INVALID, UPLOAD_CONFLICT, UPLOAD_HASH_MISMATCH, UPLOAD_QUOTA_EXCEEDED, VISIT_NOT_OPEN,
        CLIP_ERASED, TRANSACTION_EXPIRED, STORE_UNAVAILABLE, ERASE_KEYS_DAMAGED.
        """
        ...

    async def download(self, record_id: bytes, access_id: bytes, owner: bytes) -> ClipDownload:
        """Return a clip to its owner under their final access transaction.

        Raises NOT_FOUND, ACCESS_NOT_GRANTED, ACCESS_ENDED, CLIP_NOT_CONFIRMED, CLIP_ERASED, CLIP_QUARANTINED,
        CUSTODY_CATCHING_UP, STORE_UNAVAILABLE, ERASE_KEYS_DAMAGED.
        """
        ...

    async def stage_part(self, upload: GrantUpload, owner: bytes) -> str:
        """Store this custodian's part of a shared record's key; return its status. `owner` is the visit's first key.

        Raises UPLOAD_INVALID, UPLOAD_CONFLICT, CLIP_NOT_CONFIRMED, CLIP_ERASED, CLIP_QUARANTINED, NOT_PERMITTED,
        GRANT_ENDED, TRANSACTION_EXPIRED, RATE_LIMITED, DISK_RESERVE_REACHED, STORE_UNAVAILABLE, ERASE_KEYS_DAMAGED.
        """
        ...

    async def download_shared(self, request: SharedRequest, grant_id: bytes, grantee: bytes) -> SharedDownload:
        """Return a shared clip to a grant's one-time key, under its final request.

        Raises as `download`, and NOT_PERMITTED, GRANT_ENDED, GRANT_PARTS_MISSING, GRANTEE_NOT_A_MEMBER.
        """
        ...

    async def put_background(self, digest: bytes, content: bytes, robot: bytes) -> None:
        """Store an admitted empty frame under its verified SHA-256. Idempotent.

        Raises EMPTY_FRAME_NOT_APPROVED, BACKGROUND_NOT_A_PICTURE, UPLOAD_QUOTA_EXCEEDED, STORE_UNAVAILABLE.
        """
        ...

    async def get_background(self, digest: bytes) -> bytes | None:
        """Return an approved empty frame. Raises CUSTODY_CATCHING_UP, STORE_UNAVAILABLE."""
        ...


class ReceiptIssuer(Protocol):
    """Signs receipts of consent statements."""

    def issue(self, snapshot: LedgerView, txid: bytes, caller: bytes) -> SignedReceipt:
        """Return the signed receipt of a caller's own final consent statement.

        Raises CONSENT_RECEIPT_ELSEWHERE, NOT_FOUND, BLOCK_PRUNED, CONSENT_WORD_MISSING, CONSENT_RECEIPT_INVALID,
        NOTICE_INVALID.
        """
        ...


class RoundWatch(Protocol):
    """Tells where the node is in the protocol."""

    def place(self) -> RoundDocument: ...

    def finality_lag_ms(self, height: int) -> int | None:
        """Return a block's age when learned final; None if long ago or never."""
        ...


class Clock(Protocol):
    """The node's wall clock."""

    def now_ms(self) -> int:
        """Return milliseconds since 1970 UTC."""
        ...


def _ignore(_source: str, _error: BlockRobotError) -> None: ...


@dataclass(frozen=True, slots=True)
class ApiServices:
    """What `create_api` needs; `custody` and `receipts`: None without a custodian.

    `on_over_budget` gets sources over budget; `peers_with_block` names peers with a height's body.
    """

    genesis: Genesis
    node_name: str
    clock: Clock
    ledger: LedgerReader
    views: ViewRunner
    pool: TransactionPool
    custody: CustodyService | None
    receipts: ReceiptIssuer | None = None
    rounds: RoundWatch | None = None
    public_explorer: bool = False
    trusted_proxies: TrustedProxies = NO_PROXIES
    on_over_budget: Callable[[str, BlockRobotError], None] = _ignore
    peers_with_block: PeersWithBlock = lambda _: ()
