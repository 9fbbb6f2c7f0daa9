"""Mutants of what a producer says: votes, timeouts, proposals (R2, R4)."""

from __future__ import annotations

import pytest

from consensus.chain.messages import Proposal, sign_vote
from consensus.protocol.core import Core
from consensus.protocol.effects import Broadcast
from consensus.protocol.voter import Voter
from tests.sim.mutants.mutant import Mutant
from tests.sim.mutants.schedules import CHAOS, TWO_BLOCKS_FOR_ALL


def vote_for_every_proposal(patch: pytest.MonkeyPatch) -> None:
    """A second block of the round gets a vote too."""
    original = Core._on_proposal

    def on_proposal(self: Core, proposal: Proposal, sender: int | None) -> None:
        original(self, proposal, sender)
        voter, block = self._voter, proposal.block
        last = voter.last_vote
        is_second = last is not None and last.round == block.header.round and last.block_id != block.block_id
        if is_second and voter._key is not None and voter.index is not None:
            vote = sign_vote(voter._key, voter._chain_id, self.epoch, last.round, block.block_id, voter.index)
            self._effects.append(Broadcast(vote))

    patch.setattr(Core, "_on_proposal", on_proposal)


def vote_after_a_timeout(patch: pytest.MonkeyPatch) -> None:
    """Only votes forbid votes: a round that was given up may still get one."""

    def may_sign(self: Voter, round_number: int) -> bool:
        last = 0 if self.last_vote is None else self.last_vote.round
        return self.index is not None and not self._is_barred and round_number > last

    patch.setattr(Voter, "may_sign", may_sign)


SPEAKING = (
    Mutant("vote twice in a round", "R4", vote_for_every_proposal, TWO_BLOCKS_FOR_ALL, frozenset({"no_double_vote"})),
    Mutant("vote after a timeout", "R4", vote_after_a_timeout, CHAOS, frozenset({"no_double_vote"})),
)
