"""Who keeps a clip: the same for everybody, in proportion to room, and moving little when a custodian comes or goes."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from consensus.primitives.hashing import sha256
from consensus.records import placement as placement_module
from consensus.records.placement import COPIES_DEFAULT_COUNT, Placement

RECORDS_COUNT = 6_000
ORDERS = [
    [3, 2, 0, 1],
    [1, 3, 2, 0],
    [0, 3, 2, 1],
    [1, 2, 0, 3],
    [3, 2, 0, 1],
    [3, 1, 2, 0],
    [0, 3, 2, 1],
    [1, 2, 3, 0],
]
"""Of four records, with equal rooms and with rooms of 1 to 4; computed apart from the program, with floats."""
custodian_keys = st.sets(st.binary(min_size=33, max_size=33), min_size=2, max_size=8)
record_ids = st.binary(min_size=16, max_size=16)


def custodian(number: int) -> bytes:
    return b"\x02" + sha256(b"custodian %d" % number)


def records(count: int = RECORDS_COUNT) -> list[bytes]:
    return [sha256(b"record %d" % number)[:16] for number in range(count)]


def count_held(placement: Placement, count: int = RECORDS_COUNT) -> dict[bytes, int]:
    held = dict.fromkeys(placement.rooms, 0)
    for record_id in records(count):
        for key in placement.keepers(record_id):
            held[key] += 1
    return held


@given(
    record_ids, st.dictionaries(st.binary(min_size=33, max_size=33), st.integers(1, 9), min_size=1), st.integers(0, 9)
)
def test_the_order_in_which_custodians_are_named_changes_nothing(
    record_id: bytes, rooms: dict[bytes, int], copies: int
) -> None:
    turned = Placement(dict(reversed(rooms.items())), copies)
    assert Placement(rooms, copies).rank(record_id) == turned.rank(record_id)
    assert sorted(turned.rank(record_id)) == sorted(rooms)
    assert len(turned.keepers(record_id)) == turned.count == min(copies or COPIES_DEFAULT_COUNT, len(rooms))
    assert {key for key in rooms if turned.is_keeper(key, record_id)} == set(turned.keepers(record_id))


@given(record_ids, custodian_keys, st.integers(2, 4))
def test_one_that_leaves_hands_on_its_own_clips_alone(record_id: bytes, keys: set[bytes], copies: int) -> None:
    """And, read backwards, one that joins takes its share and moves nothing between the others."""
    before = Placement.even(keys, copies).rank(record_id)
    for gone in keys:
        after = Placement.even(keys - {gone}, copies).rank(record_id)
        assert after == tuple(key for key in before if key != gone)


@given(record_ids, custodian_keys)
def test_one_that_declares_more_room_wins_clips_and_loses_none(record_id: bytes, keys: set[bytes]) -> None:
    more = min(keys)
    before = Placement.even(keys, 2).rank(record_id)
    after = Placement({key: 2 if key == more else 1 for key in keys}, 2).rank(record_id)
    assert after.index(more) <= before.index(more)
    assert [key for key in after if key != more] == [key for key in before if key != more]


@given(record_ids, custodian_keys, st.integers(2, 1 << 40))
def test_equal_rooms_give_one_order_in_whatever_unit(record_id: bytes, keys: set[bytes], unit: int) -> None:
    """One more custodian of nearly no room makes them be compared by logarithms, not by their draws."""
    almost_none = bytes(33)
    ranked = Placement({**dict.fromkeys(keys, unit << 80), almost_none: 1}, 2).rank(record_id)
    assert [key for key in ranked if key != almost_none] == [
        key for key in Placement.even(keys, 2).rank(record_id) if key != almost_none
    ]


def test_shares_are_in_proportion_to_rooms() -> None:
    rooms = {custodian(number): number for number in (1, 2, 3, 4)}
    placement = Placement(rooms, 64)
    first = dict.fromkeys(rooms, 0)
    count = 1_500
    for record_id in records(count):
        first[placement.rank(record_id)[0]] += 1
    for key, room in rooms.items():
        share = room / sum(rooms.values())
        assert abs(first[key] - share * count) < 4.5 * math.sqrt(count * share * (1 - share))


def test_six_custodians_with_two_copies_have_the_room_of_three() -> None:
    """The room ends when the fullest is full: 2.9 times one custodian's and more, of 3 at best."""
    held = count_held(Placement.even([custodian(number) for number in range(6)], 2), 60_000)
    assert sum(held.values()) == 2 * 60_000
    assert 60_000 / max(held.values()) >= 2.9


def test_one_order_is_written_down() -> None:
    """Whoever changes how it is computed moves every network's clips."""
    keys = [custodian(number) for number in range(4)]
    even, uneven = Placement.even(keys, 2), Placement({key: 1 + number for number, key in enumerate(keys)}, 2)
    named = [
        [keys.index(key) for key in placement.rank(record)] for placement in (even, uneven) for record in records(4)
    ]
    assert named == ORDERS


def test_who_declares_no_room_counts_as_the_least_of_those_who_do() -> None:
    first, second, third = (custodian(number) for number in range(3))
    assert Placement.of({first: 0, second: 0}, 2, {}) == Placement.even([first, second], 2)
    assert Placement.of({first: 0, second: 500, third: 2_000}, 2, {}) == Placement(
        {first: 500, second: 500, third: 2_000}, 2
    )


@given(record_ids, st.dictionaries(st.binary(min_size=33, max_size=33), st.integers(1, 1 << 24), min_size=2))
def test_floats_give_the_exact_order(record_id: bytes, rooms: dict[bytes, int]) -> None:
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(placement_module, "_SURELY", math.inf)
        exact = Placement(rooms).rank(record_id)
    assert Placement(rooms).rank(record_id) == exact


@pytest.mark.parametrize("draw", [0, 1, (1 << 63) - 1, 1 << 63, (1 << 64) - 2, (1 << 64) - 1])
def test_floats_are_exact_to_twelve_digits_at_either_end(draw: int) -> None:
    exact = float(placement_module._exact_score(draw, 7))
    assert 7 / placement_module._minus_log(draw) == pytest.approx(exact, rel=1e-12)


@given(
    record_ids,
    st.dictionaries(st.binary(min_size=33, max_size=33), st.sampled_from("abc"), min_size=2),
    st.integers(2, 4),
)
def test_copies_lie_at_as_many_organisations_as_there_are(
    record_id: bytes, organisations: dict[bytes, str], copies: int
) -> None:
    rooms = {key: 1 + number % 3 for number, key in enumerate(organisations)}
    placement = Placement(rooms, copies, organisations)
    keepers = placement.keepers(record_id)
    owners = {organisations[key] for key in keepers}
    assert len(owners) == min(placement.count, len(set(organisations.values())))
    by_score = Placement(rooms, copies).rank(record_id)
    firsts = [next(key for key in by_score if organisations[key] == owner) for owner in owners]
    assert set(firsts) <= set(keepers), "of each organisation the one that is first by room and draw"


def test_no_organisation_keeps_a_clip_alone_whatever_room_it_declares() -> None:
    honest, greedy = [custodian(number) for number in range(6)], [custodian(number) for number in (6, 7)]
    rooms = dict.fromkeys(honest, 1_000) | dict.fromkeys(greedy, 1 << 24)
    placement = Placement(rooms, 2, dict.fromkeys(greedy, "greedy"))
    for record_id in records(500):
        assert set(placement.keepers(record_id)) & set(honest)
