"""Votes and timeouts on their way to a certificate. Must never count a producer twice, nor grow without bound.

Callers have checked signatures and ranges of indexes. For each round the first word of a producer counts; a second,
different one is ignored here.
"""

from __future__ import annotations

from consensus.chain.block import IndexedSignature, QuorumCertificate, TimeoutCertificate, TimeoutSignature
from consensus.chain.messages import Timeout, Vote


class VoteCollector:
    """The votes of the rounds above the highest QC."""

    def __init__(self, quorum: int) -> None:
        self._quorum = quorum
        self._rounds: dict[int, dict[int, Vote]] = {}

    def has(self, vote: Vote) -> bool:
        """Tell whether a vote of this producer in this round was counted already."""
        return vote.index in self._rounds.get(vote.round, {})

    def add(self, vote: Vote) -> QuorumCertificate | None:
        """Count a vote; return the certificate if it completes one (exactly q votes, sorted by index)."""
        votes = self._rounds.setdefault(vote.round, {})
        if vote.index in votes:
            return None
        votes[vote.index] = vote
        same = sorted(index for index, other in votes.items() if other.block_id == vote.block_id)
        if len(same) != self._quorum:
            return None
        signatures = tuple(IndexedSignature(index=index, signature=votes[index].signature) for index in same)
        return QuorumCertificate(epoch=vote.epoch, round=vote.round, block_id=vote.block_id, votes=signatures)

    def forget_up_to(self, round_number: int) -> None:
        """Drop the votes of this round and of those below it."""
        for old in [number for number in self._rounds if number <= round_number]:
            del self._rounds[old]

    def __len__(self) -> int:
        return sum(len(votes) for votes in self._rounds.values())


class TimeoutCollector:
    """The timeouts of one round: the node's own."""

    def __init__(self, quorum: int) -> None:
        self._quorum = quorum
        self._timeouts: dict[int, Timeout] = {}

    def add(self, timeout: Timeout) -> TimeoutCertificate | None:
        """Count a timeout; return the certificate if it completes one (exactly q timeouts, sorted by index)."""
        if timeout.index in self._timeouts:
            return None
        self._timeouts[timeout.index] = timeout
        if len(self._timeouts) != self._quorum:
            return None
        signatures = tuple(
            TimeoutSignature(index=index, qc_round=self._timeouts[index].qc.round, signature=entry.signature)
            for index, entry in sorted(self._timeouts.items())
        )
        return TimeoutCertificate(epoch=timeout.epoch, round=timeout.round, timeouts=signatures)

    def clear(self) -> None:
        """Forget all: the round is over."""
        self._timeouts.clear()

    def __len__(self) -> int:
        return len(self._timeouts)
