"""What the journal keeps: blocks stay until the synced store has them (R12)."""

from __future__ import annotations

from collections.abc import Sequence

from consensus.chain.block import Block, QuorumCertificate, TimeoutCertificate
from consensus.chain.journal_records import KIND_STATE, JournalRecord, JournalState, encode_block_record
from consensus.chain.messages import Timeout, Vote
from consensus.limits import UNSTORED_BLOCKS_MAX_COUNT
from consensus.primitives.encoding import encode
from consensus.protocol.block_tree import BlockNode


class JournalBuilder:
    """Tracks journalled blocks and finalized ones not yet synced."""

    def __init__(self, epoch: int, restored: JournalState) -> None:
        self._epoch = epoch
        self._journalled: set[bytes] = set(restored.blocks)
        self._unstored: dict[bytes, BlockNode] = {}

    @property
    def is_behind(self) -> bool:
        return len(self._unstored) >= UNSTORED_BLOCKS_MAX_COUNT

    def unstored(self) -> list[BlockNode]:
        return list(self._unstored.values())

    def get_unstored(self, block_id: bytes) -> Block | None:
        node = self._unstored.get(block_id)
        return None if node is None else node.block

    def note_finalized(self, nodes: Sequence[BlockNode]) -> None:
        for node in nodes:
            self._unstored[node.block_id] = node

    def forget(self, stored_height: int) -> None:
        for block_id, node in list(self._unstored.items()):
            if node.header.height <= stored_height:
                del self._unstored[block_id]
                self._journalled.discard(block_id)

    def write(
        self,
        kind: str,
        *,
        branch: Sequence[BlockNode],
        last_voted_round: int,
        high_qc: QuorumCertificate,
        entered_by: TimeoutCertificate | None,
        proposed_id: bytes | None = None,
        vote: Vote | None = None,
        timeout: Timeout | None = None,
    ) -> bytes:
        ancestry = [*self._unstored.values(), *branch] if branch else []
        fresh = [node for node in ancestry if node.block_id not in self._journalled]
        self._journalled.update(node.block_id for node in fresh)
        return encode(
            JournalRecord(
                kind=kind,
                epoch=self._epoch,
                last_voted_round=last_voted_round,
                blocks=tuple(node.block for node in fresh),
                high_qc=high_qc,
                entered_by=entered_by,
                proposed_id=proposed_id,
                vote=vote,
                timeout=timeout,
                lockout=None,
            )
        )

    def snapshot(self, tree: Sequence[BlockNode], state: JournalState) -> tuple[bytes, ...]:
        needed = {node.block_id: node for node in [*self._unstored.values(), *tree]}
        kept = [node for block_id, node in needed.items() if block_id in self._journalled]
        kept.sort(key=lambda node: node.header.height)
        self._journalled = {node.block_id for node in kept}
        record = JournalRecord(
            kind=KIND_STATE,
            epoch=self._epoch,
            last_voted_round=state.last_voted_round,
            blocks=(),
            high_qc=state.high_qc,
            entered_by=state.entered_by,
            proposed_id=state.proposed_id,
            vote=state.vote,
            timeout=state.timeout,
            lockout=state.lockout,
        )
        return (*(encode_block_record(self._epoch, node.block) for node in kept), encode(record))
