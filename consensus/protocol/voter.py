"""The safety kernel, the only signer of votes and timeouts: one per round, journalled first."""

from __future__ import annotations

from consensus.chain.block import Block, QuorumCertificate, TimeoutCertificate
from consensus.chain.block_rules import is_safe_to_extend
from consensus.chain.epoch_settings import ChainSettings
from consensus.chain.journal_records import (
    KIND_PROPOSAL,
    KIND_TIMEOUT,
    KIND_VOTE,
    LOCKOUT_OUTDATED,
    JournalState,
    SigningLockout,
    encode_lockout_record,
)
from consensus.chain.messages import (
    MESSAGE_TIMEOUT,
    LastSignedResponse,
    Proposal,
    SignedMessage,
    Timeout,
    Vote,
    sign_timeout,
    sign_vote,
)
from consensus.chain.schedule import Schedule
from consensus.limits import UNFINALIZED_BLOCKS_MAX_COUNT
from consensus.primitives.keys import PrivateKey
from consensus.protocol.block_tree import BlockNode, BlockTree
from consensus.protocol.effects import Broadcast, Effect, Persist
from consensus.protocol.journal_builder import JournalBuilder
from consensus.protocol.signing_guard import LockoutStatus, SigningGuard


class Voter:
    """What one producer signed and may still sign; followers sign nothing."""

    def __init__(
        self,
        settings: ChainSettings,
        chain_id: bytes,
        schedule: Schedule,
        key: PrivateKey | None,
        restored: JournalState,
        tree: BlockTree,
        before: Voter | None,
    ) -> None:
        """`before`: the previous epoch's voter (R36)."""
        self._settings, self._chain_id, self._epoch = settings, chain_id, schedule.epoch
        self._key, self._tree = key, tree
        self.index = None if key is None else schedule.index_of(key.public_key)
        self.journal_builder = JournalBuilder(schedule.epoch, restored)
        self.last_voted_round = restored.last_voted_round
        self.last_vote = restored.vote
        self.last_timeout = restored.timeout
        self.proposed_id = restored.proposed_id
        self.newest_epoch = restored.newest_epoch
        if before is None:
            self.signing_guard = SigningGuard(schedule, self.index, settings.base_timeout_ms, restored.lockout)
        else:
            self.signing_guard = before.signing_guard.next(
                schedule, self.index, settings.base_timeout_ms, boundary_round=before._tree.root.header.round
            )

    def may_sign(self, round_number: int) -> bool:
        """R4, R40: nothing may have been signed in this or later rounds."""
        spoken_round = max(self.last_voted_round, self.signing_guard.signs_above_round)
        return self.index is not None and not self._is_barred and round_number > spoken_round

    def may_have_signed(self, round_number: int) -> bool:
        is_open = self.index is not None and not self._is_barred
        return is_open and self.last_voted_round < round_number <= self.signing_guard.signs_above_round

    @property
    def _is_barred(self) -> bool:
        return self._tree.has_ended or self.has_left or self.journal_builder.is_behind or self.signing_guard.is_blocking

    @property
    def has_left(self) -> bool:
        return self.index is not None and self.newest_epoch > self._epoch

    def remembers(self, message: SignedMessage) -> bool:
        """R34: whether this message, or one of a later round, is remembered (R35)."""
        if message.round != self.last_voted_round:
            return message.round < self.last_voted_round
        vote, timeout = self.last_vote, self.last_timeout
        voted_id = vote.block_id if vote is not None and vote.round == message.round else None
        given_up = timeout.qc.round if timeout is not None and timeout.round == message.round else None
        if voted_id is None and given_up is None:
            return True
        return given_up == message.qc_round if message.kind == MESSAGE_TIMEOUT else voted_id == message.block_id

    # Its own memory

    @property
    def lockout(self) -> LockoutStatus | None:
        if self.has_left:
            until = f"its ledger reaches epoch {self.newest_epoch}, of which its journal speaks"
            return LockoutStatus(LOCKOUT_OUTDATED, until)
        return self.signing_guard.report

    def lock_out(self, message: SignedMessage) -> list[Effect]:
        """R34: an own message missing from the journal means lost memory."""
        lockout = self.signing_guard.lockout
        return [] if self.remembers(message) else self._follow(lockout, self.signing_guard.lock_out(message.round))

    def take_answer(self, sender: int, answer: LastSignedResponse) -> list[Effect]:
        lockout = self.signing_guard.lockout
        return self._follow(lockout, self.signing_guard.take(sender, answer, self.last_voted_round))

    def end_lockout(self) -> list[Effect]:
        """R35: lift the lockout once the chain has passed it."""
        lockout = self.signing_guard.lockout
        if lockout is None or not self.signing_guard.may_end(self._tree.root.header):
            return []
        if lockout.epoch == self._epoch and lockout.above_round is not None:
            self.last_voted_round = max(self.last_voted_round, lockout.above_round)
        return self._follow(lockout, self.signing_guard.end())

    def _follow(self, lockout_before: SigningLockout | None, consequences: list[Effect]) -> list[Effect]:
        lockout = self.signing_guard.lockout
        if lockout == lockout_before:
            return consequences
        return [Persist(records=(encode_lockout_record(self._epoch, self.last_voted_round, lockout),)), *consequences]

    # Votes and timeouts

    def has_timed_out(self, round_number: int) -> bool:
        return self.last_timeout is not None and self.last_timeout.round == round_number

    def may_vote(self, node: BlockNode, branch: list[BlockNode], round_number: int, now_ms: int) -> bool:
        """R4, R5: whether the executed block ending `branch` may be voted for."""
        header = node.header
        return (
            header.round == round_number
            and self.may_sign(round_number)
            and is_safe_to_extend(header)
            and header.timestamp_ms <= now_ms + self._settings.max_clock_drift_ms
            and not (node.block.transactions and len(branch) > UNFINALIZED_BLOCKS_MAX_COUNT)
        )

    def vote(
        self,
        branch: list[BlockNode],
        high_qc: QuorumCertificate,
        entered_by: TimeoutCertificate | None,
        *,
        is_own: bool = False,
    ) -> tuple[Vote, list[Effect]]:
        """R12: journal the block and vote, then send. Requires `may_vote` (or `may_sign` for an own block)."""
        node = branch[-1]
        if self._key is None or self.index is None or not self.may_sign(node.header.round):
            raise AssertionError("this producer may not speak in this round")
        vote = sign_vote(self._key, self._chain_id, self._epoch, node.header.round, node.block_id, self.index)
        self.last_voted_round = node.header.round
        self.last_vote = vote
        if is_own:
            self.proposed_id = node.block_id
        record = self.journal_builder.write(
            KIND_PROPOSAL if is_own else KIND_VOTE,
            branch=branch,
            last_voted_round=self.last_voted_round,
            high_qc=high_qc,
            entered_by=entered_by,
            proposed_id=node.block_id if is_own else None,
            vote=vote,
        )
        effects: list[Effect] = [Persist(records=(record,))]
        if is_own:
            effects.append(Broadcast(Proposal(block=node.block)))
        effects.append(Broadcast(vote))
        return vote, effects

    def time_out(
        self, round_number: int, high_qc: QuorumCertificate, entered_by: TimeoutCertificate | None
    ) -> tuple[Timeout, list[Effect]] | None:
        """R6: give the round up, barring votes in it; None if signing is barred."""
        is_barred = self._is_barred or self.has_timed_out(round_number)
        if self._key is None or self.index is None or is_barred:
            return None
        timeout = sign_timeout(
            self._key, self._chain_id, round_number, self.index, high_qc, entered_by, epoch=self._epoch
        )
        self.last_voted_round = max(self.last_voted_round, round_number)
        self.last_timeout = timeout
        record = self.journal_builder.write(
            KIND_TIMEOUT,
            branch=(),
            last_voted_round=self.last_voted_round,
            high_qc=high_qc,
            entered_by=entered_by,
            timeout=timeout,
        )
        return timeout, [Persist(records=(record,)), Broadcast(timeout)]

    def latest_messages(
        self, round_number: int, high_qc_round: int, proposed: Block | None
    ) -> list[Proposal | Vote | Timeout]:
        """R13: return the last relevant messages byte for byte; `proposed` is `proposed_id`'s block."""
        messages: list[Proposal | Vote | Timeout] = []
        if self.index is None:
            return messages
        if proposed is not None and proposed.header.round == round_number:
            messages.append(Proposal(block=proposed))
        if self.last_vote is not None and self.last_vote.round >= high_qc_round:
            messages.append(self.last_vote)
        if self.last_timeout is not None and self.last_timeout.round == round_number:
            messages.append(self.last_timeout)
        return messages

    def snapshot(
        self, tree: list[BlockNode], high_qc: QuorumCertificate, entered_by: TimeoutCertificate | None
    ) -> tuple[bytes, ...]:
        state = JournalState(
            last_voted_round=self.last_voted_round,
            high_qc=high_qc,
            entered_by=entered_by,
            vote=self.last_vote,
            timeout=self.last_timeout,
            proposed_id=self.proposed_id,
            lockout=self.signing_guard.lockout,
        )
        return self.journal_builder.snapshot(tree, state)
