"""What a node hears from a peer whose certificate is genuine: a stream of frames, into four whole nodes and into one core.

The liar's own words are signed with its own key, so that they get past the check of signatures.
"""

from __future__ import annotations

import asyncio
import struct
from collections.abc import Iterator
from random import Random
from typing import Any

import msgspec

from consensus.chain.block import Block, FinalityProof, Header, QuorumCertificate
from consensus.chain.messages import (
    CertificateNotice,
    LastSignedRequest,
    LastSignedResponse,
    Proposal,
    Timeout,
    Vote,
    sign_block,
    sign_timeout,
    sign_vote,
)
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, decode, encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.protocol.events import (
    BlocksFetched,
    Event,
    LastSignedReceived,
    LastSignedRequested,
    NoticeReceived,
    ProposalReceived,
    TimeoutReceived,
    VoteReceived,
)
from node.p2p.wire import (
    PROTOCOL_VERSION,
    BlockBatch,
    BranchRequest,
    ClipRequest,
    FinalizedRequest,
    FrameDecoder,
    FrameKind,
    HeightNotice,
    Hello,
    Refusal,
    RequestKind,
    SnapshotRequest,
    TransactionBatch,
    decode_request,
    encode_frame,
    encode_request,
)
from node.snapshot.snapshot_format import read_manifest
from tests.fuzz.target import FlipBytes, Target, refusing
from tests.fuzz.trees import change_msgpack
from tests.unit.consensus.one_core import OneCore
from tests.unit.node.small_nodes import SmallNodes, make_genesis, producer_key
from tests.virtual_time import VirtualLoop

LIAR = "d"
LIAR_INDEX = 3
AFTER_S = 0.03
FRESH_AFTER_COUNT = 2_000
_HEAD = struct.Struct(">IB")


def frames_of(data: bytes) -> Iterator[tuple[FrameKind, bytes]]:
    """Yield the whole frames of a stream, as a connection cuts them. Raises PEER_MESSAGE_INVALID."""
    decoder = FrameDecoder()
    half = len(data) // 2
    for part in (data[:half], data[half:]):
        yield from decoder.feed(part)


def frame(kind: FrameKind, message: Wire) -> bytes:
    return encode_frame(kind, encode(message))


def ask(kind: RequestKind, message: Wire) -> bytes:
    return encode_frame(FrameKind.REQUEST, encode_request(1, kind, encode(message)))


class _Signing:
    """Signs the liar's words anew after they were changed."""

    def __init__(self, key: PrivateKey, chain_id: bytes) -> None:
        self._key, self._chain_id = key, chain_id

    def sign(self, kind: FrameKind, payload: bytes) -> bytes:
        try:
            return self._sign(kind, payload)
        except (BlockRobotError, OverflowError, ValueError):
            return payload

    def _sign(self, kind: FrameKind, payload: bytes) -> bytes:
        key, chain_id = self._key, self._chain_id
        if kind is FrameKind.VOTE:
            vote = decode(payload, Vote)
            return encode(sign_vote(key, chain_id, vote.epoch, vote.round, vote.block_id, LIAR_INDEX))
        if kind is FrameKind.TIMEOUT:
            was = decode(payload, Timeout)
            return encode(sign_timeout(key, chain_id, was.round, LIAR_INDEX, was.qc, was.entered_by, was.epoch))
        if kind is FrameKind.PROPOSAL:
            block = decode(payload, Proposal).block
            header = block.header
            signature = sign_block(key, chain_id, header.epoch, header.round, block.block_id)
            return encode(Proposal(block=msgspec.structs.replace(block, signature=signature)))
        return payload


def mutate_frames(data: bytes, random: Random, flip: FlipBytes, signing: _Signing) -> bytes:
    """Change one frame of a stream, or which frames there are."""
    try:
        frames = list(frames_of(data))
    except BlockRobotError:
        frames = []
    if not frames or random.random() < 0.1:
        return flip(data, random)
    place = random.randrange(len(frames))
    kind, payload = frames[place]
    if random.random() < 0.1:
        frames.append(random.choice(frames))
    elif kind in {FrameKind.REQUEST, FrameKind.RESPONSE}:
        frames[place] = (kind, payload[:5] + (change_msgpack(payload[5:], random, flip) or flip(payload[5:], random)))
    else:
        changed = change_msgpack(payload, random, flip) or flip(payload, random)
        frames[place] = (kind, signing.sign(kind, changed) if random.random() < 0.7 else changed)
    return b"".join(_HEAD.pack(len(payload) + 1, kind) + payload for kind, payload in frames)


def core_seeds() -> list[bytes]:
    """Streams of frames of every kind of word, about a chain of the core's epoch and of the next."""
    one = OneCore(0)
    blocks = one.chain(1, 2, 3)
    later = one.chain(5)
    tc = one.tc(3, 2)
    boundary = one.boundary(1)
    closing = one.closing(2, boundary)
    vote, notice = one.vote(LIAR_INDEX, blocks[0]), CertificateNotice(qc=one.qc(blocks[2]), entered_by=tc)
    answer = LastSignedResponse(0, one.now_ms, "signing", 0, None, one.root_qc, None)
    streams = [
        [frame(FrameKind.VOTE, vote)],
        [frame(FrameKind.PROPOSAL, Proposal(block=block)) for block in blocks],
        [frame(FrameKind.PROPOSAL, Proposal(block=later[0])), frame(FrameKind.NOTICE, notice)],
        [
            frame(FrameKind.TIMEOUT, one.timeout(LIAR_INDEX, 1)),
            frame(FrameKind.TIMEOUT, one.timeout(2, 4, one.qc(blocks[2]), tc)),
        ],
        [frame(FrameKind.NOTICE, notice)],
        [
            frame(FrameKind.LAST_SIGNED_REQUEST, LastSignedRequest(epoch=0, asked_at_ms=1)),
            frame(FrameKind.LAST_SIGNED_RESPONSE, answer),
        ],
        [frame(FrameKind.PROPOSAL, Proposal(block=block)) for block in (boundary, closing)],
        [frame(FrameKind.RESPONSE, BlockBatch(tuple(encode(block) for block in blocks), None))],
    ]
    return [b"".join(stream) for stream in streams]


def open_consensus() -> Target:
    """One core that executes what it is told to, among peers of whom one lies: it neither halts nor leaves its epoch."""
    base = OneCore(0)
    signing = _Signing(base.keys[LIAR_INDEX], base.chain_id)

    def run(data: bytes) -> None:
        one = OneCore(0)
        before = one.core.epoch
        with refusing("ENCODING_", "PEER_MESSAGE_"):
            for kind, payload in frames_of(data):
                for event in _events(kind, payload, one.now_ms):
                    one.executed(one.handle(event))
        assert not one.core.halted, one.core.halted
        assert one.core.epoch == before

    return Target("consensus", core_seeds(), run, lambda data, random, flip: mutate_frames(data, random, flip, signing))


def _events(kind: FrameKind, payload: bytes, now_ms: int) -> Iterator[Event]:
    if kind is FrameKind.VOTE:
        yield VoteReceived(vote=decode(payload, Vote), now_ms=now_ms, sender=LIAR_INDEX)
    elif kind is FrameKind.PROPOSAL:
        yield ProposalReceived(proposal=decode(payload, Proposal), sender=LIAR_INDEX, now_ms=now_ms)
    elif kind is FrameKind.TIMEOUT:
        yield TimeoutReceived(timeout=decode(payload, Timeout), sender=LIAR_INDEX, now_ms=now_ms)
    elif kind is FrameKind.NOTICE:
        yield NoticeReceived(notice=decode(payload, CertificateNotice), now_ms=now_ms)
    elif kind is FrameKind.LAST_SIGNED_REQUEST:
        yield LastSignedRequested(request=decode(payload, LastSignedRequest), sender=LIAR_INDEX, now_ms=now_ms)
    elif kind is FrameKind.LAST_SIGNED_RESPONSE:
        yield LastSignedReceived(answer=decode(payload, LastSignedResponse), sender=LIAR_INDEX, now_ms=now_ms)
    elif kind is FrameKind.RESPONSE:
        blocks = tuple(decode(data, Block) for data in decode(payload, BlockBatch).blocks)
        if blocks:
            yield BlocksFetched(blocks=blocks, now_ms=now_ms)


class _Crowd:
    """Four nodes that go on through all inputs; the liar's certificate is the fourth's."""

    def __init__(self) -> None:
        self.loop = VirtualLoop()
        self.broken: list[BaseException] = []
        self.loop.set_exception_handler(self._note)
        self.crowd = SmallNodes(make_genesis(["a", "b", "c", LIAR]))
        self.run(self._begin())

    async def _begin(self) -> None:
        await self.crowd.start()
        await self.crowd.finalize("a", self._call())

    def _call(self) -> Any:
        return self.crowd.transaction("identity", "authenticate", bytes(32))

    def _note(self, _loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        self.broken.append(context.get("exception") or RuntimeError(context["message"]))

    def run(self, work: Any) -> Any:
        return self.loop.run_until_complete(work)

    async def hear(self, data: bytes) -> None:
        handler = self.crowd.links["a"].handler
        with refusing(""):
            for kind, payload in frames_of(data):
                if kind is FrameKind.REQUEST:
                    number, asked, body = decode_request(payload)
                    if asked in set(RequestKind):
                        assert len(await handler.peer_request(LIAR, RequestKind(asked), body)) < 1 << 23, number
                elif kind is FrameKind.RESPONSE:
                    self._read_answer(payload)
                elif kind in {FrameKind.HELLO, FrameKind.REFUSAL}:
                    decode(payload, Hello if kind is FrameKind.HELLO else Refusal)
                else:
                    handler.peer_frame(LIAR, kind, payload)
        await asyncio.sleep(AFTER_S)

    def _read_answer(self, payload: bytes) -> None:
        """What answers to the node's own questions are made of."""
        _, _, body = decode_request(payload)
        if body.startswith(b"blockrobot-snapshot"):
            read_manifest(body)
            return
        batch = decode(body, BlockBatch)
        for data in batch.blocks:
            block = decode(data, Block)
            assert len(block.block_id) == len(sha256(b"")), block.header
        if batch.proof is not None:
            assert decode(batch.proof.header_bytes, Header)

    def seeds(self) -> list[bytes]:
        """One stream for each kind of frame and request, as the nodes themselves sent it."""
        sent = {kind: payload for link in self.crowd.links.values() for _, kind, payload in link.sent}
        with self.crowd.ledgers["a"].snapshot() as snapshot:
            position, finality = snapshot.position, decode(snapshot.finality, FinalityProof)
            block = encode(snapshot.block(1))
        assert position is not None
        batch = encode(BlockBatch(blocks=(block,), proof=finality))
        asked = [
            ask(RequestKind.BRANCH, BranchRequest(finality.child_qc.block_id, 0)),
            ask(RequestKind.FINALIZED, FinalizedRequest(1, 5)),
            ask(RequestKind.CLIP, ClipRequest(bytes(32), 0)),
            ask(RequestKind.SNAPSHOT, SnapshotRequest(b"", -1, 0)),
            encode_frame(FrameKind.RESPONSE, encode_request(1, 0, batch)),
            frame(FrameKind.HELLO, Hello(PROTOCOL_VERSION, self.crowd.genesis.chain_id, LIAR, 0)),
            frame(FrameKind.HEIGHT, HeightNotice(2, 0)),
            frame(FrameKind.TRANSACTIONS, TransactionBatch((self.run(self._wire()),))),
            frame(FrameKind.LAST_SIGNED_REQUEST, LastSignedRequest(0, 1)),
        ]
        qc: QuorumCertificate = finality.child_qc
        forged = CertificateNotice(msgspec.structs.replace(qc, epoch=1), None)
        words = [encode_frame(kind, payload) for kind, payload in sent.items()]
        return [*words, *asked, frame(FrameKind.NOTICE, forged), b"".join(asked)]

    async def _wire(self) -> bytes:
        return bytes(self._call().wire)


def open_peer() -> Target:
    """Whole nodes: peers, core, intake, synchroniser; what fails in a task counts too."""
    holder = [_Crowd()]
    signing = _Signing(producer_key(LIAR), holder[0].crowd.genesis.chain_id)
    seeds = holder[0].seeds()

    heard = [0]

    def run(data: bytes) -> None:
        crowd = holder[0]
        heard[0] += 1
        if crowd.crowd.nodes["a"].core.epoch or heard[0] % FRESH_AFTER_COUNT == 0:  # it was suspended for what it said
            close()
            crowd = holder[0] = _Crowd()
        crowd.run(crowd.hear(data))
        if crowd.broken:
            raise crowd.broken.pop()
        for node in crowd.crowd.nodes.values():
            assert not node.core.halted, node.core.halted

    def close() -> None:
        holder[0].run(holder[0].crowd.stop())
        holder[0].loop.close()

    return Target(
        "peer", seeds, run, lambda data, random, flip: mutate_frames(data, random, flip, signing), 64 * 1024, close
    )
