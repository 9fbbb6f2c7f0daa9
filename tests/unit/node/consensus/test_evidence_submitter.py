"""R32: evidence goes on the chain once, from whoever's turn it is, and again until the state knows of it."""

from __future__ import annotations

from types import SimpleNamespace

import msgspec
import pytest

from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from consensus.state.producers import ACCUSED, CANDIDATE, CandidateRow
from node.consensus.evidence_submitter import ACCUSE_AGAIN_MS, PENDING_MAX_COUNT, TURN_MS, EvidenceSubmitter
from tests.sim.named_chain import CHAIN_ID
from tests.state_rows import stored
from tests.unit.consensus.one_core import Peers
from tests.unit.consensus.test_core_evidence import evidence_of_votes

PEERS = Peers()
EVIDENCE = evidence_of_votes(0)


class Stage:
    """Pool, state, clock and schedule in one."""

    def __init__(self, index: int | None = 1) -> None:
        self.now = 1_000_000
        self.state: dict[bytes, bytes] = {}
        self.submitted: list = []
        self.error: BlockRobotError | None = None
        self.schedule = PEERS.schedule
        key = PEERS.keys[index] if index is not None else PEERS.keys[0].__class__(bytes(31) + b"\x07")
        self.evidence_submitter = EvidenceSubmitter(
            key=key,
            chain_id=CHAIN_ID,
            pool=self,
            reader=lambda: self,
            schedule=lambda: self.schedule,
            clock=lambda: self.now,
        )

    def get(self, key: bytes) -> bytes | None:
        return self.state.get(key)

    async def submit(self, wires):
        self.submitted += [decode_transaction(wire) for wire in wires]
        return [SimpleNamespace(error=self.error) for _ in wires]

    def mark_candidate(
        self, status: str, *, key: bytes = EVIDENCE.producer, successor: bytes = b"", reinstated: int = 0
    ) -> None:
        height = 7 if status == "suspended" else 0
        entry = {"status": status, "successor": successor, "reinstated_epoch": reinstated, "suspended_height": height}
        self.state[CANDIDATE.key(key)] = stored(CandidateRow, **entry)


async def test_an_accusation_names_both_words_and_is_signed_with_the_producers_key():
    stage = Stage(1)
    stage.evidence_submitter.note(EVIDENCE)
    stage.now += TURN_MS
    assert await stage.evidence_submitter.submit_if_due() == 1
    (accusation,) = stage.submitted
    body = accusation.body
    assert (body.contract, body.entry, body.sender) == ("producers", "accuse", PEERS.keys[1].public_key)
    assert accusation.arguments() == list(msgspec.structs.astuple(EVIDENCE))


@pytest.mark.parametrize(("index", "turn"), [(1, 1), (2, 2), (3, 3), (None, 4)])
async def test_everybody_waits_for_his_turn(index, turn):
    stage = Stage(index)
    stage.evidence_submitter.note(EVIDENCE)
    stage.now += turn * TURN_MS - 1
    assert await stage.evidence_submitter.submit_if_due() == 0
    stage.now += 1
    assert await stage.evidence_submitter.submit_if_due() == 1


async def test_who_sees_it_known_before_his_turn_says_nothing():
    stage = Stage(3)
    stage.evidence_submitter.note(EVIDENCE)
    stage.state[ACCUSED.key(EVIDENCE.producer, 0, 1)] = encode_value(True)
    stage.now += 10 * TURN_MS
    assert await stage.evidence_submitter.submit_if_due() == 0
    assert stage.evidence_submitter.pending == []


async def test_a_removed_producer_is_accused_for_it_might_come_back_and_a_suspended_one_is_not():
    stage = Stage()
    stage.mark_candidate("removed")
    stage.evidence_submitter.note(EVIDENCE)
    stage.now += TURN_MS
    assert await stage.evidence_submitter.submit_if_due() == 1
    stage = Stage()
    stage.mark_candidate("suspended")
    stage.evidence_submitter.note(EVIDENCE)
    stage.now += TURN_MS
    assert await stage.evidence_submitter.submit_if_due() == 0
    assert stage.evidence_submitter.pending == []


async def test_a_new_key_is_no_way_out_and_an_old_sin_is_forgiven_with_the_reinstatement():
    stage = Stage()
    heir = b"h" * 33
    stage.mark_candidate("removed", successor=heir)
    stage.mark_candidate("producing", key=heir)
    stage.evidence_submitter.note(EVIDENCE)
    stage.now += TURN_MS
    assert await stage.evidence_submitter.submit_if_due() == 1
    stage.mark_candidate("producing", key=heir, reinstated=1)
    stage.now += ACCUSE_AGAIN_MS
    assert await stage.evidence_submitter.submit_if_due() == 0


async def test_it_is_tried_again_with_another_transaction_until_it_is_known():
    stage = Stage()
    stage.mark_candidate("producing")
    stage.evidence_submitter.note(EVIDENCE)
    stage.error = BlockRobotError("MEMPOOL_FULL")
    stage.now += TURN_MS
    for _ in range(3):
        assert await stage.evidence_submitter.submit_if_due() == 1
        assert await stage.evidence_submitter.submit_if_due() == 0
        stage.now += ACCUSE_AGAIN_MS
    assert len({transaction.txid for transaction in stage.submitted}) == 3
    stage.mark_candidate("suspended")
    assert await stage.evidence_submitter.submit_if_due() == 0
    assert stage.evidence_submitter.pending == []


async def test_one_case_a_producer_and_round_is_taken_up_and_no_more_than_so_many():
    stage = Stage()
    for _ in range(2):
        stage.evidence_submitter.note(EVIDENCE)
    assert len(stage.evidence_submitter.pending) == 1
    stage.evidence_submitter._cases = dict.fromkeys(map(bytes, range(PENDING_MAX_COUNT)))
    stage.evidence_submitter.note(evidence_of_votes(2))
    assert len(stage.evidence_submitter._cases) == PENDING_MAX_COUNT


async def test_nobody_is_accused_without_two_genuine_words_and_nobody_accuses_himself():
    own, stranger = Stage(0), Stage()
    own.evidence_submitter.note(EVIDENCE)
    stranger.evidence_submitter.note(msgspec.structs.replace(EVIDENCE, second_signature=bytes(64)))
    assert own.evidence_submitter.pending == stranger.evidence_submitter.pending == []
