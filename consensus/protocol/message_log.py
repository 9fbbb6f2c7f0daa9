"""A bounded log of producers' messages: first per round for evidence (R30), newest for restarts (R33)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from consensus.chain.block import Block, Header, QuorumCertificate, TimeoutCertificate
from consensus.chain.evidence import Evidence, is_valid_message_signature, make_evidence
from consensus.chain.messages import MESSAGE_PROPOSAL, MESSAGE_TIMEOUT, MESSAGE_VOTE, SignedMessage, Timeout, Vote
from consensus.chain.schedule import Schedule
from consensus.chain.signature_cache import SignatureCheck
from consensus.limits import EVIDENCE_ROUNDS_KEPT_COUNT, MESSAGE_CHECKS_MAX_COUNT

_RANK = {MESSAGE_PROPOSAL: 0, MESSAGE_VOTE: 1, MESSAGE_TIMEOUT: 2}


@dataclass(slots=True)
class _Heard:
    block_id: bytes = b""
    signature: bytes = b""
    is_accused: bool = False
    is_confronted: bool = False
    failed_counts: dict[int | None, int] = field(default_factory=dict)
    """How many forgeries each sender (an index, None for all that are no producers) sent under this name."""


class MessageLog:
    """One epoch's log; `own_index` is never accused."""

    def __init__(self, chain_id: bytes, schedule: Schedule, own_index: int | None, check: SignatureCheck) -> None:
        self._chain_id, self._schedule, self._own_index, self._check = chain_id, schedule, own_index, check
        self._round = 1
        self._rounds: dict[int, dict[tuple[str, int], _Heard]] = {}
        self._newest: dict[int, SignedMessage] = {}
        self._own_messages: list[SignedMessage] = []

    def enter(self, round_number: int) -> None:
        self._round = round_number
        low = round_number - EVIDENCE_ROUNDS_KEPT_COUNT
        for old in [number for number in self._rounds if number < low]:
            del self._rounds[old]

    def newest(self, index: int | None) -> SignedMessage | None:
        return None if index is None else self._newest.get(index)

    def pop_own_messages(self) -> list[SignedMessage]:
        messages, self._own_messages = self._own_messages, []
        return messages

    # Messages that might not be genuine

    def log_unverified_vote(self, vote: Vote, sender: int | None) -> list[Evidence]:
        """Log a vote, verifying only new information; `sender` is authenticated, isolating forgers (R31)."""
        return self._log_unverified(MESSAGE_VOTE, vote.round, vote.index, vote.block_id, vote.signature, sender)

    def log_unverified_proposal(
        self, block: Block, header: Header, block_id: bytes, sender: int | None
    ) -> list[Evidence]:
        """Log a block as its leader's message, ignoring body and certificates."""
        if header.epoch != self._schedule.epoch or not 0 <= header.producer < len(self._schedule.producers):
            return []
        return self._log_unverified(MESSAGE_PROPOSAL, header.round, header.producer, block_id, block.signature, sender)

    def _log_unverified(
        self, kind: str, round_number: int, index: int, block_id: bytes, signature: bytes, sender: int | None
    ) -> list[Evidence]:
        if abs(round_number - self._round) > EVIDENCE_ROUNDS_KEPT_COUNT:
            return []
        heard = self._heard(kind, round_number, index)
        failed_count = heard.failed_counts.get(sender, 0)
        if heard.block_id == block_id or heard.is_accused or failed_count >= MESSAGE_CHECKS_MAX_COUNT:
            return []
        is_genuine = is_valid_message_signature(
            kind,
            self._chain_id,
            self._schedule.epoch,
            round_number,
            block_id,
            producer=self._schedule.producers[index],
            signature=signature,
            check=self._check,
        )
        if is_genuine:
            return self._note(kind, round_number, index, block_id, signature)
        heard.failed_counts[sender] = failed_count + 1
        return []

    def _heard(self, kind: str, round_number: int, index: int) -> _Heard:
        messages = self._rounds.get(round_number)
        if messages is None:
            messages = self._rounds[round_number] = {}
        heard = messages.get((kind, index))
        if heard is None:
            heard = messages[kind, index] = _Heard()
        return heard

    def find_conflicting_voters(self, round_number: int) -> tuple[bytes, list[int]]:
        """Return a round's first proposal and voters for another, each once (R39)."""
        messages = self._rounds.get(round_number, {})
        held = messages.get((MESSAGE_PROPOSAL, self._schedule.leader(round_number)))
        if held is None or not held.block_id:
            return b"", []
        named = []
        for (kind, index), heard in messages.items():
            is_another = kind == MESSAGE_VOTE and heard.block_id not in (b"", held.block_id)
            if is_another and not heard.is_confronted and index != self._own_index:
                heard.is_confronted = True
                named.append(index)
        return held.block_id, named

    # Genuine messages

    def log_vote(self, vote: Vote) -> list[Evidence]:
        return self._note(MESSAGE_VOTE, vote.round, vote.index, vote.block_id, vote.signature)

    def log_proposal(self, block: Block, header: Header, block_id: bytes) -> list[Evidence]:
        return self._note(MESSAGE_PROPOSAL, header.round, header.producer, block_id, block.signature)

    def log_timeout(self, timeout: Timeout) -> None:
        self._note_timeout(timeout.round, timeout.index, timeout.qc.round, timeout.signature)

    def log_tc(self, tc: TimeoutCertificate) -> None:
        for entry in tc.timeouts:
            self._note_timeout(tc.round, entry.index, entry.qc_round, entry.signature)

    def log_qc(self, qc: QuorumCertificate) -> list[Evidence]:
        found: list[Evidence] = []
        for vote in qc.votes:
            found += self._note(MESSAGE_VOTE, qc.round, vote.index, qc.block_id, vote.signature)
        return found

    def log_blocks(self, blocks: Iterable[Block]) -> None:
        for block in blocks:
            header = block.header
            if header.epoch == self._schedule.epoch and header.round > 0:
                self._note(MESSAGE_PROPOSAL, header.round, header.producer, block.block_id, block.signature)
                self.log_qc(header.qc)
                if header.tc is not None:
                    self.log_tc(header.tc)

    def _note_timeout(self, round_number: int, index: int, qc_round: int, signature: bytes) -> None:
        self._note_newest(MESSAGE_TIMEOUT, round_number, index, b"", qc_round, signature)

    def _note(self, kind: str, round_number: int, index: int, block_id: bytes, signature: bytes) -> list[Evidence]:
        self._note_newest(kind, round_number, index, block_id, 0, signature)
        if index == self._own_index or abs(round_number - self._round) > EVIDENCE_ROUNDS_KEPT_COUNT:
            return []
        heard = self._heard(kind, round_number, index)
        if not heard.block_id:
            heard.block_id, heard.signature = block_id, signature
        elif heard.block_id != block_id and not heard.is_accused:
            heard.is_accused = True
            producer = self._schedule.producers[index]
            one, other = (heard.block_id, heard.signature), (block_id, signature)
            return [make_evidence(kind, self._schedule.epoch, round_number, producer, one, other)]
        return []

    def _note_newest(
        self, kind: str, round_number: int, index: int, block_id: bytes, qc_round: int, signature: bytes
    ) -> None:
        known = self._newest.get(index)
        is_newer = known is None or (round_number, _RANK[kind]) > (known.round, _RANK[known.kind])
        if not is_newer and index != self._own_index:
            return
        message = SignedMessage(
            kind=kind,
            epoch=self._schedule.epoch,
            round=round_number,
            block_id=block_id,
            qc_round=qc_round,
            signature=signature,
        )
        if is_newer:
            self._newest[index] = message
        if index == self._own_index:
            self._own_messages.append(message)
