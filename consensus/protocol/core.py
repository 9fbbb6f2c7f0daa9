"""The consensus core: Jolteon as a pure state machine, `handle(event) -> [effects]`.

`Persist` precedes sending. Rules: `consensus/README.md`.
"""

from __future__ import annotations

from collections.abc import Sequence

from consensus.chain.block import Block, Header, QuorumCertificate, TimeoutCertificate
from consensus.chain.block_rules import is_safe_to_extend
from consensus.chain.epoch_settings import ChainSettings
from consensus.chain.evidence import Evidence
from consensus.chain.journal_records import JournalState, read_journal
from consensus.chain.message_checks import MessageChecks
from consensus.chain.messages import (
    LOCKED_OUT,
    CertificateNotice,
    LastSignedRequest,
    LastSignedResponse,
    Proposal,
    SignedMessage,
    Timeout,
    Vote,
)
from consensus.chain.schedule import Schedule
from consensus.chain.signature_cache import SignatureCache, SignatureCheck
from consensus.errors import BlockRobotError
from consensus.limits import VOTE_ROUNDS_AHEAD_MAX_COUNT
from consensus.primitives.keys import PrivateKey
from consensus.protocol import effects, events
from consensus.protocol.block_fetching import Fetcher
from consensus.protocol.block_processor import BlockProcessor
from consensus.protocol.block_tree import BlockNode, BlockTree, Execution, make_node
from consensus.protocol.effects import Effect, Message
from consensus.protocol.events import Event
from consensus.protocol.message_log import MessageLog
from consensus.protocol.pacemaker import Pacemaker
from consensus.protocol.proposer import Proposer
from consensus.protocol.signing_guard import LockoutStatus
from consensus.protocol.vote_collectors import TimeoutCollector, VoteCollector
from consensus.protocol.voter import Voter

_LATE_VOTE_ROUNDS = 2


class Core:
    """One node's consensus; without a scheduled key it only follows."""

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
        before: Core | None = None,
    ) -> None:
        """Begin above `finalized`, the synced store's head, in the schedule's epoch.

        `round_zero_id`: genesis or boundary (R23). `before`: the previous epoch's core; signing in it skips asking
        (R36, R37). Raises ENCODING_*.
        """
        if finalized_qc.epoch != schedule.epoch:
            raise AssertionError("the certificate of the finalized head is of another epoch")
        kept = [] if before is None else before._later_records
        restored = read_journal([*kept, *journal], schedule.epoch)
        check = check or SignatureCache()
        self.schedule = schedule
        self._later_records: list[bytes] = restored.later
        self._genuine = MessageChecks(chain_id, schedule, round_zero_id, check)
        self._tree = BlockTree(finalized, finalized_qc)
        self._votes = VoteCollector(schedule.quorum)
        self._timeouts = TimeoutCollector(schedule.quorum)
        self._pacemaker: Pacemaker = Pacemaker(settings, schedule, None if before is None else before._pacemaker)
        voter_before = None if before is None else before._voter
        self._voter: Voter = Voter(settings, chain_id, schedule, key, restored, self._tree, voter_before)
        self._blocks = BlockProcessor(self._tree, self._voter.journal_builder, self._pacemaker)
        self._proposer = Proposer(settings, schedule, self.index, self._tree, self._pacemaker)
        self._message_log = MessageLog(chain_id, schedule, self.index, check)
        self._fetcher = Fetcher(self.index, settings.base_timeout_ms)
        self._effects: list[Effect] = []
        self._now_ms = 0
        self._pending = False
        self._proposal_seen_round = 0
        self._timeout_seen_round = 0
        self._noticed: dict[int, int] = {}
        self._restore(restored, finalized_qc)
        self._recall(restored, finalized, finalized_qc)

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
        self._message_log.enter(self.round)
        self._message_log.log_blocks([finalized, *restored.blocks.values()])
        for qc in (finalized_qc, self.high_qc):
            self._message_log.log_qc(qc)
        if self.entered_by is not None:
            self._message_log.log_tc(self.entered_by)
        head, is_alone = finalized.header, len(self.schedule.producers) == 1 and self.index is not None
        if is_alone and head.epoch == self.epoch and head.round > 0:
            # Alone, it certified the head's child too: it has nobody to ask what it said above that.
            self._voter.last_voted_round = max(self._voter.last_voted_round, head.round + 1)

    # What others may look at

    @property
    def halted(self) -> str:
        return self._blocks.halted

    @property
    def epoch(self) -> int:
        return self.schedule.epoch

    @property
    def index(self) -> int | None:
        return self._voter.index

    @property
    def last_voted_round(self) -> int:
        return self._voter.last_voted_round

    @property
    def leader(self) -> int:
        return self.schedule.leader(self.round)

    @property
    def finalized(self) -> Header:
        return self._tree.root.header

    @property
    def finalized_id(self) -> bytes:
        return self._tree.root.block_id

    @property
    def has_ended(self) -> bool:
        return self._tree.has_ended

    @property
    def has_timed_out(self) -> bool:
        return self._voter.has_timed_out(self.round)

    @property
    def lockout(self) -> LockoutStatus | None:
        return self._voter.lockout

    @property
    def is_busy(self) -> bool:
        branch = self._tree.branch(self.high_qc.block_id)
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
        return [node.block_id for node in self._tree.branch(self.high_qc.block_id) or []]

    def block(self, block_id: bytes) -> Block | None:
        node = self._tree.find(block_id)
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
        return (*self._later_records, *own)  # the own ones last: the last record about a lockout counts

    # Events

    def handle(self, event: Event) -> list[Effect]:
        """Return an event's effects in order; halted: none, ended: answers only (R22)."""
        if self.halted:
            return []
        self._now_ms = event.now_ms
        self._effects = []
        self._dispatch(event)
        self._settle()
        return self._effects

    def _dispatch(self, event: Event) -> None:  # noqa: PLR0912 - one line for each event
        match event:
            case events.VoteReceived(vote=vote, sender=sender):
                self._on_vote(vote, sender)
            case events.ProposalReceived(proposal=proposal, sender=sender):
                self._on_proposal(proposal, sender)
            case events.BlockExecuted():
                self._on_executed(event)
            case events.BlockBuilt():
                self._on_built(event)
            case events.TimeoutReceived(timeout=timeout, sender=sender):
                self._on_timeout(timeout, sender)
            case events.NoticeReceived(notice=notice):
                self._accept_qc(notice.qc)
                self._accept_tc(notice.entered_by)
            case events.LastSignedRequested(request=request, sender=sender):
                self._on_last_signed_requested(request, sender)
            case events.LastSignedReceived(answer=answer, sender=sender):
                self._on_last_signed_response(answer, sender)
            case events.TimerFired(kind=kind, round=round_number):
                self._on_timer(kind, round_number)
            case events.WorkChanged(pending=pending):
                self._pending = pending
            case events.BlocksFetched(blocks=blocks):
                self._on_fetched(blocks)
            case events.FinalizedElsewhere(head=head, qc=qc):
                self._on_finalized_elsewhere(head, qc)
            case events.PeerConnected(index=index):
                self._greet(index)
            case events.Started():
                self._on_started()

    def _settle(self) -> None:
        self._effects += self._blocks.commit()
        if self.has_ended:
            self._effects += self._pacemaker.stop()
        if self.halted or self.has_ended:
            return
        lifted = self._voter.end_lockout()
        self._effects += lifted
        if lifted and not self._voter.signing_guard.is_blocking:
            self._resume_signing()
        while self._voter.may_have_signed(self.round):
            self._time_out()
        self._lead()
        if self.index is not None:
            busy, timed_out = self.is_busy, self.has_timed_out
            certified_above = len(self.certified_branch())
            delay_ms = self._pacemaker.round_delay_ms(self.round, self._tree.root_round, certified_above)
            self._effects += self._pacemaker.run(self.round, busy=busy, timed_out=timed_out, delay_ms=delay_ms)
        wanted = [self.high_qc.block_id]
        wanted += [node.block_id for node in self._tree.orphans.values() if node.header.round == self.round]
        self._effects += self._fetcher.ask(self._tree, wanted, len(self.schedule.producers), self.round)

    def _on_started(self) -> None:
        self._effects += self._pacemaker.heartbeat()
        self._effects += self._voter.signing_guard.begin(self._now_ms)
        if self._voter.has_left and self.lockout is not None:
            self._effects.append(effects.LockoutChanged(self.lockout.reason, self.lockout.until))
        self._check_own_messages()
        self._effects += [effects.Broadcast(message) for message in self._latest_messages()]
        last_vote, last_timeout = self._voter.last_vote, self._voter.last_timeout
        if last_vote is not None and last_vote.round > self.high_qc.round:
            self._count_vote(last_vote)
        if last_timeout is not None and last_timeout.round == self.round:
            self._count_timeout(last_timeout)
        self._effects += self._blocks.execute_children(self._tree.root)

    def _latest_messages(self) -> list[Message]:
        proposed_id = self._voter.proposed_id
        proposed = None if proposed_id is None else self.block(proposed_id)
        notice = CertificateNotice(qc=self.high_qc, entered_by=self.entered_by)
        return [notice, *self._voter.latest_messages(self.round, self.high_qc.round, proposed)]

    def _greet(self, index: int) -> None:
        if index != self.index:
            self._effects += [effects.SendTo(index=index, message=message) for message in self._latest_messages()]
            self._effects += self._voter.signing_guard.ask(index)

    def _on_timer(self, kind: str, round_number: int) -> None:
        self._pacemaker.fired(kind)
        if kind == effects.TIMER_FETCH:
            self._fetcher.retry()
        elif kind == effects.TIMER_ASK:
            self._effects += self._voter.signing_guard.ask_again()
        elif kind == effects.TIMER_EXECUTE:
            self._effects += self._blocks.execute_failed()
        elif kind == effects.TIMER_PROPOSE:
            self._proposer.retry()
            if self._pacemaker.is_manual:
                self._proposer.push(self.round)
        elif kind == effects.TIMER_ROUND and round_number == self.round and self.is_busy:
            self._time_out()
        elif kind == effects.TIMER_RESEND and round_number == self.round and self._voter.last_timeout is not None:
            self._effects.append(effects.Broadcast(self._voter.last_timeout))

    # Certificates and rounds

    def _accept_qc(self, qc: QuorumCertificate) -> bool:
        if self._tree.certificates.get(qc.block_id) == qc:
            return True
        is_genuine = self._genuine.of_qc(qc)
        if is_genuine:
            self._use_qc(qc)
        return is_genuine

    def _use_qc(self, qc: QuorumCertificate) -> None:
        if self._tree.certify(qc):
            self._pacemaker.note_qc(qc)
            own = self._tree.get(qc.block_id) if qc.block_id == self._voter.proposed_id else None
            if own is not None:
                self._pacemaker.note_round_trip(self._now_ms - own.arrived_ms)
            self._effects += self._blocks.certified(qc.block_id)
        self._note_evidence(self._message_log.log_qc(qc))
        if qc.round > self.high_qc.round:
            self.high_qc = qc
            self._votes.forget_up_to(qc.round)
        if qc.round >= self.round:
            self._enter(qc.round + 1, None)

    def _accept_tc(self, tc: TimeoutCertificate | None) -> None:
        if tc is None or tc.round < self.round or not self._genuine.of_tc(tc):
            return
        self._message_log.log_tc(tc)
        self._check_own_messages()
        if tc.highest_qc_round <= self.high_qc.round:
            self._pacemaker.note_tc(tc)
            self._enter(tc.round + 1, tc)

    def _enter(self, round_number: int, entered_by: TimeoutCertificate | None) -> None:
        proposed = None if self._voter.proposed_id is None else self._tree.get(self._voter.proposed_id)
        is_lost = entered_by is not None and proposed is not None and proposed.header.round == self.round
        if is_lost and proposed is not None and proposed.block_id not in self._tree.certificates:
            self._effects.append(effects.ProposalLost(block_id=proposed.block_id))
        self.round = round_number
        self.entered_by = entered_by
        self._timeouts.clear()
        self._message_log.enter(round_number)

    def _answer_stale(self, index: int | None, *, always: bool) -> None:
        if index is None or index == self.index or not self._genuine.has_producer(index):
            return
        if always or self._noticed.get(index) != self.round:
            self._noticed[index] = self.round
            notice = CertificateNotice(qc=self.high_qc, entered_by=self.entered_by)
            self._effects.append(effects.SendTo(index=index, message=notice))

    # Proposals and blocks

    def _on_proposal(self, proposal: Proposal, sender: int | None) -> None:
        node = self._add_block(proposal.block, sender)
        if node is not None:
            self._pacemaker.record_message_from(node.header.producer)
            self._answer_conflicting_voters(node.header.round)
            if node.header.round < self.round - 1:
                self._answer_stale(sender, always=False)

    def _on_fetched(self, blocks: tuple[Block, ...]) -> None:
        for block in reversed(blocks):
            self._add_block(block)

    def _add_block(self, block: Block, sender: int | None = None) -> BlockNode | None:
        try:
            node = make_node(block, self._now_ms)
        except BlockRobotError:
            return None
        self._note_evidence(self._message_log.log_unverified_proposal(block, node.header, node.block_id, sender))
        self._effects += self._blocks.check_fork(node)
        is_old = node.header.round < self._tree.root_round
        if not is_old and not self._tree.may_add(node.block_id, node.header):
            return None
        if not self._genuine.of_block(block, node.header):
            return None
        self._note_evidence(self._message_log.log_proposal(block, node.header, node.block_id))
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
        self._effects += self._blocks.connected(connected)

    def _on_executed(self, event: events.BlockExecuted) -> None:
        node = self._tree.get(event.block_id)
        if node is None or node.execution is not Execution.RUNNING:
            return
        self._effects += self._blocks.executed(node, event)
        if event.valid and not event.fault:
            self._try_vote(node)
            self._effects += self._blocks.execute_children(node)

    def _on_finalized_elsewhere(self, head: Block, qc: QuorumCertificate) -> None:
        self._effects += self._blocks.finalized_elsewhere(head, self._now_ms)
        if qc.epoch == self.epoch:
            self._use_qc(qc)

    # Votes

    def _try_vote(self, node: BlockNode) -> None:
        branch = self._tree.branch(node.block_id)
        if branch and not node.withheld and self._voter.may_vote(node, branch, self.round, self._now_ms):
            self._vote(branch, is_own=False)

    def _resume_signing(self) -> None:
        for node in list(self._tree.nodes.values()):
            if node.execution is Execution.VALID and node.header.round == self.round:
                self._try_vote(node)

    def _vote(self, branch: list[BlockNode], *, is_own: bool) -> None:
        vote, emitted = self._voter.vote(branch, self.high_qc, self.entered_by, is_own=is_own)
        self._effects += emitted
        self._count_vote(vote)

    def _on_vote(self, vote: Vote, sender: int | None) -> None:
        if vote.epoch != self.epoch or not self._genuine.has_producer(vote.index):
            return
        self._note_evidence(self._message_log.log_unverified_vote(vote, sender))
        is_late = vote.round <= self.high_qc.round
        is_stale = is_late and 0 <= vote.round < self.round - _LATE_VOTE_ROUNDS
        is_near = not is_late and vote.round <= self.round + VOTE_ROUNDS_AHEAD_MAX_COUNT
        counts = is_near and not self._votes.has(vote)
        is_genuine = (is_stale or counts) and self._genuine.of_vote(vote)
        if is_genuine:
            self._note_evidence(self._message_log.log_vote(vote))
        self._answer_conflicting_voters(vote.round)
        if is_genuine and is_stale:
            self._answer_stale(vote.index, always=False)
        elif is_genuine:
            self._pacemaker.record_message_from(vote.index)
            self._count_vote(vote)

    def _count_vote(self, vote: Vote) -> None:
        qc = self._votes.add(vote)
        if qc is not None:
            self._use_qc(qc)

    # Timeouts

    def _time_out(self) -> None:
        spoken = self._voter.time_out(self.round, self.high_qc, self.entered_by)
        if spoken is not None:
            timeout, emitted = spoken
            self._effects += emitted
            self._count_timeout(timeout)

    def _on_timeout(self, timeout: Timeout, sender: int | None) -> None:
        if timeout.index == self.index or not self._genuine.of_timeout(timeout):
            return
        self._pacemaker.record_message_from(timeout.index)
        self._message_log.log_timeout(timeout)
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
        is_abandoned = timeout.index == self.leader and self._proposal_seen_round != self.round
        if tc is not None:
            self._accept_tc(tc)
        elif is_abandoned or len(self._timeouts) > self.schedule.faults_tolerated:
            self._time_out()

    # What producers said before

    def _note_evidence(self, found: list[Evidence]) -> None:
        self._effects += [effects.EvidenceFound(evidence=evidence) for evidence in found]
        self._check_own_messages()

    def _check_own_messages(self) -> None:
        for message in self._message_log.pop_own_messages():
            self._effects += self._voter.lock_out(message)

    def _answer_conflicting_voters(self, round_number: int) -> None:
        if self.index is None:
            return
        block_id, voters = self._message_log.find_conflicting_voters(round_number)
        node = self._tree.find(block_id)
        if node is not None:
            self._effects += [effects.SendTo(index=index, message=Proposal(block=node.block)) for index in voters]

    def _on_last_signed_requested(self, request: LastSignedRequest, sender: int | None) -> None:
        if request.epoch != self.epoch or self.index is None or sender is None or sender == self.index:
            return
        answer = LastSignedResponse(
            epoch=self.epoch,
            asked_at_ms=request.asked_at_ms,
            signing_state=LOCKED_OUT if self._voter.has_left else self._voter.signing_guard.signing_state,
            signed_round=self.last_voted_round,
            message=self._message_log.newest(sender),
            qc=self.high_qc,
            entered_by=self.entered_by,
        )
        self._effects.append(effects.SendTo(index=sender, message=answer))

    def _on_last_signed_response(self, answer: LastSignedResponse, sender: int | None) -> None:
        if sender == self.index or not self._genuine.has_producer(sender) or sender is None:
            return
        if not self._voter.signing_guard.is_answer(answer) or not self._accept_qc(answer.qc):
            return
        proven_round, tc = 1 + answer.qc.round, answer.entered_by
        if tc is not None and self._genuine.of_tc(tc):
            proven_round = max(proven_round, 1 + tc.round)
            self._accept_tc(tc)
        if not 0 <= answer.signed_round <= proven_round:
            return
        was_barred = self._voter.signing_guard.is_blocking
        self._check_own_message(answer.message)
        self._effects += self._voter.take_answer(sender, answer)
        if was_barred and not self._voter.signing_guard.is_blocking:
            self._resume_signing()

    def _check_own_message(self, message: SignedMessage | None) -> None:
        if message is None or self.index is None or message.epoch != self.epoch:
            return
        if not self._voter.remembers(message) and self._genuine.of_message(message, self.index):
            self._effects += self._voter.lock_out(message)

    # Leading

    def _lead(self) -> None:
        if self._voter.may_sign(self.round):
            at_once = self.entered_by is not None or self._timeout_seen_round == self.round
            self._effects += self._proposer.lead(
                self.round, self.high_qc, self.entered_by, self._now_ms, pending=self._pending, at_once=at_once
            )

    def _on_built(self, event: events.BlockBuilt) -> None:
        if event.round != self.round or not self._proposer.is_building(self.round):
            return
        if event.block is None:
            self._effects += self._proposer.note_failure(self.round)
            return
        node = make_node(event.block, self._now_ms)
        header = node.header
        if not self._voter.may_sign(self.round) or header.round != self.round or not is_safe_to_extend(header):
            return
        if header.parent_id not in self._tree.nodes or not self._tree.may_add(node.block_id, header):
            return
        node.execution = Execution.VALID
        self._insert(node)
        branch = self._tree.branch(node.block_id)
        if branch is not None and node.execution is Execution.VALID:
            self._vote(branch, is_own=True)
