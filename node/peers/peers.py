"""Connects peers' frames with engine, mempool, synchroniser and custody."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from functools import partial
from typing import Protocol

import structlog

from consensus.chain.block import Block, EpochProof
from consensus.chain.messages import CertificateNotice, LastSignedRequest, LastSignedResponse, Proposal, Timeout, Vote
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.protocol.effects import FetchBlocks, Message
from consensus.protocol.events import (
    BlocksFetched,
    Event,
    LastSignedReceived,
    LastSignedRequested,
    NoticeReceived,
    PeerConnected,
    ProposalReceived,
    TimeoutReceived,
    VoteReceived,
)
from node.consensus.engine import Engine
from node.consensus.epoch_change import EpochStart, EpochTransition, verify_following
from node.limits.token_buckets import Allowance, Source, TokenBuckets, over_budget
from node.mempool.gossip import AGAIN_MAX_BYTES, Gossip, batches, oldest_within
from node.mempool.mempool import Mempool
from node.mempool.transaction_intake import Outcome, TransactionIntake
from node.p2p.frame_costs import FRAME_COSTS, Lane
from node.p2p.wire import (
    BlockBatch,
    BranchRequest,
    FinalizedRequest,
    FrameKind,
    HeightNotice,
    RequestKind,
    TransactionBatch,
)
from node.peers.peer_requests import PeerRequests
from node.storage.ledger_store import LedgerStore
from node.sync.block_sync import Synchroniser

FETCH_PEERS_MAX_COUNT = 2
UNSETTLED_OF_PEER_MAX_COUNT = 256
UNSETTLED_MAX_MS = 3_000
OWN_BOUNDARY_WAIT_MS = 100
NEVER_PASSED_ON = frozenset(
    {
        "ENCODING_INVALID",
        "ENCODING_NOT_CANONICAL",
        "SIGNATURE_HIGH_S",
        "SIGNATURE_INVALID",
        "TRANSACTION_TOO_LARGE",
        "TRANSACTION_WRONG_CHAIN",
    }
)
"""What is wrong with a transaction whoever looks at it: a node passes on what it checked, so a peer that sends it lies."""
CONTROL_ALLOWANCE = Allowance(us_per_s=50_000, burst_us=250_000)

_KINDS: dict[type[Message], FrameKind] = {
    Proposal: FrameKind.PROPOSAL,
    Vote: FrameKind.VOTE,
    Timeout: FrameKind.TIMEOUT,
    CertificateNotice: FrameKind.NOTICE,
    LastSignedRequest: FrameKind.LAST_SIGNED_REQUEST,
    LastSignedResponse: FrameKind.LAST_SIGNED_RESPONSE,
}
_CONSENSUS_FRAME_KINDS = frozenset(_KINDS.values())

log = structlog.get_logger(__name__)


class Network(Protocol):
    """The links to all peers."""

    @property
    def connected(self) -> list[str]: ...

    async def start(self) -> None:
        """Raises PORT_IN_USE, PORT_NOT_PERMITTED, ADDRESS_NOT_HERE."""
        ...

    async def stop(self) -> None: ...

    def broadcast(self, kind: FrameKind, payload: bytes) -> None: ...

    def send(self, peer: str, kind: FrameKind, payload: bytes) -> bool: ...

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Raises PEER_UNAVAILABLE."""
        ...

    def cut_off(self, peer: str, error: BlockRobotError) -> None: ...


class SnapshotSource(Protocol):
    """Serves snapshots to nodes too far behind for blocks."""

    async def serve(self, body: bytes) -> bytes: ...


class ClipSource(Protocol):
    """What a custodian serves to other custodians."""

    async def serve_peer(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Raises BlockRobotError to refuse."""
        ...


class Peers:
    """The engine's outbox, and the handler of what peers send."""

    def __init__(
        self,
        *,
        chain_id: bytes,
        name: str,
        start: EpochStart,
        name_of_producer: Callable[[bytes], str | None],
        mempool: Mempool,
        intake: TransactionIntake,
        ledger: LedgerStore,
        clock: Callable[[], int],
        on_over_budget: Callable[[str, BlockRobotError], None] = lambda _source, _error: None,
    ) -> None:
        """`start` is the current epoch's; `name_of_producer` maps producer keys to nodes."""
        self._chain_id = chain_id
        self._name_of_producer = name_of_producer
        self._mempool = mempool
        self._intake = intake
        self._on_over_budget = on_over_budget
        self._control: TokenBuckets[str] = TokenBuckets(
            lambda _peer: CONTROL_ALLOWANCE, asyncio.get_running_loop().time
        )
        self._requests = PeerRequests(ledger, on_over_budget)
        self._ledger = ledger
        with ledger.snapshot() as view:
            self._earliest_height = view.earliest_height
        self._clock = clock
        self._own_name = name
        self._epoch = start
        self._epoch_transition = EpochTransition(start=start, ledger=ledger, send=self._send)
        self.name_producers()
        self._unsettled: dict[str, dict[bytes, int]] = {}
        self._fetching: set[asyncio.Task[None]] = set()
        self._hints: dict[str, asyncio.TimerHandle] = {}
        self.gossip = Gossip(self._send_batch)
        self.clips: ClipSource | None = None
        self.snapshots: SnapshotSource | None = None

    def connect(self, network: Network, engine: Engine, sync: Synchroniser) -> None:
        self._network, self._engine, self._sync = network, engine, sync

    async def stop(self) -> None:
        self.gossip.stop()
        self._epoch_transition.stop()
        self._requests.stop()
        for timer in self._hints.values():
            timer.cancel()
        for task in self._fetching:
            task.cancel()
        await asyncio.gather(*self._fetching, return_exceptions=True)

    # Epochs

    def name_producers(self) -> None:
        names = [self._name_of_producer(key) for key in self._epoch.schedule.producers]
        self._names = names
        self._indexes = {node: index for index, node in enumerate(names) if node is not None}

    def begin_epoch(self, start: EpochStart) -> None:
        """Announce a new epoch, help its producers into it, process their earlier messages."""
        self._epoch = start
        self.name_producers()
        self.announce_height(self.finalized_height())
        for peer, kind, payload in self._epoch_transition.begin(start, set(self._indexes) - {self._own_name}):
            self._receive_consensus_message(peer, kind, payload)

    def _receive_consensus_message(self, peer: str, kind: FrameKind, payload: bytes) -> None:
        event, epoch = self._event_of(peer, kind, payload)
        if epoch == self._epoch.number:
            self._note_peer_active(peer)
            self._engine.submit(event)
        elif epoch < self._epoch.number:
            self._epoch_transition.answer(peer, epoch)
        else:
            if epoch == self._epoch.number + 1:
                self._epoch_transition.keep(peer, kind, payload)
            self._follow_later(peer, epoch)

    def _note_peer_active(self, peer: str) -> None:
        """R25: a producer first heard in this epoch may have missed its messages."""
        index = self._indexes.get(peer)
        if self._epoch_transition.record_message_from(peer) and index is not None:
            self._engine.submit(PeerConnected(index=index, now_ms=self._clock()))

    def _event_of(self, peer: str, kind: FrameKind, payload: bytes) -> tuple[Event, int]:
        now_ms, sender = self._clock(), self._indexes.get(peer)
        if kind is FrameKind.VOTE:
            vote = decode(payload, Vote)
            return VoteReceived(vote=vote, now_ms=now_ms, sender=sender), vote.epoch
        if kind is FrameKind.PROPOSAL:
            proposal = decode(payload, Proposal)
            return ProposalReceived(proposal=proposal, sender=sender, now_ms=now_ms), proposal.block.header.epoch
        if kind is FrameKind.TIMEOUT:
            timeout = decode(payload, Timeout)
            return TimeoutReceived(timeout=timeout, sender=sender, now_ms=now_ms), timeout.epoch
        if kind is FrameKind.LAST_SIGNED_REQUEST:
            request = decode(payload, LastSignedRequest)
            return LastSignedRequested(request=request, sender=sender, now_ms=now_ms), request.epoch
        if kind is FrameKind.LAST_SIGNED_RESPONSE:
            answer = decode(payload, LastSignedResponse)
            return LastSignedReceived(answer=answer, sender=sender, now_ms=now_ms), answer.epoch
        notice = decode(payload, CertificateNotice)
        return NoticeReceived(notice=notice, now_ms=now_ms), notice.qc.epoch

    def _follow_later(self, peer: str, epoch: int) -> None:
        if peer not in self._hints:
            loop = asyncio.get_running_loop()
            self._hints[peer] = loop.call_later(OWN_BOUNDARY_WAIT_MS / 1000, self._follow, peer, epoch)

    def _follow(self, peer: str, epoch: int) -> None:
        self._hints.pop(peer, None)
        if epoch > self._epoch.number:
            self._sync.note_epoch(peer, epoch)

    def _take_proof(self, peer: str, payload: bytes) -> None:
        """Raises PROOF_INVALID, CERTIFICATE_INVALID, ENCODING_*."""
        proof = decode(payload, EpochProof)
        if proof.epoch.number <= self._epoch.number:
            self._tell_height(peer)
            return
        if proof.epoch.number == self._epoch.number + 1:
            verify_following(proof, self._epoch, self._chain_id)
        self._follow_later(peer, proof.epoch.number)

    def _note_height(self, peer: str, notice: HeightNotice) -> None:
        if notice.epoch < self._epoch.number:
            self._epoch_transition.answer(peer, notice.epoch)
        else:
            self._note_peer_active(peer)
        if notice.epoch > self._epoch.number:
            self._follow_later(peer, notice.epoch)
        self._sync.note_height(peer, notice.finalized_height, notice.earliest_height)

    # Outbox of the engine

    def broadcast(self, message: Message) -> None:
        self._network.broadcast(_KINDS[type(message)], encode(message))

    def send_to(self, index: int, message: Message) -> None:
        name = self._names[index]
        if name is not None:
            self._network.send(name, _KINDS[type(message)], encode(message))

    def gossip_again(self) -> None:
        self.gossip.repeat(self._mempool.transactions())

    def fetch(self, effect: FetchBlocks) -> None:
        """Ask some named producers for a branch, except during a long catch-up."""
        if self._sync.closes_gap:
            return
        connected = self._network.connected
        signers = [self._names[index] for index in effect.producers]
        names = [name for name in signers if name is not None and name in connected]
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

    def _send(self, peer: str, kind: FrameKind, payload: bytes) -> bool:
        return self._network.send(peer, kind, payload)

    def _send_batch(self, payload: bytes) -> None:
        self._network.broadcast(FrameKind.TRANSACTIONS, payload)

    def announce_height(self, height: int) -> None:
        notice = HeightNotice(height, self._epoch.number, self._earliest_height)
        self._network.broadcast(FrameKind.HEIGHT, encode(notice))

    def forget_blocks(self, below_height: int) -> None:
        """Serve no blocks below the pruned height, and announce it."""
        self._requests.forget_below(below_height)
        self._earliest_height = below_height
        self.announce_height(self.finalized_height())

    def _tell_height(self, peer: str) -> None:
        notice = HeightNotice(self.finalized_height(), self._epoch.number, self._earliest_height)
        self._network.send(peer, FrameKind.HEIGHT, encode(notice))

    # Handler of the network

    def finalized_height(self) -> int:
        position = self._ledger.position
        return 0 if position is None else position.height

    def peer_connected(self, peer: str, finalized_height: int) -> None:
        for payload in batches(oldest_within(self._mempool.transactions(), AGAIN_MAX_BYTES)):
            self._network.send(peer, FrameKind.TRANSACTIONS, payload)
        self._tell_height(peer)
        self._sync.note_height(peer, finalized_height)
        index = self._indexes.get(peer)
        if index is not None:
            self._engine.submit(PeerConnected(index=index, now_ms=self._clock()))

    def peer_disconnected(self, peer: str) -> None:
        self._sync.forget(peer)
        self._intake.forget(Source("peer", peer))
        self._unsettled.pop(peer, None)

    def on_over_budget(self, source: Source, wait_s: float) -> None:
        self._on_over_budget(str(source), over_budget(str(source), wait_s))

    def peer_frame(self, peer: str, kind: FrameKind, payload: bytes) -> None:
        """Raises ENCODING_*, PROOF_INVALID, CERTIFICATE_INVALID; drops heights and requests over budget."""
        cost = FRAME_COSTS[kind]
        if cost.lane is Lane.CONTROL and not self._control.take(peer, cost.us):
            self.on_over_budget(Source("peer", peer), self._control.wait_s(peer, cost.us))
            return
        if kind in _CONSENSUS_FRAME_KINDS:
            self._receive_consensus_message(peer, kind, payload)
        elif kind is FrameKind.TRANSACTIONS:
            self._take_transactions(peer, decode(payload, TransactionBatch).transactions)
        elif kind is FrameKind.HEIGHT:
            self._note_height(peer, decode(payload, HeightNotice))
        elif kind is FrameKind.EPOCH:
            self._take_proof(peer, payload)

    async def peer_request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        return await self._requests.answer(peer, kind, partial(self._answer, peer, kind, body))

    async def _answer(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        if kind is RequestKind.BRANCH:
            request = decode(body, BranchRequest)
            branch = [encode(block) for block in self._engine.core.branch(request.block_id, request.above_height)]
            return await self._requests.read_branch(request, branch)
        if kind is RequestKind.FINALIZED:
            return await self._requests.read_finalized(decode(body, FinalizedRequest))
        if kind is RequestKind.SNAPSHOT:
            return b"" if self.snapshots is None else await self.snapshots.serve(body)
        if self.clips is None:
            raise BlockRobotError("NOT_FOUND", "This node is no custodian.")
        return await self.clips.serve_peer(peer, kind, body)

    # Transactions

    def _take_transactions(self, peer: str, wires: Sequence[bytes]) -> None:
        self._intake.offer(Source("peer", peer), wires, partial(self._note_taken, peer, None))

    def _note_taken(self, peer: str, until_ms: int | None, outcomes: list[Outcome]) -> None:
        for outcome in outcomes:
            error = outcome.error
            if error is None:
                continue
            if error.code in NEVER_PASSED_ON:
                self._network.cut_off(peer, error)
                self._intake.forget(Source("peer", peer))
                return
            if error.code == "SENDER_NOT_ADMITTED":
                self._keep_unsettled(peer, outcome.wire, until_ms)
        if any(outcome.is_new for outcome in outcomes):
            self._engine.note_work()

    def _keep_unsettled(self, peer: str, wire: bytes, until_ms: int | None) -> None:
        kept = self._unsettled.setdefault(peer, {})
        if len(kept) < UNSETTLED_OF_PEER_MAX_COUNT:
            kept.setdefault(wire, self._clock() + UNSETTLED_MAX_MS if until_ms is None else until_ms)

    def retry_unsettled(self) -> None:
        """Retry transactions whose sender had no standing here yet."""
        if not self._unsettled:
            return
        now_ms = self._clock()
        waiting, self._unsettled = self._unsettled, {}
        for peer, kept in waiting.items():
            for until_ms in sorted(set(kept.values())):
                if until_ms > now_ms:
                    wires = [wire for wire, until in kept.items() if until == until_ms]
                    self._intake.offer(Source("peer", peer), wires, partial(self._note_taken, peer, until_ms))
