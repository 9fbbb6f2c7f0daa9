"""Rights in the wallet: which key says what, that nothing joins a person to her visits, what is kept of a correction."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from clients.wallet.ledger.visit_audit import audit_all
from clients.wallet.presentation.audit_story import describe_event
from clients.wallet.records.rights_requests import (
    RecordChoice,
    Rights,
    RightsStatement,
    choose,
    read_correction,
    write_correction,
)
from clients.wallet.store.keystore import Keystore
from consensus.errors import BlockRobotError
from consensus.rights.right_codes import commit_correction
from consensus.state.rights import CORRECTION_COUNT, OBJECTION, QUARANTINE, RESTRICTION, RestrictionRow
from tests.world.dicts import NOW_MS, Saying, World


@pytest.fixture
def saying(world: World, monkeypatch: pytest.MonkeyPatch) -> Saying:
    saying = Saying()
    monkeypatch.setattr(world.network, "call", saying)
    return saying


async def no_sleep(_: float) -> None:
    """Time passes."""


def quiet(_: int, __: int) -> None:
    """Nobody listens."""


async def test_a_word_about_a_visit_is_signed_by_its_owner_key_alone(world: World, saying: Saying) -> None:
    visit = world.open_visit()
    clip = world.record(visit)
    reports = await world.wallet.records()
    rights = Rights(world.wallet)
    (whole,) = choose(reports, (), (visit.owner.hex()[:12],))
    (one,) = choose(reports, (clip.upload.record_id.hex(),), ())
    await rights.restrict(whole, "legal-claim")
    await rights.lift(one)
    await rights.correct(one, "attribution", "That is my sister.")
    await rights.deny(whole.visit)
    assert {key for key, _, _ in saying.said} == {visit.owner}
    assert [(entry, arguments[:1]) for _, entry, arguments in saying.said] == [
        ("rights.restrict", [[]]),
        ("rights.lift", [[clip.upload.record_id]]),
        ("rights.rectify", [[clip.upload.record_id]]),
        ("rights.wrong_person", []),
    ]


async def test_an_objection_speaks_as_the_member_of_recording_and_as_each_owner_of_release(
    world: World, saying: Saying
) -> None:
    visits = [world.open_visit() for _ in range(5)]
    world.open_visit(world.stranger())
    world.put(OBJECTION, {"demo": NOW_MS}, visits[0].owner)
    world.put(QUARANTINE, b"b" * 32, visits[1].owner)
    slept: list[float] = []

    async def sleep(seconds: float) -> None:
        slept.append(seconds)

    rights = Rights(world.wallet, sleep=sleep)
    assert await rights.object_to_recording(["demo"]) == 8
    said = await rights.object_to_release(["demo"], at_once=False, on_progress=quiet)
    member = world.keys.identity.public_key
    assert saying.said[0] == (member, "rights.object_to", [b"h" * 32, ["demo"]])
    assert {key for key, _, _ in saying.said[1:]} == {visit.owner for visit in visits[2:]}
    assert all(member not in repr(arguments).encode() for _, _, arguments in saying.said[1:])
    assert len(said) == len(slept) == 3
    await rights.object_to_release(["demo"], at_once=True, on_progress=quiet)
    assert len(slept) == 3, "at once means without a pause"


async def test_the_order_in_which_visits_are_told_is_drawn(world: World, saying: Saying) -> None:
    visits = [world.open_visit().owner for _ in range(12)]
    orders = set()
    for _ in range(4):
        saying.said.clear()
        await Rights(world.wallet, sleep=no_sleep).object_to_release(["demo"], at_once=False, on_progress=quiet)
        orders.add(tuple(key for key, _, _ in saying.said))
    assert len(orders) > 1
    assert all(set(order) == set(visits) for order in orders)


async def test_restricting_several_visits_is_spread_too_and_one_alone_waits_for_nothing(
    world: World, saying: Saying
) -> None:
    slept: list[float] = []

    async def sleep(seconds: float) -> None:
        slept.append(seconds)

    for _ in range(12):
        world.open_visit()
    visits = [RecordChoice(report.visit) for report in await world.wallet.records()]
    rights, orders = Rights(world.wallet, sleep=sleep), set()
    for _ in range(4):
        saying.said.clear()
        said, refusal = await rights.say_each(visits, rights.lift, at_once=False, on_progress=quiet)
        assert (len(said), refusal) == (12, None)
        orders.add(tuple(key for key, _, _ in saying.said))
    assert (len(slept), len(orders) > 1) == (48, True)
    await rights.say_each(visits[:1], rights.lift, at_once=False, on_progress=quiet)
    await rights.say_each(visits, rights.lift, at_once=True, on_progress=quiet)
    assert len(slept) == 48


async def test_what_was_said_before_a_refusal_is_returned_with_it(world: World, saying: Saying) -> None:
    for _ in range(3):
        world.open_visit()
    visits = [RecordChoice(report.visit) for report in await world.wallet.records()]
    rights = Rights(world.wallet, sleep=no_sleep)

    async def lift_twice(chosen: RecordChoice) -> RightsStatement:
        saying.refusal = "CALL_REFUSED" if len(saying.said) == 2 else ""
        return await rights.lift(chosen)

    said, refusal = await rights.say_each(visits, lift_twice, at_once=False, on_progress=quiet)
    assert len(said) == 2
    assert refusal is not None
    assert refusal.code == "CALL_REFUSED"


async def test_a_corrections_text_stays_in_the_wallet_and_proves_itself(world: World, saying: Saying) -> None:
    visit = world.open_visit()
    (report,) = await world.wallet.records()
    _, correction = await Rights(world.wallet).correct(RecordChoice(report.visit), "attribution", "That is my sister.")
    (_, _, arguments) = saying.said[-1]
    assert arguments == [[], "attribution", commit_correction(correction)]
    assert b"sister" not in repr(arguments).encode()
    assert Keystore.open(world.store._path, "tea").content.corrections == [correction]
    assert read_correction(write_correction(correction)) == correction
    assert (correction.visit, len(correction.salt)) == (visit.owner.hex(), 64)


async def test_what_was_refused_is_forgotten_and_what_may_have_become_final_is_kept(
    world: World, saying: Saying
) -> None:
    world.open_visit()
    (report,) = await world.wallet.records()
    rights = Rights(world.wallet)
    for code, kept in (("CALL_REFUSED", 0), ("TRANSACTION_NOT_FINAL_IN_TIME", 1)):
        saying.refusal = code
        with pytest.raises(BlockRobotError):
            await rights.correct(RecordChoice(report.visit), "metadata", "It was on Monday.")
        assert len(world.store.content.corrections) == kept


def test_any_change_of_a_correction_changes_its_commitment() -> None:
    first = read_correction(b'{"kind":"attribution","text":"a","salt":"00","visit":"02","record_ids":["01"]}')
    others = [
        b'{"kind":"metadata","text":"a","salt":"00","visit":"02","record_ids":["01"]}',
        b'{"kind":"attribution","text":"b","salt":"00","visit":"02","record_ids":["01"]}',
        b'{"kind":"attribution","text":"a","salt":"01","visit":"02","record_ids":["01"]}',
        b'{"kind":"attribution","text":"a","salt":"00","visit":"03","record_ids":["01"]}',
        b'{"kind":"attribution","text":"a","salt":"00","visit":"02","record_ids":[]}',
        b'{"kind":"attribution","text":"a\\u0001","salt":"00","visit":"02","record_ids":[]}',
    ]
    commitments = {commit_correction(first), *(commit_correction(read_correction(data)) for data in others)}
    assert len(commitments) == len(others) + 1
    with pytest.raises(BlockRobotError):
        read_correction(b"[]")


@pytest.mark.parametrize(
    ("act", "code"),
    [
        (lambda rights, chosen: rights.restrict(chosen, "because"), "VALUE_INVALID"),
        (lambda rights, chosen: rights.correct(chosen, "rumour", "x"), "VALUE_INVALID"),
        (lambda rights, chosen: rights.correct(chosen, "metadata", ""), "VALUE_INVALID"),
        (lambda rights, chosen: rights.correct(chosen, "metadata", "x" * 4097), "VALUE_INVALID"),
        (lambda rights, _: rights.object_to_recording(["spying"]), "PURPOSE_UNKNOWN"),
    ],
)
async def test_what_cannot_be_said_is_not_sent(world: World, saying: Saying, act: Any, code: str) -> None:
    world.open_visit()
    (report,) = await world.wallet.records()
    with pytest.raises(BlockRobotError) as refusal:
        await act(Rights(world.wallet), RecordChoice(report.visit))
    assert (refusal.value.code, saying.said) == (code, [])


async def test_a_visit_is_named_by_a_beginning_that_is_its_own(world: World) -> None:
    for _ in range(3):
        world.record(world.open_visit())
    reports = await world.wallet.records()
    for start, code in (("02", "NAME_TOO_SHORT"), ("ffffffff", "VISIT_NOT_FOUND")):
        with pytest.raises(BlockRobotError, match=rf"^{code}:"):
            choose(reports, (), (start,))
    record_id = reports[1].records[0].record_id.hex()
    (chosen,) = choose(reports, (record_id[:12].upper(), record_id), ())
    assert [entry.record_id.hex() for entry in chosen.records] == [record_id], (
        "a beginning is enough, and twice is once"
    )
    with pytest.raises(BlockRobotError):
        choose(reports, ("00" * 16,), ())
    record = reports[0].records[0].record_id.hex()
    both = choose(reports, (record,), (reports[0].visit.owner.hex(),))
    assert both == [RecordChoice(reports[0].visit)], "the whole visit holds the record"


async def test_records_show_what_stands_of_a_visit(world: World) -> None:
    visit = world.open_visit()
    first, second = world.record(visit), world.record(visit)
    world.put(RESTRICTION, RestrictionRow("accuracy", False, 0, 0, [first.upload.record_id], NOW_MS), visit.owner)
    world.put(OBJECTION, {"research": 1, "care": 1}, visit.owner)
    world.put(CORRECTION_COUNT, 2, visit.owner)
    (report,) = await world.wallet.records()
    rights = report.rights
    assert (rights.objections, rights.corrections_count, rights.breach_id) == (("care", "research"), 2, b"")
    assert (rights.restricts(first.upload.record_id), rights.restricts(second.upload.record_id)) == (True, False)


async def test_the_audit_says_each_right_in_words(world: World, tmp_path: Path) -> None:
    told = {
        "restricted": {"ground": "legal-claim", "until_ms": 5},
        "objected": {"purposes": ["research"]},
        "corrected": {"number": 0, "kind": "attribution"},
        "denied": {"breach_id": b"\xab" * 32},
        "breach_assessed": {"risk": "high", "reason": "released-before"},
        "breach_notified": {"recipient": "authority", "late": True},
        "breach_closed": {"outcome": "erased", "reason": "matched-wrongly"},
    }
    visit = world.open_visit()
    for kind, data in told.items():
        world.append_audit(visit.owner, kind, data=data)
    words = [describe_event(entry.kind, entry.data) for entry in await audit_all(world.wallet)]
    assert words == [
        "ground: legal-claim, kept beyond its time",
        "to: research",
        "number 1, attribution",
        "breach abababababab",
        "risk: high, released-before",
        "told: authority, late",
        "outcome: erased, matched-wrongly",
    ]
    assert describe_event("recorded", {}) == ""
