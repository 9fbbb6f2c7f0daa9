"""Assembles the parts of one node from `Environment`."""

from __future__ import annotations

import asyncio
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from typing import Any, Protocol

import structlog

from consensus.chain.block import FinalityProof
from consensus.chain.genesis import Genesis
from consensus.chain.signature_cache import SignatureCache, SignatureCheck
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.protocol.core import Core
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.sender_admission import find_account, require_admission
from node.api.ports import Clock
from node.api_adapters import FinalizedLedger, Pool
from node.consensus.engine import Engine, Outbox
from node.consensus.epoch_change import EpochStart, Head, read_head
from node.consensus.evidence_submitter import EvidenceSubmitter, describe_accused, suspended_height
from node.consensus.journal import JournalEntry
from node.consensus.journal_writer import VotingJournal
from node.consensus.readiness_reporter import ReadinessReporter
from node.consensus.stall_detector import StallDetector
from node.custody.coordination.custody_admin import CustodyAdmin
from node.custody.coordination.custody_coordinator import CustodyCoordinator, CustodyPlace
from node.directory.node_directory import Directory
from node.execution.block_executor import ExecutedBlock, Executor, genesis_block
from node.execution.execution_machines import Machine
from node.ledger.ledger_writer import FinalityFeed, LedgerWriter
from node.limits.account_byte_limiter import AccountByteLimiter
from node.limits.refusal_log import RefusalLog
from node.mempool.call_check import CallCheck
from node.mempool.mempool import Mempool
from node.mempool.quarantine import Quarantine
from node.mempool.transaction_cache import TransactionCache
from node.mempool.transaction_intake import TransactionIntake
from node.metrics import NodeMetrics
from node.p2p.network import PeerHandler
from node.peers.peers import Network, Peers
from node.retention.pruning import Pruner
from node.storage.ledger_store import LedgerStore, Position
from node.sync.block_sync import LAG_TOLERATED_BLOCKS, Synchroniser

HOUSEKEEPING_INTERVAL_MS = 1_000
_VERSION = version("blockrobot")

log = structlog.get_logger(__name__)


class OpenJournal(VotingJournal, Protocol):
    """The voting journal as it was found."""

    @property
    def entries(self) -> tuple[JournalEntry, ...]: ...


@dataclass(frozen=True, slots=True)
class Environment:
    """All that a node's parts touch outside of themselves.

    `stopwatch`: monotonic seconds. `machine`, `check`, `transactions` may be shared in a process; `wrap_outbox` may
    intercept sends; `directory` defaults to genesis's.
    """

    genesis: Genesis
    name: str
    ledger: LedgerStore
    journal: OpenJournal
    clock: Clock
    open_network: Callable[[PeerHandler], Network]
    key: PrivateKey | None
    custody: CustodyPlace | None = None
    stopwatch: Callable[[], float] = time.perf_counter
    randomness: Callable[[int], bytes] = secrets.token_bytes
    machine: Machine | None = None
    check: SignatureCheck = field(default_factory=SignatureCache)
    transactions: TransactionCache = field(default_factory=TransactionCache)
    wrap_outbox: Callable[[Outbox], Outbox] | None = None
    directory: Directory | None = None
    keep_blocks: int = 0
    waits_for_machine: bool = False


async def begin_ledger(ledger: LedgerStore, genesis: Genesis) -> None:
    """Store genesis in a new ledger. Raises GENESIS_IN_USE, STORAGE_*, GENESIS_INVALID."""
    if ledger.position is None:
        await ledger.commit([genesis_block(genesis)], b"")
    with ledger.snapshot() as snapshot:
        if snapshot.block_height(genesis.block_id) != 0:
            raise BlockRobotError(
                "GENESIS_IN_USE", "The node's ledger has begun by another genesis file than it has now."
            )


def make_core(surroundings: Environment, head: Head, before: Core | None = None, journal: Sequence[bytes] = ()) -> Core:
    """Return a core continuing from this head, after `before` or with the journal."""
    return Core(
        head.start.epoch.settings,
        surroundings.genesis.chain_id,
        head.start.schedule,
        surroundings.key,
        finalized=head.block,
        finalized_qc=head.qc,
        round_zero_id=head.start.round_zero_id,
        journal=journal,
        check=surroundings.check,
        before=before,
    )


def restore_core(surroundings: Environment) -> tuple[Core, EpochStart]:
    """Return the core restored from ledger and journal. Raises STORAGE_DAMAGED."""
    with surroundings.ledger.snapshot() as snapshot:
        head = read_head(snapshot, surroundings.genesis)
    journal = [entry.record for entry in surroundings.journal.entries]
    return make_core(surroundings, head, journal=journal), head.start


class NodeComponents:
    """One node's parts: started and stopped once, on the event loop."""

    def __init__(self, surroundings: Environment) -> None:
        """Make all parts without sending anything. Raises STORAGE_*, GENESIS_INVALID."""
        self.surroundings = around = surroundings
        self.genesis = genesis = around.genesis
        self.directory = around.directory or Directory.of_genesis(genesis)
        self._directory_is_behind = False
        self._read_directory()
        self._stack = AsyncExitStack()
        self._started_at = around.stopwatch()
        core, start = restore_core(around)
        machine = around.machine or ContractMachine.of_genesis(genesis)
        self.executor = Executor(
            genesis=genesis,
            ledger=around.ledger,
            machine=machine,
            cache=around.transactions,
            key=around.key,
            waits=around.waits_for_machine,
            quarantine=Quarantine(around.stopwatch),
        )
        self.executor.begin_epoch(start.schedule)
        try:
            self._make_parts(core, start)
        except BaseException:
            self.executor.close()
            raise

    def _make_parts(self, core: Core, start: EpochStart) -> None:
        around, genesis, now_ms = self.surroundings, self.genesis, self.surroundings.clock.now_ms
        self.mempool = Mempool(
            chain_id=genesis.chain_id,
            cache=around.transactions,
            check_admission=self._check_admission,
            is_spent=self._is_spent,
            account_of=lambda transaction: find_account(self.executor.reader, transaction),
            byte_budgets=AccountByteLimiter(asyncio.get_running_loop().time),
        )
        self.over_budget = RefusalLog("over_budget")
        self.intake = TransactionIntake(self.mempool, now_ms, self.on_over_budget)
        self.feed = FinalityFeed(core.finalized.height)
        self.writer = LedgerWriter(around.ledger)
        self.engine = Engine(
            core=core,
            start=start,
            make_core=partial(make_core, around),
            executor=self.executor,
            mempool=self.mempool,
            journal=around.journal,
            sink=self.writer,
            clock=now_ms,
            stopwatch=around.stopwatch,
        )
        self.peers = Peers(
            chain_id=genesis.chain_id,
            name=around.name,
            start=start,
            name_of_producer=self._name_of_producer,
            mempool=self.mempool,
            intake=self.intake,
            ledger=around.ledger,
            clock=now_ms,
            on_over_budget=self.on_over_budget,
        )
        self.network = around.open_network(self.peers)
        self.sync = Synchroniser(
            genesis=genesis,
            ledger=around.ledger,
            engine=self.engine,
            executor=self.executor,
            writer=self.writer,
            feed=self.feed,
            requester=self.network,
        )
        self.peers.connect(self.network, self.engine, self.sync)
        self.engine.add_epoch_listener(self.peers.begin_epoch)
        self.engine.add_unseen_listener(self.intake.note_unseen)
        self.directory.add_listener(lambda _directory: self.peers.name_producers())
        self.pool = Pool(
            mempool=self.mempool,
            intake=self.intake,
            engine=self.engine,
            gossip=self.peers.gossip,
            feed=self.feed,
            clock=around.clock,
            calls=CallCheck(lambda: self.executor.reader),
        )
        self.finalized = FinalizedLedger(around.ledger, self.feed)
        self.stall_detector = StallDetector(
            around.stopwatch, lambda: self.engine.epoch.epoch.settings, now_ms, lambda: self.sync.is_running
        )
        self.custody = self._make_custody()
        self.custody_admin = self._make_custody_admin()
        self.pruner = Pruner(around.ledger, around.keep_blocks, self._custody_height)
        self.pruner.add_listener(self.peers.forget_blocks)
        self._readiness_reporter = self._make_readiness_reporter()
        self.evidence_submitter = self._make_evidence_submitter()
        self._metrics = NodeMetrics(_gauges_of(self), now_ms)

    def _make_readiness_reporter(self) -> ReadinessReporter | None:
        around = self.surroundings
        if around.key is None:
            return None
        return ReadinessReporter(
            key=around.key,
            chain_id=self.genesis.chain_id,
            pool=self.pool,
            reader=lambda: self.executor.reader,
            schedule=lambda: self.engine.epoch.schedule,
            is_close=lambda: self.sync.lag_blocks <= LAG_TOLERATED_BLOCKS and bool(self.network.connected),
            clock=around.clock.now_ms,
            randomness=around.randomness,
        )

    def _make_evidence_submitter(self) -> EvidenceSubmitter | None:
        around = self.surroundings
        if around.key is None:
            return None
        evidence_submitter = EvidenceSubmitter(
            key=around.key,
            chain_id=self.genesis.chain_id,
            pool=self.pool,
            reader=lambda: self.executor.reader,
            schedule=lambda: self.engine.epoch.schedule,
            clock=around.clock.now_ms,
        )
        self.engine.add_evidence_listener(evidence_submitter.note)
        return evidence_submitter

    def _make_custody(self) -> CustodyCoordinator | None:
        around, place = self.surroundings, self.surroundings.custody
        if place is None:
            return None
        now_ms = around.clock.now_ms
        custody = CustodyCoordinator(
            genesis=self.genesis,
            name=around.name,
            custodian=place.make_custodian(around.ledger, now_ms),
            key=place.key,
            ledger=around.ledger,
            feed=self.feed,
            pool=self.pool,
            peers=self.network,
            clock=now_ms,
            randomness=around.randomness,
            custodians=lambda: self.directory.custodians,
            is_in_touch=self._has_heard_the_network,
            final_height=lambda: self.writer.queued_height,
            hold_room=None if place.reserve is None else place.reserve.hold,
            room_gib=place.room_gib,
        )
        self.peers.clips = custody
        return custody

    def _has_heard_the_network(self) -> bool:
        level = 1 + sum(self.sync.is_level_with(peer) for peer in self.network.connected)
        return level >= self.engine.epoch.schedule.quorum

    def _make_custody_admin(self) -> CustodyAdmin | None:
        around, place, custody = self.surroundings, self.surroundings.custody, self.custody
        if place is None or custody is None:
            return None
        return CustodyAdmin(
            name=around.name,
            member=place.key.public_key,
            custodian=custody.custodian,
            store=place.store,
            keys=place.erase_keys,
            ledger=around.ledger,
            clock=around.clock.now_ms,
            find_peers=custody.find_peers,
            is_serving=lambda: custody.is_serving,
            failing=custody.failing,
            describe_uploads=partial(custody.describe_uploads, place.store, reserve=place.reserve),
        )

    def _custody_height(self) -> int | None:
        if self.custody is None:
            return None
        followed = self.custody.checkpoint_height
        return -1 if followed is None else followed

    async def start(self) -> None:
        """Connect and take part. Raises PORT_*, ADDRESS_NOT_HERE, STORE_UNAVAILABLE, ERASE_KEYS_DAMAGED."""
        stack = self._stack
        self.writer.add_listener(self._follow_directory)
        self.writer.add_listener(self._note_stored)
        self.writer.add_listener(self.feed.publish)
        self.writer.add_listener(self.stall_detector.note_final)
        self.writer.add_listener(self._metrics.note_finalized)
        self.writer.add_listener(self._after_stored)
        self.writer.start(
            on_failure=partial(self.engine.pause, "ledger"),
            on_recovery=partial(self.engine.resume, "ledger"),
            between_events=self.engine.call_between_events,
        )
        for stop in (self.writer.stop, self.engine.stop, self.sync.stop, self.peers.stop, self.intake.stop):
            stack.push_async_callback(stop)
        await self.network.start()
        stack.push_async_callback(self.network.stop)
        wrap = self.surroundings.wrap_outbox
        self.engine.start(self.peers if wrap is None else wrap(self.peers))
        housekeeping = asyncio.get_running_loop().create_task(self._run_housekeeping(), name="housekeeping")
        stack.push_async_callback(_cancel, housekeeping)
        if self.custody is not None:
            await self.custody.start()
            stack.push_async_callback(self.custody.stop)

    async def stop(self) -> None:
        await self._stack.aclose()
        self.executor.close()

    @property
    def core(self) -> Core:
        return self.engine.core

    # What the parts ask of the whole

    def on_over_budget(self, source: str, error: BlockRobotError) -> None:
        self.over_budget.note(source, error, self.surroundings.clock.now_ms(), source.rpartition(" ")[0])

    def _name_of_producer(self, key: bytes) -> str | None:
        return self.directory.name_of_producer(key)

    def _read_directory(self) -> None:
        with self.surroundings.ledger.snapshot() as snapshot:
            if snapshot.position is not None:
                self.directory.refresh(snapshot, snapshot.position.height)

    def _follow_directory(self, blocks: list[ExecutedBlock], _proof: FinalityProof, position: Position) -> None:
        writes = (block.overlay.writes for block in blocks)
        if self._directory_is_behind or self.directory.needs_refresh(writes, position.height):
            self._catch_up_with_directory()

    def _note_stored(self, blocks: list[ExecutedBlock], proof: FinalityProof, position: Position) -> None:
        self.engine.note_stored(blocks, proof, position, self.writer.take_stored())

    def _catch_up_with_directory(self) -> None:
        self._directory_is_behind = True
        try:
            self._read_directory()
        except BlockRobotError as error:
            log.error("directory_unreadable", code=error.code, detail=error.detail)
        else:
            self._directory_is_behind = False

    def _check_admission(self, transaction: Transaction) -> bool:
        reader = self.executor.reader
        position = reader.position
        if position is None:
            return False
        require_admission(reader, transaction, position.timestamp_ms)
        return True

    def _is_spent(self, txid: bytes) -> bool:
        return self.engine.is_on_branch(txid) or self.executor.reader.locate(txid) is not None

    def _after_stored(self, _blocks: list[ExecutedBlock], _proof: FinalityProof, _position: Position) -> None:
        self.peers.retry_unsettled()

    async def _run_housekeeping(self) -> None:
        announced = -1
        while True:
            await asyncio.sleep(HOUSEKEEPING_INTERVAL_MS / 1000)
            if self._directory_is_behind:
                self._catch_up_with_directory()
            self.pool.purge_expired()
            self.stall_detector.look(len(self.mempool))
            self.peers.retry_unsettled()
            self.engine.note_work()
            self.sync.recheck()
            await self.pruner.run_once()
            if self._readiness_reporter is not None:
                await self._readiness_reporter.submit_if_due()
            if self.evidence_submitter is not None:
                await self.evidence_submitter.submit_if_due()
            if self.feed.height != announced:
                announced = self.feed.height
                self.peers.announce_height(announced)

    # NodeStatus

    def is_ready(self) -> bool:
        in_touch = 1 + len(self.network.connected)
        return in_touch >= self.engine.epoch.schedule.quorum and self.engine.is_signing and not self.sync.closes_gap

    def describe(self) -> Mapping[str, Any]:
        core = self.core
        position = self.executor.reader.position
        return {
            "name": self.surroundings.name,
            "organisation": self._organisation(),
            "membership": self._membership(),
            "directory_height": self.directory.height,
            "chain_id": self.genesis.chain_id.hex(),
            "ready": self.is_ready(),
            "height": core.finalized.height + len(core.certified_branch()),
            "finalized_height": self.feed.height,
            "earliest_height": self.executor.reader.earliest_height,
            "state_root": position.state_root.hex() if position else None,
            "state_height": position.height if position else None,
            "round": core.round,
            "epoch": core.epoch,
            "leader": self._leader_name(),
            "peers": self.network.connected,
            "mempool": len(self.mempool),
            "custody_checkpoint": None if self.custody is None else self.custody.checkpoint_height,
            "custody_failing": None if self.custody is None else self.custody.failing.code,
            "over_budget": self.over_budget.describe(self.surroundings.clock.now_ms()),
            "fault": core.halted or self.engine.fault,
            "execution": self.executor.quarantine.describe(),
            "lockout": None if core.lockout is None else core.lockout._asdict(),
            "finality": self.stall_detector.describe(),
            "suspended_height": self._suspended_height(),
            "accused": self.describe_accused(),
            "version": _VERSION,
            "uptime_s": round(self.surroundings.stopwatch() - self._started_at, 1),
        }

    def _organisation(self) -> str | None:
        return getattr(self.directory.content.nodes.get(self.surroundings.name), "organisation", None)

    def _membership(self) -> str:
        if self.directory.node(self.surroundings.name) is not None:
            return "active"
        return "removed" if self.surroundings.name in self.directory.content.nodes else "unknown"

    def _suspended_height(self) -> int | None:
        key = self.surroundings.key
        return None if key is None else suspended_height(self.executor.reader, key.public_key)

    def describe_accused(self) -> list[dict[str, Any]]:
        return describe_accused(self.evidence_submitter, self.directory, self.executor.reader)

    def count_producers_in_touch(self) -> int:
        in_touch = {self.surroundings.name, *self.network.connected}
        return sum(self._name_of_producer(key) in in_touch for key in self.engine.epoch.schedule.producers)

    def _leader_name(self) -> str | None:
        return self._name_of_producer(self.engine.epoch.schedule.producers[self.core.leader])

    def metrics(self) -> bytes:
        return self._metrics.render()


async def _cancel(task: asyncio.Task[None]) -> None:
    task.cancel()
    await asyncio.gather(task, return_exceptions=True)


def _gauges_of(parts: NodeComponents) -> dict[str, tuple[str, Callable[[], float]]]:
    return {
        "blockrobot_finalized_height": ("Height of the newest stored block.", lambda: parts.feed.height),
        "blockrobot_lag_blocks": ("Blocks behind the highest height that peers claim.", lambda: parts.sync.lag_blocks),
        **parts.stall_detector.gauges(),
        "blockrobot_round": ("The round that the node is in.", lambda: parts.core.round),
        "blockrobot_producers": ("Producers of this epoch.", lambda: len(parts.engine.epoch.schedule.producers)),
        "blockrobot_quorum": ("Producers whose votes make a block final.", lambda: parts.engine.epoch.schedule.quorum),
        "blockrobot_producers_in_touch": (
            "Producers of this epoch that are connected, with this node if it is one.",
            parts.count_producers_in_touch,
        ),
        "blockrobot_producers_accused": (
            "Producers that signed twice in one round, by evidence here or by a suspension on the chain.",
            lambda: len(parts.describe_accused()),
        ),
        "blockrobot_peers_connected": ("Connected peers.", lambda: len(parts.network.connected)),
        "blockrobot_mempool_transactions": ("Waiting transactions.", partial(len, parts.mempool)),
        "blockrobot_mempool_size_bytes": ("Bytes of waiting transactions.", lambda: parts.mempool.size_bytes),
        "blockrobot_mempool_max_bytes": ("Bytes that may wait.", lambda: parts.mempool.max_bytes),
        "blockrobot_mempool_evicted_total": (
            "Transactions that made room in a full pool for others of whom less waited.",
            lambda: parts.mempool.evicted_count,
        ),
        "blockrobot_signatures_checked_total": (
            "Signatures of transactions that this node checked as they came in.",
            lambda: parts.intake.signatures_checked_count,
        ),
        "blockrobot_transactions_dropped_total": (
            "Transactions that were refused or dropped because their source was over its budget.",
            lambda: parts.intake.dropped_count,
        ),
        "blockrobot_rounds_timed_out_total": (
            "Rounds that this node gave up since its start.",
            lambda: parts.engine.rounds_timed_out_count,
        ),
        **parts.executor.quarantine.gauges(),
        "blockrobot_signing": (
            "1 while the node takes part.",
            lambda: float(parts.engine.is_signing and parts.core.lockout is None),
        ),
        "blockrobot_time_seconds": (
            "The node's clock, in Unix time.",
            lambda: parts.surroundings.clock.now_ms() / 1000,
        ),
        **({} if parts.custody is None else {"blockrobot_custody_behind_blocks": _lag_of(parts, parts.custody)}),
    }


def _lag_of(parts: NodeComponents, custody: CustodyCoordinator) -> tuple[str, Callable[[], float]]:
    def read() -> float:
        followed = -1 if custody.checkpoint_height is None else custody.checkpoint_height
        return max(0, parts.feed.height - followed)

    return "Final blocks that the custodian has not followed yet.", read
