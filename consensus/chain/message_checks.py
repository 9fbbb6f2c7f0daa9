"""Authenticity checks of peer messages; raise for nothing a peer can send."""

from __future__ import annotations

from consensus.chain.block import Block, Header, QuorumCertificate, TimeoutCertificate
from consensus.chain.block_rules import check_block
from consensus.chain.messages import (
    TIMEOUT_TAG,
    VOTE_TAG,
    SignedMessage,
    Timeout,
    Vote,
    is_genuine,
    timeout_parts,
    vote_parts,
)
from consensus.chain.schedule import Schedule, verify_qc, verify_tc
from consensus.chain.signature_cache import SignatureCheck
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import EXACT_INTEGER_END
from consensus.primitives.hashing import HASH_SIZE_BYTES


class MessageChecks:
    """The checks of one chain's epoch."""

    def __init__(self, chain_id: bytes, schedule: Schedule, round_zero_id: bytes, check: SignatureCheck) -> None:
        self._chain_id, self._schedule, self._round_zero_id = chain_id, schedule, round_zero_id
        self._check = check

    def has_producer(self, index: int | None) -> bool:
        return index is not None and 0 <= index < len(self._schedule.producers)

    def of_qc(self, qc: QuorumCertificate) -> bool:
        try:
            verify_qc(qc, self._schedule, self._chain_id, self._round_zero_id, self._check)
        except BlockRobotError:
            return False
        return qc.round < EXACT_INTEGER_END

    def of_tc(self, tc: TimeoutCertificate) -> bool:
        try:
            verify_tc(tc, self._schedule, self._chain_id, self._check)
        except BlockRobotError:
            return False
        return tc.round < EXACT_INTEGER_END

    def of_vote(self, vote: Vote) -> bool:
        if len(vote.block_id) != HASH_SIZE_BYTES:
            return False
        parts = vote_parts(self._chain_id, vote.epoch, vote.round, vote.block_id)
        return self._check(self._schedule.producers[vote.index], VOTE_TAG, vote.signature, *parts)

    def of_timeout(self, timeout: Timeout) -> bool:
        if not self.has_producer(timeout.index) or timeout.epoch != self._schedule.epoch:
            return False
        if not 0 <= timeout.qc.round < timeout.round < EXACT_INTEGER_END:
            return False
        parts = timeout_parts(self._chain_id, timeout.epoch, timeout.round, timeout.qc.round)
        return self._check(self._schedule.producers[timeout.index], TIMEOUT_TAG, timeout.signature, *parts)

    def of_message(self, message: SignedMessage, index: int) -> bool:
        return is_genuine(message, self._chain_id, self._schedule.producers[index])

    def of_block(self, block: Block, header: Header) -> bool:
        try:
            check_block(
                block,
                header,
                chain_id=self._chain_id,
                schedule=self._schedule,
                round_zero_id=self._round_zero_id,
                check=self._check,
            )
        except BlockRobotError:
            return False
        return True
