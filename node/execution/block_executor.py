"""Executes blocks on their branch.

The newest stored block is the base, a snapshot; blocks above are in-memory overlays by id.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from consensus.chain.block import (
    HEADER_VERSION,
    Block,
    EpochProof,
    FinalityProof,
    Header,
    Receipt,
    Receipts,
    compute_receipts_root,
    compute_transactions_root,
)
from consensus.chain.block_rules import lost_rounds_before_giving_up, may_give_up_change
from consensus.chain.epoch_settings import Epoch, compute_epoch_hash
from consensus.chain.genesis import Genesis
from consensus.chain.messages import sign_block
from consensus.chain.schedule import Schedule
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.errors import BlockRobotError
from consensus.limits import (
    BLOCK_GAS_MAX,
    BLOCK_SIZE_MAX_BYTES,
    BLOCK_TRANSACTIONS_MAX_COUNT,
)
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.protocol.effects import BuildBlock
from contracts.execution.epochs import next_epoch
from contracts.execution.genesis import open_genesis
from contracts.execution.results import BlockResult, ExpectedBlock
from contracts.execution.validity import RecentTransactions, check_block_transactions, select_valid
from contracts.state.view import Overlay, StateView
from node.execution.execution_machines import BlockExecutionResult, CheckedBlock, Machine, RemoteMachine
from node.execution.execution_retries import ExecutionRetries
from node.mempool.mempool import Mempool
from node.mempool.quarantine import Quarantine
from node.mempool.transaction_cache import TransactionCache
from node.storage.ledger_store import FinalizedBlock, LedgerSnapshot, LedgerStore

BLOCK_CONTENT_MAX_BYTES = BLOCK_SIZE_MAX_BYTES - 64 * 1024
ROOMY_PER_CENT = 80


@dataclass(slots=True, eq=False)
class ExecutedBlock:
    """An executed block; `next_epoch` is set for a boundary.

    `withheld`: gives up a contract change that this node could carry out (R42).
    """

    block: Block
    block_id: bytes
    header: Header
    transactions: list[Transaction]
    receipts: tuple[Receipt, ...]
    overlay: Overlay
    txids: frozenset[bytes]
    next_epoch: Epoch | None = None
    withheld: bool = False

    @property
    def is_roomy(self) -> bool:
        size = sum(len(transaction.wire) for transaction in self.transactions)
        return (
            self.header.gas_used * 100 < BLOCK_GAS_MAX * ROOMY_PER_CENT
            and len(self.transactions) * 100 < BLOCK_TRANSACTIONS_MAX_COUNT * ROOMY_PER_CENT
            and size * 100 < BLOCK_CONTENT_MAX_BYTES * ROOMY_PER_CENT
        )

    def to_stored(self, proof: FinalityProof) -> FinalizedBlock:
        epoch_proof = b""
        if self.next_epoch is not None:
            if proof.header_bytes != self.block.header_bytes:
                raise AssertionError("a boundary is stored with the proof of another block")
            epoch_proof = encode(EpochProof(finality=proof, epoch=self.next_epoch))
        return FinalizedBlock(
            height=self.header.height,
            block_id=self.block_id,
            block_bytes=encode(self.block),
            receipts_bytes=encode(Receipts(receipts=self.receipts)),
            timestamp_ms=self.header.timestamp_ms,
            state_root=self.header.state_root,
            transactions=[(item.txid, item.body.valid_until_ms) for item in self.transactions],
            state_writes=self.overlay.writes,
            page_writes=self.overlay.page_writes,
            events=[encode(event) for receipt in self.receipts for event in receipt.events],
            epoch_proof_bytes=epoch_proof,
        )


class _BranchTransactions:
    def __init__(self, above: frozenset[bytes], base: LedgerSnapshot) -> None:
        self._above = above
        self._base = base

    def __contains__(self, txid: object, /) -> bool:
        return txid in self._above or (isinstance(txid, bytes) and self._base.locate(txid) is not None)


class Executor:
    """Executes and holds the blocks above the stored ledger."""

    def __init__(
        self,
        *,
        genesis: Genesis,
        ledger: LedgerStore,
        machine: Machine,
        cache: TransactionCache,
        key: PrivateKey | None,
        waits: bool = False,
        quarantine: Quarantine | None = None,
    ) -> None:
        """`waits`: the machine is another process; the event loop does not block."""
        self.quarantine = quarantine or Quarantine(time.monotonic)
        self.waits = waits
        self.schedule: Schedule = genesis.schedule
        self.thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="execution")
        self._chain_id = genesis.chain_id
        self._ledger = ledger
        self._machine = machine
        self._retries = ExecutionRetries(machine, self.quarantine)
        self._cache = cache
        self._key = key
        self._blocks: dict[bytes, ExecutedBlock] = {}
        self._base: LedgerSnapshot = ledger.snapshot()
        self._reader: LedgerSnapshot = ledger.snapshot()

    def close(self) -> None:
        self.thread.shutdown(wait=True)
        self._base.close()
        self._reader.close()

    @property
    def reader(self) -> LedgerSnapshot:
        return self._reader

    @property
    def base_height(self) -> int:
        position = self._base.position
        return -1 if position is None else position.height

    def executed(self, block_id: bytes) -> ExecutedBlock:
        return self._blocks[block_id]

    def find(self, block_id: bytes) -> ExecutedBlock | None:
        return self._blocks.get(block_id)

    # Branches

    def _view(self, block_id: bytes) -> StateView:
        executed = self._blocks.get(block_id)
        if executed is not None:
            return executed.overlay
        position = self._base.position
        if position is None or position.block_id != block_id:
            raise LookupError(f"the parent {block_id.hex()} was not executed here")
        return self._base

    def _branch(self, block_id: bytes) -> Iterator[ExecutedBlock]:
        executed = self._blocks.get(block_id)
        while executed is not None:
            yield executed
            executed = self._blocks.get(executed.header.parent_id)

    def txids_on_branch(self, block_id: bytes) -> frozenset[bytes]:
        return frozenset().union(*(executed.txids for executed in self._branch(block_id)))

    def must_close(self, parent_id: bytes, epoch: int) -> bool:
        parent = self._blocks.get(parent_id)
        if parent is None or parent.header.epoch != epoch:
            return False
        return parent.header.is_closing or parent.next_epoch is not None

    def _recent(self, block_id: bytes) -> _BranchTransactions:
        return _BranchTransactions(self.txids_on_branch(block_id), self._base)

    def _time_of(self, block_id: bytes) -> int:
        executed = self._blocks.get(block_id)
        if executed is not None:
            return executed.header.timestamp_ms
        position = self._base.position
        return -1 if position is None else position.timestamp_ms

    # Verifying

    def verify(self, block: Block, *, certified: bool = False) -> ExecutedBlock:
        """Execute another node's block and compare the roots.

        A failed one is retried only if `certified`. Raises BLOCK_INVALID, transaction errors, ExecutionFault,
        LookupError (unknown parent).
        """
        block_id = block.block_id
        known = self._blocks.get(block_id)
        if known is not None:
            return known
        header = block.header
        parent = self._view(header.parent_id)
        must_close = self.must_close(header.parent_id, header.epoch)
        if header.is_closing != must_close or (must_close and block.transactions):
            raise BlockRobotError("BLOCK_INVALID", "Only empty closing blocks stand behind a boundary, and only there.")
        transactions = [self._cache.verified(wire) for wire in block.transactions]
        checked = CheckedBlock(block, block_id, header, tuple(transactions))
        if not certified:
            self._retries.require_not_failed_before(checked, parent)
        parent_id = header.parent_id
        executed = self.execute_final(
            checked, parent, self._time_of(parent_id), self._recent(parent_id), certified=certified
        )
        if header.gives_up_change and not certified:
            executed.withheld = not may_give_up_change(header, self.schedule) and self._retries.can_change(
                parent, header
            )
        self._blocks[block_id] = executed
        return executed

    def note_lost(self, block_id: bytes) -> None:
        """R41: leave a lost own block's transactions to others for a while."""
        executed = self._blocks.get(block_id)
        if executed is not None:
            self.quarantine.note_lost(executed.txids)

    def execute_final(
        self,
        checked: CheckedBlock,
        parent: StateView,
        parent_time_ms: int,
        recent: RecentTransactions,
        result: BlockExecutionResult | None = None,
        *,
        certified: bool = True,
    ) -> ExecutedBlock:
        """Execute a block (or use `result`), compare the roots, keep nothing.

        Signatures are already checked. Raises BLOCK_INVALID, transaction errors, ExecutionFault.
        """
        header, transactions = checked.header, list(checked.transactions)
        check_block_transactions(
            transactions,
            chain_id=self._chain_id,
            parent_time_ms=parent_time_ms,
            time_ms=header.timestamp_ms,
            recent=recent,
        )
        if header.is_closing:
            result = _unchanged(parent)
        elif result is None:
            result = self._retries.verify(checked, parent, certified=certified)
        following = next_epoch(result.writes, header.epoch)
        _require_equal(header, result, following)
        return _executed(checked.block, checked.block_id, header, transactions, parent, result, following)

    def execute_ahead(self, parent: StateView, blocks: Sequence[CheckedBlock]) -> Sequence[BlockExecutionResult]:
        """Return results of the first of these blocks, maybe none; roots unchecked."""
        if not isinstance(self._machine, RemoteMachine) or len(blocks) < 2:
            return ()
        headers = [checked.header for checked in blocks]
        expected = [
            ExpectedBlock(
                header.height, header.timestamp_ms, checked.transactions, header.state_root, header.gives_up_change
            )
            for header, checked in zip(headers, blocks, strict=True)
        ]
        return self._machine.verify_ahead(parent, expected)

    def read_transaction(self, wire: bytes) -> Transaction:
        """Decode a transaction and check its signature, uncached; thread-safe.

        Raises ENCODING_*, TRANSACTION_TOO_LARGE, SIGNATURE_*.
        """
        transaction = self._cache.get(wire)
        if transaction is None:
            transaction = decode_transaction(wire)
            transaction.verify_sender()
        return transaction

    # Building

    def choose(self, mempool: Mempool, parent_id: bytes, timestamp_ms: int) -> list[Transaction]:
        """Choose transactions not on the branch yet; none behind a boundary."""
        if self.must_close(parent_id, self.schedule.epoch):
            return []
        taken = mempool.take(
            max_count=BLOCK_TRANSACTIONS_MAX_COUNT,
            max_bytes=BLOCK_CONTENT_MAX_BYTES,
            timestamp_ms=timestamp_ms,
            exclude=self.txids_on_branch(parent_id) | self.quarantine.held(),
        )
        recent = self._recent(parent_id)
        return select_valid(taken, chain_id=self._chain_id, time_ms=timestamp_ms, recent=recent)

    def build(
        self, request: BuildBlock, timestamp_ms: int, transactions: list[Transaction]
    ) -> tuple[ExecutedBlock, list[bytes]]:
        """Execute, complete and sign a block; return it and failed txids.

        A block deciding an epoch is a boundary; a closing block behind it executes nothing. A failing contract change
        is given up (R42). Raises LookupError for an unknown parent.
        """
        if self._key is None:
            raise AssertionError("a follower never builds")
        parent = self._view(request.parent_id)
        is_closing, gives_up_change = self.must_close(request.parent_id, request.epoch), False
        if is_closing:
            result, faulty = _unchanged(parent), list[bytes]()
        else:
            lost_rounds = request.round - request.qc.round - 1
            is_hopeless = lost_rounds >= 2 * lost_rounds_before_giving_up(self.schedule)
            result, faulty, gives_up_change = self._retries.build(
                parent, request.height, timestamp_ms, transactions, is_hopeless=is_hopeless
            )
        included = {receipt.txid for receipt in result.receipts}
        chosen = [transaction for transaction in transactions if transaction.txid in included]
        following = next_epoch(result.writes, request.epoch)
        header = Header(
            version=HEADER_VERSION,
            chain_id=self._chain_id,
            epoch=request.epoch,
            height=request.height,
            round=request.round,
            parent_id=request.parent_id,
            qc=request.qc,
            tc=request.tc,
            producer=request.producer,
            timestamp_ms=timestamp_ms,
            transactions_root=compute_transactions_root([transaction.txid for transaction in chosen]),
            receipts_root=compute_receipts_root(result.receipts),
            state_root=result.state_root,
            next_schedule_hash=None if following is None else compute_epoch_hash(following),
            gas_used=result.gas_used,
            is_closing=is_closing,
            gives_up_change=gives_up_change,
        )
        header_bytes = encode(header)
        block_id = sha256(header_bytes)
        block = Block(
            header_bytes=header_bytes,
            signature=sign_block(self._key, self._chain_id, header.epoch, header.round, block_id),
            transactions=tuple(transaction.wire for transaction in chosen),
        )
        executed = _executed(block, block_id, header, chosen, parent, result, following)
        self._blocks[block_id] = executed
        return executed, faulty

    # Moving up

    def begin_epoch(self, schedule: Schedule) -> None:
        """Begin an epoch at the stored head; only while nothing executes."""
        self.schedule = schedule
        self._blocks = {
            block_id: executed for block_id, executed in self._blocks.items() if executed.header.epoch == schedule.epoch
        }

    def move_base(self, stored: LedgerSnapshot | None = None) -> None:
        """Move the base to the newest stored block; only while nothing executes.

        Takes over `stored`, the ledger as the core knows it; the store may be ahead.
        """
        newest = self._ledger.snapshot() if stored is None else stored
        position = newest.position
        if position is None or position.height <= self.base_height:
            newest.close()
            return
        self.quarantine.forget_up_to(position.height)
        previous, self._base = self._base, newest
        above = sorted(self._blocks.values(), key=lambda executed: executed.header.height)
        self._blocks = {}
        for executed in above:
            parent_id = executed.header.parent_id
            if executed.header.height > position.height and (
                parent_id == position.block_id or parent_id in self._blocks
            ):
                self._blocks[executed.block_id] = executed
                if parent_id == position.block_id:
                    executed.overlay.rebase(newest)
        previous.close()
        self._reader.close()
        self._reader = self._ledger.snapshot()


def _unchanged(parent: StateView) -> BlockExecutionResult:
    return BlockResult((), {}, {}, parent.state_root, compute_receipts_root(()), 0)


def _executed(
    block: Block,
    block_id: bytes,
    header: Header,
    transactions: list[Transaction],
    parent: StateView,
    result: BlockExecutionResult,
    following: Epoch | None,
) -> ExecutedBlock:
    return ExecutedBlock(
        block=block,
        block_id=block_id,
        header=header,
        transactions=transactions,
        receipts=result.receipts,
        overlay=Overlay(parent, result.writes, result.page_writes, result.state_root),
        txids=frozenset(transaction.txid for transaction in transactions),
        next_epoch=following,
    )


def _require_equal(header: Header, result: BlockExecutionResult, following: Epoch | None) -> None:
    """Raises BLOCK_INVALID."""
    if result.left_out:
        raise BlockRobotError("BLOCK_INVALID", "The block holds a transaction that does not fit into it.")
    if result.gas_used != header.gas_used or result.state_root != header.state_root:
        raise BlockRobotError("BLOCK_INVALID", "The state after the block is not the one that its header names.")
    if compute_receipts_root(result.receipts) != header.receipts_root:
        raise BlockRobotError("BLOCK_INVALID", "The receipts are not the ones that the header names.")
    if header.next_schedule_hash != (None if following is None else compute_epoch_hash(following)):
        raise BlockRobotError("BLOCK_INVALID", "The next epoch is not the one that the header names.")


def genesis_block(genesis: Genesis) -> FinalizedBlock:
    """Ready to store. Raises GENESIS_INVALID."""
    state = open_genesis(genesis)
    block = genesis.block()
    return FinalizedBlock(
        height=0,
        block_id=block.block_id,
        block_bytes=encode(block),
        receipts_bytes=encode(Receipts(receipts=())),
        timestamp_ms=block.header.timestamp_ms,
        state_root=state.state_root,
        state_writes=state.writes,
        page_writes=state.pages,
    )
