"""Lies about certificates: stale ones and forged ones."""

from __future__ import annotations

from typing import ClassVar

import msgspec

from consensus.chain.block import (
    Header,
    IndexedSignature,
    QuorumCertificate,
    TimeoutCertificate,
    TimeoutSignature,
)
from consensus.chain.messages import (
    TIMEOUT_TAG,
    VOTE_TAG,
    CertificateNotice,
    LastSignedResponse,
    Proposal,
    Timeout,
    timeout_parts,
    vote_parts,
)
from consensus.primitives.keys import COMPACT_SIGNATURE_SIZE_BYTES
from consensus.protocol.effects import Message
from network.byzantine.behaviour import Behaviour, BoundedCache, ByzantineContext
from node.consensus.engine import Outbox

_ROUNDS_AHEAD_MAX_COUNT = 50


class StaleCertificates(Behaviour):
    """Denies newer certificates in timeouts, builds on old parents, announces old certificates."""

    name: ClassVar[str] = "stale-certificates"

    def __init__(self, inner: Outbox, liar: ByzantineContext) -> None:
        super().__init__(inner, liar)
        self._known: BoundedCache[int, QuorumCertificate] = BoundedCache()
        self._parents: BoundedCache[bytes, Header] = BoundedCache()
        self._said: BoundedCache[tuple[str, int], Message] = BoundedCache()

    def broadcast(self, message: Message) -> None:
        self._learn(message)
        super().broadcast(self._bent(message))
        old = self._old(below=self._own.round)
        if old is not None and self._chance.random() < 0.25:
            super().broadcast(CertificateNotice(qc=old, entered_by=None))

    def send_to(self, index: int, message: Message) -> None:
        old = self._old(below=self._own.round)
        if isinstance(message, CertificateNotice) and old is not None:
            message = CertificateNotice(qc=old, entered_by=None)
        elif isinstance(message, LastSignedResponse):
            signed_round = 0 if old is None else old.round
            qc = message.qc if old is None else old
            message = msgspec.structs.replace(message, message=None, signed_round=signed_round, qc=qc, entered_by=None)
        super().send_to(index, self._bent(message))

    def _learn(self, message: Message) -> None:
        qc = self._own.high_qc
        parent = self._own.header(qc.block_id)
        if parent is not None:
            self._parents.keep(qc.block_id, parent)
        if qc.epoch != self._own.epoch:
            return
        if any(known.epoch != qc.epoch for known in self._known.values()):
            self._known.clear()
        if isinstance(message, Timeout | Proposal):
            self._known.keep(qc.round, qc)

    def _old(self, below: int) -> QuorumCertificate | None:
        rounds = sorted(number for number in self._known if number < below)[:-1]
        return self._known[self._chance.choice(rounds)] if rounds else None

    def _bent(self, message: Message) -> Message:
        if isinstance(message, Timeout):
            place = ("timeout", message.round)
            return self._said.get(place) or self._said.keep(place, self._stale_timeout(message))
        if isinstance(message, Proposal) and self.is_own(message.block):
            place = ("proposal", message.block.header.round)
            return self._said.get(place) or self._said.keep(place, self._stale_proposal(message))
        return message

    def _stale_timeout(self, timeout: Timeout) -> Timeout:
        old = self._old(below=timeout.qc.round + 1)
        return timeout if old is None else self.timeout_with(timeout, old, timeout.entered_by)

    def _stale_proposal(self, proposal: Proposal) -> Proposal:
        block = proposal.block
        old = self._old(below=block.header.qc.round)
        parent = None if old is None else self._parents.get(old.block_id)
        if old is None or parent is None:
            return proposal
        changed = self.rewrite(
            block,
            height=parent.height + 1,
            parent_id=old.block_id,
            qc=old,
            timestamp_ms=max(parent.timestamp_ms + 1, block.header.timestamp_ms),
        )
        return Proposal(block=changed)


class ForgedCertificates(Behaviour):
    """Accompanies each honest message with one on a forged certificate."""

    name: ClassVar[str] = "forged-certificates"

    def broadcast(self, message: Message) -> None:
        if isinstance(message, Proposal) and self.is_own(message.block) and self._chance.random() < 0.5:
            forged = self._forge_qc(max(1, message.block.header.round - 1))
            message = Proposal(block=self.rewrite(message.block, qc=forged, parent_id=forged.block_id, tc=None))
        super().broadcast(message)
        if self._own.index is None:
            return
        ahead = self._own.round + self._chance.randint(0, _ROUNDS_AHEAD_MAX_COUNT)
        if isinstance(message, Timeout):
            super().broadcast(self.timeout_with(message, self._forge_qc(message.round - 1), None))
            super().broadcast(self.timeout_with(message, message.qc, self._forge_tc(ahead), ahead + 1))
        else:
            tc = self._forge_tc(ahead) if self._chance.random() < 0.5 else None
            super().broadcast(CertificateNotice(qc=self._forge_qc(ahead), entered_by=tc))

    def send_to(self, index: int, message: Message) -> None:
        if isinstance(message, LastSignedResponse):
            ahead = self._own.round + self._chance.randint(1, _ROUNDS_AHEAD_MAX_COUNT)
            qc, tc = self._forge_qc(ahead), self._forge_tc(ahead)
            message = msgspec.structs.replace(message, signed_round=ahead, qc=qc, entered_by=tc)
        super().send_to(index, message)

    @property
    def _quorum(self) -> int:
        count = self._own.producers_count
        return count - (count - 1) // 3

    def _forge_qc(self, round_number: int) -> QuorumCertificate:
        """Forgeries: one hand for all, one short, duplicate signer, moved, noise."""
        real = self._own.high_qc
        kinds = ["one hand", "noise", "no votes"] + (["too few", "twice", "moved"] if len(real.votes) > 1 else [])
        kind = self._chance.choice(kinds)
        if kind == "too few":
            return msgspec.structs.replace(real, votes=real.votes[:-1])
        if kind == "twice":
            return msgspec.structs.replace(real, votes=(*real.votes[:-1], real.votes[0]))
        block_id = self.made_up_id()
        if kind == "moved":
            return msgspec.structs.replace(real, round=max(1, round_number), block_id=block_id)
        signature = self._chance.randbytes(COMPACT_SIGNATURE_SIZE_BYTES)
        if kind == "one hand":
            parts = vote_parts(self._own.chain_id, self._own.epoch, max(1, round_number), block_id)
            signature = self._key.sign_compact(VOTE_TAG, *parts)
        votes = tuple(IndexedSignature(index=index, signature=signature) for index in range(self._quorum))
        return QuorumCertificate(
            epoch=self._own.epoch,
            round=max(1, round_number),
            block_id=block_id,
            votes=() if kind == "no votes" else votes,
        )

    def _forge_tc(self, round_number: int) -> TimeoutCertificate:
        number = max(1, round_number)
        parts = timeout_parts(self._own.chain_id, self._own.epoch, number, 0)
        signature = self._key.sign_compact(TIMEOUT_TAG, *parts)
        own = self._own.index or 0
        is_repeated = self._chance.random() < 0.5
        indexes = [own] * self._quorum if is_repeated else list(range(self._quorum))
        return TimeoutCertificate(
            epoch=self._own.epoch,
            round=number,
            timeouts=tuple(TimeoutSignature(index=index, qc_round=0, signature=signature) for index in indexes),
        )
