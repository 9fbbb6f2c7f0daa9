"""Pairing against a brute-force oracle: whatever order things arrive in, a frame gets exactly its owners, in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clients.robot.pairing.tag_pairing import NOT_PAIRED_NO_TAG, NOT_PAIRED_UNKNOWN_TAG, Decision, Pairing
from clients.robot.sensing.sensor_clocks import RunClocks
from clients.robot.sensing.sensor_events import Frame, Sighting

WINDOW_MS = 500
LATENESS_MS = 100
LAST_MS = 6_000
FRAME_DELAY_MAX_MS = 400
REPORT_DELAY_MAX_MS = 80
START_MS = 1_579_278_405_000
DEPTH = np.zeros((1, 1), dtype=np.uint16)


@dataclass(frozen=True)
class Seen:
    """A reading as the world had it: whose, from when to when, when it arrives, and whether it is told."""

    alias: str
    first: int
    last: int
    arrives: int
    told: bool
    twice: bool

    @property
    def known(self) -> bool:
        return self.alias != "stranger"


def times(least: int, most: int) -> st.SearchStrategy[int]:
    """Return instants on a coarse grid and a millisecond beside it, so that many meet at the ends of windows."""
    return st.builds(lambda tick, beside: tick * 100 + beside, st.integers(least // 100, most // 100), BESIDE)


BESIDE = st.sampled_from([0, 0, 0, -1, 1])


@st.composite
def readings(draw: st.DrawFn) -> Seen:
    first = draw(times(0, LAST_MS))
    arrives = first + min(draw(times(-300, LATENESS_MS)), LATENESS_MS)  # before it was read: the reader runs ahead
    return Seen(
        draw(st.sampled_from(["a", "b", "c", "stranger"])),
        first,
        first + draw(st.integers(0, 80)),
        arrives,
        draw(st.booleans()),
        draw(st.booleans()),
    )


sightings = st.lists(readings(), max_size=25)
frames = st.lists(st.tuples(times(0, LAST_MS), st.integers(0, FRAME_DELAY_MAX_MS)), max_size=60)


def oracle(at: int, seen: list[Seen]) -> tuple[tuple[str, ...], str]:
    covering = [one for one in seen if one.first - WINDOW_MS <= at <= one.last + WINDOW_MS]
    owners = tuple(sorted({one.alias for one in covering if one.known}))
    if owners:
        return owners, ""
    return (), NOT_PAIRED_UNKNOWN_TAG if covering else NOT_PAIRED_NO_TAG


def tell(pairing: Pairing, one: Seen) -> list[Decision]:
    received = one.arrives if one.told else None
    return pairing.add_sighting(one.alias, one.first, one.last, known=one.known, received_at_ms=received)


class Play:
    """Frames and sightings in the order of their arrival, at one instant sightings first."""

    def __init__(self, taken: list[tuple[int, int]], seen: list[Seen]) -> None:
        self.taken = taken
        self.seen = seen
        self.pairing = Pairing(WINDOW_MS, LATENESS_MS)
        self.decided: list[Decision] = []
        self.arrived: set[int] = set()
        self.now: int | None = None
        self.script = [(at + delay, 1, i) for i, (at, delay) in enumerate(taken)]
        self.script += [(one.arrives, 0, i) for i, one in enumerate(seen) for _ in range(1 + one.twice)]
        self.script.sort()

    def step(self, kind: int, i: int) -> list[Decision]:
        if kind == 1:
            self.arrived.add(i)
            self._pass(self.taken[i][0])
            made = self.pairing.add_frame(i, self.taken[i][0])
        else:
            if self.seen[i].told:
                self._pass(self.seen[i].arrives)
            made = tell(self.pairing, self.seen[i])
        self.decided += made
        return made

    def _pass(self, at: int) -> None:
        self.now = at if self.now is None else max(self.now, at)

    def waiting(self) -> set[int]:
        return self.arrived - {decision.sequence for decision in self.decided}

    def run(self, count: int | None = None) -> Play:
        for _, kind, i in self.script[:count]:
            self.step(kind, i)
        return self


@given(frames, sightings)
def test_every_frame_is_decided_once_with_exactly_its_owners(taken: list[tuple[int, int]], seen: list[Seen]) -> None:
    play = Play(taken, seen).run()
    play.decided += play.pairing.flush()
    assert sorted(d.sequence for d in play.decided) == list(range(len(taken)))
    for decision in play.decided:
        assert (decision.owners, decision.reason) == oracle(decision.captured_at_ms, seen)
    assert play.pairing.late_count == 0
    assert play.pairing.refused == {}


@given(frames, sightings)
def test_a_frame_is_decided_when_nothing_that_may_arrive_changes_it_and_at_once_then(
    taken: list[tuple[int, int]], seen: list[Seen]
) -> None:
    """After every step: who is decided could not be changed by any later reading, who waits could be by some."""
    play = Play(taken, seen)
    for _, kind, i in play.script:
        made = play.step(kind, i)
        now = play.now
        if now is None:
            assert not made
            continue
        earliest = now - LATENESS_MS  # what is still to come was first read no sooner
        for decision in made:
            later = [Seen("new", first, first, now, True, False) for first in range(earliest, earliest + 3)]
            assert oracle(decision.captured_at_ms, later) == ((), NOT_PAIRED_NO_TAG)
        for number in play.waiting():
            at = play.taken[number][0]
            first = max(earliest, at - WINDOW_MS)
            assert oracle(at, [Seen("new", first, first, now, True, False)])[0] == ("new",)


@given(st.data(), frames.filter(bool), sightings)
def test_whoever_waits_can_still_be_given_an_owner(
    data: st.DataObject, taken: list[tuple[int, int]], seen: list[Seen]
) -> None:
    play = Play(taken, seen)
    play.run(data.draw(st.integers(1, len(play.script))))
    waiting, now = sorted(play.waiting()), play.now
    if not waiting or now is None:
        return
    number = data.draw(st.sampled_from(waiting))
    first = taken[number][0] + WINDOW_MS
    assert now <= first + LATENESS_MS, "it would be late otherwise"
    play.pairing.add_sighting("new", first, first)
    (mine,) = [decision for decision in play.pairing.flush() if decision.sequence == number]
    assert "new" in mine.owners
    assert play.pairing.late_count == 0


@given(st.lists(times(0, LAST_MS), max_size=60), sightings)
def test_decisions_on_frames_that_come_in_order_come_in_time_order(taken: list[int], seen: list[Seen]) -> None:
    decided = Play([(at, 0) for at in taken], seen).run().decided
    assert [d.captured_at_ms for d in decided] == sorted(d.captured_at_ms for d in decided)


@given(frames, st.permutations(range(6)), st.lists(st.integers(0, LAST_MS), min_size=6, max_size=6))
def test_the_order_in_which_sightings_arrive_does_not_matter(
    taken: list[tuple[int, int]], order: list[int], firsts: list[int]
) -> None:
    def owners(arrival: list[int]) -> list[Decision]:
        pairing = Pairing(WINDOW_MS, LATENESS_MS)
        for i in arrival:
            pairing.add_sighting("abc"[i % 3], firsts[i], firsts[i])
        return [d for i, (at, _) in enumerate(sorted(taken)) for d in pairing.add_frame(i, at)] + pairing.flush()

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


@given(
    st.lists(
        st.tuples(st.sampled_from("ab"), st.integers(0, LAST_MS), st.integers(0, REPORT_DELAY_MAX_MS)),
        min_size=1,
        max_size=25,
    ),
    st.lists(st.tuples(st.integers(0, LAST_MS), st.integers(0, 30)), min_size=1, max_size=60),
    st.tuples(st.integers(-86_400_000, 86_400_000), st.integers(-86_400_000, 86_400_000)),
    st.integers(-200, 200),
)
def test_with_readers_whose_clocks_are_off_and_drift_frames_are_paired_as_by_true_time(
    read: list[tuple[str, int, int]], taken: list[tuple[int, int]], offsets_ms: tuple[int, int], drift_ppm: int
) -> None:
    """Only frames nearer to a window's end than the delays that hide an offset may differ. Each tag has its reader."""
    clocks, pairing = RunClocks(), Pairing(WINDOW_MS, 2 * LATENESS_MS)
    script: list[tuple[int, int, Frame | Sighting]] = []
    for alias, at, delay in read:
        stamp = START_MS + at + offsets_ms["ab".index(alias)] + round(drift_ppm * 1e-6 * at)
        seen = Sighting(stamp, stamp, alias, origin=f"/{alias}", received_at_ms=START_MS + at + delay)
        script.append((at + delay, len(script), seen))
    for number, (at, delay) in enumerate(taken):
        script.append((at + delay, len(script), Frame(START_MS + at, number, DEPTH, START_MS + at + delay)))
    decided: list[Decision] = []
    for _, _, event in sorted(script, key=lambda item: item[:2]):
        for one in clocks.admit(event):
            if isinstance(one, Frame):
                decided += pairing.add_frame(one.sequence, one.captured_at_ms, vouched=True)
            else:
                decided += pairing.add_sighting(
                    one.uid, one.first_seen_ms, one.last_seen_ms, received_at_ms=one.received_at_ms
                )
    decided += pairing.flush()
    assert len(decided) == len(taken)
    slack = REPORT_DELAY_MAX_MS + 5
    for decision in decided:
        gaps = {alias: abs(decision.captured_at_ms - START_MS - at) for alias, at, _ in reversed(read)}
        for alias in "ab":
            nearest = min(
                (abs(decision.captured_at_ms - START_MS - at) for a, at, _ in read if a == alias), default=None
            )
            if nearest is None or nearest > WINDOW_MS + slack:
                assert alias not in decision.owners, gaps
            elif nearest <= WINDOW_MS - slack:
                assert alias in decision.owners, gaps
