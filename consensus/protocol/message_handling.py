"""Handling of producers' words: equivocation, requests, own forgotten words; only prevents signing."""

from __future__ import annotations

from consensus.chain.block import Block, Header, QuorumCertificate, TimeoutCertificate
from consensus.chain.evidence import Evidence
from consensus.chain.journal_records import SILENCE_OUTDATED, SigningLockout, encode_silence_record
from consensus.chain.messages import (
    SILENT,
    LastSignedRequest,
    LastSignedResponse,
    Proposal,
    SignedMessage,
    Timeout,
    Vote,
)
from consensus.protocol.core_state import CoreState
from consensus.protocol.effects import Effect, EvidenceFound, Persist, SendTo
from consensus.protocol.signing_guard import LockoutStatus


class MessageHandler(CoreState):
    """The core's listening part (R30 to R36)."""

    @property
    def silence(self) -> LockoutStatus | None:
        if self._voter.has_left:
            until = f"its ledger reaches epoch {self._voter.newest_epoch}, of which its journal speaks"
            return LockoutStatus(SILENCE_OUTDATED, until)
        return self._voter.signing_guard.report

    # Words of all

    def _hear_vote(self, vote: Vote, sender: int | None) -> None:
        self._note_evidence(self._witness.hear_vote(vote, sender))

    def _hear_proposal(self, block: Block, header: Header, block_id: bytes, sender: int | None) -> None:
        self._note_evidence(self._witness.hear_proposal(block, header, block_id, sender))

    def _is_genuine_vote(self, vote: Vote) -> bool:
        is_genuine = self._genuine.of_vote(vote)
        if is_genuine:
            self._note_evidence(self._witness.note_vote(vote))
        return is_genuine

    def _is_genuine_block(self, block: Block, header: Header, block_id: bytes) -> bool:
        is_genuine = self._genuine.of_block(block, header)
        if is_genuine:
            self._note_evidence(self._witness.note_proposal(block, header, block_id))
        return is_genuine

    def _confront(self, round_number: int) -> None:
        if self.index is None:
            return
        block_id, voters = self._witness.confront(round_number)
        node = self._tree.get(block_id) or self._tree.orphans.get(block_id)
        if node is not None:
            self._effects += [SendTo(index=index, message=Proposal(block=node.block)) for index in voters]

    def _hear_timeout(self, timeout: Timeout) -> None:
        self._witness.note_timeout(timeout)

    def _hear_qc(self, qc: QuorumCertificate) -> None:
        self._note_evidence(self._witness.note_qc(qc))

    def _hear_tc(self, tc: TimeoutCertificate) -> None:
        self._witness.note_tc(tc)
        self._doubt_own_memory()

    def _note_evidence(self, found: list[Evidence]) -> None:
        self._effects += [EvidenceFound(evidence=evidence) for evidence in found]
        self._doubt_own_memory()

    # Words of this node's own

    def _doubt_own_memory(self) -> None:
        """R34: an own word missing from the journal means lost memory."""
        for word in self._witness.take_own_words():
            if not self._voter.remembers(word):
                self._doubt(word.round)

    def _doubt(self, forgotten_round: int) -> None:
        signing_guard = self._voter.signing_guard
        mark = signing_guard.mark
        self._follow(mark, signing_guard.doubt(forgotten_round))

    def _follow(self, mark_before: SigningLockout | None, consequences: list[Effect]) -> None:
        mark = self._voter.signing_guard.mark
        if mark != mark_before:
            record = encode_silence_record(self.epoch, self._voter.last_voted_round, mark)
            self._effects.append(Persist(records=(record,)))
        self._effects += consequences

    def _hear_own_word(self, word: SignedMessage | None) -> None:
        if word is None or self.index is None or word.epoch != self.epoch:
            return
        if not self._voter.remembers(word) and self._genuine.of_word(word, self.index):
            self._doubt(word.round)

    # Asking and answering

    def _on_words_asked(self, request: LastSignedRequest, sender: int | None) -> None:
        if request.epoch != self.epoch or self.index is None or sender is None or sender == self.index:
            return
        answer = LastSignedResponse(
            epoch=self.epoch,
            asked_at_ms=request.asked_at_ms,
            speech=SILENT if self._voter.has_left else self._voter.signing_guard.speech,
            signed_round=self._voter.last_voted_round,
            word=self._witness.newest(sender),
            qc=self.high_qc,
            entered_by=self.entered_by,
        )
        self._effects.append(SendTo(index=sender, message=answer))

    def _hear_answer(self, answer: LastSignedResponse, sender: int, proven_round: int) -> bool:
        signing_guard = self._voter.signing_guard
        if not 0 <= answer.signed_round <= proven_round:
            return False
        was_barred = signing_guard.bars
        self._hear_own_word(answer.word)
        mark = signing_guard.mark
        self._follow(mark, signing_guard.take(sender, answer, self._voter.last_voted_round))
        return was_barred and not signing_guard.bars

    def _end_silence(self) -> bool:
        signing_guard = self._voter.signing_guard
        mark = signing_guard.mark
        if mark is None or not signing_guard.may_end(self._tree.root.header):
            return False
        if mark.epoch == self.epoch and mark.above_round is not None:
            self._voter.last_voted_round = max(self._voter.last_voted_round, mark.above_round)
        self._follow(mark, signing_guard.end())
        return not signing_guard.bars
