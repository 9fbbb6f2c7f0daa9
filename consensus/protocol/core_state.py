"""A node's consensus state: round, certificates and tree; actions are in `core.py`."""

from __future__ import annotations

from collections.abc import Sequence

from consensus.chain.block import Block, Header, QuorumCertificate
from consensus.chain.epoch_settings import ChainSettings
from consensus.chain.journal_records import JournalState, read_journal
from consensus.chain.message_checks import MessageChecks
from consensus.chain.schedule import Schedule
from consensus.chain.signature_cache import SignatureCache, SignatureCheck
from consensus.primitives.keys import PrivateKey
from consensus.protocol.block_fetching import Fetcher
from consensus.protocol.block_tree import BlockNode, BlockTree, make_node
from consensus.protocol.effects import Effect
from consensus.protocol.message_log import MessageLog
from consensus.protocol.pacemaker import Pacemaker
from consensus.protocol.proposer import Proposer
from consensus.protocol.vote_collectors import TimeoutCollector, VoteCollector
from consensus.protocol.voter import Voter


class CoreState:
    """One core's state, restored from store head and journal."""

    def __init__(
        self,
        settings: ChainSettings,
        chain_id: bytes,
        schedule: Schedule,
        key: PrivateKey | None,
        *,
        finalized: Block,
        finalized_qc: QuorumCertificate,
        round_zero_id: bytes,
        journal: Sequence[bytes] = (),
        check: SignatureCheck | None = None,
        before: CoreState | None = None,
    ) -> None:
        """Begin above `finalized`, the synced store's head, in the schedule's epoch.

        `round_zero_id`: genesis or boundary (R23). `before`: the previous epoch's core; speaking in it skips asking
        (R36, R37). Raises ENCODING_*.
        """
        if finalized_qc.epoch != schedule.epoch:
            raise AssertionError("the certificate of the finalized head is of another epoch")
        self._schedule = schedule
        check = check or SignatureCache()
        self._genuine = MessageChecks(chain_id, schedule, round_zero_id, check)
        self._tree = BlockTree(finalized, finalized_qc)
        self._votes = VoteCollector(schedule.quorum)
        self._timeouts = TimeoutCollector(schedule.quorum)
        self._pacemaker = Pacemaker(settings, schedule)
        self._leading = Proposer(settings, self._pacemaker)
        kept = [] if before is None else before._later_records
        restored = read_journal([*kept, *journal], schedule.epoch)
        self._later_records: list[bytes] = restored.later
        self._voter = Voter(settings, chain_id, schedule, key, restored)
        if before is not None:
            signing_guard = before._voter.signing_guard
            self._voter.signing_guard = signing_guard.next(
                schedule, self._voter.index, settings.base_timeout_ms, boundary_round=before._tree.root.header.round
            )
        self._witness = MessageLog(chain_id, schedule, self._voter.index, check)
        self._fetcher = Fetcher(self._voter.index, settings.base_timeout_ms)
        self._retry_ms = max(1, settings.base_timeout_ms // 4)
        self._effects: list[Effect] = []
        self._now_ms = 0
        self._dirty = True
        self._branch: list[BlockNode] | None = None
        self._pending = False
        self._proposal_seen_round = 0
        self._timeout_seen_round = 0
        self._noticed: dict[int, int] = {}
        self.halted = ""
        self._restore(restored, finalized_qc)
        self._recall(restored, finalized, finalized_qc)
        self._note_end()

    def _restore(self, restored: JournalState, finalized_qc: QuorumCertificate) -> None:
        self.high_qc = finalized_qc
        if restored.high_qc is not None and restored.high_qc.round > finalized_qc.round:
            self.high_qc = restored.high_qc
        self.entered_by = restored.entered_by
        if self.entered_by is not None and self.entered_by.round <= self.high_qc.round:
            self.entered_by = None
        self.round = 1 + (self.high_qc.round if self.entered_by is None else self.entered_by.round)
        nodes = sorted((make_node(block, 0) for block in restored.blocks.values()), key=lambda node: node.header.height)
        for qc in [self.high_qc, *(node.header.qc for node in nodes)]:
            self._tree.certify(qc)
        for node in nodes:
            if self._tree.may_add(node.block_id, node.header):
                self._tree.add(node)

    def _recall(self, restored: JournalState, finalized: Block, finalized_qc: QuorumCertificate) -> None:
        self._witness.enter(self.round)
        self._witness.note_blocks([finalized, *restored.blocks.values()])
        for qc in (finalized_qc, self.high_qc):
            self._witness.note_qc(qc)
        if self.entered_by is not None:
            self._witness.note_tc(self.entered_by)
        head, is_alone = finalized.header, len(self._schedule.producers) == 1 and self.index is not None
        if is_alone and head.epoch == self.epoch and head.round > 0:
            # Alone, it certified the head's child too: it has nobody to ask what it said above that.
            self._voter.last_voted_round = max(self._voter.last_voted_round, head.round + 1)

    def _note_end(self) -> None:
        head = self._tree.root.header
        self._voter.has_ended = head.epoch > self.epoch or (head.epoch == self.epoch and head.is_boundary)

    # What others may look at

    @property
    def epoch(self) -> int:
        return self._schedule.epoch

    @property
    def schedule(self) -> Schedule:
        return self._schedule

    @property
    def index(self) -> int | None:
        return self._voter.index

    @property
    def last_voted_round(self) -> int:
        return self._voter.last_voted_round

    @property
    def leader(self) -> int:
        return self._schedule.leader(self.round)

    @property
    def finalized(self) -> Header:
        return self._tree.root.header

    @property
    def finalized_id(self) -> bytes:
        return self._tree.root.block_id

    @property
    def has_ended(self) -> bool:
        return self._voter.has_ended

    @property
    def has_timed_out(self) -> bool:
        return self._voter.has_timed_out(self.round)

    @property
    def is_busy(self) -> bool:
        branch = self._certified_branch()
        return (
            self._pending
            or branch is None
            or any(node.block.transactions or node.header.ends_epoch for node in branch)
            or self.round in (self._proposal_seen_round, self._timeout_seen_round)
            or self.has_timed_out
            or self._pacemaker.heartbeat_due
            or bool(self._pacemaker.interval_ms)
        )

    def certified_branch(self) -> list[bytes]:
        """Return certified ids above the finalized head, oldest first (empty if any miss)."""
        return [node.block_id for node in self._certified_branch() or []]

    def block(self, block_id: bytes) -> Block | None:
        node = self._tree.get(block_id) or self._tree.orphans.get(block_id)
        return self._voter.journal_builder.get_unstored(block_id) if node is None else node.block

    def branch(self, block_id: bytes, above_height: int) -> list[Block]:
        path = self._tree.branch(block_id)
        if path is None:
            return []
        ancestry = [*self._voter.journal_builder.unstored(), *path]
        return [node.block for node in ancestry if node.header.height > above_height]

    def forget_journalled(self, stored_height: int) -> None:
        """The synced store holds all blocks to this height; unjournal them (R12)."""
        self._voter.journal_builder.forget(stored_height)

    def journal_snapshot(self) -> tuple[bytes, ...]:
        blocks = [*self._tree.nodes.values(), *self._tree.orphans.values()]
        own = self._voter.snapshot(blocks, self.high_qc, self.entered_by)
        return (*self._later_records, *own)  # the own ones last: the last word about a silence is theirs

    def _certified_branch(self) -> list[BlockNode] | None:
        if self._dirty:
            self._branch = self._tree.branch(self.high_qc.block_id)
        return self._branch
