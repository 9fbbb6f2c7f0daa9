"""Mutants of what blocks do: execution, replays, the stores, and what clients are told."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import pytest

from consensus.chain.block import FinalityProof
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.results import BlockContext
from node.components import NodeComponents
from node.custody.coordination.custody_coordinator import CustodyCoordinator
from node.custody.finalized_events import collect_events
from node.execution import block_executor
from node.execution.block_executor import ExecutedBlock, _BranchTransactions
from node.ledger.ledger_writer import FinalityFeed, LedgerWriter
from node.storage.ledger_store import KeptBlock
from node.storage.memory_store import MemoryRestore, _Tables
from tests.sim.mutants.mutant import Mutant
from tests.sim.mutants.schedules import CHAOS, REPLAY, REPLAY_AFTER_PRUNING, REPLAY_AFTER_SNAPSHOTS, WRONG_ROOTS


def look_at_ones_own_clock(patch: pytest.MonkeyPatch) -> None:
    """Contracts see how often this process has executed something."""
    count = itertools.count()

    def context(self: ContractMachine, height: int, time_ms: int) -> BlockContext:
        return BlockContext(chain_id=self._chain_id, height=height, time_ms=time_ms + next(count) % 2)

    patch.setattr(ContractMachine, "_context", context)


def compare_no_roots(patch: pytest.MonkeyPatch) -> None:
    """Whatever a header says of its block's results is believed."""
    patch.setattr(block_executor, "_require_equal", lambda header, result, following: None)


def forget_stored_txids(patch: pytest.MonkeyPatch) -> None:
    """Only transactions above the stored ledger count as known."""
    patch.setattr(_BranchTransactions, "__contains__", lambda self, txid: txid in self._above)


def prune_txids(patch: pytest.MonkeyPatch) -> None:
    """With a block's body its transactions' ids go."""
    prune = _Tables.prune

    def forgetful(self: _Tables, below_height: int, reduce: Callable[[bytes], bytes]) -> None:
        prune(self, below_height, reduce)
        self.locations = {txid: place for txid, place in self.locations.items() if place.height >= self.earliest_height}

    patch.setattr(_Tables, "prune", forgetful)


def drop_txids_at_a_snapshot(patch: pytest.MonkeyPatch) -> None:
    """A ledger made out of a snapshot knows its blocks, and of their transactions nothing."""
    put = MemoryRestore.put_kept

    def put_kept(self: MemoryRestore, blocks: Sequence[KeptBlock]) -> None:
        put(self, [kept._replace(recent=kept.recent._replace(transactions=())) for kept in blocks])

    patch.setattr(MemoryRestore, "put_kept", put_kept)


def apply_reversible_blocks(patch: pytest.MonkeyPatch) -> None:
    """The custodian's store follows certified blocks, final or not."""
    make = NodeComponents._make_custody

    def make_custody(self: NodeComponents) -> CustodyCoordinator | None:
        custody = make(self)
        note = self.engine._note_certified

        def note_certified(block_id: bytes) -> None:
            note(block_id)
            executed = self.executor.find(block_id)
            if executed is not None and custody is not None and custody.checkpoint_height is not None:
                self.engine._loop.create_task(apply(custody, executed))

        self.engine._note_certified = note_certified  # type: ignore[method-assign]
        return custody

    async def apply(custody: CustodyCoordinator, executed: ExecutedBlock) -> None:
        header = executed.header
        if header.height == (custody.checkpoint_height or 0) + 1:
            events = collect_events(header.height, executed.block_id, header.timestamp_ms, executed.receipts)
            await custody._custodian.on_finalized_block(events)
            custody.checkpoint_height = header.height

    patch.setattr(NodeComponents, "_make_custody", make_custody)


def tell_too_early(patch: pytest.MonkeyPatch) -> None:
    """Who waits for a transaction is told when its block is handed to the store."""
    store = LedgerWriter.store

    def store_and_tell(self: LedgerWriter, blocks: list[ExecutedBlock], proof: FinalityProof) -> None:
        store(self, blocks, proof)
        for listener in self._listeners:
            feed = getattr(listener, "__self__", None)
            if isinstance(feed, FinalityFeed):
                feed.publish(blocks, proof, blocks[-1].to_stored(proof).position)

    patch.setattr(LedgerWriter, "store", store_and_tell)


STORING = (
    Mutant("execution that depends on the node", "R5", look_at_ones_own_clock, CHAOS, frozenset({"equal_state_roots"})),
    Mutant("verify compares no roots", "R5", compare_no_roots, WRONG_ROOTS, frozenset({"liveness"})),
    Mutant("forget stored txids", "once for all", forget_stored_txids, REPLAY, frozenset({"exactly_once"})),
    Mutant("drop txids when pruning", "once for all", prune_txids, REPLAY_AFTER_PRUNING, frozenset({"exactly_once"})),
    Mutant(
        "drop txids at a snapshot",
        "once for all",
        drop_txids_at_a_snapshot,
        REPLAY_AFTER_SNAPSHOTS,
        frozenset({"exactly_once"}),
    ),
    Mutant(
        "apply reversible blocks to the store",
        "final only",
        apply_reversible_blocks,
        CHAOS,
        frozenset({"chain_equals_store"}),
    ),
    Mutant("acknowledge before durable storage", "R12", tell_too_early, CHAOS, frozenset({"code_faults"})),
)
