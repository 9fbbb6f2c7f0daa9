"""Each checker finds the broken promise in a history made by hand, and nothing in one that keeps it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import msgspec
import pytest

from network.sim.checkers import CHECKERS
from network.sim.checkers.custody import check_copies
from network.sim.history import (
    Acknowledged,
    Asked,
    BlockFinalized,
    ChainAudit,
    ClipKept,
    ClipTaken,
    CodeFault,
    CustodyAudit,
    Ended,
    EpochBegan,
    ExecutionDiffered,
    Flooded,
    Healed,
    History,
    NodeRefusedStart,
    NodeRestored,
    NodeStarted,
    Observation,
    PeerCutOff,
    ProposalSent,
    TimeoutSent,
    ValueRead,
    VoteSent,
)


def block(
    height: int, *, node: int = 0, name: str = "", txids: tuple[bytes, ...] = (), **changes: Any
) -> BlockFinalized:
    made = BlockFinalized(10.0 * height, node, True, height, 0, height, (name or str(height)).encode(), b"root", txids)
    return msgspec.structs.replace(made, **changes)


def told(height: int, txid: bytes = b"t", *, node: int = 0) -> Acknowledged:
    return Acknowledged(10.0 * height + 5, node, txid, height, str(height).encode(), True)


def end(*heights: int, settled: bool = True) -> Ended:
    return Ended(1_000.0, -1, heights, heights, settled)


AUDIT = CustodyAudit(900.0, 0, 2, b"2", (b"a",), (), (), (b"e",), (b"g",), b"2", (b"a", b"e"), (b"e",), (b"g",), 0)


CHAIN = ChainAudit(910.0, 0, (0, 1, 2), 2, ((b"a", (0, 1)),), ((b"x", (b"e",), (0,)),))
"""Record `a` is to be kept by nodes 0 and 1; the erasure `x` of record `e` is confirmed by node 0."""


@dataclass(frozen=True)
class Case:
    checker: str
    kept: tuple[Observation, ...]
    broken: tuple[Observation, ...]


def audit(**changes: Any) -> CustodyAudit:
    return msgspec.structs.replace(AUDIT, **changes)


def flooded(taken_ms: float | None) -> tuple[Observation, ...]:
    """Twelve calls that take 10 ms each; then a node floods, and one call takes so long."""
    seen: list[Observation] = []
    for number in range(1, 13):
        txid = bytes([number])
        seen += [Asked(10.0 * number, 0, txid), block(number, txids=(txid,), at_ms=10.0 * number + 10)]
    seen += [Flooded(500.0, 3, 900.0, "ranges"), Asked(600.0, 0, b"t")]
    final = () if taken_ms is None else (block(60, txids=(b"t",), at_ms=600 + taken_ms),)
    return (*seen, *final)


MANY = tuple(bytes([number]) for number in range(49, 61))
VOTE = VoteSent(1.0, 0, 0, 3, b"x")
CASES = {
    "two final blocks at a height": Case(
        "agreement", (block(1), block(1, node=1)), (block(1), block(1, node=1, name="y"))
    ),
    "a client is told of another block": Case("agreement", (block(1), told(1)), (block(1, name="y"), told(1))),
    "an epoch has two schedules": Case(
        "agreement",
        (EpochBegan(1.0, 0, 1, (b"p",), b"b"), EpochBegan(2.0, 1, 1, (b"p",), b"b")),
        (EpochBegan(1.0, 0, 1, (b"p",), b"b"), EpochBegan(2.0, 1, 1, (b"p", b"q"), b"b")),
    ),
    "an epoch begins at two blocks": Case(
        "agreement",
        (EpochBegan(1.0, 0, 1, (b"p",), b"b"), EpochBegan(9.0, 0, 1, (b"p",), b"b")),
        (EpochBegan(1.0, 0, 1, (b"p",), b"b"), EpochBegan(2.0, 1, 1, (b"p",), b"c")),
    ),
    "a ledger ends lower after a restart": Case(
        "durability",
        (block(1), block(2), NodeStarted(30.0, 0, 2, b"2", b"root", -1)),
        (block(1), block(2), NodeStarted(30.0, 0, 1, b"1", b"root", -1)),
    ),
    "told of what an old disk lacks": Case(
        "durability",
        (block(1), block(2), NodeRestored(30.0, 0, 1), told(2)),
        (block(1), block(2), NodeRestored(22.0, 0, 1), told(2)),
    ),
    "told before it was safe": Case("durability", (block(1), told(1)), (block(1), told(2))),
    "two votes in a round": Case("no_double_vote", (VOTE, VOTE), (VOTE, VoteSent(2.0, 0, 0, 3, b"y"))),
    "a vote after giving the round up": Case(
        "no_double_vote", (VOTE, TimeoutSent(2.0, 0, 0, 3, 2), VOTE), (TimeoutSent(0.5, 0, 0, 3, 2), VOTE)
    ),
    "two proposals in a round": Case(
        "no_double_proposal",
        (ProposalSent(1.0, 0, 0, 3, 1, b"x"), ProposalSent(2.0, 0, 1, 3, 1, b"y")),
        (ProposalSent(1.0, 0, 0, 3, 1, b"x"), ProposalSent(2.0, 0, 0, 3, 1, b"y")),
    ),
    "a new word of an earlier round": Case(
        "only_forward", (VOTE, VoteSent(2.0, 0, 0, 4, b"y"), VOTE), (VoteSent(0.5, 0, 0, 4, b"y"), VOTE)
    ),
    "another state": Case(
        "equal_state_roots", (block(1), block(1, node=1)), (block(1), block(1, node=1, state_root=b"other"))
    ),
    "a block executed twice with different results": Case(
        "equal_state_roots", (block(1),), (block(1), ExecutionDiffered(1.0, -1, 1, "different state root"))
    ),
    "a call that must succeed fails": Case(
        "calls_succeed",
        (told(1), msgspec.structs.replace(told(1), ok=False, code="EXPIRY_WRONG", excused=("EXPIRY_WRONG",))),
        (msgspec.structs.replace(told(1), ok=False, code="NOT_A_ROBOT", excused=("EXPIRY_WRONG",)),),
    ),
    "another value read": Case(
        "equal_state_roots",
        (ValueRead(1.0, 0, b"k", 1, b"root", b"v"), ValueRead(2.0, 1, b"k", 1, b"root", b"v")),
        (ValueRead(1.0, 0, b"k", 1, b"root", b"v"), ValueRead(2.0, 1, b"k", 1, b"root", b"w")),
    ),
    "a transaction twice": Case(
        "exactly_once", (block(1, txids=(b"t",)), block(2)), (block(1, txids=(b"t",)), block(2, txids=(b"t",)))
    ),
    "an acknowledged transaction lost": Case(
        "exactly_once", (block(1, txids=(b"t",)), told(1), end(1)), (block(1), told(1), end(1))
    ),
    "a store ahead of its ledger": Case(
        "chain_equals_store", (NodeStarted(1.0, 0, 2, b"2", b"", 2),), (NodeStarted(1.0, 0, 2, b"2", b"", 3),)
    ),
    "a record that the store forgot": Case("chain_equals_store", (AUDIT,), (audit(confirmed=()),)),
    "a record that no chain knows": Case("chain_equals_store", (AUDIT,), (audit(missing=(b"z",)),)),
    "a clip that another custodian has": Case(
        "chain_equals_store",
        (audit(confirmed=(), missing=(b"a",)), audit(node=1, checkpoint=3, checkpoint_id=b"3", chain_id_at=b"3")),
        (audit(confirmed=(), missing=(b"a",)), audit(node=1)),
    ),
    "a clip that was taken and is not kept": Case(
        "chain_equals_store",
        (ClipTaken(1.0, 0, b"a"), NodeRestored(2.0, 0, 1), audit(confirmed=(), missing=(b"a",))),
        (NodeRestored(1.0, 0, 1), ClipTaken(2.0, 0, b"a"), audit(confirmed=(), missing=(b"a",))),
    ),
    "a run in which nothing was kept": Case(
        "chain_equals_store",
        (ClipTaken(1.0, 1, b"1"), audit(confirmed=(), missing=MANY, chain_recorded=MANY)),
        (audit(confirmed=(), missing=MANY, chain_recorded=MANY),),
    ),
    "an erased record still kept": Case("erased_means_erased", (AUDIT,), (audit(confirmed=(b"a", b"e")),)),
    "a keeper without its copy": Case(
        "copies",
        (AUDIT, audit(node=1), audit(node=2, confirmed=()), CHAIN),
        (AUDIT, audit(node=1, confirmed=()), audit(node=2), CHAIN),
    ),
    "a clip that two took and nobody has": Case(
        "copies",
        (ClipTaken(1.0, 0, b"a"), audit(confirmed=()), audit(node=1, confirmed=()), CHAIN),
        (ClipTaken(1.0, 0, b"a"), ClipTaken(2.0, 2, b"a"), audit(confirmed=()), audit(node=1, confirmed=()), CHAIN),
    ),
    "an erasure that one who had the clip has not confirmed": Case(
        "erasures_confirmed",
        (ClipKept(1.0, 0, b"e"), Asked(2.0, 1, b"x"), ClipKept(3.0, 1, b"e"), AUDIT, audit(node=1), CHAIN),
        (ClipKept(1.0, 1, b"e"), Asked(2.0, 1, b"x"), AUDIT, audit(node=1), CHAIN),
    ),
    "a key that still opens": Case("erased_means_erased", (AUDIT,), (audit(keys_left=1),)),
    "nothing new after healing": Case(
        "liveness", (Healed(20.0, -1, 2, 0, 2, (0,)), block(3)), (Healed(20.0, -1, 2, 0, 2, (0,)), block(2))
    ),
    "too many rounds after healing": Case(
        "liveness",
        (Healed(20.0, -1, 2, 0, 2, (0,)), block(3, round=10)),
        (Healed(20.0, -1, 2, 0, 2, (0,)), block(3, round=60)),
    ),
    "too many rounds after healing, in two epochs": Case(
        "liveness",
        (Healed(20.0, -1, 2, 0, 2, (0,)), VoteSent(25.0, 0, 0, 8, b"x"), block(3, epoch=1, round=4)),
        (Healed(20.0, -1, 2, 0, 2, (0,)), VoteSent(25.0, 0, 0, 12, b"x"), block(3, epoch=1, round=4)),
    ),
    "fewer rounds than asked for": Case("liveness", (end(3),), (msgspec.structs.replace(end(3), reached=False),)),
    "no end": Case("liveness", (end(3),), (end(3, settled=False),)),
    "calls that wait while a node floods": Case("finality_under_flood", flooded(40.0), flooded(60.0)),
    "calls that are never final while a node floods": Case("finality_under_flood", flooded(40.0), flooded(None)),
    "a flood in which nobody asked for anything": Case("finality_under_flood", flooded(40.0), flooded(40.0)[:-2]),
    "calls that wait longer than for a round of a peer that was cut off": Case(
        "finality_under_flood",
        (*flooded(540.0), PeerCutOff(550.0, 0, 3, "SIGNATURE_INVALID")),
        (*flooded(560.0), PeerCutOff(550.0, 0, 3, "SIGNATURE_INVALID")),
    ),
    "calls that wait though it was no flooding peer that was cut off": Case(
        "finality_under_flood", flooded(40.0), (*flooded(60.0), PeerCutOff(550.0, 0, 2, "SIGNATURE_INVALID"))
    ),
    "an exception": Case("code_faults", (), (CodeFault(1.0, 0, "KeyError"),)),
    "a node that will not start": Case(
        "code_faults", (NodeRefusedStart(1.0, 0, "JOURNAL_UNWRITABLE"),), (NodeRefusedStart(1.0, 0, "JOURNAL_DAMAGED"),)
    ),
}


def history_of(observations: tuple[Observation, ...]) -> History:
    history = History()
    for observation in observations:
        history.add(observation)
    return history


@pytest.mark.parametrize("name", CASES)
def test_a_checker_finds_its_broken_promise_and_only_that(name: str) -> None:
    case = CASES[name]
    assert CHECKERS[case.checker](history_of(case.kept)) == []
    found = CHECKERS[case.checker](history_of(case.broken))
    assert {violation.checker for violation in found} == {case.checker}


def test_every_checker_is_tried_here() -> None:
    assert {case.checker for case in CASES.values()} == set(CHECKERS)


def test_what_a_dishonest_node_says_breaks_no_promise_of_the_honest_ones() -> None:
    history = history_of((VOTE, VoteSent(2.0, 0, 0, 3, b"y"), block(1), block(1, name="y")))
    history.byzantine = frozenset({0})
    assert [violation for check in CHECKERS.values() for violation in check(history)] == []


def test_a_clip_that_only_dishonest_custodians_took_is_no_honest_ones_loss() -> None:
    history = history_of((ClipTaken(1.0, 0, b"a"), ClipTaken(2.0, 2, b"a"), CHAIN))
    assert check_copies(history)
    history.byzantine = frozenset({0, 2})
    assert check_copies(history) == []
