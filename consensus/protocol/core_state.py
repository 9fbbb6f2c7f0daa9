"""Where a node stands in consensus: its round, its certificates, its tree, and what others may look at.

Must never act: what follows from an event is `core.py`'s.
"""

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
    """The state of one core, restored from the store's head and the journal."""

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
        """Begin above `finalized`, the head of the synced store, certified by `finalized_qc`, in the schedule's epoch.

        `round_zero_id` is the block that round 0 of the epoch certifies: genesis, or the boundary before (R23).
        `journal` holds the records read back, in order. `before` is this process's core of the epoch before, if there
        is one: who speaks in it need not ask (R36), and what its journal knew of this epoch is said (R37). Raises
        ENCODING_* for a record that is none.
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
            returning = before._voter.returning
            self._voter.returning = returning.next(
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
        """R13: go on where the journal ends. Journalled blocks were checked when they were journalled."""
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
        """R33: the certificates at hand name the newest words of others; and one's own, should the journal lack them."""
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
        """R22: with its boundary final this epoch is over."""
        head = self._tree.root.header
        self._voter.has_ended = head.epoch > self.epoch or (head.epoch == self.epoch and head.is_boundary)

    # What others may look at

    @property
    def epoch(self) -> int:
        """The epoch of the schedule."""
        return self._schedule.epoch

    @property
    def schedule(self) -> Schedule:
        """The producers of the epoch."""
        return self._schedule

    @property
    def index(self) -> int | None:
        """This node's place in the schedule, None for a follower."""
        return self._voter.index

    @property
    def last_voted_round(self) -> int:
        """The last round in which this node voted or gave up: it votes only above it."""
        return self._voter.last_voted_round

    @property
    def leader(self) -> int:
        """The index of this round's leader."""
        return self._schedule.leader(self.round)

    @property
    def finalized(self) -> Header:
        """The header of the finalized head."""
        return self._tree.root.header

    @property
    def finalized_id(self) -> bytes:
        """The id of the finalized head."""
        return self._tree.root.block_id

    @property
    def has_ended(self) -> bool:
        """True once the boundary of this epoch is final (R22): the driver makes a core for the next one."""
        return self._voter.has_ended

    @property
    def has_timed_out(self) -> bool:
        """True if this node gave up the current round."""
        return self._voter.has_timed_out(self.round)

    @property
    def is_busy(self) -> bool:
        """R10: whether there is anything to wait for."""
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
        """Return the ids of the certified blocks above the finalized head, oldest first (empty while some miss)."""
        return [node.block_id for node in self._certified_branch() or []]

    def block(self, block_id: bytes) -> Block | None:
        """Return a block above the synced store, for a peer that asks."""
        node = self._tree.get(block_id) or self._tree.orphans.get(block_id)
        return self._voter.journalist.get_unstored(block_id) if node is None else node.block

    def branch(self, block_id: bytes, above_height: int) -> list[Block]:
        """Return this block and its known ancestors above a height, oldest first, for a peer that asks."""
        path = self._tree.branch(block_id)
        if path is None:
            return []
        ancestry = [*self._voter.journalist.unstored(), *path]
        return [node.block for node in ancestry if node.header.height > above_height]

    def forget_journalled(self, stored_height: int) -> None:
        """The synced store holds every block up to this height: the journal need not (R12)."""
        self._voter.journalist.forget(stored_height)

    def journal_snapshot(self) -> tuple[bytes, ...]:
        """Return the fewest records that say what the journal must say now; they replace it whole."""
        blocks = [*self._tree.nodes.values(), *self._tree.orphans.values()]
        own = self._voter.snapshot(blocks, self.high_qc, self.entered_by)
        return (*self._later_records, *own)  # the own ones last: the last word about a silence is theirs

    def _certified_branch(self) -> list[BlockNode] | None:
        """Return the certified blocks above the finalized head, oldest first; None while some are missing."""
        if self._dirty:
            self._branch = self._tree.branch(self.high_qc.block_id)
        return self._branch
