"""Pairing against a brute-force oracle: whatever order things arrive in, a frame gets exactly its owners."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from clients.robot.pairing import NOT_PAIRED_NO_TAG, NOT_PAIRED_UNKNOWN_TAG, Decision, Pairing

WINDOW_MS = 500
LATENESS_MS = 100

sightings = st.lists(
    st.tuples(
        st.sampled_from(["a", "b", "c", "stranger"]),
        st.integers(0, 6_000),  # first seen
        st.integers(0, 80),  # for how long
        st.integers(-300, LATENESS_MS),  # arrival after first seen; negative: the reader's clock runs ahead
        st.booleans(),  # reported twice
    ),
    max_size=25,
)
frames = st.lists(st.integers(0, 6_000), max_size=60)


def known(alias: str) -> bool:
    return alias != "stranger"


def oracle(at: int, seen: list[tuple[str, int, int]]) -> tuple[tuple[str, ...], str]:
    covering = {alias for alias, first, last in seen if first - WINDOW_MS <= at <= last + WINDOW_MS}
    owners = tuple(sorted(filter(known, covering)))
    if owners:
        return owners, ""
    return (), NOT_PAIRED_UNKNOWN_TAG if covering else NOT_PAIRED_NO_TAG


def run(frame_times: list[int], seen: list[tuple[str, int, int, int, bool]]) -> tuple[list[Decision], Pairing]:
    """Play frames at their own time and sightings at theirs plus delay; at the same instant the sighting first."""
    script: list[tuple[int, int, int]] = [(at, 1, i) for i, at in enumerate(frame_times)]
    for i, (_, first, _, delay, twice) in enumerate(seen):
        script.append((first + delay, 0, i))
        if twice:
            script.append((first + delay, 0, i))
    pairing, decided = Pairing(WINDOW_MS, LATENESS_MS), []
    for at, kind, i in sorted(script):
        if kind == 1:
            decided += pairing.add_frame(i, at)
        else:
            alias, first, lasting, _, _ = seen[i]
            pairing.add_sighting(alias, first, first + lasting, known=known(alias))
    return decided + pairing.flush(), pairing


@given(frames, sightings)
def test_every_frame_is_decided_once_with_exactly_its_owners(
    frame_times: list[int], seen: list[tuple[str, int, int, int, bool]]
) -> None:
    decided, pairing = run(frame_times, seen)
    assert sorted(d.sequence for d in decided) == list(range(len(frame_times)))
    spans = [(alias, first, first + lasting) for alias, first, lasting, _, _ in seen]
    for decision in decided:
        assert (decision.owners, decision.reason) == oracle(decision.captured_at_ms, spans)
    assert pairing.late_count == 0


@given(frames, sightings)
def test_decisions_come_in_time_order_and_never_before_the_last_sighting_could(
    frame_times: list[int], seen: list[tuple[str, int, int, int, bool]]
) -> None:
    decided, _ = run(frame_times, seen)
    times = [decision.captured_at_ms for decision in decided]
    assert times == sorted(times)
    pairing = Pairing(WINDOW_MS, LATENESS_MS)
    for at in sorted(frame_times):
        for decision in pairing.add_frame(at, at):
            assert decision.captured_at_ms + WINDOW_MS + LATENESS_MS < at


@given(frames, st.permutations(range(6)), st.lists(st.integers(0, 6_000), min_size=6, max_size=6))
def test_the_order_in_which_sightings_arrive_does_not_matter(
    frame_times: list[int], order: list[int], firsts: list[int]
) -> None:
    def owners(arrival: list[int]) -> list[Decision]:
        pairing = Pairing(WINDOW_MS, LATENESS_MS)
        for i in arrival:
            pairing.add_sighting("abc"[i % 3], firsts[i], firsts[i])
        return [d for i, at in enumerate(sorted(frame_times)) for d in pairing.add_frame(i, at)] + pairing.flush()

    assert owners(order) == owners(sorted(order))


@given(st.integers(LATENESS_MS + 1, 5_000))
def test_a_sighting_that_is_too_late_changes_no_decision_and_is_counted(delay: int) -> None:
    pairing = Pairing(WINDOW_MS, LATENESS_MS)
    decided = [d for at in range(0, 10_000, 50) for d in pairing.add_frame(at, at)]
    now = 9_950
    before = {d.sequence: d.owners for d in decided}
    pairing.add_sighting("a", now - delay, now - delay)
    rest = pairing.flush()
    assert pairing.late_count == 1
    assert not before.keys() & {d.sequence for d in rest}
    for decision in rest:
        assert decision.owners == (("a",) if abs(decision.captured_at_ms - (now - delay)) <= WINDOW_MS else ())
