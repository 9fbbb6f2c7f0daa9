"""The schedule: round leaders and quorum size."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

from consensus.chain.block import QuorumCertificate, TimeoutCertificate
from consensus.chain.epoch_settings import Epoch, compute_epoch_hash
from consensus.chain.messages import TIMEOUT_TAG, VOTE_TAG, timeout_parts, vote_parts
from consensus.chain.signature_cache import SignatureCheck
from consensus.errors import BlockRobotError
from consensus.limits import PRODUCERS_MAX_COUNT
from consensus.primitives.keys import verify

__all__ = ["Epoch", "Schedule", "compute_epoch_hash", "verify_qc", "verify_tc"]


@dataclass(frozen=True, slots=True)
class Schedule:
    """An epoch's producers in turn order (33-byte keys).

    `leaderless` indexes vote but never lead; if it names all, all lead.
    """

    epoch: int
    producers: tuple[bytes, ...]
    blocks_per_turn: int = 1
    leaderless: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.producers)
        if not 1 <= count <= PRODUCERS_MAX_COUNT or len(set(self.producers)) != count:
            raise BlockRobotError("GENESIS_INVALID", f"A schedule has 1 to {PRODUCERS_MAX_COUNT} different producers.")
        if self.blocks_per_turn < 1 or self.epoch < 0:
            raise BlockRobotError("GENESIS_INVALID", "A schedule's epoch or number of blocks per turn is impossible.")
        is_sorted = all(first < second for first, second in itertools.pairwise(self.leaderless))
        if not is_sorted or any(not 0 <= index < count for index in self.leaderless):
            raise BlockRobotError("GENESIS_INVALID", "The leaderless seats are not sorted indexes of producers.")

    @classmethod
    def of(cls, epoch: Epoch) -> Schedule:
        """Raises GENESIS_INVALID if there is none."""
        return cls(epoch.number, epoch.producers, epoch.settings.blocks_per_turn, epoch.leaderless)

    @property
    def quorum(self) -> int:
        """q = n - f with f = (n-1)//3: any two quorums share an honest producer."""
        count = len(self.producers)
        return count - (count - 1) // 3

    @property
    def faults_tolerated(self) -> int:
        """f = (n-1)//3."""
        return (len(self.producers) - 1) // 3

    def leader(self, round_number: int) -> int:
        """Return the leader's index: round robin over leading seats, `blocks_per_turn` each."""
        turn = round_number // self.blocks_per_turn
        count = len(self.producers)
        if not self.leaderless or len(self.leaderless) == count:
            return turn % count
        leaders = [index for index in range(count) if index not in self.leaderless]
        return leaders[turn % len(leaders)]

    def index_of(self, public_key: bytes) -> int | None:
        return self.producers.index(public_key) if public_key in self.producers else None


def _require_indexes(indexes: list[int], schedule: Schedule) -> None:
    if (
        len(indexes) != schedule.quorum
        or any(first >= second for first, second in itertools.pairwise(indexes))
        or indexes[0] < 0
        or indexes[-1] >= len(schedule.producers)
    ):
        raise BlockRobotError("CERTIFICATE_INVALID", "A certificate is not signed by exactly a quorum, in order.")


def verify_qc(
    qc: QuorumCertificate, schedule: Schedule, chain_id: bytes, round_zero_id: bytes, check: SignatureCheck = verify
) -> None:
    """Check a QC; round 0 certifies only `round_zero_id`. Raises CERTIFICATE_INVALID."""
    if qc.epoch != schedule.epoch:
        raise BlockRobotError("CERTIFICATE_INVALID", "The certificate is of another epoch.")
    if qc.round < 0:
        raise BlockRobotError("CERTIFICATE_INVALID", "A round is never negative.")
    if qc.round == 0:
        if qc.block_id != round_zero_id or qc.votes:
            raise BlockRobotError("CERTIFICATE_INVALID", "Round 0 certifies the epoch's first parent only.")
        return
    _require_indexes([vote.index for vote in qc.votes], schedule)
    parts = vote_parts(chain_id, qc.epoch, qc.round, qc.block_id)
    for vote in qc.votes:
        if not check(schedule.producers[vote.index], VOTE_TAG, vote.signature, *parts):
            raise BlockRobotError("CERTIFICATE_INVALID", f"The vote of producer {vote.index} is not genuine.")


def verify_tc(tc: TimeoutCertificate, schedule: Schedule, chain_id: bytes, check: SignatureCheck = verify) -> None:
    """Check q distinct timeouts for the round. Raises CERTIFICATE_INVALID."""
    if tc.epoch != schedule.epoch:
        raise BlockRobotError("CERTIFICATE_INVALID", "The certificate is of another epoch.")
    _require_indexes([timeout.index for timeout in tc.timeouts], schedule)
    for timeout in tc.timeouts:
        if not 0 <= timeout.qc_round < tc.round or not check(
            schedule.producers[timeout.index],
            TIMEOUT_TAG,
            timeout.signature,
            *timeout_parts(chain_id, tc.epoch, tc.round, timeout.qc_round),
        ):
            raise BlockRobotError("CERTIFICATE_INVALID", f"The timeout of producer {timeout.index} is not genuine.")
