"""Whatever happens in whatever order: nobody acts but within a mandate, as a model says that keeps whole sentences.

The contract keeps ids and steps; the model keeps who said what, by which right, and asks anew each time who may.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from consensus.rights.mandates import ACCEPT_MS, APPROVE_MS
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Person

OFFICERS = ("eva", "max", "ida")
RELATIVES = ("mother", "aunt")
EVERYBODY = ("child", *RELATIVES, *OFFICERS, "stranger")
PURPOSES = ("care", "research")
STEP_MS = 300_000


@dataclass
class Given:
    """A mandate in words: who represents, until when, who has agreed so far and until when the next one has to."""

    representative: str
    until_ms: int
    officers: list[str]
    next_ms: int
    accepted: bool = False
    ended: bool = False


@dataclass
class Word:
    """The last word on a purpose: a yes until some time, or a no; `by` None is the child herself."""

    yes: bool
    until_ms: int
    by: Given | None


@dataclass
class Model:
    """What everybody would agree on."""

    revoked: set[str] = field(default_factory=set)
    mandates: list[Given] = field(default_factory=list)
    words: dict[str, Word] = field(default_factory=dict)

    def holds(self, mandate: Given, now_ms: int) -> bool:
        there = mandate.representative not in self.revoked and "child" not in self.revoked
        return mandate.accepted and not mandate.ended and now_ms < mandate.until_ms and there

    def over(self, mandate: Given, now_ms: int) -> bool:
        if mandate.accepted:
            return not self.holds(mandate, now_ms)
        return now_ms > min(mandate.next_ms, mandate.until_ms - 1)

    def finish(self, mandate: Given) -> None:
        mandate.ended = True
        if mandate.accepted:
            for purpose, word in self.words.items():
                if word.yes and word.by is mandate:
                    self.words[purpose] = Word(False, 0, mandate)

    def current(self) -> Given | None:
        return next((mandate for mandate in self.mandates if not mandate.ended), None)

    def propose(self, who: str, representative: str, until_ms: int, now_ms: int) -> bool:
        before = self.current()
        fits = who in OFFICERS and who != representative and not {who, representative, "child"} & self.revoked
        fits = fits and representative not in ("child", "stranger") and now_ms < until_ms
        if not fits or (before is not None and not self.over(before, now_ms)):
            return False
        if before is not None:
            self.finish(before)
        self.mandates.append(Given(representative, until_ms, [who], now_ms + APPROVE_MS))
        return True

    def agreeable(self, mandate: Given, now_ms: int) -> bool:
        gone = self.revoked & {"child", mandate.representative, *mandate.officers}
        return not mandate.ended and not mandate.accepted and not gone and not self.over(mandate, now_ms)

    def approve(self, mandate: Given, who: str, now_ms: int) -> bool:
        second = who in OFFICERS and who not in {*mandate.officers, mandate.representative, *self.revoked}
        if not second or len(mandate.officers) > 1 or not self.agreeable(mandate, now_ms):
            return False
        mandate.officers.append(who)
        mandate.next_ms = now_ms + ACCEPT_MS
        return True

    def accept(self, mandate: Given, who: str, now_ms: int) -> bool:
        named = who == mandate.representative and len(mandate.officers) > 1
        mandate.accepted = mandate.accepted or (named and self.agreeable(mandate, now_ms))
        return named and mandate.accepted and not mandate.ended

    def end(self, mandate: Given, who: str) -> bool:
        may = who in {"child", mandate.representative, *OFFICERS} and who not in self.revoked
        if not may or mandate.ended:
            return False
        self.finish(mandate)
        return True

    def close(self, mandate: Given, who: str, now_ms: int) -> bool:
        if mandate.ended or who == "stranger" or who in self.revoked or not self.over(mandate, now_ms):
            return False
        self.finish(mandate)
        return True

    def right(self, who: str, now_ms: int) -> tuple[bool, Given | None]:
        """Whether somebody may speak for the child, and by which mandate."""
        if who == "child":
            return "child" not in self.revoked, None
        mandate = self.current()
        may = mandate is not None and who == mandate.representative and self.holds(mandate, now_ms)
        return may, mandate

    def give(self, who: str, purpose: str, until_ms: int, now_ms: int) -> bool:
        may, by = self.right(who, now_ms)
        last = self.words.get(purpose)
        barred = by is not None and last is not None and not last.yes and last.by is None
        beyond = by is not None and not 0 < until_ms <= by.until_ms
        if not may or barred or beyond or 0 < until_ms <= now_ms:
            return False
        self.words[purpose] = Word(True, until_ms, by)
        return True

    def refuse(self, who: str, purpose: str, now_ms: int) -> bool:
        may, by = self.right(who, now_ms)
        last = self.words.get(purpose)
        if may and not (by is not None and last is not None and not last.yes and last.by is None):
            self.words[purpose] = Word(False, 0, by)
        return may

    def withdraw(self, who: str, now_ms: int) -> bool:
        may, by = self.right(who, now_ms)
        given = [purpose for purpose, word in self.words.items() if word.yes]
        for purpose in PURPOSES if by is None else given:  # what she takes back herself nobody gives for her
            if may:
                self.words[purpose] = Word(False, 0, by)
        return may

    def allowed(self, purpose: str, now_ms: int) -> bool:
        word = self.words.get(purpose)
        return word is not None and word.yes and not 0 < word.until_ms <= now_ms and "child" not in self.revoked


WHO = st.sampled_from(EVERYBODY)
OFTEN: list[tuple[Any, ...]] = [
    *[("give", "mother", purpose, 20) for purpose in (*PURPOSES, *PURPOSES, *PURPOSES)],
    *[("give", "child", purpose, 0) for purpose in PURPOSES],
    *[("refuse", "child", purpose) for purpose in (*PURPOSES, *PURPOSES)],
    *[("refuse", "mother", purpose) for purpose in PURPOSES],
    ("withdraw", "child"),
    ("withdraw", "mother"),
    *[("end", who) for who in ("mother", "child", "ida")],
    ("mandate", "mother", 30),
    ("mandate", "aunt", 8),
    ("wait", 4),
]
SELDOM: list[tuple[Any, ...]] = [
    *[("give", who, "care", days) for who, days in (("aunt", 5), ("eva", 5), ("mother", 0), ("mother", 31))],
    *[("withdraw", who) for who in ("aunt", "eva", "stranger")],
    *[("end", who) for who in ("stranger", "aunt")],
    *[("close", who) for who in ("stranger", "eva", "mother")],
    *[("revoke", who) for who in ("mother", "eva")],
    ("wait", 31),
]
GIVING = st.one_of(
    st.tuples(st.just("approve"), WHO),
    st.tuples(st.just("accept"), WHO),
    st.sampled_from(
        [
            *[("approve", who) for who in ("max", "ida")],
            *[("accept", who) for who in RELATIVES],
            *[("revoke", who) for who in ("eva", "ida", "eva", "mother")],
            *[("wait", days) for days in (1, 4, 8)],
            ("end", "child"),
            ("propose", "max", "mother", 5),
            ("propose", "stranger", "mother", 5),
            ("propose", "eva", "child", 5),
            ("propose", "eva", "mother", -1),
        ]
    ),
)
IN_FORCE = st.lists(st.sampled_from(OFTEN * 3 + SELDOM), min_size=5, max_size=18)
TO_BE_GIVEN = st.lists(GIVING, min_size=1, max_size=5)


class Play:
    """A ward and the model beside it."""

    def __init__(self) -> None:
        self.hospital, self.model = Hospital(), Model()
        self.people = {name: self.enrol(name) for name in EVERYBODY if name != "stranger"}
        self.people["stranger"] = Person("stranger", handle=bytes(32))
        self.ids: list[bytes] = []

    def enrol(self, name: str) -> Person:
        """Somebody who said nothing yet."""
        person = Person(name, "officer" if name in OFFICERS else "subject")
        card = self.hospital.card(name, person.role)
        arguments = self.hospital.register_arguments(person, card, purposes=[])
        self.hospital.must(person.identity, "identity", "register", *arguments)
        person.handle = card.handle
        return person

    @property
    def now_ms(self) -> int:
        """The time of the block that will hold what is said next."""
        return self.hospital.time_ms + 100

    def day(self, number: int) -> int:
        return self.hospital.bucket() + number * DAY_MS if number else 0

    def send(self, who: str, contract: str, entry: str, *arguments: Any) -> bool:
        receipt = self.hospital.send(self.people[who].identity, contract, entry, *arguments)
        if receipt.ok and entry == "propose":
            self.ids.append(receipt.txid)
        return receipt.ok

    def step(self, kind: str, *rest: Any) -> None:
        model, now_ms, child = self.model, self.now_ms, self.people["child"].handle
        if kind == "wait":
            self.hospital.time_ms += rest[0] * DAY_MS
        elif kind == "revoke":
            self.revoke(rest[0])
        elif kind == "mandate":
            self.step("propose", "eva", rest[0], rest[1])
            self.step("approve", "max")
            self.step("accept", rest[0])
        elif kind == "propose":
            who, representative, days = rest
            until_ms = self.hospital.bucket() + days * DAY_MS
            expected = model.propose(who, representative, until_ms, now_ms)
            named = self.people[representative].handle
            assert self.send(who, "mandates", "propose", child, named, bytes(32), ["consent"], until_ms) == expected
        elif kind in ("approve", "accept", "close", "end"):
            self.decide(kind, rest[0], now_ms)
        else:
            self.say(kind, child, now_ms, *rest)

    def revoke(self, who: str) -> None:
        if who == "stranger" or who in self.model.revoked:
            return
        self.hospital.must(self.hospital.admin, "identity", "revoke", self.people[who].handle)
        self.model.revoked.add(who)
        if who == "child":
            self.model.words.clear()

    def decide(self, kind: str, who: str, now_ms: int) -> None:
        if not self.ids:
            return
        mandate, was_accepted = self.model.mandates[-1], self.model.mandates[-1].accepted
        expected = self.model.end(mandate, who) if kind == "end" else getattr(self.model, kind)(mandate, who, now_ms)
        if kind == "accept":
            expected = expected and not was_accepted
        assert self.send(who, "mandates", kind, self.ids[-1]) == expected, (kind, who)

    def say(self, kind: str, child: bytes, now_ms: int, who: str, *rest: Any) -> None:
        model = self.model
        if kind == "give":
            purpose, until_ms = rest[0], self.day(rest[1])
            expected = model.give(who, purpose, until_ms, now_ms)
            arguments = [[purpose], ["depth"], 0, until_ms, 0, self.hospital.height]
        elif kind == "refuse":
            expected, arguments = model.refuse(who, rest[0], now_ms), [[rest[0]], ["depth"]]
        else:
            expected, arguments = model.withdraw(who, now_ms), [[], []]
        assert self.send(who, "consent", kind, child, *arguments) == expected, (kind, who)

    def check(self) -> None:
        self.hospital.block([])
        hospital, model, child = self.hospital, self.model, self.people["child"].handle
        for purpose in PURPOSES:
            told = hospital.view("consent", "allowed", child, purpose, "depth")
            assert told == model.allowed(purpose, hospital.time_ms), purpose
        for who in EVERYBODY:
            found = hospital.view("mandates", "acting_for", child, self.people[who].identity.public_key, "consent")
            assert (found is not None) == (who != "child" and model.right(who, hospital.time_ms)[0]), who


def play(steps: list[tuple[Any, ...]]) -> None:
    story = Play()
    for step in steps:
        story.step(*step)
        story.check()


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from(RELATIVES), IN_FORCE)
def test_whoever_speaks_speaks_within_the_mandate(relative: str, steps: list[tuple[Any, ...]]) -> None:
    play([("mandate", relative, 30), *steps])


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from([*RELATIVES, "max"]), TO_BE_GIVEN, TO_BE_GIVEN)
def test_nobody_is_given_one_but_by_two_officers_and_by_accepting(
    relative: str, before: list[tuple[Any, ...]], after: list[tuple[Any, ...]]
) -> None:
    play([("propose", "eva", relative, 30), *before, ("approve", "ida"), *after, ("accept", relative)])
