"""What the HTTP interface needs of its node, as Protocols owned by this side.

Everything that is read comes from one finalized snapshot: nothing that could still be undone is ever shown.
"""

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
from node.budgets.token_buckets import OWN, Source

PoolStatus = Literal["pending", "unknown", "expired"]


@dataclass(frozen=True, slots=True)
class TransactionPlace:
    """Where a finalized transaction stands: the block's height and the index within it."""

    height: int
    index: int


@dataclass(frozen=True, slots=True)
class SubmitResult:
    """What became of one submitted wire. `txid` is empty if the bytes are no transaction at all."""

    txid: bytes
    error: BlockRobotError | None


@dataclass(frozen=True, slots=True)
class BlockHead:
    """A finalized header's bytes, and how many transactions its block holds; None once the block was pruned."""

    header_bytes: bytes
    transactions_count: int | None


class LedgerSnapshot(Protocol):
    """The ledger at one finalized block. It does not change while it is open."""

    @property
    def header(self) -> Header:
        """The header of the newest finalized block."""
        ...

    @property
    def finality(self) -> FinalityProof | None:
        """The proof that `header` is final; None only at genesis, which needs none."""
        ...

    def get(self, key: bytes) -> bytes | None:
        """Return the encoded value under a flat key, or None."""
        ...

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` pairs of flat key and encoded value under the prefix, in key order."""
        ...

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Yield the pairs from `start` up to but without `end`, in key order."""
        ...

    def prove(self, key: bytes) -> Proof:
        """Return the proof of the key's presence or absence under `header.state_root`."""
        ...

    def block(self, height: int) -> Block | None:
        """Return the finalized block of this height, or None above the head (or if it was pruned)."""
        ...

    def receipts(self, height: int) -> Sequence[Receipt] | None:
        """Return the receipts of the block of this height, in its order, or None."""
        ...

    def block_bytes(self, height: int) -> bytes | None:
        """Return the canonical bytes of the finalized block of this height, or None."""
        ...

    def receipt_bytes(self, height: int) -> Sequence[tuple[bytes, bytes]] | None:
        """Return the txid and the canonical bytes of each receipt of the block of this height, or None."""
        ...

    def receipt(self, height: int, index: int) -> Receipt | None:
        """Return one receipt of the block of this height, or None if the block is not here."""
        ...

    def events(self, height: int, index: int, limit: int) -> Sequence[tuple[int, int, ContractEvent]]:
        """Return up to `limit` events with height and index among their block's, from this place on, in order."""
        ...

    def header_bytes(self, height: int) -> bytes | None:
        """Return the bytes of the finalized header of this height, pruned or not; None where it is not known."""
        ...

    def head(self, height: int) -> BlockHead | None:
        """Return a finalized block's header and how many transactions it holds; None where it is not known."""
        ...

    def block_height(self, block_id: bytes) -> int | None:
        """Return the height of the finalized block with this 32-byte id, or None."""
        ...

    @property
    def earliest_height(self) -> int:
        """The height from which on all blocks and receipts are here; 0 unless older ones were pruned."""
        ...

    def epoch_proof(self, number: int) -> bytes | None:
        """Return the encoded `EpochProof` that began epoch `number` (1 or above), or None."""
        ...

    def locate(self, txid: bytes) -> TransactionPlace | None:
        """Return where a finalized transaction stands, or None."""
        ...


class LedgerReader(Protocol):
    """The finalized ledger."""

    def snapshot(self) -> AbstractContextManager[LedgerSnapshot]:
        """Open a snapshot of the newest finalized block; close it soon (it holds a reader's slot of the store)."""
        ...

    async def wait_above(self, height: int, timeout_ms: int) -> bool:
        """Wait until a block above `height` is final; tell whether one is, or the time ran out."""
        ...


class ViewRunner(Protocol):
    """Runs the read-only entries of contracts."""

    async def run_view(
        self, snapshot: LedgerSnapshot, contract: str, view: str, arguments: list[Any], source: Source = OWN
    ) -> bytes:
        """Return the encoded result of a view on this snapshot, for a source of calls (this node, if none is named).

        The snapshot must stay open until then. Raises TRANSACTION_CONTRACT_UNKNOWN for an unknown contract or view,
        CONTRACT_DISABLED, CALL_REFUSED if the contract refuses, RATE_LIMITED if too many of the source wait, VIEWS_BUSY
        if too many wait in all, CONTRACT_WORKER_FAILED.
        """
        ...


class TransactionPool(Protocol):
    """The node's pool of waiting transactions."""

    async def submit(self, wires: Sequence[bytes], source: Source = OWN) -> Sequence[SubmitResult]:
        """Check and admit transactions; one result for each wire, in order. An already known one is no error.

        `source` is whose budget pays for what nobody signed; this node's own, if it is not said. Raises RATE_LIMITED.
        """
        ...

    def status(self, txid: bytes) -> PoolStatus:
        """Tell what the pool knows of a transaction that is not final."""
        ...

    async def wait_final(self, txid: bytes, timeout_ms: int) -> bool:
        """Wait until the transaction is final; tell whether it is, or the time ran out (or it expired)."""
        ...


class UploadAdmissionService(Protocol):
    """Judges a robot's upload by what stands before its body, and holds room and quota for it meanwhile."""

    def clip(self, record_id: bytes, owner: bytes, size_bytes: int, robot: bytes) -> AbstractAsyncContextManager[None]:
        """Let a clip of so many bytes in. Raises VISIT_NOT_OPEN, UPLOAD_QUOTA_EXCEEDED, DISK_RESERVE_REACHED."""
        ...

    def background(self, digest: bytes, size_bytes: int, robot: bytes) -> AbstractAsyncContextManager[None]:
        """Let an empty frame in. Raises EMPTY_FRAME_NOT_APPROVED, UPLOAD_QUOTA_EXCEEDED, DISK_RESERVE_REACHED."""
        ...


class CustodyService(Protocol):
    """The node's custodian."""

    @property
    def admission(self) -> UploadAdmissionService:
        """What lets uploads in before their bodies are read."""
        ...

    async def stage(self, upload: ClipUpload, robot: bytes) -> None:
        """Keep an uploaded clip of the robot with this member key until its record is final. Repeating is harmless.

        It was let in before. Raises UPLOAD_INVALID, UPLOAD_CONFLICT, UPLOAD_QUOTA_EXCEEDED, VISIT_NOT_OPEN,
        STORE_UNAVAILABLE.
        """
        ...

    async def download(self, record_id: bytes, access_id: bytes, owner: bytes) -> ClipDownload:
        """Return a clip to its owner under a final access transaction of hers.

        Raises NOT_FOUND, ACCESS_NOT_GRANTED, CLIP_NOT_CONFIRMED, CLIP_ERASED, STORE_UNAVAILABLE.
        """
        ...

    async def stage_part(self, upload: GrantUpload, owner: bytes) -> str:
        """Keep this custodian's part of a shared record's key for the visit with this first owner key; return its status.

        Raises UPLOAD_INVALID, UPLOAD_CONFLICT, CLIP_NOT_CONFIRMED, CLIP_ERASED, CLIP_QUARANTINED, NOT_PERMITTED,
        GRANT_ENDED, TRANSACTION_EXPIRED, RATE_LIMITED, STORE_UNAVAILABLE.
        """
        ...

    async def download_shared(self, request: SharedRequest, grant_id: bytes, grantee: bytes) -> SharedDownload:
        """Return a shared clip to the holder of a grant's one-time key, under a final request of hers.

        Raises as `download`, and GRANT_ENDED, GRANT_PARTS_MISSING, GRANTEE_NOT_A_MEMBER.
        """
        ...

    async def put_background(self, digest: bytes, content: bytes, robot: bytes) -> None:
        """Keep a robot's recorded empty frame under its SHA-256 (already checked). Repeating is harmless.

        It was let in before. Raises EMPTY_FRAME_NOT_APPROVED, BACKGROUND_NOT_A_PICTURE, UPLOAD_QUOTA_EXCEEDED,
        STORE_UNAVAILABLE.
        """
        ...

    async def get_background(self, digest: bytes) -> bytes | None:
        """Return a recorded empty frame, or None."""
        ...


@dataclass(frozen=True, slots=True)
class SignedReceipt:
    """A consent receipt as the organisation's node signed it, and the wire of the transaction that it is about."""

    document: bytes
    key: bytes
    signature: bytes
    transaction: bytes


class ReceiptIssuer(Protocol):
    """Signs receipts of what people said about consent."""

    def issue(self, snapshot: LedgerSnapshot, txid: bytes, caller: bytes) -> SignedReceipt:
        """Return the signed receipt of a caller's own final word.

        Raises CONSENT_RECEIPT_ELSEWHERE, NOT_FOUND, CONSENT_WORD_MISSING, CONSENT_RECEIPT_INVALID, NOTICE_INVALID.
        """
        ...


class NodeStatus(Protocol):
    """What the operator's listener shows. Must never hold a secret."""

    def is_ready(self) -> bool:
        """Tell whether the node is in touch with a quorum and serves."""
        ...

    def problem(self) -> BlockRobotError | None:
        """Return why no peer would talk to this node, if that is so."""
        ...

    def describe(self) -> Mapping[str, Any]:
        """Return name, height, round, peers and the like as a JSON-ready mapping."""
        ...

    def metrics(self) -> bytes:
        """Return the metrics in the Prometheus text format."""
        ...


@dataclass(frozen=True, slots=True)
class RoundPlace:
    """Where a node is in the protocol, none of it final; `leader` is a seat of the epoch's schedule."""

    epoch: int
    round: int
    leader: int
    certified_height: int
    timed_out_count: int


class RoundWatch(Protocol):
    """Tells where the node is in the protocol."""

    def place(self) -> RoundPlace:
        """Return epoch, round, leader, certified height, and how many rounds this node gave up since its start."""
        ...

    def finality_lag_ms(self, height: int) -> int | None:
        """Return how old a block was when this node learned that it is final; None if that was long ago, or never."""
        ...


class Clock(Protocol):
    """The node's wall clock."""

    def now_ms(self) -> int:
        """Return milliseconds since 1970 UTC."""
        ...


def _ignore(_source: str, _error: BlockRobotError) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True)
class ApiServices:
    """All that `create_api` needs. `custody` and `receipts` are None at a node without a custodian.

    `note_over` hears which source of requests is over its budget. `keepers` names the peers that say they keep the body
    of the block of a height.

    `public_explorer` opens headers, producers and counts to anybody (`node.api.access.route_access.EXPLORER`).
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
    note_over: Callable[[str, BlockRobotError], None] = _ignore
    keepers: Callable[[int], Sequence[str]] = lambda _: ()
