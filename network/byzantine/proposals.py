"""Lies about blocks: equivocation, withholding, partial sending, wrong roots, future stamps."""

from __future__ import annotations

from typing import Any, ClassVar

from consensus.chain.block import Block, compute_receipts_root, compute_transactions_root
from consensus.chain.messages import Proposal, Vote
from consensus.protocol.effects import Message
from network.byzantine.behaviour import Behaviour, BoundedCache, ByzantineContext
from node.consensus.engine import Outbox

_ROOT_BYTES = 32


class Equivocate(Behaviour):
    """Two genuine blocks per own round, each shown with a vote to one half."""

    name: ClassVar[str] = "equivocate"

    def __init__(self, inner: Outbox, liar: ByzantineContext) -> None:
        super().__init__(inner, liar)
        self._twins: BoundedCache[bytes, tuple[Block, list[int], list[int]] | None] = BoundedCache()

    def broadcast(self, message: Message) -> None:
        if isinstance(message, Proposal) and self.is_own(message.block):
            twins = self._twins_of(message.block)
            if twins is not None:
                self._split(message, Proposal(block=twins[0]), twins[1], twins[2])
                return
        elif isinstance(message, Vote):
            twins = self._twins.get(message.block_id)
            if twins is not None:
                self._split(message, self.vote_for(message, twins[0].block_id), twins[1], twins[2])
                return
        super().broadcast(message)

    def _split(self, first: Message, second: Message, first_half: list[int], second_half: list[int]) -> None:
        for index in first_half:
            self.send_to(index, first)
        for index in second_half:
            self.send_to(index, second)

    def _twins_of(self, block: Block) -> tuple[Block, list[int], list[int]] | None:
        block_id = block.block_id
        if block_id in self._twins:
            return self._twins[block_id]
        twin = self._twin(block)
        if twin is None:
            return self._twins.keep(block_id, None)
        header = block.header
        for known in (block_id, twin.block_id):
            self._accomplices.tell(header.epoch, header.round, known)
        return self._twins.keep(block_id, (twin, *self.halves()))

    def _twin(self, block: Block) -> Block | None:
        header = block.header
        parent = self._own.header(header.parent_id)
        if parent is None:
            return None
        return self.rewrite(
            block,
            transactions=(),
            timestamp_ms=header.timestamp_ms + 1,
            transactions_root=compute_transactions_root([]),
            receipts_root=compute_receipts_root(()),
            state_root=parent.state_root,
            next_schedule_hash=None,
            gas_used=0,
        )


class WithholdBlocks(Behaviour):
    """Withholds its own blocks, losing its rounds, but still votes."""

    name: ClassVar[str] = "withhold-blocks"

    def broadcast(self, message: Message) -> None:
        if not (isinstance(message, Proposal) and self.is_own(message.block)):
            super().broadcast(message)

    def send_to(self, index: int, message: Message) -> None:
        if not (isinstance(message, Proposal) and self.is_own(message.block)):
            super().send_to(index, message)


class PartialProposals(Behaviour):
    """Sends each block to a random non-empty subset of the others."""

    name: ClassVar[str] = "partial-proposals"

    def __init__(self, inner: Outbox, liar: ByzantineContext) -> None:
        super().__init__(inner, liar)
        self._shown: BoundedCache[bytes, list[int]] = BoundedCache()

    def broadcast(self, message: Message) -> None:
        if not (isinstance(message, Proposal) and self.is_own(message.block)):
            super().broadcast(message)
            return
        for index in self._chosen(message.block):
            self.send_to(index, message)

    def _chosen(self, block: Block) -> list[int]:
        block_id = block.block_id
        if block_id not in self._shown:
            others = self.others()
            count = self._chance.randint(1, max(1, len(others) - 1))
            self._shown.keep(block_id, sorted(self._chance.sample(others, min(count, len(others)))))
        return self._shown[block_id]


class WrongRoots(Behaviour):
    """Blocks with a wrong state root, receipt root or gas."""

    name: ClassVar[str] = "wrong-roots"

    def __init__(self, inner: Outbox, liar: ByzantineContext) -> None:
        super().__init__(inner, liar)
        self._wrong: BoundedCache[bytes, Block] = BoundedCache()

    def broadcast(self, message: Message) -> None:
        super().broadcast(self._bent(message))

    def send_to(self, index: int, message: Message) -> None:
        super().send_to(index, self._bent(message))

    def _bent(self, message: Message) -> Message:
        if isinstance(message, Proposal) and self.is_own(message.block):
            return Proposal(block=self._wrong_of(message.block))
        if isinstance(message, Vote) and message.block_id in self._wrong:
            return self.vote_for(message, self._wrong[message.block_id].block_id)
        return message

    def _wrong_of(self, block: Block) -> Block:
        block_id = block.block_id
        if block_id not in self._wrong:
            field = self._chance.choice(("state_root", "receipts_root", "transactions_root", "gas_used"))
            wrong: Any = 1 + block.header.gas_used if field == "gas_used" else self._chance.randbytes(_ROOT_BYTES)
            self._wrong.keep(block_id, self.rewrite(block, **{field: wrong}))
        return self._wrong[block_id]


class TimeLimit(Behaviour):
    """Stamps blocks as far ahead as accepted, through its clock (`byzantine_clock`)."""

    name: ClassVar[str] = "time-limit"
    bends_clock: ClassVar[bool] = True
