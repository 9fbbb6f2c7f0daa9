"""Decides which missing blocks to request, and when again."""

from __future__ import annotations

from consensus.chain.block import QuorumCertificate
from consensus.limits import UNEXECUTED_BLOCKS_MAX_COUNT
from consensus.protocol.block_tree import BlockNode, BlockTree, Execution
from consensus.protocol.effects import TIMER_FETCH, CancelTimer, Effect, FetchBlocks, SetTimer


class Fetcher:
    """Requests the first missing ancestors, again every `retry_ms`."""

    def __init__(self, own_index: int | None, retry_ms: int) -> None:
        self._own_index = own_index
        self._retry_ms = retry_ms
        self._asked: bytes | None = None
        self._above_height = 0

    def note_progress(self, connected: list[BlockNode]) -> None:
        if connected and self._asked is not None:
            self._asked = b""
            self._above_height = max(node.header.height for node in connected)

    def retry(self) -> None:
        """No answer: request everything above the finalized head again."""
        self._above_height = 0
        if self._asked is not None:
            self._asked = b""

    def ask(self, tree: BlockTree, wanted: list[bytes], everyone: int, round_number: int) -> list[Effect]:
        missing: tuple[bytes, QuorumCertificate | None] | None = None
        for block_id in wanted:
            missing = missing or tree.missing_ancestor(block_id)
        if missing is None:
            asked, self._asked, self._above_height = self._asked, None, 0
            return [] if asked is None else [CancelTimer(kind=TIMER_FETCH)]
        block_id, qc = missing
        if block_id == self._asked or (self._asked == b"" and self._is_digesting(tree)):
            return []
        signers = {vote.index for vote in qc.votes} if qc is not None else set(range(everyone))
        self._asked = block_id
        return [
            FetchBlocks(
                block_id=block_id,
                above_height=max(self._above_height, tree.root.header.height),
                producers=tuple(sorted(signers - {self._own_index})),
            ),
            SetTimer(kind=TIMER_FETCH, round=round_number, delay_ms=self._retry_ms),
        ]

    @staticmethod
    def _is_digesting(tree: BlockTree) -> bool:
        unexecuted = sum(node.execution in (Execution.WAITING, Execution.RUNNING) for node in tree.nodes.values())
        return unexecuted >= UNEXECUTED_BLOCKS_MAX_COUNT
