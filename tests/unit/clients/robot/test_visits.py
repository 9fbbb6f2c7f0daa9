"""Visits: one owner key a person and visit, never longer than ten minutes, and only she can find and use it."""

from __future__ import annotations

import secrets

from clients.robot.recording.visit_keyring import CLOSE_DELAY_MAX_MS, VisitKeyring
from consensus.limits import TIME_BUCKET_MS, VISIT_MAX_MS
from consensus.members.roster import RosterRow
from consensus.primitives.keys import PrivateKey
from consensus.records.owner_keys import derive_owner_key, scan_announcement

CHAIN = bytes(range(32))
ROBOT = PrivateKey(bytes([9] * 32)).public_key
START_MS = 1_800_000_123_456


class Person:
    """The keys of somebody on the roster."""

    def __init__(self) -> None:
        self.spend = PrivateKey(secrets.token_bytes(32))
        self.view = PrivateKey(secrets.token_bytes(32))
        self.row = RosterRow(
            tag=bytes(32),
            handle=bytes(32),
            spend=self.spend.public_key,
            view=self.view.public_key,
            sealing=bytes(32),
            proof=b"",
        )


def book() -> VisitKeyring:
    return VisitKeyring(CHAIN, ROBOT, "demo")


def test_a_visit_lasts_while_its_person_is_there_and_nothing_is_recorded_once_it_may_be_closed() -> None:
    visits, ann = book(), Person()
    first = visits.chain_for("ann", ann.row, START_MS)
    assert visits.chain_for("ann", ann.row, START_MS + 60_000) is first
    # Though the clock is set back.
    visits, ann = book(), Person()
    first = visits.chain_for("ann", ann.row, START_MS)
    assert not visits.goes_on(first.owner, START_MS + VISIT_MAX_MS + CLOSE_DELAY_MAX_MS)
    assert visits.chain_for("ann", ann.row, START_MS).owner != first.owner


def test_a_new_visit_begins_before_ten_minutes_are_over() -> None:
    """With room for the last records to reach the chain while their visit may still take them."""
    visits, ann = book(), Person()
    first = visits.chain_for("ann", ann.row, START_MS)
    owners = {first.owner: START_MS}
    for second in range(1, 1_800):
        now_ms = START_MS + 1_000 * second
        chain = visits.chain_for("ann", ann.row, now_ms)
        owners.setdefault(chain.owner, now_ms)
        assert now_ms - owners[chain.owner] <= VISIT_MAX_MS - 60_000
    assert len(owners) >= 3


def test_the_chain_of_a_new_visit_begins_at_its_beginning() -> None:
    visits, ann = book(), Person()
    first = visits.chain_for("ann", ann.row, START_MS)
    first.record_count, first.previous_hash = 7, b"h" * 32
    second = visits.chain_for("ann", ann.row, START_MS + VISIT_MAX_MS)
    assert (second.record_count, second.previous_hash) == (0, bytes(32))


def test_a_visit_that_is_over_is_in_nobodys_memory() -> None:
    """Also of somebody who does not come again: a thief would learn whose it was."""
    visits, ann, bob = book(), Person(), Person()
    over = visits.chain_for("ann", ann.row, START_MS)
    visits.chain_for("bob", bob.row, START_MS + VISIT_MAX_MS)
    assert over.owner not in {visit.chain.owner for visit in visits._open.values()}
    assert "bob" in visits._open
    assert "ann" not in visits._open


def test_two_visits_of_one_person_have_nothing_in_common_and_the_announced_time_is_coarse() -> None:
    visits, ann = book(), Person()
    first = visits.chain_for("ann", ann.row, START_MS)
    second = visits.chain_for("ann", ann.row, START_MS + VISIT_MAX_MS)
    assert first.owner != second.owner
    assert first.ephemeral != second.ephemeral
    chain = book().chain_for("ann", Person().row, START_MS)
    assert chain.bucket_ms % TIME_BUCKET_MS == 0
    assert 0 <= START_MS - chain.bucket_ms < TIME_BUCKET_MS


def test_only_the_person_finds_and_uses_her_visit() -> None:
    visits, ann, bob = book(), Person(), Person()
    chain = visits.chain_for("ann", ann.row, START_MS)
    found = [
        scan_announcement(
            person.view, person.spend.public_key, chain.ephemeral, chain.view_tag, chain_id=CHAIN, robot=ROBOT
        )
        for person in (ann, bob)
    ]
    assert found[0] == chain.owner
    assert found[1] != chain.owner
    own = derive_owner_key(ann.spend, ann.view, chain.ephemeral, chain_id=CHAIN, robot=ROBOT)
    assert own.public_key == chain.owner


def test_a_visit_is_closed_after_its_nine_minutes_and_a_random_delay_whatever_ended_it() -> None:
    """Closed when she says no it would name her: her word stands beside it on the chain."""
    visits, ann, bob = book(), Person(), Person()
    of_ann, of_bob = visits.chain_for("ann", ann.row, START_MS).owner, visits.chain_for("bob", bob.row, START_MS).owner
    visits.forget("ann")
    again = visits.chain_for("ann", ann.row, START_MS + 1_000).owner
    for owner in (of_ann, of_bob, again):
        assert visits.goes_on(owner, START_MS + VISIT_MAX_MS - 60_001)
    for owner in (of_ann, of_bob, again):
        assert not visits.goes_on(owner, START_MS + 1_000 + VISIT_MAX_MS - 60_000 + CLOSE_DELAY_MAX_MS)


def test_the_time_of_closing_is_drawn_for_each_visit() -> None:
    """Two people who came together would else leave together."""
    visits, delays = book(), set()
    owners = [visits.chain_for(str(number), Person().row, START_MS).owner for number in range(12)]
    for owner in owners:
        rolled_ms = START_MS + VISIT_MAX_MS - 60_000
        delays.add(
            next(ms for ms in range(0, CLOSE_DELAY_MAX_MS + 1, 100) if not visits.goes_on(owner, rolled_ms + ms))
        )
    assert len(delays) > 6
    assert min(delays) < CLOSE_DELAY_MAX_MS / 2 < max(delays)
