"""Bounded collectors of checked votes and timeouts; one per producer and round."""

from __future__ import annotations

from consensus.chain.block import IndexedSignature, QuorumCertificate, TimeoutCertificate, TimeoutSignature
from consensus.chain.messages import Timeout, Vote


class VoteCollector:
    """The votes of the rounds above the highest QC."""

    def __init__(self, quorum: int) -> None:
        self._quorum = quorum
        self._rounds: dict[int, dict[int, Vote]] = {}

    def has(self, vote: Vote) -> bool:
        return vote.index in self._rounds.get(vote.round, {})

    def add(self, vote: Vote) -> QuorumCertificate | None:
        """Count a vote; return a completed QC (exactly q votes, sorted by index)."""
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
        for old in [number for number in self._rounds if number <= round_number]:
            del self._rounds[old]

    def __len__(self) -> int:
        return sum(len(votes) for votes in self._rounds.values())


class TimeoutCollector:
    """The timeouts of the node's own round."""

    def __init__(self, quorum: int) -> None:
        self._quorum = quorum
        self._timeouts: dict[int, Timeout] = {}

    def add(self, timeout: Timeout) -> TimeoutCertificate | None:
        """Count a timeout; return a completed TC (exactly q, sorted by index)."""
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
        self._timeouts.clear()

    def __len__(self) -> int:
        return len(self._timeouts)
