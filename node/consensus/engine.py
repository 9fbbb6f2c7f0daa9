"""Drives the consensus core, executing its effects in order.

Nothing is sent before its record is synced.
"""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import structlog

from consensus.chain.block import EpochProof, FinalityProof, certificate_of, genesis_certificate
from consensus.chain.evidence import Evidence
from consensus.chain.messages import Timeout
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.protocol.core import Core
from consensus.protocol.effects import (
    BlockCertified,
    Broadcast,
    BuildBlock,
    CancelTimer,
    CommitBlocks,
    Effect,
    EvidenceFound,
    ExecuteBlock,
    FetchBlocks,
    Halt,
    LockoutChanged,
    Message,
    Persist,
    ProposalLost,
    SendTo,
    SetTimer,
)
from consensus.protocol.events import (
    BlockBuilt,
    BlockExecuted,
    BlocksFetched,
    Event,
    FinalizedElsewhere,
    LastSignedReceived,
    LastSignedRequested,
    NoticeReceived,
    PeerConnected,
    ProposalReceived,
    Started,
    TimeoutReceived,
    TimerFired,
    VoteReceived,
    WorkChanged,
)
from contracts.execution.results import ExecutionFault
from node.consensus.epoch_change import EpochStart, Head
from node.consensus.journal_writer import JournalWriter, VotingJournal
from node.execution.block_executor import ExecutedBlock, Executor
from node.mempool.mempool import Mempool
from node.storage.ledger_store import LedgerSnapshot, Position

INLINE_TRANSACTIONS_MAX_COUNT = 24
DRAIN_MAX_MS = 20
_PATIENCE_TURNS = 2
_JOURNAL = "journal"
_RETRANSMITTED_EVENTS = (
    VoteReceived,
    ProposalReceived,
    TimeoutReceived,
    NoticeReceived,
    BlocksFetched,
    LastSignedRequested,
    LastSignedReceived,
    PeerConnected,
)
"""What a node that stands still need not keep: its peers say it again, or it is asked for again."""

log = structlog.get_logger(__name__)


class Outbox(Protocol):
    """Where the core's messages go."""

    def broadcast(self, message: Message) -> None: ...

    def send_to(self, index: int, message: Message) -> None: ...

    def fetch(self, effect: FetchBlocks) -> None:
        """The answer arrives as `BlocksFetched`."""
        ...

    def gossip_again(self) -> None: ...


class FinalizedSink(Protocol):
    """Where finalized blocks go."""

    def store(self, blocks: list[ExecutedBlock], proof: FinalityProof) -> None: ...


CoreFactory = Callable[[Head, Core], Core]
"""Makes the core of the epoch that a head begins, after the core of the epoch before."""
EpochListener = Callable[[EpochStart], None]
EvidenceListener = Callable[[Evidence], None]
UnseenListener = Callable[[int, Sequence[Transaction]], None]
"""Hears the time of a final block, in ms since 1970, and which of its transactions never waited here."""


class Engine:
    """One node's consensus: one core after another, each for one epoch."""

    def __init__(
        self,
        *,
        core: Core,
        start: EpochStart,
        make_core: CoreFactory,
        executor: Executor,
        mempool: Mempool,
        journal: VotingJournal,
        sink: FinalizedSink,
        clock: Callable[[], int],
        stopwatch: Callable[[], float] = time.perf_counter,
    ) -> None:
        """`core` is in the epoch of `start`; `make_core` makes the next ones.

        `clock`: ms since 1970; `stopwatch`: monotonic seconds, also within a callback.
        """
        self.core = core
        self.epoch = start
        self._make_core = make_core
        self._epoch_listeners: list[EpochListener] = []
        self._evidence_listeners: list[EvidenceListener] = []
        self._unseen_listeners: list[UnseenListener] = []
        self._executor = executor
        self._mempool = mempool
        self._outages: dict[str, str] = {}
        self._journal_writer = JournalWriter(
            journal,
            stopwatch=stopwatch,
            snapshot=self._snapshot_of_core,
            on_outage=partial(self.pause, _JOURNAL),
            on_recovery=partial(self.resume, _JOURNAL),
        )
        self._sink = sink
        self._clock = clock
        self._stopwatch = stopwatch
        self._outbox: Outbox | None = None
        self._loop = asyncio.get_running_loop()
        self._events: deque[Event | Callable[[], None]] = deque()
        self._effects: deque[Effect] = deque()
        self._timers: dict[str, asyncio.TimerHandle] = {}
        self._draining = False
        self._waiting: asyncio.Future[Event | None] | None = None
        self._stopped = False
        self._pending = False
        self._is_work_noted = False
        self._branch: dict[bytes, frozenset[bytes]] = {}
        self._branch_txids: frozenset[bytes] = frozenset()
        self._unstored: dict[bytes, frozenset[bytes]] = {}
        self.rounds_timed_out_count = 0
        self._timed_out = (-1, -1)

    def start(self, outbox: Outbox) -> None:
        self._outbox = outbox
        self._journal_writer.start(self._executor.thread)
        self.submit(Started(now_ms=self._clock()))

    def add_epoch_listener(self, listener: EpochListener) -> None:
        """Called at each epoch's start, before its first event."""
        self._epoch_listeners.append(listener)

    def add_evidence_listener(self, listener: EvidenceListener) -> None:
        self._evidence_listeners.append(listener)

    def add_unseen_listener(self, listener: UnseenListener) -> None:
        self._unseen_listeners.append(listener)

    async def stop(self) -> None:
        self._stopped = True
        for handle in self._timers.values():
            handle.cancel()
        await self._journal_writer.stop()
        await self.stop_waiting()

    async def stop_waiting(self) -> None:
        while self._waiting is not None:
            await asyncio.wait([self._waiting])
            await asyncio.sleep(0)

    @property
    def is_signing(self) -> bool:
        """Neither halted nor unable to write."""
        return not self.core.halted and not self.fault

    # Events

    def submit(self, event: Event) -> None:
        """Queue an event for the core; during an outage recurring ones are dropped."""
        if self._outages and isinstance(event, _RETRANSMITTED_EVENTS):
            return
        self._events.append(event)
        self._drain()

    def call_between_events(self, action: Callable[[], None]) -> None:
        """With no block executing."""
        self._events.append(action)
        self._drain()

    def _drain(self) -> None:
        if self._draining or self._waiting is not None or self._stopped:
            return
        self._draining = True
        deadline = self._stopwatch() + DRAIN_MAX_MS / 1000
        try:
            while self._waiting is None and not self._outages:
                if self._effects:
                    self._execute_effect(self._effects.popleft())
                elif self._events:
                    if self._stopwatch() > deadline:
                        self._loop.call_soon(self._drain)
                        break
                    self._take(self._events.popleft())
                else:
                    break
        finally:
            self._draining = False

    def _take(self, event: Event | Callable[[], None]) -> None:
        if callable(event):
            event()
            return
        self._effects.extend(self.core.handle(event))

    # Effects

    def _execute_effect(self, effect: Effect) -> None:  # noqa: PLR0912 - one line for each effect
        outbox = self._outbox
        if outbox is None:
            raise AssertionError("the engine has not been started")
        match effect:
            case Persist(records=records):
                self._persist(records)
            case Broadcast(message=message):
                outbox.broadcast(message)
                if isinstance(message, Timeout):
                    self._count_timed_out(message)
                    outbox.gossip_again()
            case SendTo(index=index, message=message):
                outbox.send_to(index, message)
            case ExecuteBlock():
                self._execute(effect)
            case BuildBlock():
                self._build(effect)
            case CommitBlocks():
                self._commit(effect)
            case FetchBlocks():
                outbox.fetch(effect)
            case SetTimer(kind=kind, round=round_number, delay_ms=delay_ms):
                self._set_timer(kind, round_number, delay_ms)
            case CancelTimer(kind=kind):
                self._cancel_timer(kind)
            case BlockCertified(block_id=block_id):
                self._note_certified(block_id)
            case ProposalLost(block_id=block_id):
                self._executor.note_lost(block_id)
            case EvidenceFound(evidence=evidence):
                self._show_evidence(evidence)
            case LockoutChanged(reason=reason, until=until):
                log.warning("producer_locked_out" if reason else "producer_signs_again", reason=reason, until=until)
            case Halt(reason=reason):
                log.critical("halted", reason=reason)

    def _show_evidence(self, evidence: Evidence) -> None:
        producer = evidence.producer.hex()
        log.warning("evidence_found", kind=evidence.kind, producer=producer, epoch=evidence.epoch, round=evidence.round)
        for listener in self._evidence_listeners:
            listener(evidence)

    def _count_timed_out(self, timeout: Timeout) -> None:
        place = (timeout.epoch, timeout.round)
        if place > self._timed_out:
            self._timed_out = place
            self.rounds_timed_out_count += 1

    def _persist(self, records: tuple[bytes, ...]) -> None:
        if not self._journal_writer.append(records):
            return
        if self._journal_writer.is_fast:
            self._journal_writer.sync()
            self._journal_writer.complete_sync()
        else:
            self._run_in_thread(self._journal_writer.sync)

    # Executing

    def _execute(self, effect: ExecuteBlock) -> None:
        if self._is_quick(effect.block.transactions):
            self._events.append(self._verify(effect))
        else:
            self._run_in_thread(lambda: self._verify(effect))

    def _is_quick(self, transactions: Sequence[object]) -> bool:
        return not self._executor.waits and len(transactions) <= INLINE_TRANSACTIONS_MAX_COUNT

    def _run_in_thread(self, work: Callable[[], Event | None]) -> None:
        future: asyncio.Future[Event | None] = self._loop.run_in_executor(self._executor.thread, work)
        self._waiting = future
        future.add_done_callback(self._resume)

    def _resume(self, future: asyncio.Future[Event | None]) -> None:
        self._waiting = None
        if future.cancelled() or self._stopped:
            return
        event = future.result()
        self._journal_writer.complete_sync()
        if event is not None:
            self._events.appendleft(event)
        self._drain()

    def _verify(self, effect: ExecuteBlock) -> Event:
        block_id = effect.block.block_id
        valid, fault, withheld = True, False, False
        try:
            withheld = self._executor.verify(effect.block, certified=effect.certified).withheld
        except BlockRobotError as error:
            log.warning("block_refused", block=block_id.hex(), code=error.code, detail=error.detail)
            valid, fault = (
                False,
                error.code.startswith("STORAGE_"),
            )  # the node's own ledger says nothing about the block
        except ExecutionFault as error:
            log.error("block_not_executed", block=block_id.hex(), certified=effect.certified, reason=error.reason)
            valid, fault = False, True
        except Exception:
            log.exception("block_execution_fault", block=block_id.hex())
            valid, fault = False, True
        return BlockExecuted(block_id, valid=valid, fault=fault, withheld=withheld, now_ms=self._clock())

    def _build(self, effect: BuildBlock) -> None:
        timestamp_ms = max(effect.parent_timestamp_ms + 1, self._clock())
        transactions = [] if effect.empty else self._executor.choose(self._mempool, effect.parent_id, timestamp_ms)
        if self._is_quick(transactions):
            self._events.append(self._built(effect, timestamp_ms, transactions))
        else:
            self._run_in_thread(lambda: self._built(effect, timestamp_ms, transactions))

    def _built(self, effect: BuildBlock, timestamp_ms: int, transactions: list[Transaction]) -> Event:
        try:
            executed, _ = self._executor.build(effect, timestamp_ms, transactions)
        except Exception:
            log.exception("block_building_fault", round=effect.round)
            return BlockBuilt(round=effect.round, block=None, now_ms=self._clock())
        return BlockBuilt(round=effect.round, block=executed.block, now_ms=self._clock())

    def _commit(self, effect: CommitBlocks) -> None:
        executed = [self._executor.executed(block.block_id) for block in effect.blocks]
        unseen = [
            (item.header.timestamp_ms, [one for one in item.transactions if one.txid not in self._mempool])
            for item in executed
        ]
        for item in executed:
            self._mempool.remove(item.txids)
            self._unstored[item.block_id] = item.txids
        self._refresh_branch()
        self._sink.store(executed, effect.proof)
        for listener in self._unseen_listeners:
            for time_ms, transactions in unseen:
                if transactions:
                    listener(time_ms, transactions)

    # The mempool's view of the branch

    def _note_certified(self, block_id: bytes) -> None:
        block = self.core.block(block_id)
        if block is None:
            return
        executed = self._executor.find(block_id)
        self._mempool.note_block(is_roomy=executed is not None and executed.is_roomy)
        self._refresh_branch()

    def _refresh_branch(self) -> None:
        branch: dict[bytes, frozenset[bytes]] = {}
        for block_id in self.core.certified_branch():
            known = self._branch.get(block_id)
            if known is None:
                executed = self._executor.find(block_id)
                known = frozenset() if executed is None else executed.txids
            if known:
                branch[block_id] = known
        self._branch = branch
        self._branch_txids = frozenset().union(*branch.values()) if branch else frozenset()
        self.note_work()

    def is_on_branch(self, txid: bytes) -> bool:
        """Return whether a certified, not yet stored block has this transaction."""
        return txid in self._branch_txids or any(txid in txids for txids in self._unstored.values())

    def note_stored(
        self,
        blocks: list[ExecutedBlock],
        proof: FinalityProof,
        position: Position,
        stored: LedgerSnapshot | None = None,
    ) -> None:
        """Take note that the ledger is stored up to this position. Only between events.

        Takes over `stored`, the ledger at this position.
        """
        head = blocks[-1]
        if head.header.height > self.core.finalized.height and head.next_epoch is None:
            self._take(FinalizedElsewhere(head=head.block, qc=certificate_of(proof), now_ms=self._clock()))
        self._executor.move_base(stored)
        self.core.forget_journalled(position.height)
        self._unstored = {
            block_id: txids for block_id, txids in self._unstored.items() if self._executor.find(block_id) is not None
        }
        for block in blocks:
            self._mempool.remove(block.txids)
        if head.next_epoch is None:
            self._journal_writer.compact()
        else:
            proof_bytes = encode(EpochProof(finality=proof, epoch=head.next_epoch))
            self._begin_epoch(EpochStart(head.next_epoch, head.block_id, proof_bytes), head)

    def _begin_epoch(self, start: EpochStart, boundary: ExecutedBlock) -> None:
        """Replace the core for a new epoch; the old one's messages are dropped."""
        for kind in list(self._timers):
            self._cancel_timer(kind)
        self._effects.clear()
        self._events = deque(event for event in self._events if callable(event))
        qc = genesis_certificate(start.round_zero_id, start.number)
        self.core, self.epoch = self._make_core(Head(start, boundary.block, qc), self.core), start
        self._executor.begin_epoch(start.schedule)
        self._branch, self._branch_txids, self._unstored = {}, frozenset(), {}
        self._pending = False
        self._journal_writer.rewrite()
        log.info("epoch_begun", epoch=start.number, height=boundary.header.height, producers=len(start.epoch.producers))
        self.submit(Started(now_ms=self._clock()))
        for listener in self._epoch_listeners:
            listener(start)
        self.note_work()

    # Disks that refuse

    def _snapshot_of_core(self) -> tuple[bytes, ...]:
        return self.core.journal_snapshot()

    @property
    def fault(self) -> str:
        """Return why the node cannot write, or ""."""
        return " ".join(self._outages.values())

    def pause(self, disk: str, reason: str) -> None:
        """R38: stop signing while this disk refuses writes; keep pending work."""
        self._outages[disk] = reason
        log.critical("node_cannot_write", disk=disk, reason=reason)

    def resume(self, disk: str) -> None:
        if self._outages.pop(disk, None) is not None and not self._outages:
            log.warning("disk_recovered", disk=disk)
            self.note_work()
            self._drain()

    def note_work(self) -> None:
        """Once what the core has ordered is done: between a certificate and its commit a final call would count as work."""
        if not self._is_work_noted:
            self._is_work_noted = True
            self.call_between_events(self._tell_work)

    def _tell_work(self) -> None:
        self._is_work_noted = False
        patience = _PATIENCE_TURNS * len(self._executor.schedule.producers)
        pending = self._mempool.has_work(self._branch_txids | self._executor.quarantine.held(), patience)
        if pending != self._pending:
            self._pending = pending
            self._take(WorkChanged(pending=pending, now_ms=self._clock()))

    # Timers

    def _set_timer(self, kind: str, round_number: int, delay_ms: int) -> None:
        self._cancel_timer(kind)
        self._timers[kind] = self._loop.call_later(delay_ms / 1000, self._fire, kind, round_number)

    def _cancel_timer(self, kind: str) -> None:
        handle = self._timers.pop(kind, None)
        if handle is not None:
            handle.cancel()

    def _fire(self, kind: str, round_number: int) -> None:
        self._timers.pop(kind, None)
        self.submit(TimerFired(kind=kind, round=round_number, now_ms=self._clock()))
