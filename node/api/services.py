"""Protocols of what the HTTP interface needs from its node."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractAsyncContextManager, AbstractContextManager
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from consensus.chain.block import Block, ContractEvent, FinalityProof, Header, Receipt
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.trie import Proof
from consensus.records.clips import ClipDownload, ClipUpload
from consensus.records.sharing import GrantUpload, SharedDownload, SharedRequest
from node.api.explorer_documents import RoundDocument
from node.limits.token_buckets import OWN, Source

PoolStatus = Literal["pending", "unknown", "expired"]
PeersWithBlock = Callable[[int], Sequence[str]]
"""Returns the names of the peers that say they keep the body of the block of a height."""


@dataclass(frozen=True, slots=True)
class TransactionPlace:
    """A finalized transaction's block height and index."""

    height: int
    index: int


@dataclass(frozen=True, slots=True)
class SubmitResult:
    """Result of one submitted wire; `txid` is empty if undecodable."""

    txid: bytes
    error: BlockRobotError | None


@dataclass(frozen=True, slots=True)
class BlockHead:
    """A header's bytes and transaction count (None once pruned)."""

    header_bytes: bytes
    transactions_count: int | None


class LedgerView(Protocol):
    """The ledger at one finalized block; immutable while open."""

    @property
    def header(self) -> Header: ...

    @property
    def finality(self) -> FinalityProof | None:
        """Return the proof that `header` is final; None only at genesis."""
        ...

    def get(self, key: bytes) -> bytes | None: ...

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` pairs (flat key, encoded value), in key order."""
        ...

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Yield pairs from `start` up to but without `end`, in key order."""
        ...

    def prove(self, key: bytes) -> Proof: ...

    def block(self, height: int) -> Block | None:
        """Return a finalized block; None above the head or if pruned."""
        ...

    def receipts(self, height: int) -> Sequence[Receipt] | None: ...

    def block_bytes(self, height: int) -> bytes | None: ...

    def receipt_bytes(self, height: int) -> Sequence[tuple[bytes, bytes]] | None:
        """Return txid and canonical bytes of a block's receipts, or None."""
        ...

    def receipt(self, height: int, index: int) -> Receipt | None: ...

    def events(self, height: int, index: int, limit: int) -> Sequence[tuple[int, int, ContractEvent]]: ...

    def header_bytes(self, height: int) -> bytes | None:
        """Return a finalized header's bytes, pruned or not, or None."""
        ...

    def head(self, height: int) -> BlockHead | None: ...

    def block_height(self, block_id: bytes) -> int | None: ...

    @property
    def earliest_height(self) -> int:
        """Return the lowest height whose body is kept (0: unpruned)."""
        ...

    def epoch_proof(self, number: int) -> bytes | None:
        """Return the encoded `EpochProof` that began epoch `number` (1 or above)."""
        ...

    def locate(self, txid: bytes) -> TransactionPlace | None: ...


class LedgerReader(Protocol):
    """The finalized ledger."""

    def snapshot(self) -> AbstractContextManager[LedgerView]:
        """Open the newest finalized snapshot; close soon (it holds a reader slot)."""
        ...

    async def wait_above(self, height: int, timeout_ms: int) -> bool:
        """Wait for a final block above `height`; False on timeout."""
        ...


class ViewRunner(Protocol):
    """Runs the read-only entries of contracts."""

    async def run_view(
        self, snapshot: LedgerView, contract: str, view: str, arguments: list[Any], source: Source = OWN
    ) -> bytes:
        """Return a view's encoded result; the snapshot stays open until then.

        Raises TRANSACTION_CONTRACT_UNKNOWN, CONTRACT_DISABLED, CALL_REFUSED, RATE_LIMITED (this source), VIEWS_BUSY
        (all), CONTRACT_WORKER_FAILED.
        """
        ...


class TransactionPool(Protocol):
    """The node's pool of waiting transactions."""

    async def submit(self, wires: Sequence[bytes], source: Source = OWN) -> Sequence[SubmitResult]:
        """Check and admit transactions; one result per wire, in order; known ones pass.

        `source` pays for unsigned bytes (default: this node). Raises RATE_LIMITED.
        """
        ...

    def status(self, txid: bytes) -> PoolStatus: ...

    async def wait_final(self, txid: bytes, timeout_ms: int) -> bool:
        """Wait until a transaction is final; False on timeout or expiry."""
        ...


class UploadAdmissionService(Protocol):
    """Admits a robot's uploads before their bodies, reserving room and quota."""

    def clip(self, record_id: bytes, owner: bytes, size_bytes: int, robot: bytes) -> AbstractAsyncContextManager[None]:
        """Admit a clip. Raises VISIT_NOT_OPEN, UPLOAD_QUOTA_EXCEEDED, DISK_RESERVE_REACHED, RATE_LIMITED."""
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

    async def stage(self, upload: ClipUpload, robot: bytes) -> None:
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


@dataclass(frozen=True, slots=True)
class SignedReceipt:
    """A consent receipt signed by the organisation's node, and its transaction's wire."""

    document: bytes
    key: bytes
    signature: bytes
    transaction: bytes


class ReceiptIssuer(Protocol):
    """Signs receipts of consent statements."""

    def issue(self, snapshot: LedgerView, txid: bytes, caller: bytes) -> SignedReceipt:
        """Return the signed receipt of a caller's own final consent statement.

        Raises CONSENT_RECEIPT_ELSEWHERE, NOT_FOUND, BLOCK_PRUNED, CONSENT_WORD_MISSING, CONSENT_RECEIPT_INVALID,
        NOTICE_INVALID.
        """
        ...


class NodeStatus(Protocol):
    """Status shown on the operator's listener; holds no secrets."""

    def is_ready(self) -> bool: ...

    def problem(self) -> BlockRobotError | None: ...

    def describe(self) -> Mapping[str, Any]: ...

    def metrics(self) -> bytes: ...


class RoundWatch(Protocol):
    """Tells where the node is in the protocol."""

    def place(self) -> RoundDocument:
        """Return epoch, round, leader, certified height and rounds given up since start."""
        ...

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
    on_over_budget: Callable[[str, BlockRobotError], None] = _ignore
    peers_with_block: PeersWithBlock = lambda _: ()


def require_not_pruned(snapshot: LedgerView, height: int, peers_with_block: PeersWithBlock) -> None:
    """Raise BLOCK_PRUNED, naming keepers, if this block's body is not here."""
    earliest = snapshot.earliest_height
    if height < earliest:
        names = peers_with_block(height)
        who = f"{', '.join(names)} {'keep' if len(names) > 1 else 'keeps'} it" if names else "No peer says to keep it"
        raise BlockRobotError(
            "BLOCK_PRUNED", f"The body of block {height} was pruned; this node has them from {earliest} on. {who}."
        )
