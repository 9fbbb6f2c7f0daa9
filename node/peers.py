"""What the node says to its peers and hears from them. Must never encode a received message again to pass it on.

Between the frames of `node/p2p` and the parts that decide: the engine, the mempool, the synchroniser and custody.
"""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Protocol

import structlog

from consensus.block import Block
from consensus.effects import FetchBlocks, Message
from consensus.errors import BlockRobotError
from consensus.events import (
    BlocksFetched,
    NoticeReceived,
    PeerConnected,
    ProposalReceived,
    TimeoutReceived,
    VoteReceived,
)
from consensus.genesis import Genesis
from consensus.messages import CertificateNotice, Proposal, Timeout, Vote
from consensus.primitives.encoding import decode, encode
from node.engine import Engine
from node.gossip import AGAIN_MAX_BYTES, Gossip, batches, oldest_within
from node.mempool import Mempool
from node.p2p.wire import BlockBatch, BranchRequest, FrameKind, HeightNotice, RequestKind, TransactionBatch
from node.storage.ledger_store import LedgerStore
from node.sync import Synchroniser

FETCH_PEERS_MAX_COUNT = 2
BRANCH_MAX_BYTES = 4 * 1024 * 1024
BRANCH_STORED_MAX_COUNT = 128
UNSETTLED_MAX_COUNT = 1024
UNSETTLED_MAX_MS = 3_000

_KINDS: dict[type[Message], FrameKind] = {
    Proposal: FrameKind.PROPOSAL,
    Vote: FrameKind.VOTE,
    Timeout: FrameKind.TIMEOUT,
    CertificateNotice: FrameKind.NOTICE,
}

log = structlog.get_logger(__name__)


class Network(Protocol):
    """The links to all peers."""

    @property
    def connected(self) -> list[str]:
        """The names of the connected peers, sorted."""
        ...

    async def start(self) -> None:
        """Let peers come, and go to them. Raises PORT_IN_USE."""
        ...

    async def stop(self) -> None:
        """Let go of all links."""
        ...

    def broadcast(self, kind: FrameKind, payload: bytes) -> None:
        """Send one payload to all connected peers."""
        ...

    def send(self, peer: str, kind: FrameKind, payload: bytes) -> bool:
        """Send to one peer; tell whether it is connected."""
        ...

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Ask one peer and return its answer. Raises PEER_UNAVAILABLE."""
        ...


class ClipSource(Protocol):
    """What a custodian serves to other custodians."""

    async def serve_peer(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Answer a request for a clip or a background. Raises BlockRobotError to refuse."""
        ...


class Peers:
    """The engine's outbox, and the handler of what peers send."""

    def __init__(
        self, *, genesis: Genesis, name: str, mempool: Mempool, ledger: LedgerStore, clock: Callable[[], int]
    ) -> None:
        self._genesis = genesis
        self._mempool = mempool
        self._ledger = ledger
        self._clock = clock
        schedule = genesis.schedule
        self._names = [_name_of(genesis, key) for key in schedule.producers]
        self._indexes = {node: index for index, node in enumerate(self._names)}
        self._own_name = name
        self._unsettled: OrderedDict[bytes, int] = OrderedDict()
        self._fetching: set[asyncio.Task[None]] = set()
        self.gossip = Gossip(self._send_batch)
        self.clips: ClipSource | None = None

    def connect(self, network: Network, engine: Engine, sync: Synchroniser) -> None:
        """Tie the parts together; called once, before anything starts."""
        self._network, self._engine, self._sync = network, engine, sync

    async def stop(self) -> None:
        """Stop what is under way."""
        self.gossip.stop()
        for task in self._fetching:
            task.cancel()
        await asyncio.gather(*self._fetching, return_exceptions=True)

    # Outbox of the engine

    def broadcast(self, message: Message) -> None:
        """Send to all peers."""
        self._network.broadcast(_KINDS[type(message)], encode(message))

    def send_to(self, index: int, message: Message) -> None:
        """Send to one producer."""
        self._network.send(self._names[index], _KINDS[type(message)], encode(message))

    def gossip_again(self) -> None:
        """Send the waiting transactions to all peers again."""
        self.gossip.repeat(self._mempool.transactions())

    def fetch(self, effect: FetchBlocks) -> None:
        """Ask some of the named producers for a branch; what comes first goes to the core.

        Not while a long gap is being closed: the core asks again, and then needs only what lies above it.
        """
        if self._sync.is_running:
            return
        connected = set(self._network.connected)
        names = [self._names[index] for index in effect.producers if self._names[index] in connected]
        others = [name for name in connected if name not in names]
        for name in (names + others)[:FETCH_PEERS_MAX_COUNT]:
            task = asyncio.get_running_loop().create_task(self._fetch_branch(name, effect))
            self._fetching.add(task)
            task.add_done_callback(self._fetching.discard)

    async def _fetch_branch(self, name: str, effect: FetchBlocks) -> None:
        request = BranchRequest(block_id=effect.block_id, above_height=effect.above_height)
        try:
            answer = await self._network.request(name, RequestKind.BRANCH, encode(request))
            blocks = tuple(decode(data, Block) for data in decode(answer, BlockBatch).blocks)
        except BlockRobotError as error:
            log.info("fetch_failed", peer=name, code=error.code)
            return
        if blocks:
            self._engine.submit(BlocksFetched(blocks=blocks, now_ms=self._clock()))

    def _send_batch(self, payload: bytes) -> None:
        self._network.broadcast(FrameKind.TRANSACTIONS, payload)

    def announce_height(self, height: int) -> None:
        """Tell all peers how far this node is."""
        self._network.broadcast(FrameKind.HEIGHT, encode(HeightNotice(finalized_height=height)))

    # Handler of the network

    def finalized_height(self) -> int:
        """Return the height of the newest stored block."""
        position = self._ledger.position
        return 0 if position is None else position.height

    def peer_connected(self, peer: str, finalized_height: int) -> None:
        """Greet a peer: what waits here, and what the core has to say."""
        for payload in batches(oldest_within(self._mempool.transactions(), AGAIN_MAX_BYTES)):
            self._network.send(peer, FrameKind.TRANSACTIONS, payload)
        self._sync.note_height(peer, finalized_height)
        index = self._indexes.get(peer)
        if index is not None:
            self._engine.submit(PeerConnected(index=index, now_ms=self._clock()))

    def peer_disconnected(self, peer: str) -> None:
        """A peer is gone."""
        self._sync.forget(peer)

    def peer_frame(self, peer: str, kind: FrameKind, payload: bytes) -> None:
        """Take a frame. Raises ENCODING_* for what is malformed."""
        now_ms = self._clock()
        if kind is FrameKind.VOTE:
            self._engine.submit(VoteReceived(vote=decode(payload, Vote), now_ms=now_ms))
        elif kind is FrameKind.PROPOSAL:
            proposal = decode(payload, Proposal)
            self._engine.submit(ProposalReceived(proposal=proposal, sender=self._indexes.get(peer), now_ms=now_ms))
        elif kind is FrameKind.TRANSACTIONS:
            self._take_transactions(decode(payload, TransactionBatch).transactions, now_ms)
        elif kind is FrameKind.TIMEOUT:
            timeout = decode(payload, Timeout)
            self._engine.submit(TimeoutReceived(timeout=timeout, sender=self._indexes.get(peer), now_ms=now_ms))
        elif kind is FrameKind.NOTICE:
            self._engine.submit(NoticeReceived(notice=decode(payload, CertificateNotice), now_ms=now_ms))
        elif kind is FrameKind.HEIGHT:
            self._sync.note_height(peer, decode(payload, HeightNotice).finalized_height)

    async def peer_request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Answer a request. Raises BlockRobotError to refuse."""
        if kind is RequestKind.BRANCH:
            return self._serve_branch(decode(body, BranchRequest))
        if kind is RequestKind.FINALIZED:
            return self._sync.serve(body)
        if self.clips is None:
            raise BlockRobotError("NOT_FOUND", "This node is no custodian.")
        return await self.clips.serve_peer(peer, kind, body)

    def _serve_branch(self, request: BranchRequest) -> bytes:
        """Return a branch, completed from the ledger where the core no longer holds it."""
        branch = [encode(block) for block in self._engine.core.branch(request.block_id, request.above_height)]
        lowest = decode(branch[0], Block).header.height if branch else 0
        with self._ledger.snapshot() as snapshot:
            if not branch:
                lowest = (snapshot.block_height(request.block_id) or -1) + 1
            first = max(request.above_height + 1, lowest - BRANCH_STORED_MAX_COUNT, 1)
            stored = [data for _, data in snapshot.iter_blocks(first, lowest - first)] if lowest > first else []
        kept: list[bytes] = []
        size = 0
        for data in reversed(stored + branch):
            size += len(data)
            if kept and size > BRANCH_MAX_BYTES:
                break
            kept.append(data)
        return encode(BlockBatch(blocks=tuple(reversed(kept)), proof=None))

    # Transactions

    def _take_transactions(self, wires: Sequence[bytes], now_ms: int) -> None:
        for wire in wires:
            self._admit(wire, now_ms)
        self._engine.note_work()

    def _admit(self, wire: bytes, now_ms: int) -> None:
        try:
            self._mempool.admit(wire, now_ms)
        except BlockRobotError as error:
            if error.code == "SENDER_WITHOUT_STANDING" and len(self._unsettled) < UNSETTLED_MAX_COUNT:
                self._unsettled.setdefault(wire, now_ms + UNSETTLED_MAX_MS)

    def retry_unsettled(self) -> None:
        """Look again at transactions whose sender had no standing here yet: the peer may have been ahead."""
        if not self._unsettled:
            return
        now_ms = self._clock()
        waiting, self._unsettled = self._unsettled, OrderedDict()
        for wire, until_ms in waiting.items():
            if until_ms > now_ms:
                self._admit(wire, now_ms)
                if wire in self._unsettled:
                    self._unsettled[wire] = until_ms
        self._engine.note_work()


def _name_of(genesis: Genesis, producer_key: bytes) -> str:
    return next(node.name for node in genesis.nodes if node.producer_key == producer_key)
