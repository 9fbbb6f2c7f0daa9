"""The consensus core: Jolteon as a state machine, `handle(event) -> [effects]`. Must never read a clock, draw a random
number, do I/O, or sign anything that does not stand behind a `Persist` of the same bytes.

The rules R1..R18 quoted here are those of `consensus/README.md`. The driver (a node, or the simulator) carries out the
effects of all calls in one order.
"""

from __future__ import annotations

from collections.abc import Sequence

from consensus.block import Block, FinalityProof, Header, QuorumCertificate, TimeoutCertificate
from consensus.block_rules import check_block, is_safe_to_extend
from consensus.blocktree import BlockNode, BlockTree, Execution, TwoChain, make_node
from consensus.collectors import TimeoutCollector, VoteCollector
from consensus.effects import (
    TIMER_FETCH,
    TIMER_PROPOSE,
    TIMER_RESEND,
    TIMER_ROUND,
    BlockCertified,
    Broadcast,
    CommitBlocks,
    Effect,
    ExecuteBlock,
    Halt,
    Message,
    SendTo,
)
from consensus.errors import BlockRobotError
from consensus.events import (
    BlockBuilt,
    BlockExecuted,
    BlocksFetched,
    Event,
    FinalizedElsewhere,
    NoticeReceived,
    PeerConnected,
    ProposalReceived,
    Started,
    TimeoutReceived,
    TimerFired,
    VoteReceived,
    WorkChanged,
)
from consensus.fetching import Fetcher
from consensus.genesis import ChainSettings
from consensus.journal_records import JournalState, read_journal
from consensus.leading import Leading
from consensus.limits import VOTE_ROUNDS_AHEAD_MAX_COUNT
from consensus.messages import (
    TIMEOUT_TAG,
    VOTE_TAG,
    CertificateNotice,
    Proposal,
    Timeout,
    Vote,
    timeout_parts,
    vote_parts,
)
from consensus.pacemaker import Pacemaker
from consensus.primitives.keys import PrivateKey
from consensus.schedule import Schedule, verify_qc, verify_tc
from consensus.signature_cache import SignatureCache, SignatureCheck
from consensus.voter import Voter

_LATE_VOTE_ROUNDS = 2


class Core:
    """One node's part in consensus. Without a key, or with one outside the schedule, it only follows."""

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
    ) -> None:
        """Begin above `finalized`, the head of the synced store, certified by `finalized_qc`.

        `round_zero_id` is the block that round 0 of the epoch certifies (genesis). `journal` holds the records read
        back, in order. Raises ENCODING_* for a record that is none.
        """
        self._chain_id, self._schedule, self._round_zero_id = chain_id, schedule, round_zero_id
        self._check: SignatureCheck = check or SignatureCache()
        self._tree = BlockTree(finalized, finalized_qc)
        self._votes = VoteCollector(schedule.quorum)
        self._timeouts = TimeoutCollector(schedule.quorum)
        self._pacemaker = Pacemaker(settings, schedule)
        self._leading = Leading(settings, self._pacemaker)
        restored = read_journal(journal, schedule.epoch)
        self._voter = Voter(settings, chain_id, schedule, key, restored)
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

    # What others may look at

    @property
    def epoch(self) -> int:
        """The epoch of the schedule."""
        return self._schedule.epoch

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
            or any(node.block.transactions for node in branch)
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
        return self._voter.snapshot(list(self._tree.nodes.values()), self.high_qc, self.entered_by)

    # Events

    def handle(self, event: Event) -> list[Effect]:
        """Take one event; return what to do, in order. A halted core does nothing."""
        if self.halted:
            return []
        self._now_ms = event.now_ms
        self._effects = []
        self._dispatch(event)
        self._settle()
        return self._effects

    def _dispatch(self, event: Event) -> None:
        match event:
            case VoteReceived(vote=vote):
                self._on_vote(vote)
            case ProposalReceived(proposal=proposal, sender=sender):
                self._on_proposal(proposal, sender)
            case BlockExecuted():
                self._on_executed(event)
            case BlockBuilt():
                self._on_built(event)
            case TimeoutReceived(timeout=timeout, sender=sender):
                self._on_timeout(timeout, sender)
            case NoticeReceived(notice=notice):
                self._accept_qc(notice.qc)
                self._accept_tc(notice.entered_by)
            case TimerFired(kind=kind, round=round_number):
                self._on_timer(kind, round_number)
            case WorkChanged(pending=pending):
                self._pending = pending
            case BlocksFetched(blocks=blocks):
                self._on_fetched(blocks)
            case FinalizedElsewhere(head=head, qc=qc):
                self._on_finalized_elsewhere(head, qc)
            case PeerConnected(index=index):
                self._greet(index)
            case Started():
                self._on_started()

    def _settle(self) -> None:
        """Derive from the new state what else is to be done: commit, propose, wait, fetch."""
        if self._dirty:
            self._commit()
        if self.halted:
            return
        self._lead()
        branch = self._certified_branch()
        delay_ms = self._pacemaker.round_delay_ms(
            self.round, self._tree.root.header.round, 0 if branch is None else len(branch)
        )
        if self.index is not None:
            busy, timed_out = self.is_busy, self.has_timed_out
            self._effects += self._pacemaker.run(self.round, busy=busy, timed_out=timed_out, delay_ms=delay_ms)
        wanted = [self.high_qc.block_id]
        wanted += [node.block_id for node in self._tree.orphans.values() if node.header.round == self.round]
        self._effects += self._fetcher.ask(self._tree, wanted, len(self._schedule.producers), self.round)

    def _on_started(self) -> None:
        """R13: say again what was said, byte for byte, and execute the journal's blocks."""
        self._effects += self._pacemaker.heartbeat()
        self._effects += [Broadcast(message) for message in self._last_words()]
        last_vote, last_timeout = self._voter.last_vote, self._voter.last_timeout
        if last_vote is not None and last_vote.round > self.high_qc.round:
            self._count_vote(last_vote)
        if last_timeout is not None and last_timeout.round == self.round:
            self._count_timeout(last_timeout)
        self._execute_children(self._tree.root)

    def _last_words(self) -> list[Message]:
        """Return what a peer that was away may have missed from this node."""
        proposed_id = self._voter.proposed_id
        proposed = None if proposed_id is None else self.block(proposed_id)
        notice = CertificateNotice(qc=self.high_qc, entered_by=self.entered_by)
        return [notice, *self._voter.last_words(self.round, self.high_qc.round, proposed)]

    def _greet(self, index: int) -> None:
        if index != self.index:
            self._effects += [SendTo(index=index, message=message) for message in self._last_words()]

    def _on_timer(self, kind: str, round_number: int) -> None:
        self._pacemaker.fired(kind)
        if kind == TIMER_FETCH:
            self._fetcher.retry()
        elif kind == TIMER_PROPOSE and self._pacemaker.is_manual:
            self._leading.push(self.round)
        elif kind == TIMER_ROUND and round_number == self.round and self.is_busy:
            self._time_out()
        elif kind == TIMER_RESEND and self._voter.has_timed_out(round_number) and self._voter.last_timeout:
            self._effects.append(Broadcast(self._voter.last_timeout))

    # Certificates and rounds

    def _accept_qc(self, qc: QuorumCertificate) -> bool:
        """Check a certificate and use it; tell whether it is genuine."""
        if self._tree.certificates.get(qc.block_id) == qc:
            return True
        try:
            verify_qc(qc, self._schedule, self._chain_id, self._round_zero_id, self._check)
        except BlockRobotError:
            return False
        self._use_qc(qc)
        return True

    def _use_qc(self, qc: QuorumCertificate) -> None:
        if self._tree.certify(qc):
            self._dirty = True
            self._pacemaker.note_qc(qc)
            node = self._tree.get(qc.block_id)
            if node is not None:
                self._note_certified(node)
            elif self._tree.is_forked_below(qc):
                self._halt("A quorum certified a block that contradicts the finalized chain.")
        if qc.round > self.high_qc.round:
            self.high_qc = qc
            self._dirty = True
            self._votes.forget_up_to(qc.round)
        if qc.round >= self.round:
            self._enter(qc.round + 1, None)

    def _accept_tc(self, tc: TimeoutCertificate | None) -> None:
        """R7: a TC leads into the next round, if the QC that it speaks of is known here."""
        if tc is None or tc.round < self.round or tc.epoch != self.epoch:
            return
        try:
            verify_tc(tc, self._schedule, self._chain_id, self._check)
        except BlockRobotError:
            return
        if tc.highest_qc_round <= self.high_qc.round:
            self._pacemaker.note_tc(tc)
            self._enter(tc.round + 1, tc)

    def _enter(self, round_number: int, entered_by: TimeoutCertificate | None) -> None:
        self.round = round_number
        self.entered_by = entered_by
        self._timeouts.clear()

    def _answer_stale(self, index: int | None, *, always: bool) -> None:
        """R6: bring a peer that is behind up to date; for anything but timeouts once a round and peer."""
        if index is None or index == self.index or not 0 <= index < len(self._schedule.producers):
            return
        if always or self._noticed.get(index) != self.round:
            self._noticed[index] = self.round
            notice = CertificateNotice(qc=self.high_qc, entered_by=self.entered_by)
            self._effects.append(SendTo(index=index, message=notice))

    # Proposals and blocks

    def _on_proposal(self, proposal: Proposal, sender: int | None) -> None:
        node = self._add_block(proposal.block)
        if node is not None:
            self._pacemaker.note_word_of(node.header.producer)
            if node.header.round < self.round - 1:
                self._answer_stale(sender, always=False)

    def _on_fetched(self, blocks: tuple[Block, ...]) -> None:
        """Newest first, so that each block's certificate is known when the block comes."""
        for block in reversed(blocks):
            self._add_block(block)

    def _add_block(self, block: Block) -> BlockNode | None:
        """Check a block and put it into the tree if it has room there; return it if it is genuine and not known."""
        try:
            node = make_node(block, self._now_ms)
            if node.header.round >= self._tree.root.header.round and not self._tree.may_add(node.block_id, node.header):
                return None
            check_block(
                block,
                node.header,
                chain_id=self._chain_id,
                schedule=self._schedule,
                round_zero_id=self._round_zero_id,
                check=self._check,
            )
        except BlockRobotError:
            return None
        self._use_qc(node.header.qc)
        self._accept_tc(node.header.tc)
        if not self.halted and self._tree.may_add(node.block_id, node.header):
            self._insert(node)
        return node

    def _insert(self, node: BlockNode) -> None:
        connected = self._tree.add(node)
        self._fetcher.note_progress(connected)
        if node.header.round == self.round:
            self._proposal_seen_round = self.round
        qc = self._tree.certificates.get(node.block_id)
        if qc is not None and self._tree.is_forked_below(qc):
            self._halt("A quorum certified a block that contradicts the finalized chain.")
        self._on_connected(connected)

    def _on_connected(self, connected: list[BlockNode]) -> None:
        self._dirty = self._dirty or bool(connected)
        for node in connected:
            if node.block_id in self._tree.certificates:
                self._note_certified(node)
        for node in connected:
            if node.parent is not None and node.parent.execution is Execution.VALID:
                self._execute(node)

    def _note_certified(self, node: BlockNode) -> None:
        self._effects.append(BlockCertified(block_id=node.block_id))
        if node.execution is Execution.REFUSED:
            self._halt("A certified block cannot be executed here.")

    def _execute(self, node: BlockNode) -> None:
        if node.execution is Execution.WAITING and not self.halted:
            node.execution = Execution.RUNNING
            self._effects.append(ExecuteBlock(block=node.block))

    def _execute_children(self, node: BlockNode) -> None:
        for child in node.children:
            self._execute(child)

    def _on_executed(self, event: BlockExecuted) -> None:
        node = self._tree.get(event.block_id)
        if node is None or node.execution is not Execution.RUNNING:
            return
        self._dirty = True
        if not event.valid or event.fault:
            node.execution = Execution.REFUSED
            if node.block_id in self._tree.certificates:
                self._halt("A certified block cannot be executed here.")
            return
        node.execution = Execution.VALID
        self._try_vote(node)
        self._execute_children(node)

    # Votes

    def _try_vote(self, node: BlockNode) -> None:
        """Vote for an executed block if the safety kernel lets it."""
        branch = self._tree.branch(node.block_id)
        if branch is not None and self._voter.may_vote(node, branch, self.round, self._now_ms):
            self._vote(branch, is_own=False)

    def _vote(self, branch: list[BlockNode], *, is_own: bool) -> None:
        vote, effects = self._voter.vote(branch, self.high_qc, self.entered_by, is_own=is_own)
        self._effects += effects
        self._count_vote(vote)

    def _on_vote(self, vote: Vote) -> None:
        if vote.epoch != self.epoch or not 0 <= vote.index < len(self._schedule.producers):
            return
        if vote.round <= self.high_qc.round:
            if 0 <= vote.round < self.round - _LATE_VOTE_ROUNDS:
                self._answer_stale(vote.index, always=False)
            return
        if vote.round > self.round + VOTE_ROUNDS_AHEAD_MAX_COUNT or self._votes.has(vote):
            return
        parts = vote_parts(self._chain_id, vote.epoch, vote.round, vote.block_id)
        if self._check(self._schedule.producers[vote.index], VOTE_TAG, vote.signature, *parts):
            self._pacemaker.note_word_of(vote.index)
            self._count_vote(vote)

    def _count_vote(self, vote: Vote) -> None:
        qc = self._votes.add(vote)
        if qc is not None:
            self._use_qc(qc)

    # Timeouts

    def _time_out(self) -> None:
        """R6: give the round up, once."""
        spoken = self._voter.time_out(self.round, self.high_qc, self.entered_by)
        if spoken is not None:
            timeout, effects = spoken
            self._effects += effects
            self._count_timeout(timeout)

    def _on_timeout(self, timeout: Timeout, sender: int | None) -> None:
        if not 0 <= timeout.index < len(self._schedule.producers) or timeout.index == self.index:
            return
        if timeout.epoch != self.epoch or not 0 <= timeout.qc.round < timeout.round < 1 << 63:
            return
        parts = timeout_parts(self._chain_id, timeout.epoch, timeout.round, timeout.qc.round)
        if not self._check(self._schedule.producers[timeout.index], TIMEOUT_TAG, timeout.signature, *parts):
            return
        self._pacemaker.note_word_of(timeout.index)
        if timeout.qc.round > self.high_qc.round and not self._accept_qc(timeout.qc):
            return
        self._accept_tc(timeout.entered_by)
        if timeout.round < self.round:
            self._answer_stale(timeout.index if sender is None else sender, always=True)
        elif timeout.round == self.round:
            self._count_timeout(timeout)

    def _count_timeout(self, timeout: Timeout) -> None:
        tc = self._timeouts.add(timeout)
        self._timeout_seen_round = self.round
        if tc is not None:
            self._accept_tc(tc)
        elif len(self._timeouts) > self._schedule.faults_tolerated:
            self._time_out()

    # Finality

    def _certified_branch(self) -> list[BlockNode] | None:
        """Return the certified blocks above the finalized head, oldest first; None while some are missing."""
        if self._dirty:
            self._branch = self._tree.branch(self.high_qc.block_id)
        return self._branch

    def _commit(self) -> None:
        """R8: finalize the highest block that has a certified child of the next round, with its ancestors."""
        chains = self._tree.two_chains()
        if chains:
            newest = chains[-1]
            ids = {node.block_id for node in self._tree.branch(newest.final.block_id) or []}
            if any(chain.final.block_id not in ids for chain in chains):
                self._halt("Two contradicting blocks are final: more producers are faulty than the chain tolerates.")
                return
            self._finalize(newest)
        self._branch = self._tree.branch(self.high_qc.block_id)
        self._dirty = False

    def _finalize(self, chain: TwoChain) -> None:
        proof = FinalityProof(
            header_bytes=chain.final.block.header_bytes,
            child_header_bytes=chain.child.block.header_bytes,
            child_qc=chain.child_qc,
        )
        path = self._tree.advance_root(chain.final)
        self._voter.journalist.note_finalized(path)
        self._effects.append(CommitBlocks(blocks=tuple(node.block for node in path), proof=proof))
        self._effects += self._pacemaker.heartbeat()

    def _on_finalized_elsewhere(self, head: Block, qc: QuorumCertificate) -> None:
        """R16: sync stored blocks durably; go on above them."""
        node = self._tree.get(head.block_id)
        if head.header.height > self._tree.root.header.height:
            self._dirty = True
            if node is not None:
                node.execution = Execution.VALID
                self._voter.journalist.note_finalized(self._tree.advance_root(node))
                self._execute_children(node)
            else:
                self._on_connected(self._tree.replace_root(head, self._now_ms))
            self._effects += self._pacemaker.heartbeat()
        self._use_qc(qc)

    def _halt(self, reason: str) -> None:
        if not self.halted:
            self.halted = reason
            self._effects.append(Halt(reason=reason))

    # Leading

    def _lead(self) -> None:
        """R2, R3: propose once, if this node leads the round, may speak in it and has a reason."""
        parent = self._tree.get(self.high_qc.block_id)
        if (
            self.index is None
            or self.index != self.leader
            or not self._voter.may_speak(self.round)
            or self._leading.is_building(self.round)
            or parent is None
            or parent.execution is not Execution.VALID
        ):
            return
        branch = self._certified_branch() or []
        at_once = self.entered_by is not None or self._timeout_seen_round == self.round
        wait_ms = self._leading.delay_ms(
            parent, branch, now_ms=self._now_ms, pending=self._pending, at_once=at_once, round_number=self.round
        )
        if wait_ms is None:
            return
        if wait_ms > 0:
            self._effects += self._pacemaker.wait_to_propose(self.round, wait_ms)
            return
        self._effects.append(
            self._leading.build(
                self.round,
                parent,
                branch,
                qc=self.high_qc,
                entered_by=self.entered_by,
                epoch=self.epoch,
                producer=self.index,
            )
        )

    def _on_built(self, event: BlockBuilt) -> None:
        """Propose the block, unless the round is over or given up by now."""
        if event.round != self.round or not self._leading.is_building(self.round):
            return
        if event.block is None:
            self._leading.give_up()
            self._effects += self._pacemaker.wait_to_propose(self.round, self._retry_ms)
            return
        node = make_node(event.block, self._now_ms)
        header = node.header
        if not self._voter.may_speak(self.round) or header.round != self.round or not is_safe_to_extend(header):
            return
        if header.parent_id not in self._tree.nodes or not self._tree.may_add(node.block_id, header):
            return
        node.execution = Execution.VALID
        self._insert(node)
        branch = self._tree.branch(node.block_id)
        if branch is not None and node.execution is Execution.VALID:
            self._vote(branch, is_own=True)
