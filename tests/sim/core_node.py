"""One simulated node: a production core, and a driver around it that does what `consensus/README.md` asks of one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

from consensus.chain.block import Block, EpochProof, FinalityProof, Header, QuorumCertificate, certificate_of
from consensus.chain.messages import CertificateNotice, LastSignedRequest, LastSignedResponse, Proposal, Timeout, Vote
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
from tests.sim.core_store import CoreStore, Stored
from tests.sim.named_chain import CHAIN_ID, build_block, execute, find_next_epoch, hash_next_epoch, txid_of

if TYPE_CHECKING:
    from tests.sim.core_cluster import Cluster

SYNC_GAP_BLOCKS = 40
FETCH_MAX_BLOCKS = 16


def epoch_of(message: Message) -> int:
    """Return the epoch that a message names."""
    match message:
        case Proposal(block=block):
            return block.header.epoch
        case CertificateNotice(qc=qc):
            return qc.epoch
        case _:
            return message.epoch


class SimNode:
    """One node: a core, and what the driver around it does. It goes by its number; the core by the schedule's index."""

    def __init__(self, cluster: Cluster, number: int) -> None:
        self.cluster, self.number = cluster, number
        self.key = cluster.keys[number] if number < len(cluster.keys) else None
        self.journal: list[bytes] = []
        self.store = CoreStore(cluster.genesis, cluster.genesis_qc, cluster.first_epoch)
        self.mempool: dict[bytes, bytes] = {}
        self.final_txids: set[bytes] = set()
        self.life = 0
        self.is_up = False
        self.finalized_at_ms: dict[bytes, float] = {}
        self.core: Core

    @property
    def height(self) -> int:
        return self.core.finalized.height

    # Living and dying

    def start(self) -> None:
        """Open the store and the journal, as after a crash."""
        self.is_up = True
        self.store.lose_unsynced()
        self.final_txids = {txid_of(wire) for stored in self.store.synced for wire in stored.block.transactions}
        self.begin()

    def begin(self, before: Core | None = None) -> None:
        """Make the core of the epoch that the synced store is in (R24), after the one that ended."""
        self.life += 1
        self.queue: deque[Effect] = deque()
        self.is_persisting = False
        self.is_store_syncing = False
        self.timers: dict[str, int] = {}
        self.told_pending = False
        self.epoch = self.store.epoch
        self.core = Core(
            self.epoch.settings,
            CHAIN_ID,
            self.store.schedule,
            self.key,
            finalized=self.store.head,
            finalized_qc=self.store.head_qc,
            round_zero_id=self.store.round_zero_id,
            journal=self.journal,
            check=self.cluster.check,
            before=before,
        )
        others = {self.cluster.number_of(key) for key in self.epoch.producers} - {self.number}
        self.unheard = others if self.epoch.number else set()
        self.handle(Started(now_ms=self.cluster.now_ms))
        self.tell_work()
        self.announce()

    def crash(self) -> None:
        """Lose everything that is not on the disk."""
        self.life += 1
        self.is_up = False

    def start_if_down(self) -> None:
        if not self.is_up:
            self.start()
            self.cluster.reconnect(self.number)

    def later(self, delay: float, action: Callable[[], None]) -> None:
        """Do something after a delay, if this life of the node, or of its core, still goes on then."""
        life = self.life
        self.cluster.at(self.cluster.clock + delay, lambda: action() if self.life == life else None)

    # The core

    def handle(self, event: Event) -> None:
        self.queue.extend(self.core.handle(event))
        self.drain()

    def drain(self) -> None:
        """Carry effects out in order; stop at a Persist until it is synced. With none left, an ended core is replaced."""
        while self.queue and not self.is_persisting and self.is_up:
            effect = self.queue.popleft()
            if isinstance(effect, Persist):
                self.is_persisting = True
                self.later(self.cluster.random.uniform(0.05, 1.0), lambda records=effect.records: self.synced(records))
            else:
                self.carry_out(effect)
        if self.is_up and not self.queue and not self.is_persisting and self.store.epoch.number > self.epoch.number:
            self.begin(self.core)
            self.journal[:] = self.core.journal_snapshot()

    def synced(self, records: tuple[bytes, ...]) -> None:
        self.journal.extend(records)
        self.is_persisting = False
        if self.cluster.crash_after_sync > 0 and self.cluster.random.random() < self.cluster.crash_after_sync:
            self.crash()
            self.cluster.at(self.cluster.clock + self.cluster.random.uniform(50, 1500), self.start_if_down)
            return
        self.drain()

    def carry_out(self, effect: Effect) -> None:
        match effect:
            case Broadcast(message=message):
                for peer in range(len(self.cluster.nodes)):
                    self.send(peer, message)
            case SendTo(index=index, message=message):
                self.send(self.number_of(index), message)
            case ExecuteBlock(block=block):
                self.later(self.cluster.execution_ms, lambda: self.executed(block))
            case BuildBlock():
                self.later(self.cluster.execution_ms, lambda: self.build(effect))
            case CommitBlocks(blocks=blocks, proof=proof):
                self.commit(blocks, proof)
            case FetchBlocks(block_id=block_id, above_height=above, producers=producers):
                assert producers or len(self.epoch.producers) == 1
                peer = self.cluster.nodes[self.number_of(self.cluster.random.choice(producers))]
                self.cluster.transmit(self.number, peer.number, lambda: peer.serve(self.number, block_id, above))
            case SetTimer(kind=kind, round=round_number, delay_ms=delay_ms):
                self.timers[kind] = token = self.timers.get(kind, 0) + 1
                self.later(delay_ms, lambda: self.fire(kind, round_number, token))
            case CancelTimer(kind=kind):
                self.timers[kind] = self.timers.get(kind, 0) + 1
            case BlockCertified():
                self.later(0, self.tell_work)
            case EvidenceFound(evidence=evidence):
                self.cluster.evidence.append((self.number, evidence))
            case LockoutChanged():
                pass
            case Halt(reason=reason):
                self.cluster.halts.append((self.number, reason))

    def fire(self, kind: str, round_number: int, token: int) -> None:
        if self.timers.get(kind) == token:
            self.handle(TimerFired(kind=kind, round=round_number, now_ms=self.cluster.now_ms))

    # Peers

    def number_of(self, index: int) -> int:
        """Return the number of the node behind an index of this epoch's schedule."""
        return self.cluster.number_of(self.epoch.producers[index])

    def index_of(self, number: int) -> int | None:
        """Return the index of a node in this epoch's schedule."""
        key = self.cluster.nodes[number].key
        return None if key is None else self.store.schedule.index_of(key.public_key)

    def send(self, peer: int, message: Message) -> None:
        if peer == self.number:
            return
        if not (isinstance(message, Proposal) and message.block.header.producer != self.index_of(self.number)):
            self.cluster.violations.check_message(self.number, message)  # another's block it may show (R39), also two
        self.cluster.messages += 1
        self.cluster.transmit(self.number, peer, lambda: self.cluster.nodes[peer].receive(self.number, message))
        if isinstance(message, Timeout):
            pending = list(self.mempool.values())
            if pending:
                self.cluster.transmit(self.number, peer, lambda: self.cluster.nodes[peer].submit(*pending))

    def receive(self, sender: int, message: Message) -> None:
        """R25: only messages of this epoch are the core's."""
        if not self.is_up:
            return
        if epoch_of(message) < self.epoch.number:
            self.tell_epoch(sender)
        elif epoch_of(message) > self.epoch.number:
            self.ask_sync(sender)
        else:
            self.note_heard(sender)
            self.handle(self.event_of(sender, message))

    def event_of(self, sender: int, message: Message) -> Event:
        now = self.cluster.now_ms
        match message:
            case Vote():
                return VoteReceived(vote=message, now_ms=now, sender=self.index_of(sender))
            case Proposal():
                return ProposalReceived(proposal=message, sender=self.index_of(sender), now_ms=now)
            case Timeout():
                return TimeoutReceived(timeout=message, sender=self.index_of(sender), now_ms=now)
            case CertificateNotice():
                return NoticeReceived(notice=message, now_ms=now)
            case LastSignedRequest():
                return LastSignedRequested(request=message, sender=self.index_of(sender), now_ms=now)
            case LastSignedResponse():
                return LastSignedReceived(answer=message, sender=self.index_of(sender), now_ms=now)

    def connected(self, peer: int) -> None:
        """The connection to a peer came up; followers are no business of the core's."""
        index = self.index_of(peer)
        if self.is_up and index is not None:
            self.handle(PeerConnected(index=index, now_ms=self.cluster.now_ms))

    # From epoch to epoch

    def announce(self) -> None:
        """Tell every producer of this epoch how it began, until each has spoken in it."""
        for peer in sorted(self.unheard):
            self.tell_epoch(peer)
        if self.unheard:
            self.later(self.epoch.settings.base_timeout_ms, self.announce)

    def note_heard(self, sender: int) -> None:
        if sender in self.unheard:
            self.unheard.discard(sender)
            self.connected(sender)

    def tell_epoch(self, peer: int) -> None:
        number, node = self.epoch.number, self.cluster.nodes[peer]
        self.cluster.transmit(self.number, peer, lambda: node.told_of_epoch(self.number, number))

    def told_of_epoch(self, sender: int, number: int) -> None:
        """A peer is in this epoch: catch up, or show it that one is there too."""
        if self.is_up and number > self.epoch.number:
            self.ask_sync(sender)
        elif self.is_up and number == self.epoch.number:
            self.connected(sender)

    def ask_sync(self, peer: int) -> None:
        above, node = self.store.head.header.height, self.cluster.nodes[peer]
        self.cluster.transmit(self.number, peer, lambda: node.serve_sync(self.number, above))

    def serve_sync(self, asker: int, above: int) -> None:
        """Send finalized blocks, up to the first boundary, with its proof."""
        if self.is_up:
            run, proof = self.store.run_above(above)
            peer = self.cluster.nodes[asker]
            self.cluster.transmit(self.number, asker, lambda: peer.install(self.number, run, proof))

    # Transactions and blocks

    def submit(self, *wires: bytes) -> None:
        """Take transactions from a client or peer."""
        if self.is_up:
            for wire in wires:
                if txid_of(wire) not in self.final_txids:
                    self.mempool[txid_of(wire)] = wire
            self.tell_work()

    def txids_of_branch(self, block_id: bytes) -> set[bytes]:
        """Return the transactions that are final or in the branch that ends with this block."""
        branch = self.core.branch(block_id, self.core.finalized.height)
        return self.final_txids | {txid_of(wire) for block in branch for wire in block.transactions}

    def tell_work(self) -> None:
        certified = self.core.certified_branch()
        known = self.txids_of_branch(certified[-1]) if certified else self.final_txids
        pending = any(txid not in known for txid in self.mempool)
        if self.is_up and pending != self.told_pending:
            self.told_pending = pending
            self.handle(WorkChanged(pending=pending, now_ms=self.cluster.now_ms))

    def header_of(self, block_id: bytes) -> Header:
        block = self.core.block(block_id)
        return block.header if block is not None else self.store.block(block_id).header

    def executed(self, block: Block) -> None:
        header = block.header
        if self.core.block(block.block_id) is None:
            return
        parent = self.header_of(header.parent_id)
        root = parent.state_root if header.is_closing else execute(parent, block.transactions)
        known = self.txids_of_branch(header.parent_id)
        valid = (
            root == header.state_root
            and not any(txid_of(wire) in known for wire in block.transactions)
            and header.next_schedule_hash == hash_next_epoch(self.epoch, block.transactions)
        )
        self.handle(BlockExecuted(block_id=block.block_id, valid=valid, now_ms=self.cluster.now_ms))

    def build(self, order: BuildBlock) -> None:
        if self.core.block(order.parent_id) is None and order.parent_id != self.core.finalized_id:
            return
        assert self.key is not None
        known = self.txids_of_branch(order.parent_id)
        fresh = [wire for txid, wire in self.mempool.items() if txid not in known]
        transactions = () if order.empty else tuple(fresh[:8])
        next_hash = hash_next_epoch(self.epoch, transactions)
        parent = self.header_of(order.parent_id)
        block = build_block(order, parent, transactions, self.key, self.cluster.now_ms, next_hash)
        self.handle(BlockBuilt(round=order.round, block=block, now_ms=self.cluster.now_ms))

    # Finality

    def commit(self, blocks: tuple[Block, ...], proof: FinalityProof) -> None:
        assert proof.header_bytes == blocks[-1].header_bytes
        following = find_next_epoch(self.epoch, blocks[-1].transactions)
        assert self.core.has_ended == (following is not None)
        epoch_proof = None if following is None else EpochProof(finality=proof, epoch=following)
        qcs = [block.header.qc for block in blocks[1:]] + [certificate_of(proof)]
        for place, (block, qc) in enumerate(zip(blocks, qcs, strict=True)):
            assert block.header.height == self.store.newest.header.height + 1
            self.cluster.violations.check_final(block.header, block.block_id)
            for wire in block.transactions:
                assert txid_of(wire) not in self.final_txids, "a transaction is final twice"
            self.note_final(block)
            self.store.add(Stored(block, qc, epoch_proof if place == len(blocks) - 1 else None))
        self.later(0, self.tell_work)
        self.sync_store()

    def note_final(self, block: Block) -> None:
        for wire in block.transactions:
            txid = txid_of(wire)
            self.final_txids.add(txid)
            self.finalized_at_ms.setdefault(txid, self.cluster.clock)
            self.mempool.pop(txid, None)

    def sync_store(self) -> None:
        """Begin to sync what the store has taken so far; what comes meanwhile waits for the next sync."""
        if self.store.unsynced and not self.is_store_syncing:
            self.is_store_syncing = True
            newest = self.store.newest.header
            slowest = 20 if newest.is_boundary else 400
            self.later(self.cluster.random.uniform(5, slowest), lambda: self.store_synced(newest.height))

    def store_synced(self, height: int) -> None:
        """The store synced up to a height: the journal may be cut."""
        self.is_store_syncing = False
        self.store.sync(height)
        self.sync_store()
        self.core.forget_journalled(self.store.head.header.height)
        self.journal[:] = self.core.journal_snapshot()
        self.drain()

    # Missing blocks

    def serve(self, asker: int, block_id: bytes, above: int) -> None:
        """Answer a peer that misses blocks; a peer that is far behind, or in an earlier epoch, gets finalized blocks."""
        if not self.is_up:
            return
        finalized = self.store.everything
        peer = self.cluster.nodes[asker]
        is_ended = any(stored.block.header.height > above and stored.epoch_proof for stored in finalized)
        if finalized[-1].block.header.height > above + SYNC_GAP_BLOCKS or (
            is_ended and self.core.block(block_id) is None
        ):
            self.serve_sync(asker, above)
            return
        blocks = {stored.block.block_id: stored.block for stored in finalized if stored.block.header.height > above}
        blocks |= {block.block_id: block for block in self.core.branch(block_id, above)}
        if block_id in blocks:
            answer = tuple(blocks.values())[:FETCH_MAX_BLOCKS]
            self.cluster.transmit(self.number, asker, lambda: peer.fetched(answer))

    def fetched(self, blocks: tuple[Block, ...]) -> None:
        if self.is_up:
            self.handle(BlocksFetched(blocks=blocks, now_ms=self.cluster.now_ms))

    def install(self, sender: int, run: list[tuple[Block, QuorumCertificate]], proof: EpochProof | None) -> None:
        """Sync: store finalized blocks durably, then tell the core, or go on in the next epoch."""
        if not self.is_up or self.is_persisting or self.queue:
            return
        self.store.sync(self.store.newest.header.height)
        head = self.store.head
        fresh = [entry for entry in run if entry[0].header.height > head.header.height]
        if not fresh or fresh[0][0].header.parent_id != head.block_id or self.store.epoch.number > self.epoch.number:
            self.drain()
            return
        for block, qc in fresh:
            self.cluster.violations.check_final(block.header, block.block_id)
            self.note_final(block)
            self.store.add(Stored(block, qc, proof if block is fresh[-1][0] else None))
        self.store.sync(self.store.newest.header.height)
        self.cluster.syncs += 1
        if proof is None:
            head_block, head_qc = fresh[-1]
            self.handle(FinalizedElsewhere(head=head_block, qc=head_qc, now_ms=self.cluster.now_ms))
            self.tell_work()
        else:
            self.drain()
            self.ask_sync(sender)
