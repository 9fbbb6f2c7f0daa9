"""A simulated node: production parts on a simulated machine, through many lives."""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from consensus.chain.messages import Proposal, Timeout, Vote
from consensus.errors import BlockRobotError
from consensus.protocol.effects import FetchBlocks, Message
from network.byzantine import TICK_MS, byzantine_clock, make_behaviour
from network.byzantine.behaviour import EngineView
from network.sim.history import (
    LOST,
    BlockFinalized,
    ClipKept,
    CodeFault,
    EpochBegan,
    NodeRefusedStart,
    NodeRestored,
    NodeStarted,
    NodeStopped,
    ProposalSent,
    TimeoutSent,
    VoteSent,
)
from network.sim.world.cpu import NodeCheck, NodeTransactions
from network.sim.world.custody_store import MemoryEraseKeys, SimCustodyStore
from network.sim.world.links import SimNetwork
from network.sim.world.sim_chain import EPOCH_MS, node_name
from network.sim.world.sim_disk import SimDisk
from network.sim.world.sim_ledger import SimLedger
from network.sim.world.sim_world import SimWorld
from network.sim.world.virtual_time import Owner, PowerCutError
from node.components import Environment, NodeComponents
from node.consensus.engine import Outbox
from node.consensus.epoch_change import EpochStart
from node.consensus.journal import IDENTITY_SIZE_BYTES, Journal
from node.custody.coordination.custody_coordinator import CustodyPlace
from node.p2p.network import PeerHandler
from node.storage.ledger_store import FinalizedBlock
from node.storage.memory_store import MemoryStore

JOURNAL_PATH = Path("/journal/votes.journal")
STORE_PAUSE_MS = 2.0
STORE_PAUSE_SHARE = 0.25
MID_BROADCAST_MAX_COUNT = 3


class ObservedOutbox:
    """Records an honest node's outgoing messages before passing them on."""

    def __init__(self, node: SimNode, inner: Outbox) -> None:
        self._node = node
        self._inner = inner

    def broadcast(self, message: Message) -> None:
        self._node.note_message(message)
        self._inner.broadcast(message)

    def send_to(self, index: int, message: Message) -> None:
        self._node.note_message(message)
        self._inner.send_to(index, message)

    def fetch(self, effect: FetchBlocks) -> None:
        self._inner.fetch(effect)

    def gossip_again(self) -> None:
        self._inner.gossip_again()


@dataclass(frozen=True)
class Backup:
    """What a backup of a machine holds."""

    disk: dict[Path, bytes]
    ledger: MemoryStore
    store: bytes


class SimNode:
    """A machine and its lives; `parts` is None while the node is down."""

    def __init__(self, cluster: SimWorld, index: int, dice: random.Random) -> None:
        self.cluster, self.index, self.dice = cluster, index, dice
        self.name = node_name(index)
        self.disk = SimDisk(dice)
        self.ledger = SimLedger(cluster.loop, dice, self._note_handed, self._note_durable)
        self.ledger.found(cluster.chain.first_block)
        self.custody_key = cluster.chain.custodians[index]
        self.store = SimCustodyStore(self._pause, self._note_kept)
        self.erase_keys = MemoryEraseKeys(dice)
        self.clock_offset_ms = 0
        self.behaviour = ""
        self.owner = Owner(f"{self.name} before its first life")
        self.owner.alive = False
        self.parts: NodeComponents | None = None
        self.network: SimNetwork | None = None
        self.starting: NodeComponents
        self.lives_count = 0
        self.is_lost = False
        self.is_refusing = False
        self.handed_height = 0
        self.key = cluster.chain.producers[index]
        Journal.create(JOURNAL_PATH, disk=self.disk, identity=dice.randbytes(IDENTITY_SIZE_BYTES)).close()

    @property
    def member(self) -> bytes:
        """Its key as a custodian; b"" if it is none."""
        return b"" if self.custody_key is None else self.custody_key.public_key

    @property
    def ledger_height(self) -> int:
        position = self.ledger.position
        return -1 if position is None else position.height

    # Clocks and pauses

    def now_ms(self) -> int:
        return EPOCH_MS + round(self.cluster.loop.now_ms) + self.clock_offset_ms

    async def _pause(self) -> None:
        if self.dice.random() < STORE_PAUSE_SHARE:
            await asyncio.sleep(self.dice.uniform(0, STORE_PAUSE_MS) / 1000)

    # Lives

    @property
    def is_up(self) -> bool:
        return self.owner.alive

    @property
    def is_serving(self) -> bool:
        return self.parts is not None and self.owner.alive and not self.owner.paused

    def start(self) -> None:
        if self.owner.alive or self.is_lost:
            return
        self.lives_count += 1
        self.is_refusing = False
        self.owner = Owner(f"{self.name}/{self.lives_count}")
        self.parts = None
        self.cluster.owners.append(self.owner)
        loop = self.cluster.loop
        loop.call_for(self.owner, loop.time(), self._begin)

    def _begin(self) -> None:
        self.cluster.loop.create_task(self._live())

    async def _live(self) -> None:
        cluster = self.cluster
        try:
            parts = NodeComponents(self._surroundings(Journal.open(JOURNAL_PATH, disk=self.disk)))
            self.starting = parts
            parts.engine.add_epoch_listener(self._note_epoch)
        except BlockRobotError as error:
            cluster.history.add(NodeRefusedStart(cluster.now, self.index, error.code))
            self.is_refusing = True
            cluster.loop.kill(self.owner)
            return
        checkpoint = await self.store.checkpoint()
        position = self.ledger.position
        if position is None:
            raise AssertionError("the ledger holds genesis")
        height = -1 if checkpoint is None else checkpoint.height
        started = NodeStarted(cluster.now, self.index, position.height, position.block_id, position.state_root, height)
        cluster.history.add(started)
        self._note_epoch(parts.engine.epoch)
        await parts.start()
        self.parts = parts

    def _surroundings(self, journal: Journal) -> Environment:
        cluster, key = self.cluster, self.custody_key
        chain, loop, owner = cluster.chain, cluster.loop, self.owner
        has_cpu = cluster.plan.cpu
        clock = self.now_ms
        if self.behaviour:
            clock = byzantine_clock(self.behaviour, clock, chain.genesis.settings.max_clock_drift_ms)
        return Environment(
            genesis=chain.genesis,
            name=self.name,
            ledger=self.ledger,
            journal=journal,
            clock=_Clock(clock),
            open_network=self._open_network,
            key=self.key,
            custody=None if key is None else CustodyPlace(key, self.store, self.erase_keys),
            stopwatch=lambda: max(loop.time(), owner.free_at_s) + self.disk.busy_s,
            randomness=self.dice.randbytes,
            machine=cluster.machine,
            check=NodeCheck(chain.check) if has_cpu else chain.check,
            transactions=NodeTransactions(chain.transactions) if has_cpu else chain.transactions,
            wrap_outbox=self._wrap_outbox,
        )

    def _open_network(self, handler: PeerHandler) -> SimNetwork:
        self.network = SimNetwork(self.cluster.wires, self.owner, self.name, handler)
        return self.network

    def _wrap_outbox(self, inner: Outbox) -> Outbox:
        if not self.behaviour:
            return ObservedOutbox(self, inner)
        parts = self.starting
        own = EngineView(parts.engine, self.cluster.chain.genesis.chain_id, parts.network)
        behaviour = make_behaviour(
            self.behaviour,
            inner=inner,
            own=own,
            key=self.key,
            chance=random.Random(self.dice.random()),  # noqa: S311 - a simulation's dice
            accomplices=self.cluster.accomplices,
        )
        self._tick(behaviour.tick)
        return behaviour

    def _tick(self, tick: Callable[[], None]) -> None:
        tick()
        self.cluster.loop.call_later(TICK_MS / 1000, self._tick, tick)

    def crash(self, why: str) -> None:
        if not self.owner.alive:
            return
        cluster = self.cluster
        cluster.loop.kill(self.owner)
        self.parts = None
        self.disarm()
        cluster.wires.detach(self.name)
        self.disk.cut_power()
        self.ledger.cut_power()
        cluster.history.add(NodeStopped(cluster.now, self.index, why))

    def lose(self) -> None:
        """The machine, with its disk: it never comes back."""
        self.is_lost = True
        self.crash(LOST)

    # Backups

    def back_up(self) -> Backup:
        """Erase keys are never copied."""
        return Backup(self.disk.image(), self.ledger.image(), self.store.image())

    def restore(self, backup: Backup, *, whole: bool) -> None:
        self.disk.restore(backup.disk)
        if whole:
            self.ledger.restore(backup.ledger)
            self.store.restore(backup.store)
            self.handed_height = 0
        self.cluster.history.add(NodeRestored(self.cluster.now, self.index, self.ledger_height))

    # Crashing at a point

    def arm(self, point: str, then: Callable[[], None]) -> None:
        """Cut the power at the next passage of a point (`now`: at once), then call `then`."""
        if point == "now" or not self.is_serving or self.network is None:
            self.crash(point)
            then()
            return

        def cut() -> None:
            self.disarm()
            self.disk.tears = {"before-sync": "all", "torn-sync": "part"}.get(point, "dice")
            self.crash(point)
            then()
            raise PowerCutError(point)

        if point in {"before-sync", "torn-sync"}:
            self.disk.before_sync = cut
        elif point == "after-sync":
            self.disk.after_sync = cut
        elif point == "mid-commit":
            self.ledger.before_commit = cut
        else:
            left = [self.dice.randint(1, MID_BROADCAST_MAX_COUNT)]

            def count_down() -> None:
                left[0] -= 1
                if left[0] < 0:
                    cut()

            self.network.before_send = count_down

    def disarm(self) -> None:
        self.disk.before_sync = self.disk.after_sync = self.ledger.before_commit = _nothing
        if self.network is not None:
            self.network.before_send = _nothing

    # Observations

    def note_message(self, message: Message) -> None:
        cluster = self.cluster
        if isinstance(message, Vote):
            cluster.history.add(VoteSent(cluster.now, self.index, message.epoch, message.round, message.block_id))
        elif isinstance(message, Timeout):
            high = message.qc.round
            cluster.history.add(TimeoutSent(cluster.now, self.index, message.epoch, message.round, high))
        elif isinstance(message, Proposal):
            block = message.block
            header = block.header
            if self.producer_of(header.epoch, header.producer) == self.key.public_key:
                block_id = block.block_id
                cluster.history.add(
                    ProposalSent(cluster.now, self.index, header.epoch, header.round, header.height, block_id)
                )

    def producer_of(self, epoch: int, index: int) -> bytes:
        """Return a producer's key in the node's current epoch (b"" for other epochs)."""
        parts = self.starting
        schedule = parts.engine.epoch.schedule
        return schedule.producers[index] if schedule.epoch == epoch and index < len(schedule.producers) else b""

    def _note_epoch(self, start: EpochStart) -> None:
        cluster, epoch = self.cluster, start.epoch
        cluster.history.add(EpochBegan(cluster.now, self.index, epoch.number, epoch.producers, start.round_zero_id))

    def _note_handed(self, blocks: Sequence[FinalizedBlock]) -> None:
        self.handed_height = max(self.handed_height, blocks[-1].height)
        self._note_final(blocks, stored=False)

    def _note_durable(self, blocks: Sequence[FinalizedBlock]) -> None:
        self._note_final(blocks, stored=True)

    def _note_final(self, blocks: Sequence[FinalizedBlock], *, stored: bool) -> None:
        cluster = self.cluster
        for block in blocks:
            header = cluster.header_of(block)
            if not self.behaviour:
                cluster.note_final(header)
            txids = tuple(txid for txid, _ in block.transactions)
            cluster.history.add(
                BlockFinalized(
                    cluster.now,
                    self.index,
                    stored,
                    block.height,
                    header.epoch,
                    header.round,
                    block.block_id,
                    block.state_root,
                    txids,
                )
            )

    def _note_kept(self, record_id: bytes) -> None:
        self.cluster.history.add(ClipKept(self.cluster.now, self.index, record_id))

    def note_faults(self) -> None:
        if self.parts is not None and self.parts.core.halted and not self.behaviour:
            self.cluster.history.add(CodeFault(self.cluster.now, self.index, f"halted: {self.parts.core.halted}"))


class _Clock:
    def __init__(self, now_ms: Callable[[], int]) -> None:
        self.now_ms = now_ms


def _nothing() -> None:
    """Do nothing: no power cut is armed."""
