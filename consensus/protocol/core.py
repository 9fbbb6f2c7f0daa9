"""The consensus core: Jolteon as a pure state machine, `handle(event) -> [effects]`.

No clock, randomness or I/O; `Persist` precedes sending. Rules: `consensus/README.md`.
"""

from __future__ import annotations

from consensus.chain.block import Block, QuorumCertificate, TimeoutCertificate
from consensus.chain.block_rules import is_safe_to_extend
from consensus.chain.messages import CertificateNotice, LastSignedResponse, Proposal, Timeout, Vote
from consensus.errors import BlockRobotError
from consensus.limits import VOTE_ROUNDS_AHEAD_MAX_COUNT
from consensus.protocol import effects, events
from consensus.protocol.block_tree import BlockNode, Execution, make_node
from consensus.protocol.commit_rule import Commit, choose_commit, have_contradiction
from consensus.protocol.effects import Effect, Message
from consensus.protocol.events import Event
from consensus.protocol.message_handling import MessageHandler

_LATE_VOTE_ROUNDS = 2


class Core(MessageHandler):
    """One node's consensus; without a scheduled key it only follows."""

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
                self._on_words_asked(request, sender)
            case events.LastSignedReceived(answer=answer, sender=sender):
                self._on_words_answered(answer, sender)
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
        if self._dirty and not self.has_ended:
            self._commit()
        if self.has_ended:
            self._effects += self._pacemaker.stop()
        if self.halted or self.has_ended:
            return
        if self._end_silence():
            self._speak_again()
        while self._voter.may_have_signed(self.round):
            self._time_out()
        self._lead()
        branch = self._certified_branch()
        delay_ms = self._pacemaker.round_delay_ms(
            self.round, self._tree.root_round, 0 if branch is None else len(branch)
        )
        if self.index is not None:
            busy, timed_out = self.is_busy, self.has_timed_out
            self._effects += self._pacemaker.run(self.round, busy=busy, timed_out=timed_out, delay_ms=delay_ms)
        wanted = [self.high_qc.block_id]
        wanted += [node.block_id for node in self._tree.orphans.values() if node.header.round == self.round]
        self._effects += self._fetcher.ask(self._tree, wanted, len(self._schedule.producers), self.round)

    def _on_started(self) -> None:
        self._effects += self._pacemaker.heartbeat()
        self._effects += self._voter.signing_guard.begin(self._now_ms)
        if self._voter.has_left and self.silence is not None:
            self._effects.append(effects.LockoutChanged(*self.silence))
        self._doubt_own_memory()
        self._effects += [effects.Broadcast(message) for message in self._last_words()]
        last_vote, last_timeout = self._voter.last_vote, self._voter.last_timeout
        if last_vote is not None and last_vote.round > self.high_qc.round:
            self._count_vote(last_vote)
        if last_timeout is not None and last_timeout.round == self.round:
            self._count_timeout(last_timeout)
        self._execute_children(self._tree.root)

    def _last_words(self) -> list[Message]:
        proposed_id = self._voter.proposed_id
        proposed = None if proposed_id is None else self.block(proposed_id)
        notice = CertificateNotice(qc=self.high_qc, entered_by=self.entered_by)
        return [notice, *self._voter.latest_messages(self.round, self.high_qc.round, proposed)]

    def _greet(self, index: int) -> None:
        if index != self.index:
            self._effects += [effects.SendTo(index=index, message=message) for message in self._last_words()]
            self._effects += self._voter.signing_guard.ask(index)

    def _on_timer(self, kind: str, round_number: int) -> None:
        self._pacemaker.fired(kind)
        if kind == effects.TIMER_FETCH:
            self._fetcher.retry()
        elif kind == effects.TIMER_ASK:
            self._effects += self._voter.signing_guard.ask_again()
        elif kind == effects.TIMER_EXECUTE:
            self._execute_failed()
        elif kind == effects.TIMER_PROPOSE:
            self._leading.retry()
            if self._pacemaker.is_manual:
                self._leading.push(self.round)
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
            self._dirty = True
            self._pacemaker.note_qc(qc)
            node = self._tree.get(qc.block_id)
            if node is not None:
                self._note_certified(node)
            elif qc.block_id in self._tree.orphans:
                self._check_fork(self._tree.orphans[qc.block_id])
        self._hear_qc(qc)
        if qc.round > self.high_qc.round:
            self.high_qc = qc
            self._dirty = True
            self._votes.forget_up_to(qc.round)
        if qc.round >= self.round:
            self._enter(qc.round + 1, None)

    def _accept_tc(self, tc: TimeoutCertificate | None) -> None:
        if tc is None or tc.round < self.round or not self._genuine.of_tc(tc):
            return
        self._hear_tc(tc)
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
        self._witness.enter(round_number)

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
            self._pacemaker.note_word_of(node.header.producer)
            self._confront(node.header.round)
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
        self._hear_proposal(block, node.header, node.block_id, sender)
        self._check_fork(node)
        is_old = node.header.round < self._tree.root_round
        if not is_old and not self._tree.may_add(node.block_id, node.header):
            return None
        if not self._is_genuine_block(block, node.header, node.block_id):
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
        self._on_connected(connected)

    def _check_fork(self, node: BlockNode) -> None:
        if not self.has_ended and self._tree.contradicts_root(node):
            self._halt("A quorum certified a block that contradicts the finalized chain.")

    def _on_connected(self, connected: list[BlockNode]) -> None:
        self._dirty = self._dirty or bool(connected)
        for node in connected:
            if node.block_id in self._tree.certificates:
                self._note_certified(node)
        for node in connected:
            if node.parent is not None and node.parent.execution is Execution.VALID:
                self._execute(node)

    def _note_certified(self, node: BlockNode) -> None:
        self._effects.append(effects.BlockCertified(block_id=node.block_id))
        if node.execution is Execution.REFUSED:
            self._halt("A certified block cannot be executed here.")
        elif node.execution is Execution.FAILED:
            self._execute(node)

    def _execute(self, node: BlockNode) -> None:
        if node.execution in (Execution.WAITING, Execution.FAILED) and not (self.halted or self.has_ended):
            node.execution = Execution.RUNNING
            certified = node.block_id in self._tree.certificates
            self._effects.append(effects.ExecuteBlock(block=node.block, certified=certified))

    def _execute_failed(self) -> None:
        for node in list(self._tree.nodes.values()):
            if node.execution is Execution.FAILED and node.block_id in self._tree.certificates:
                self._execute(node)

    def _execute_children(self, node: BlockNode) -> None:
        for child in node.children:
            self._execute(child)

    def _on_executed(self, event: events.BlockExecuted) -> None:
        node = self._tree.get(event.block_id)
        if node is None or node.execution is not Execution.RUNNING:
            return
        self._dirty = True
        is_certified = node.block_id in self._tree.certificates
        if event.fault:
            node.execution = Execution.FAILED
            if is_certified:
                self._effects += self._pacemaker.wait_to_execute()
            return
        if not event.valid:
            node.execution = Execution.REFUSED
            if is_certified:
                self._halt("A certified block cannot be executed here.")
            return
        node.execution, node.withheld = Execution.VALID, event.withheld
        self._pacemaker.note_executed()
        self._try_vote(node)
        self._execute_children(node)

    # Votes

    def _try_vote(self, node: BlockNode) -> None:
        branch = self._tree.branch(node.block_id)
        if branch and not node.withheld and self._voter.may_vote(node, branch, self.round, self._now_ms):
            self._vote(branch, is_own=False)

    def _speak_again(self) -> None:
        for node in list(self._tree.nodes.values()):
            if node.execution is Execution.VALID and node.header.round == self.round:
                self._try_vote(node)

    def _on_words_answered(self, answer: LastSignedResponse, sender: int | None) -> None:
        if sender == self.index or not self._genuine.has_producer(sender) or sender is None:
            return
        if not self._voter.signing_guard.is_answer(answer) or not self._accept_qc(answer.qc):
            return
        proven_round, tc = 1 + answer.qc.round, answer.entered_by
        if tc is not None and self._genuine.of_tc(tc):
            proven_round = max(proven_round, 1 + tc.round)
            self._accept_tc(tc)
        if self._hear_answer(answer, sender, proven_round):
            self._speak_again()

    def _vote(self, branch: list[BlockNode], *, is_own: bool) -> None:
        vote, words = self._voter.vote(branch, self.high_qc, self.entered_by, is_own=is_own)
        self._effects += words
        self._count_vote(vote)

    def _on_vote(self, vote: Vote, sender: int | None) -> None:
        if vote.epoch != self.epoch or not self._genuine.has_producer(vote.index):
            return
        self._hear_vote(vote, sender)
        is_late = vote.round <= self.high_qc.round
        is_stale = is_late and 0 <= vote.round < self.round - _LATE_VOTE_ROUNDS
        is_near = not is_late and vote.round <= self.round + VOTE_ROUNDS_AHEAD_MAX_COUNT
        counts = is_near and not self._votes.has(vote)
        is_genuine = (is_stale or counts) and self._is_genuine_vote(vote)
        self._confront(vote.round)
        if is_genuine and is_stale:
            self._answer_stale(vote.index, always=False)
        elif is_genuine:
            self._pacemaker.note_word_of(vote.index)
            self._count_vote(vote)

    def _count_vote(self, vote: Vote) -> None:
        qc = self._votes.add(vote)
        if qc is not None:
            self._use_qc(qc)

    # Timeouts

    def _time_out(self) -> None:
        spoken = self._voter.time_out(self.round, self.high_qc, self.entered_by)
        if spoken is not None:
            timeout, words = spoken
            self._effects += words
            self._count_timeout(timeout)

    def _on_timeout(self, timeout: Timeout, sender: int | None) -> None:
        if timeout.index == self.index or not self._genuine.of_timeout(timeout):
            return
        self._pacemaker.note_word_of(timeout.index)
        self._hear_timeout(timeout)
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
        elif is_abandoned or len(self._timeouts) > self._schedule.faults_tolerated:
            self._time_out()

    # Finality

    def _commit(self) -> None:
        chains = self._tree.two_chains()
        if chains:
            if have_contradiction(self._tree, chains):
                self._halt("Two contradicting blocks are final: more producers are faulty than the chain tolerates.")
                return
            self._finalize(choose_commit(self._tree, chains))
        self._branch = self._tree.branch(self.high_qc.block_id)
        self._dirty = False

    def _finalize(self, commit: Commit) -> None:
        path = self._tree.advance_root(commit.head)
        self._voter.journal_builder.note_finalized(path)
        self._effects.append(effects.CommitBlocks(blocks=tuple(node.block for node in path), proof=commit.proof))
        self._effects += self._pacemaker.heartbeat()
        self._note_end()

    def _on_finalized_elsewhere(self, head: Block, qc: QuorumCertificate) -> None:
        node = self._tree.get(head.block_id)
        if head.header.height > self._tree.root.header.height:
            self._dirty = True
            if node is not None:
                node.execution = Execution.VALID
                self._voter.journal_builder.note_finalized(self._tree.advance_root(node))
                self._execute_children(node)
            else:
                self._on_connected(self._tree.replace_root(head, self._now_ms))
            self._effects += self._pacemaker.heartbeat()
            self._note_end()
        if qc.epoch == self.epoch:
            self._use_qc(qc)

    def _halt(self, reason: str) -> None:
        if not self.halted:
            self.halted = reason
            self._effects.append(effects.Halt(reason=reason))

    # Leading

    def _lead(self) -> None:
        parent = self._tree.get(self.high_qc.block_id)
        if (
            self.index is None
            or self.index != self.leader
            or not self._voter.may_sign(self.round)
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

    def _on_built(self, event: events.BlockBuilt) -> None:
        if event.round != self.round or not self._leading.is_building(self.round):
            return
        if event.block is None:
            self._leading.note_failure()
            self._effects += self._pacemaker.wait_to_propose(self.round, self._retry_ms)
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
