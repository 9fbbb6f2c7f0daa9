"""A producer that lies: two proposals, votes for everything, half of its words to half of the peers, help for nobody."""

from __future__ import annotations

import msgspec

from consensus.chain.block import Block
from consensus.chain.messages import Proposal, sign_block, sign_vote
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from consensus.protocol.effects import Message
from tests.sim.core_node import SimNode
from tests.sim.named_chain import CHAIN_ID


class LyingNode(SimNode):
    """It runs the production core, and says whatever suits it besides. What it says is not checked."""

    def send(self, peer: int, message: Message) -> None:
        """Say it to some only; of an own proposal, show some another one."""
        if peer == self.number or self.cluster.random.random() < 0.4:
            return
        if isinstance(message, Proposal) and self.cluster.random.random() < 0.5:
            message = Proposal(block=self.twin_of(message.block))
        self.cluster.transmit(self.number, peer, lambda: self.cluster.nodes[peer].receive(self.number, message))

    def twin_of(self, block: Block) -> Block:
        """Return another block of the same round."""
        assert self.key is not None
        header = msgspec.structs.replace(block.header, timestamp_ms=block.header.timestamp_ms + 1)
        data = encode(header)
        signature = sign_block(self.key, CHAIN_ID, header.epoch, header.round, sha256(data))
        return msgspec.structs.replace(block, header_bytes=data, signature=signature)

    def receive(self, sender: int, message: Message) -> None:
        """Vote for every proposal, valid or not, however late."""
        index = self.index_of(self.number)
        if self.is_up and isinstance(message, Proposal) and self.key is not None and index is not None:
            header = message.block.header
            vote = sign_vote(self.key, CHAIN_ID, header.epoch, header.round, message.block.block_id, index)
            for peer in range(len(self.cluster.nodes)):
                self.send(peer, vote)
        super().receive(sender, message)

    def tell_epoch(self, peer: int) -> None:
        """Let others find out for themselves that an epoch has begun."""

    def serve(self, asker: int, block_id: bytes, above: int) -> None:
        """Give nobody blocks."""

    def serve_sync(self, asker: int, above: int) -> None:
        """Give nobody finalized blocks either."""
