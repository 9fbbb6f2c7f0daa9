"""Production cores of n nodes on a virtual clock, network and disk: one seed, one history.

What is faked is the outside only: an executor that hashes transactions, a journal whose records are safe once synced, a
store that syncs later, links that delay, lose, double and cut. Every promise that a node sends is checked as it leaves.
"""

from __future__ import annotations

import heapq
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from consensus.block import (
    Block,
    Header,
    QuorumCertificate,
    genesis_certificate,
)
from consensus.core import Core
from consensus.effects import (
    BlockCertified,
    Broadcast,
    BuildBlock,
    CancelTimer,
    CommitBlocks,
    Effect,
    ExecuteBlock,
    FetchBlocks,
    Halt,
    Message,
    Persist,
    SendTo,
    SetTimer,
)
from consensus.events import (
    BlockBuilt,
    BlockExecuted,
    BlocksFetched,
    Event,
    FinalizedElsewhere,
    NoticeReceived,
    PeerConnected,
    ProposalReceived,
    Started,
    TimeoutReceived,
    TimerFired,
    VoteReceived,
    WorkChanged,
)
from consensus.genesis import ChainSettings
from consensus.messages import CertificateNotice, Proposal, Timeout, Vote
from consensus.primitives.encoding import decode
from consensus.schedule import Schedule
from consensus.signature_cache import SignatureCache
from tests.sim.named_chain import (
    CHAIN_ID,
    EPOCH_START_MS,
    build_block,
    execute,
    make_genesis_block,
    make_keys,
    make_transaction,
    txid_of,
)

SYNC_GAP_BLOCKS = 40
FETCH_MAX_BLOCKS = 16


@dataclass
class Links:
    """How the network behaves. Delays are in ms."""

    delay_min: float = 5
    delay_max: float = 50
    loss: float = 0.0
    duplicates: float = 0.0
    groups: list[set[int]] = field(default_factory=list)

    def connects(self, first: int, second: int) -> bool:
        return not self.groups or any(first in group and second in group for group in self.groups)


@dataclass
class Violations:
    """What must never happen, checked over the whole history."""

    final: dict[int, bytes] = field(default_factory=dict)
    proposals: dict[tuple[int, int], bytes] = field(default_factory=dict)
    votes: dict[tuple[int, int], bytes] = field(default_factory=dict)
    timeouts: dict[tuple[int, int], bytes] = field(default_factory=dict)

    def check_final(self, header: Header, block_id: bytes) -> None:
        known = self.final.setdefault(header.height, block_id)
        assert known == block_id, f"two blocks are final at height {header.height}"

    def check_message(self, sender: int, message: Message) -> None:
        """No two votes, timeouts or proposals of one round, and no new vote after a timeout of the round."""
        if isinstance(message, Vote):
            place = (sender, message.round)
            assert place in self.votes or place not in self.timeouts, f"{place} voted after a timeout"
            assert self.votes.setdefault(place, message.block_id) == message.block_id, f"{place} voted twice"
        elif isinstance(message, Timeout):
            place = (sender, message.round)
            assert self.timeouts.setdefault(place, message.signature) == message.signature, f"{place} changed a timeout"
        elif isinstance(message, Proposal) and message.block.header.producer == sender:
            place = (sender, message.block.header.round)
            block_id = message.block.block_id
            assert self.proposals.setdefault(place, block_id) == block_id, f"{place} proposed twice"


class SimNode:
    """One node: a core, and what the driver around it does."""

    def __init__(self, cluster: Cluster, index: int) -> None:
        self.cluster, self.index = cluster, index
        self.journal: list[bytes] = []
        self.stored: list[tuple[Block, QuorumCertificate]] = [(cluster.genesis, cluster.genesis_qc)]
        self.unsynced: list[tuple[Block, QuorumCertificate]] = []
        self.mempool: dict[bytes, bytes] = {}
        self.final_txids: set[bytes] = set()
        self.life = 0
        self.is_up = False
        self.finalized_at_ms: dict[bytes, float] = {}
        self.core: Core

    @property
    def height(self) -> int:
        return self.core.finalized.height

    def start(self) -> None:
        """Open the store and the journal, as after a crash."""
        self.life += 1
        self.is_up = True
        self.unsynced = []
        self.queue: deque[Effect] = deque()
        self.is_syncing = False
        self.is_store_syncing = False
        self.timers: dict[str, int] = {}
        self.told_pending = False
        head, qc = self.stored[-1]
        self.final_txids = {txid_of(wire) for block, _ in self.stored for wire in block.transactions}
        self.core = Core(
            self.cluster.settings,
            CHAIN_ID,
            self.cluster.schedule,
            self.cluster.keys[self.index] if self.index < len(self.cluster.keys) else None,
            finalized=head,
            finalized_qc=qc,
            round_zero_id=self.cluster.genesis.block_id,
            journal=self.journal,
            check=self.cluster.check,
        )
        self.handle(Started(now_ms=self.cluster.now_ms))
        self.tell_work()

    def crash(self) -> None:
        """Lose everything that is not on the disk."""
        self.life += 1
        self.is_up = False

    def later(self, delay: float, action: Callable[[], None]) -> None:
        """Do something after a delay, if this life of the node still goes on then."""
        life = self.life
        self.cluster.at(self.cluster.clock + delay, lambda: action() if self.life == life else None)

    def handle(self, event: Event) -> None:
        effects = self.core.handle(event)
        self.queue.extend(effects)
        self.drain()

    def drain(self) -> None:
        """Carry effects out in order; stop at a Persist until it is synced."""
        while self.queue and not self.is_syncing and self.is_up:
            effect = self.queue.popleft()
            if isinstance(effect, Persist):
                self.is_syncing = True
                self.later(self.cluster.random.uniform(0.05, 1.0), lambda records=effect.records: self.synced(records))
            else:
                self.carry_out(effect)

    def synced(self, records: tuple[bytes, ...]) -> None:
        self.journal.extend(records)
        self.is_syncing = False
        if self.cluster.crash_after_sync > 0 and self.cluster.random.random() < self.cluster.crash_after_sync:
            self.crash()
            self.cluster.at(self.cluster.clock + self.cluster.random.uniform(50, 1500), self.start_if_down)
            return
        self.drain()

    def start_if_down(self) -> None:
        if not self.is_up:
            self.start()
            self.cluster.reconnect(self.index)

    def carry_out(self, effect: Effect) -> None:
        match effect:
            case Broadcast(message=message):
                for peer in range(len(self.cluster.nodes)):
                    self.send(peer, message)
            case SendTo(index=index, message=message):
                self.send(index, message)
            case ExecuteBlock(block=block):
                self.later(self.cluster.execution_ms, lambda: self.executed(block))
            case BuildBlock():
                self.later(self.cluster.execution_ms, lambda: self.build(effect))
            case CommitBlocks(blocks=blocks, proof=proof):
                self.commit(blocks, decode(proof.child_header_bytes, Header).qc)
            case FetchBlocks(block_id=block_id, above_height=above, producers=producers):
                assert producers or self.cluster.count == 1
                peer = self.cluster.random.choice(producers)
                self.cluster.transmit(
                    self.index, peer, lambda: self.cluster.nodes[peer].serve(self.index, block_id, above)
                )
            case SetTimer(kind=kind, round=round_number, delay_ms=delay_ms):
                self.timers[kind] = token = self.timers.get(kind, 0) + 1
                self.later(delay_ms, lambda: self.fire(kind, round_number, token))
            case CancelTimer(kind=kind):
                self.timers[kind] = self.timers.get(kind, 0) + 1
            case BlockCertified():
                self.later(0, self.tell_work)
            case Halt(reason=reason):
                self.cluster.halts.append((self.index, reason))

    def fire(self, kind: str, round_number: int, token: int) -> None:
        if self.timers.get(kind) == token:
            self.handle(TimerFired(kind=kind, round=round_number, now_ms=self.cluster.now_ms))

    def send(self, peer: int, message: Message) -> None:
        if peer == self.index:
            return
        self.cluster.violations.check_message(self.index, message)
        self.cluster.messages += 1
        self.cluster.transmit(self.index, peer, lambda: self.cluster.nodes[peer].receive(self.index, message))
        if isinstance(message, Timeout):
            pending = list(self.mempool.values())
            if pending:
                self.cluster.transmit(self.index, peer, lambda: self.cluster.nodes[peer].submit(*pending))

    def receive(self, sender: int, message: Message) -> None:
        if not self.is_up:
            return
        now = self.cluster.now_ms
        match message:
            case Vote():
                self.handle(VoteReceived(vote=message, now_ms=now))
            case Proposal():
                self.handle(ProposalReceived(proposal=message, sender=sender, now_ms=now))
            case Timeout():
                self.handle(TimeoutReceived(timeout=message, sender=sender, now_ms=now))
            case CertificateNotice():
                self.handle(NoticeReceived(notice=message, now_ms=now))

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
        return block.header if block is not None else self.stored_block(block_id).header

    def stored_block(self, block_id: bytes) -> Block:
        return next(block for block, _ in reversed([*self.stored, *self.unsynced]) if block.block_id == block_id)

    def executed(self, block: Block) -> None:
        header = block.header
        if self.core.block(block.block_id) is None:
            return
        root = execute(self.header_of(header.parent_id), block.transactions)
        known = self.txids_of_branch(header.parent_id)
        valid = root == header.state_root and not any(txid_of(wire) in known for wire in block.transactions)
        self.handle(BlockExecuted(block_id=block.block_id, valid=valid, now_ms=self.cluster.now_ms))

    def build(self, order: BuildBlock) -> None:
        if self.core.block(order.parent_id) is None and order.parent_id != self.core.finalized_id:
            return
        known = self.txids_of_branch(order.parent_id)
        fresh = [wire for txid, wire in self.mempool.items() if txid not in known]
        transactions = () if order.empty else tuple(fresh[:8])
        key = self.cluster.keys[self.index]
        block = build_block(order, self.header_of(order.parent_id), transactions, key, self.cluster.now_ms)
        self.handle(BlockBuilt(round=order.round, block=block, now_ms=self.cluster.now_ms))

    def commit(self, blocks: tuple[Block, ...], head_qc: QuorumCertificate) -> None:
        qcs = [block.header.qc for block in blocks[1:]] + [head_qc]
        for block, qc in zip(blocks, qcs, strict=True):
            assert block.header.height == [*self.stored, *self.unsynced][-1][0].header.height + 1
            self.cluster.violations.check_final(block.header, block.block_id)
            self.unsynced.append((block, qc))
            for wire in block.transactions:
                txid = txid_of(wire)
                assert txid not in self.final_txids, "a transaction is final twice"
                self.final_txids.add(txid)
                self.finalized_at_ms.setdefault(txid, self.cluster.clock)
                self.mempool.pop(txid, None)
        self.later(0, self.tell_work)
        self.sync_store()

    def sync_store(self) -> None:
        """Begin to sync what the store has taken so far; what comes meanwhile waits for the next sync."""
        if self.unsynced and not self.is_store_syncing:
            self.is_store_syncing = True
            height = self.unsynced[-1][0].header.height
            self.later(self.cluster.random.uniform(20, 400), lambda: self.store_synced(height))

    def store_synced(self, height: int) -> None:
        """The store synced up to a height: the journal may be cut."""
        self.is_store_syncing = False
        self.stored.extend(entry for entry in self.unsynced if entry[0].header.height <= height)
        self.unsynced = [entry for entry in self.unsynced if entry[0].header.height > height]
        self.sync_store()
        self.core.forget_journalled(self.stored[-1][0].header.height)
        self.journal[:] = self.core.journal_snapshot()

    def serve(self, asker: int, block_id: bytes, above: int) -> None:
        """Answer a peer that misses blocks; a peer that is far behind gets finalized blocks."""
        if not self.is_up:
            return
        finalized = [*self.stored, *self.unsynced]
        peer = self.cluster.nodes[asker]
        if finalized[-1][0].header.height > above + SYNC_GAP_BLOCKS:
            chunk = [entry for entry in finalized if entry[0].header.height > above]
            self.cluster.transmit(self.index, asker, lambda: peer.install(chunk))
            return
        blocks = {block.block_id: block for block, _ in finalized if block.header.height > above}
        blocks |= {block.block_id: block for block in self.core.branch(block_id, above)}
        if block_id in blocks:
            answer = tuple(blocks.values())[:FETCH_MAX_BLOCKS]
            self.cluster.transmit(self.index, asker, lambda: peer.fetched(answer))

    def fetched(self, blocks: tuple[Block, ...]) -> None:
        if self.is_up:
            self.handle(BlocksFetched(blocks=blocks, now_ms=self.cluster.now_ms))

    def install(self, chunk: list[tuple[Block, QuorumCertificate]]) -> None:
        """Sync: store finalized blocks durably, then tell the core."""
        if not self.is_up or self.is_syncing or self.queue:
            return
        self.stored.extend(self.unsynced)
        self.unsynced = []
        fresh = [entry for entry in chunk if entry[0].header.height > self.stored[-1][0].header.height]
        if not fresh or fresh[0][0].header.parent_id != self.stored[-1][0].block_id:
            return
        self.stored.extend(fresh)
        for block, _ in fresh:
            for wire in block.transactions:
                self.final_txids.add(txid_of(wire))
                self.finalized_at_ms.setdefault(txid_of(wire), self.cluster.clock)
                self.mempool.pop(txid_of(wire), None)
        head, qc = fresh[-1]
        self.cluster.syncs += 1
        self.handle(FinalizedElsewhere(head=head, qc=qc, now_ms=self.cluster.now_ms))
        self.tell_work()


class Cluster:
    """n nodes, one virtual clock, one source of chance."""

    def __init__(
        self, count: int = 4, seed: int = 0, settings: ChainSettings | None = None, followers: int = 0
    ) -> None:
        self.count = count
        self.random = random.Random(seed)
        self.settings = settings or ChainSettings()
        self.keys = make_keys(count)
        self.schedule = Schedule(0, tuple(key.public_key for key in self.keys), self.settings.blocks_per_turn)
        self.genesis = make_genesis_block()
        self.genesis_qc = genesis_certificate(self.genesis.block_id)
        self.check = SignatureCache(1 << 20)
        self.links = Links()
        self.violations = Violations()
        self.halts: list[tuple[int, str]] = []
        self.clock = 0.0
        self.messages = 0
        self.syncs = 0
        self.execution_ms = 1.0
        self.crash_after_sync = 0.0
        self._heap: list[tuple[float, int, Callable[[], None]]] = []
        self._sequence = 0
        self._transactions = 0
        self.nodes = [SimNode(self, index) for index in range(count + followers)]

    @property
    def now_ms(self) -> int:
        return EPOCH_START_MS + int(self.clock)

    def at(self, time: float, action: Callable[[], None]) -> None:
        self._sequence += 1
        heapq.heappush(self._heap, (time, self._sequence, action))

    def transmit(self, sender: int, receiver: int, action: Callable[[], None]) -> None:
        """Carry something over a link, as the links are when it leaves."""
        links = self.links
        if not links.connects(sender, receiver) or self.random.random() < links.loss:
            return
        for _ in range(2 if self.random.random() < links.duplicates else 1):
            self.at(self.clock + self.random.uniform(links.delay_min, links.delay_max), action)

    def reconnect(self, index: int) -> None:
        """A node came back: each of its connections comes up on both sides."""
        for peer in self.nodes:
            if peer.index != index and peer.is_up and self.links.connects(peer.index, index):
                peer.handle(PeerConnected(index=index, now_ms=self.now_ms))
                if self.nodes[index].is_up:
                    self.nodes[index].handle(PeerConnected(index=peer.index, now_ms=self.now_ms))

    def start(self) -> None:
        for node in self.nodes:
            node.start()

    def submit(self, nodes: list[int] | None = None) -> bytes:
        """Give a new transaction to these nodes (all that are up, unless said); return its txid."""
        self._transactions += 1
        wire = make_transaction(self._transactions)
        for index in range(len(self.nodes)) if nodes is None else nodes:
            self.nodes[index].submit(wire)
        return txid_of(wire)

    def run(self, duration_ms: float, until: Callable[[], bool] | None = None) -> bool:
        """Let time pass; stop early when `until` holds. Return whether it does."""
        end = self.clock + duration_ms
        while self._heap and self._heap[0][0] <= end:
            if until is not None and until():
                return True
            self.clock, _, action = heapq.heappop(self._heap)
            action()
        if until is not None and until():
            return True
        self.clock = end
        return False

    def all_final(self, txids: list[bytes]) -> bool:
        """Tell whether every node is up and has finalized all of these."""
        return all(node.is_up and all(txid in node.final_txids for txid in txids) for node in self.nodes)

    def final_where_up(self, txid: bytes) -> bool:
        """Tell whether every node that is up has finalized this one."""
        return all(txid in node.final_txids for node in self.nodes if node.is_up)

    def run_until_final(self, duration_ms: float, txid: bytes) -> bool:
        """Let time pass until this transaction is final on every node that is up."""
        return self.run(duration_ms, lambda: self.final_where_up(txid))
