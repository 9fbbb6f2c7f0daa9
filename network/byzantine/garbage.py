"""A bounded flood of junk."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import msgspec

from consensus.chain.block import Block, IndexedSignature, QuorumCertificate
from consensus.chain.messages import CertificateNotice, LastSignedResponse, Proposal, Timeout, Vote
from consensus.primitives.keys import COMPACT_SIGNATURE_SIZE_BYTES
from consensus.protocol.effects import Message
from network.byzantine.behaviour import Behaviour, BoundedCache, ByzantineContext
from node.consensus.engine import Outbox
from node.p2p.wire import FRAME_MAX_BYTES, FrameKind

MESSAGES_PER_TICK_COUNT = 10
RAW_EVERY_TICKS_COUNT = 20
RAW_MAX_BYTES = 4 * 1024
_FAR_ROUNDS_COUNT = 1 << 40
_SPOKEN_KEPT_COUNT = 16
_RAW_KINDS = (
    FrameKind.VOTE,
    FrameKind.PROPOSAL,
    FrameKind.TIMEOUT,
    FrameKind.NOTICE,
    FrameKind.TRANSACTIONS,
    FrameKind.HEIGHT,
    FrameKind.RESPONSE,
)


class Garbage(Behaviour):
    """Sends nearly right messages each tick, sometimes malformed bytes that cost the link."""

    name: ClassVar[str] = "garbage"

    def __init__(self, inner: Outbox, liar: ByzantineContext) -> None:
        super().__init__(inner, liar)
        self._spoken: BoundedCache[int, Message] = BoundedCache()
        self._said_count = 0
        self._ticks_count = 0

    def broadcast(self, message: Message) -> None:
        self._said_count += 1
        self._spoken.keep(self._said_count % _SPOKEN_KEPT_COUNT, message)
        super().broadcast(message)

    def tick(self) -> None:
        super().tick()
        self._ticks_count += 1
        for _ in range(MESSAGES_PER_TICK_COUNT):
            self._inner.broadcast(self._chance.choice(self._makers())())
        if self._ticks_count % RAW_EVERY_TICKS_COUNT == 0:
            kind = self._chance.choice(_RAW_KINDS)
            size = self._chance.randint(0, min(RAW_MAX_BYTES, FRAME_MAX_BYTES[kind]))
            self._own.send_raw(kind, self._chance.randbytes(size))

    def _makers(self) -> list[Callable[[], Message]]:
        made: list[Callable[[], Message]] = [
            self._strange_vote,
            self._strange_block,
            self._strange_notice,
            self._strange_answer,
        ]
        return [*made, self._twisted] if self._spoken else made

    def _twisted(self) -> Message:
        message = self._spoken[self._chance.choice(list(self._spoken))]
        if isinstance(message, Vote | Timeout):
            changes: list[dict[str, object]] = [
                {"signature": self._chance.randbytes(COMPACT_SIGNATURE_SIZE_BYTES)},
                {"index": self._chance.choice((-1, 1 << 20, (message.index + 1) % self._own.producers_count))},
                {"round": message.round + self._chance.choice((-1, 1, _FAR_ROUNDS_COUNT))},
                {"epoch": message.epoch + self._chance.choice((-1, 1, 1 << 30))},
            ]
            return msgspec.structs.replace(message, **self._chance.choice(changes))
        if isinstance(message, Proposal):
            block = message.block
            wires = (*block.transactions, self._chance.randbytes(64))
            return Proposal(block=msgspec.structs.replace(block, transactions=wires))
        return self._strange_notice()

    def _strange_vote(self) -> Vote:
        return Vote(
            epoch=self._own.epoch,
            round=self._own.round + self._chance.randint(0, 1 << 16),
            block_id=self._chance.randbytes(self._chance.choice((0, 31, 32, 33))),
            index=self._chance.randint(0, self._own.producers_count),
            signature=self._chance.randbytes(self._chance.choice((0, 63, 64, 65))),
        )

    def _strange_block(self) -> Proposal:
        size = self._chance.choice((0, 1, 200, 4_000))
        return Proposal(
            block=Block(
                header_bytes=self._chance.randbytes(size),
                signature=self._chance.randbytes(COMPACT_SIGNATURE_SIZE_BYTES),
                transactions=(self._chance.randbytes(32),),
            )
        )

    def _strange_answer(self) -> LastSignedResponse:
        return LastSignedResponse(
            epoch=self._own.epoch,
            asked_at_ms=self._chance.randint(-1, 1 << 44),
            signing_state=self._chance.choice(("signing", "locked-out", "")),
            signed_round=self._own.round + self._chance.randint(-1, _FAR_ROUNDS_COUNT),
            message=None,
            qc=self._strange_notice().qc,
            entered_by=None,
        )

    def _strange_notice(self) -> CertificateNotice:
        signature = self._chance.randbytes(COMPACT_SIGNATURE_SIZE_BYTES)
        votes = tuple(IndexedSignature(index=index, signature=signature) for index in range(self._own.producers_count))
        qc = QuorumCertificate(
            epoch=self._own.epoch, round=self._own.round + 1, block_id=self.made_up_id(), votes=votes
        )
        return CertificateNotice(qc=qc, entered_by=None)
