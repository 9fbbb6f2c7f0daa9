"""A candidate says that it is ready when it is close to the chain, often enough to count, and no more often than that."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from consensus.chain.schedule import Schedule
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.state.producers import CANDIDATE, CandidateRow
from node.consensus.readiness_reporter import SAY_AGAIN_BLOCKS, SAY_AGAIN_MS, SAY_INTERVAL_MIN_MS, ReadinessReporter
from node.mempool.transaction_pool import SubmitResult
from node.storage.ledger_store import Position
from tests.state_rows import stored

KEY = PrivateKey(sha256(b"candidate"))
OTHER = PrivateKey(sha256(b"producer")).public_key
ROOT = bytes(31) + b"r"


class Stage:
    """State, pool, clock and peers of one candidate."""

    def __init__(self) -> None:
        self.entry: dict[str, Any] | None = {"status": "candidate", "ready_ms": 0, "ready_height": 0}
        self.position = Position(height=7, block_id=bytes(32), state_root=ROOT, timestamp_ms=1_000)
        self.time_ms = 1_000_000
        self.is_close = True
        self.schedule = Schedule(epoch=0, producers=(OTHER,))
        self.said: list[Transaction] = []
        self.reporter = ReadinessReporter(
            key=KEY,
            chain_id=bytes(32),
            pool=self,  # type: ignore[arg-type]
            reader=lambda: self,  # type: ignore[arg-type,return-value]
            schedule=lambda: self.schedule,
            is_close=lambda: self.is_close,
            clock=lambda: self.time_ms,
            randomness=bytes,
        )

    def get(self, key: bytes) -> bytes | None:
        assert key == CANDIDATE.key(KEY.public_key)
        return None if self.entry is None else stored(CandidateRow, **self.entry)

    async def submit(self, wires: Sequence[bytes]) -> Sequence[SubmitResult]:
        self.said += [decode_transaction(wire) for wire in wires]
        return [SubmitResult(txid=self.said[-1].txid, error=None) for _ in wires]


async def test_a_candidate_says_with_its_producer_key_which_state_it_has_reached() -> None:
    stage = Stage()
    assert await stage.reporter.submit_if_due()
    (word,) = stage.said
    word.verify_sender()
    assert (word.body.sender, word.body.contract, word.body.entry) == (KEY.public_key, "producers", "ready")
    assert word.arguments() == [7, ROOT]


@pytest.mark.parametrize("why", ["no candidate", "removed", "suspended", "producing", "seated", "behind", "no chain"])
async def test_a_node_without_cause_says_nothing(why: str) -> None:
    stage = Stage()
    assert stage.entry is not None
    if why == "no candidate":
        stage.entry = None
    elif why == "seated":
        stage.schedule = Schedule(epoch=0, producers=(OTHER, KEY.public_key))
    elif why == "behind":
        stage.is_close = False
    elif why == "no chain":
        stage.position = None  # type: ignore[assignment]
    else:
        stage.entry["status"] = why
    assert not await stage.reporter.submit_if_due()
    assert stage.said == []


async def test_a_word_that_still_counts_is_not_said_again_and_an_old_one_is() -> None:
    stage = Stage()
    stage.entry = {"status": "candidate", "ready_ms": 900, "ready_height": 6}
    assert not await stage.reporter.submit_if_due()
    stage.position = Position(7, bytes(32), ROOT, 900 + SAY_AGAIN_MS + 1)
    assert await stage.reporter.submit_if_due()
    stage.time_ms += SAY_INTERVAL_MIN_MS
    stage.position = Position(6 + SAY_AGAIN_BLOCKS + 1, bytes(32), ROOT, 1_000)
    assert await stage.reporter.submit_if_due()


async def test_however_often_it_is_looked_at_the_word_is_said_at_a_bounded_rate() -> None:
    stage = Stage()
    for _ in range(100):
        await stage.reporter.submit_if_due()
        stage.time_ms += SAY_INTERVAL_MIN_MS // 10
    assert len(stage.said) == 10
