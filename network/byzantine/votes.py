"""Lies about votes: two in one round, or none."""

from __future__ import annotations

from typing import ClassVar

from consensus.chain.messages import Vote
from consensus.protocol.effects import Message
from network.byzantine.behaviour import Behaviour, BoundedCache, ByzantineContext
from node.consensus.engine import Outbox


class DoubleVote(Behaviour):
    """Votes twice per round: also for an accomplice's or nonexistent block."""

    name: ClassVar[str] = "double-vote"

    def __init__(self, inner: Outbox, liar: ByzantineContext) -> None:
        super().__init__(inner, liar)
        self._others: BoundedCache[bytes, list[Vote]] = BoundedCache()

    def broadcast(self, message: Message) -> None:
        if not isinstance(message, Vote):
            super().broadcast(message)
            return
        votes: list[Vote] = [message, *self._contradictions(message)]
        self._chance.shuffle(votes)
        for vote in votes:
            super().broadcast(vote)

    def _contradictions(self, vote: Vote) -> list[Vote]:
        rivals = self._accomplices.rivals(vote.epoch, vote.round, vote.block_id)
        if rivals or vote.block_id not in self._others:
            ids = rivals or [self.made_up_id()]
            self._others.keep(vote.block_id, [self.vote_for(vote, block_id) for block_id in ids])
        return self._others[vote.block_id]


class WithholdVotes(Behaviour):
    """Never sends a vote to others."""

    name: ClassVar[str] = "withhold-votes"

    def broadcast(self, message: Message) -> None:
        if not isinstance(message, Vote):
            super().broadcast(message)

    def send_to(self, index: int, message: Message) -> None:
        if not isinstance(message, Vote):
            super().send_to(index, message)
