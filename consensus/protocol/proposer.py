"""When and on what a leader proposes; voters judge safety."""

from __future__ import annotations

from consensus.chain.block import QuorumCertificate, TimeoutCertificate
from consensus.chain.epoch_settings import ChainSettings
from consensus.chain.schedule import Schedule
from consensus.limits import UNFINALIZED_BLOCKS_MAX_COUNT
from consensus.protocol.block_tree import BlockNode, BlockTree, Execution
from consensus.protocol.effects import BuildBlock, Effect
from consensus.protocol.pacemaker import Pacemaker


class Proposer:
    """The leader's turn: at most one block per round."""

    def __init__(
        self, settings: ChainSettings, schedule: Schedule, index: int | None, tree: BlockTree, pacemaker: Pacemaker
    ) -> None:
        self._schedule, self._index = schedule, index
        self._min_block_interval_ms = settings.min_block_interval_ms
        self._retry_ms = max(1, settings.base_timeout_ms // 4)
        self._tree = tree
        self._pacemaker = pacemaker
        self._building_round = 0
        self._pushed_round = 0
        self._has_failed = False

    def push(self, round_number: int) -> None:
        self._pushed_round = round_number

    def is_building(self, round_number: int) -> bool:
        return self._building_round >= round_number

    def note_failure(self, round_number: int) -> list[Effect]:
        """Building failed: wait for the timer, avoiding a busy loop."""
        self._has_failed = True
        return self._pacemaker.wait_to_propose(round_number, self._retry_ms)

    def retry(self) -> None:
        if self._has_failed:
            self._building_round = 0
        self._has_failed = False

    def lead(
        self,
        round_number: int,
        qc: QuorumCertificate,
        entered_by: TimeoutCertificate | None,
        now_ms: int,
        *,
        pending: bool,
        at_once: bool,
    ) -> list[Effect]:
        """Order a block on the one of the highest QC `qc`, or wait (R3).

        `at_once`: the round began with a TC or timeout.
        """
        if self._index is None or self._index != self._schedule.leader(round_number) or self.is_building(round_number):
            return []
        parent, branch = self._tree.get(qc.block_id), self._tree.branch(qc.block_id)
        if parent is None or branch is None or parent.execution is not Execution.VALID:
            return []
        wait_ms = self._delay_ms(round_number, parent, branch, now_ms, pending=pending, at_once=at_once)
        if wait_ms is None:
            return []
        if wait_ms > 0:
            return self._pacemaker.wait_to_propose(round_number, wait_ms)
        closing = parent.header.ends_epoch and parent.header.epoch == self._schedule.epoch
        self._building_round = round_number
        self._has_failed = False
        order = BuildBlock(
            epoch=self._schedule.epoch,
            round=round_number,
            height=parent.header.height + 1,
            parent_id=parent.block_id,
            parent_timestamp_ms=parent.header.timestamp_ms,
            qc=qc,
            tc=None if qc.round == round_number - 1 else entered_by,
            producer=self._index,
            empty=closing or len(branch) >= UNFINALIZED_BLOCKS_MAX_COUNT,
            closing=closing,  # only closing blocks follow a boundary (R21)
        )
        return [order]

    def _delay_ms(
        self, number: int, parent: BlockNode, branch: list[BlockNode], now_ms: int, *, pending: bool, at_once: bool
    ) -> int | None:
        """R3: return the ms until proposing on `parent` in this round, None without reason."""
        interval_ms = self._pacemaker.interval_ms
        if interval_ms is None:
            return 0 if self._pushed_round == number else None
        if at_once:
            return 0
        if interval_ms:
            return min(interval_ms, max(0, parent.header.timestamp_ms + interval_ms - now_ms))
        if self._pacemaker.heartbeat_due or any(node.block.transactions or node.header.ends_epoch for node in branch):
            return 0
        if pending:
            return max(0, parent.arrived_ms + self._min_block_interval_ms - now_ms)
        return None
