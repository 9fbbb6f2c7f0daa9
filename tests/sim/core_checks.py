"""What must never happen in a history of cores, checked as it happens."""

from __future__ import annotations

from dataclasses import dataclass, field

from consensus.chain.block import Header
from consensus.chain.messages import Proposal, Timeout, Vote
from consensus.protocol.effects import Message

Place = tuple[int, int, int]
"""(node, epoch, round)."""


@dataclass
class Violations:
    """One block a height, and one word a producer and round."""

    final: dict[int, bytes] = field(default_factory=dict)
    proposals: dict[Place, bytes] = field(default_factory=dict)
    votes: dict[Place, bytes] = field(default_factory=dict)
    timeouts: dict[Place, bytes] = field(default_factory=dict)

    def check_final(self, header: Header, block_id: bytes) -> None:
        assert not header.is_closing, f"a closing block is final at height {header.height}"
        known = self.final.setdefault(header.height, block_id)
        assert known == block_id, f"two blocks are final at height {header.height}"

    def check_message(self, sender: int, message: Message) -> None:
        """No two votes, timeouts or own proposals of one round, and no new vote after a timeout of the round."""
        if isinstance(message, Vote):
            place = (sender, message.epoch, message.round)
            assert place in self.votes or place not in self.timeouts, f"{place} voted after a timeout"
            assert self.votes.setdefault(place, message.block_id) == message.block_id, f"{place} voted twice"
        elif isinstance(message, Timeout):
            place = (sender, message.epoch, message.round)
            assert self.timeouts.setdefault(place, message.signature) == message.signature, f"{place} changed a timeout"
        elif isinstance(message, Proposal):
            header = message.block.header
            place = (sender, header.epoch, header.round)
            block_id = message.block.block_id
            assert self.proposals.setdefault(place, block_id) == block_id, f"{place} proposed twice"
