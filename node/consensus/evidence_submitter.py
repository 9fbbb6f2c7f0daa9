"""Submits evidence against producers: two genuine signatures each.

All holders have it (R30) and take turns in schedule order until finalized (R32).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import structlog

from consensus.chain.evidence import Evidence, verify_evidence
from consensus.chain.schedule import Schedule
from consensus.chain.transaction import sign_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import tagged_hash
from consensus.primitives.keys import PrivateKey
from consensus.state.producers import ACCUSED, CANDIDATE, PRODUCERS
from node.directory.node_directory import Directory
from node.mempool.transaction_pool import TransactionPool
from node.storage.ledger_store import LedgerSnapshot

TURN_MS = 1_500
ACCUSE_AGAIN_MS = 30_000
ACCUSATION_LIFETIME_MS = 60_000
PENDING_MAX_COUNT = 64
SUCCESSORS_MAX_COUNT = 16
SALT_SIZE_BYTES = 8

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class _Case:
    evidence: Evidence
    due_ms: int
    tries_count: int = 0


class EvidenceSubmitter:
    """This node's evidence that the finalized state lacks."""

    def __init__(
        self,
        *,
        key: PrivateKey,
        chain_id: bytes,
        pool: TransactionPool,
        reader: Callable[[], LedgerSnapshot],
        schedule: Callable[[], Schedule],
        clock: Callable[[], int],
    ) -> None:
        """`reader` gives the newest finalized state, `schedule` the current epoch's producers."""
        self._key = key
        self._chain_id = chain_id
        self._pool = pool
        self._reader = reader
        self._schedule = schedule
        self._clock = clock
        self._cases: dict[bytes, _Case] = {}

    @property
    def pending(self) -> list[Evidence]:
        return [case.evidence for case in self._cases.values()]

    def note(self, evidence: Evidence) -> None:
        """Add evidence: one per producer and round, never against one's own key."""
        try:
            verify_evidence(evidence, self._chain_id)
        except BlockRobotError as error:
            log.error("evidence_refused", code=error.code, detail=error.detail)
            return
        place = ACCUSED.key(evidence.producer, evidence.epoch, evidence.round)
        if evidence.producer == self._key.public_key or place in self._cases or len(self._cases) >= PENDING_MAX_COUNT:
            return
        self._cases[place] = _Case(evidence, due_ms=self._clock() + self._turn() * TURN_MS)

    def _turn(self) -> int:
        schedule = self._schedule()
        index = schedule.index_of(self._key.public_key)
        return len(schedule.producers) if index is None else index

    async def submit_if_due(self) -> int:
        """Submit due accusations, drop known cases; return the number submitted."""
        if not self._cases:
            return 0
        reader, now_ms = self._reader(), self._clock()
        for place in [place for place, case in self._cases.items() if _is_known(reader, place, case.evidence)]:
            del self._cases[place]
        due = [case for case in self._cases.values() if case.due_ms <= now_ms]
        for case in due:
            case.tries_count += 1
            case.due_ms = now_ms + ACCUSE_AGAIN_MS
            await self._accuse(case, now_ms)
        return len(due)

    async def _accuse(self, case: _Case, now_ms: int) -> None:
        evidence = case.evidence
        salt = tagged_hash("blockrobot/accusation-salt", encode(evidence), case.tries_count.to_bytes(8))
        accusation = sign_transaction(
            self._key,
            chain_id=self._chain_id,
            contract=PRODUCERS,
            entry="accuse",
            arguments=[
                evidence.kind,
                evidence.epoch,
                evidence.round,
                evidence.producer,
                evidence.first_id,
                evidence.first_signature,
                evidence.second_id,
                evidence.second_signature,
            ],
            valid_until_ms=now_ms + ACCUSATION_LIFETIME_MS,
            salt=salt[:SALT_SIZE_BYTES],
        )
        (result,) = await self._pool.submit([accusation.wire])
        code = "" if result.error is None else result.error.code
        log.warning(
            "accused", producer=evidence.producer.hex(), epoch=evidence.epoch, round=evidence.round, refused=code
        )


def _is_known(reader: LedgerSnapshot, place: bytes, evidence: Evidence) -> bool:
    """Return whether the state has the evidence, or a later suspension or reinstatement.

    Removed producers are still accused: they may return.
    """
    if reader.get(place) is not None:
        return True
    suspect = evidence.producer
    for _ in range(SUCCESSORS_MAX_COUNT):
        row = CANDIDATE.at(reader, suspect)
        if row is None:
            return False
        if not row.successor:
            return row.suspended_height > 0 or evidence.epoch < row.reinstated_epoch
        suspect = row.successor
    return False


def suspended_height(state: LedgerSnapshot, producer: bytes) -> int | None:
    row = CANDIDATE.at(state, producer)
    return row.suspended_height if row is not None and row.status == "suspended" else None


def describe_accused(
    evidence_submitter: EvidenceSubmitter | None, directory: Directory, state: LedgerSnapshot
) -> list[dict[str, Any]]:
    pending = () if evidence_submitter is None else evidence_submitter.pending
    names = {name for each in pending if (name := directory.name_of_producer(each.producer)) is not None}
    rows: list[dict[str, Any]] = [{"name": name, "state": "evidence", "height": None} for name in sorted(names)]
    for name, node in sorted(directory.content.active.items()):
        height = suspended_height(state, node.producer_key) if node.producer_key else None
        if height is not None:
            rows.append({"name": name, "state": "suspended", "height": height})
    return rows
