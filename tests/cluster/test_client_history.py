"""The judge of the stories is judged: it passes what one chain can have said, and catches each way of lying about it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.cluster.client_history import Acknowledged, ClientHistory, Read, Seen

pytestmark = pytest.mark.smoke


def _write(number: int, client: str = "ann", *, height: int | None = None, index: int = 0) -> Acknowledged:
    """Record `number`, asked for at that second and told of half a second later."""
    name = bytes([number])
    height = number if height is None else height
    return Acknowledged(client, name, name * 2, height, index, bytes([height]) * 3, number, number + 0.5)


def _read(at_s: float, height: int, client: str = "ann", node: str = "node-1", **more: object) -> Read:
    return replace(Read(client, node, height, height * 1000, at_s, at_s + 0.1), **more)  # type: ignore[arg-type]


def _seen(write: Acknowledged) -> Seen:
    return Seen(write.height, write.txid)


FIRST, SECOND, THIRD = _write(1), _write(2, "bob"), _write(3)
WRITES = [FIRST, SECOND, THIRD]


def test_what_one_chain_can_have_said_is_accepted() -> None:
    reads = [
        _read(1.6, 1, counts={"ann": 1, "bob": 0}, records={FIRST.record_id: _seen(FIRST), THIRD.record_id: None}),
        _read(1.7, 1, "bob", "node-2", counts={"ann": 1}),
        _read(3.6, 3, counts={"ann": 2, "bob": 1}, records={write.record_id: _seen(write) for write in WRITES}),
    ]
    history = ClientHistory(WRITES, reads)
    assert history.violations() == []
    assert history.unread(["node-1"]) == []


def test_a_reader_may_be_behind_what_others_were_told() -> None:
    assert ClientHistory(WRITES, [_read(9, 1, "cal", counts={"ann": 1, "bob": 0})]).violations() == []


def test_writes_that_were_under_way_together_may_stand_in_either_order() -> None:
    early, late = replace(FIRST, told_s=5.0), replace(SECOND, height=1, index=1, block_id=FIRST.block_id)
    assert ClientHistory([replace(early, index=2), late]).violations() == []


@pytest.mark.parametrize(
    ("writes", "said"),
    [
        ([FIRST, replace(SECOND, height=1, block_id=FIRST.block_id)], "one place"),
        ([FIRST, replace(SECOND, txid=FIRST.txid)], "one txid"),
        ([FIRST, replace(SECOND, record_id=FIRST.record_id)], "one record_id"),
        ([FIRST, replace(SECOND, height=0, block_id=b"")], "was asked for after"),
        ([FIRST, replace(SECOND, height=1, index=1)], "two blocks at height 1"),
    ],
    ids=["doubled place", "doubled transaction", "doubled record", "out of order", "fork"],
)
def test_acknowledgements_that_contradict_each_other_are_found(writes: list[Acknowledged], said: str) -> None:
    (found,) = ClientHistory(writes).violations()
    assert said in found


@pytest.mark.parametrize(
    ("reads", "said"),
    [
        ([_read(3.6, 3, records={FIRST.record_id: None})], "has lost"),
        ([_read(3.6, 3, records={FIRST.record_id: Seen(2, FIRST.txid)})], "acknowledged was 1"),
        ([_read(3.6, 3, records={FIRST.record_id: Seen(1, b"other")})], "acknowledged was 1"),
        ([_read(1.6, 1, records={SECOND.record_id: _seen(SECOND)})], "before it was there"),
        ([_read(3.6, 3, counts={"ann": 3})], "has 3 records of ann, acknowledged are 2"),
        ([_read(3.6, 3, counts={"bob": 0})], "has 0 records of bob, acknowledged are 1"),
        ([_read(3.6, 2)], "led back from height 3 to 2"),
        ([_read(4, 4), _read(5, 3)], "led back from height 4 to 3"),
        ([_read(4, 4), _read(4, 4, "bob", timestamp_ms=1)], "two states at height 4"),
        ([_read(4, 4, records={b"refused": Seen(4, b"")})], "which was refused"),
    ],
    ids=[
        "lost",
        "elsewhere",
        "another transaction",
        "future",
        "doubled",
        "too few",
        "behind the own write",
        "behind the own read",
        "fork",
        "refused and there",
    ],
)
def test_reads_that_no_one_chain_gives_are_found(reads: list[Read], said: str) -> None:
    (found,) = ClientHistory(WRITES, reads, given_up={b"refused"}).violations()
    assert said in found


def test_counts_that_shrink_are_found() -> None:
    reads = [_read(3.6, 3, counts={"ann": 2}), _read(3.8, 4, counts={"ann": 1})]
    found = ClientHistory(WRITES, reads).violations()
    assert "ann read 1 records of ann after 2" in found


def test_a_node_that_was_not_asked_after_the_acknowledgement_is_named() -> None:
    history = ClientHistory([FIRST], [_read(1.2, 1, records={FIRST.record_id: _seen(FIRST)})])
    assert len(history.unread(["node-1", "node-2"])) == 2
