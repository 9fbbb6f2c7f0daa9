"""Lies about epochs: past or future messages, old certificates."""

from __future__ import annotations

from typing import Any, ClassVar

import msgspec

from consensus.chain.block import Block, QuorumCertificate, TimeoutCertificate
from consensus.chain.messages import (
    SIGNING,
    CertificateNotice,
    LastSignedRequest,
    LastSignedResponse,
    Proposal,
    Timeout,
    Vote,
    sign_timeout,
    sign_vote,
)
from consensus.primitives.encoding import encode
from consensus.protocol.effects import Message
from network.byzantine.behaviour import Behaviour, ByzantineContext
from node.consensus.engine import Outbox
from node.p2p.wire import FrameKind, HeightNotice

_FAR_EPOCHS_COUNT = 1_000
_CERTIFICATES_KEPT_MAX_COUNT = 8
_TICKS_A_CLAIM = 10


class WrongEpochs(Behaviour):
    """Repeats messages in other epochs, genuinely signed, and presents old epochs' certificates as current."""

    name: ClassVar[str] = "wrong-epochs"

    def __init__(self, inner: Outbox, liar: ByzantineContext) -> None:
        super().__init__(inner, liar)
        self._genuine: list[QuorumCertificate] = []
        self._last: Vote | Timeout | Block | None = None
        self._seat = 0
        self._ticks = 0

    def broadcast(self, message: Message) -> None:
        self._learn(message)
        super().broadcast(message)
        moved = self._moved(message)
        if moved is not None:
            super().broadcast(moved)

    def send_to(self, index: int, message: Message) -> None:
        if isinstance(message, LastSignedResponse):
            message = msgspec.structs.replace(message, epoch=self._another_epoch(), qc=self._old_certificate())
        super().send_to(index, message)

    def tick(self) -> None:
        """Every half second claim a later epoch; vote, propose and time out there."""
        super().tick()
        self._ticks += 1
        if self._ticks % _TICKS_A_CLAIM:
            return
        self._learn(None)
        epoch = self._another_epoch()
        self._own.send_raw(FrameKind.HEIGHT, encode(HeightNotice(finalized_height=0, epoch=epoch)))
        old = self._old_certificate()
        for message in (
            CertificateNotice(qc=old, entered_by=None),
            CertificateNotice(qc=msgspec.structs.replace(old, epoch=self._own.epoch), entered_by=None),
            LastSignedRequest(epoch=epoch, asked_at_ms=self._ticks),
            LastSignedResponse(epoch, self._ticks, SIGNING, old.round, None, old, None),
            self._vote(epoch, self._own.round, self.made_up_id()),
            self._timeout(epoch, self._own.round, old, None),
        ):
            super().broadcast(message)
        if self._last is not None:
            moved = self._moved(self._last if not isinstance(self._last, Block) else Proposal(block=self._last))
            if moved is not None:
                super().broadcast(moved)

    def _learn(self, message: Message | None) -> None:
        qc = self._own.high_qc
        if qc not in self._genuine:
            self._genuine = [*self._genuine[-_CERTIFICATES_KEPT_MAX_COUNT:], qc]
        if self._own.index is not None:
            self._seat = self._own.index
        if isinstance(message, Vote | Timeout):
            self._last = message
        elif isinstance(message, Proposal):
            self._last = message.block

    def _another_epoch(self) -> int:
        now = self._own.epoch
        others = [now + 1, now + 2, now + self._chance.randint(3, _FAR_EPOCHS_COUNT)]
        return self._chance.choice([now - 1, *others] if now else others)

    def _old_certificate(self) -> QuorumCertificate:
        return self._chance.choice(self._genuine) if self._genuine else self._own.high_qc

    def _moved(self, message: Message) -> Message | None:
        epoch = self._another_epoch()
        if isinstance(message, Vote):
            return self._vote(epoch, message.round, message.block_id)
        if isinstance(message, Timeout):
            return self._timeout(epoch, message.round, self._old_certificate(), message.entered_by)
        if isinstance(message, Proposal) and self.is_own(message.block):
            old = self._old_certificate()
            lies: list[dict[str, Any]] = [{"epoch": epoch}, {"epoch": epoch, "qc": old}, {"qc": old, "tc": None}]
            changes = self._chance.choice(lies)
            return Proposal(block=self.rewrite(message.block, **changes))
        return None

    def _vote(self, epoch: int, round_number: int, block_id: bytes) -> Vote:
        return sign_vote(self._key, self._own.chain_id, epoch, round_number, block_id, self._seat)

    def _timeout(
        self, epoch: int, round_number: int, qc: QuorumCertificate, entered_by: TimeoutCertificate | None
    ) -> Timeout:
        return sign_timeout(self._key, self._own.chain_id, round_number, self._seat, qc, entered_by, epoch)
