"""When and on what a leader proposes; voters judge safety."""

from __future__ import annotations

from consensus.chain.block import QuorumCertificate, TimeoutCertificate
from consensus.chain.epoch_settings import ChainSettings
from consensus.limits import UNFINALIZED_BLOCKS_MAX_COUNT
from consensus.protocol.block_tree import BlockNode
from consensus.protocol.effects import BuildBlock
from consensus.protocol.pacemaker import Pacemaker


class Proposer:
    """The leader's turn: at most one block per round."""

    def __init__(self, settings: ChainSettings, pacemaker: Pacemaker) -> None:
        self._settings = settings
        self._pacemaker = pacemaker
        self._building_round = 0
        self._pushed_round = 0
        self._has_failed = False

    def push(self, round_number: int) -> None:
        self._pushed_round = round_number

    def is_building(self, round_number: int) -> bool:
        return self._building_round >= round_number

    def note_failure(self) -> None:
        """Building failed: wait for the timer, avoiding a busy loop."""
        self._has_failed = True

    def retry(self) -> None:
        if self._has_failed:
            self._building_round = 0
        self._has_failed = False

    def delay_ms(
        self,
        parent: BlockNode,
        branch: list[BlockNode],
        *,
        now_ms: int,
        pending: bool,
        at_once: bool,
        round_number: int,
    ) -> int | None:
        """R3: return the ms until proposing on `parent`, None without reason.

        `branch` is certified and unfinalized; `at_once`: the round began with a TC or timeout.
        """
        interval_ms = self._pacemaker.interval_ms
        if interval_ms is None:
            return 0 if self._pushed_round == round_number else None
        if at_once:
            return 0
        if interval_ms:
            return min(interval_ms, max(0, parent.header.timestamp_ms + interval_ms - now_ms))
        if self._pacemaker.heartbeat_due or any(node.block.transactions or node.header.ends_epoch for node in branch):
            return 0
        if pending:
            return max(0, parent.arrived_ms + self._settings.min_block_interval_ms - now_ms)
        return None

    def build(
        self,
        round_number: int,
        parent: BlockNode,
        branch: list[BlockNode],
        *,
        qc: QuorumCertificate,
        entered_by: TimeoutCertificate | None,
        epoch: int,
        producer: int,
    ) -> BuildBlock:
        """Order a block on `parent` with highest QC `qc`; only closing ones follow boundaries (R21)."""
        closing = parent.header.ends_epoch and parent.header.epoch == epoch
        self._building_round = round_number
        self._has_failed = False
        return BuildBlock(
            epoch=epoch,
            round=round_number,
            height=parent.header.height + 1,
            parent_id=parent.block_id,
            parent_timestamp_ms=parent.header.timestamp_ms,
            qc=qc,
            tc=None if qc.round == round_number - 1 else entered_by,
            producer=producer,
            empty=closing or len(branch) >= UNFINALIZED_BLOCKS_MAX_COUNT,
            closing=closing,
        )
