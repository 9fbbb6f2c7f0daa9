"""What happens in a hospital, day by day: drawn from a seed alone."""

from __future__ import annotations

import random
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from msgspec import Struct

SLOTS_A_DAY_COUNT = 12
"""A day has twelve hours in which something happens; what happens in one goes into the same blocks."""
RETENTIONS_DAYS = (1, 7, 7, 30, 30, 30, 90)
RECORDS_A_VISIT = (1, 1, 2, 2, 3)
FRAMES_A_RECORD = (1, 2, 3)
HELD_MAX_DAYS = 20
SHARED_MAX_DAYS = 10
STAFF_SHARE = 0.02
STAFF_MIN_COUNT = 2
_TRIES_COUNT = 8
_FOR_EVER_DAY = 1 << 30

Kind = Literal[
    "visit",
    "look",
    "share",
    "revoke_grant",
    "erase",
    "erase_frame",
    "restrict",
    "lift",
    "object",
    "deny",
    "withdraw",
    "give",
    "arrive",
    "leave",
    "revoke_member",
    "rotate",
    "replace_robot",
    "setting",
]


class Event(Struct, frozen=True):
    """One thing that happens. `subject` is the number of a visit, member, robot, grant or setting, by the kind.

    `records`: which of the visit's. `amounts`: of a visit the member, the robot, the days that it is kept and the frames
    of each record; of a share the doctor, the days and the grant's number; of an erased frame its index.
    """

    slot: int
    kind: Kind
    subject: int
    records: tuple[int, ...] = ()
    amounts: tuple[int, ...] = ()


class YearOptions(NamedTuple):
    """How large the hospital is, for how long, and by which seed."""

    days: int
    members: int
    robots: int
    custodians: int
    seed: int

    @property
    def staff(self) -> int:
        return max(STAFF_MIN_COUNT, round(self.members * STAFF_SHARE))


class Rate(NamedTuple):
    """How often something happens a day for each member, and how often and every how many days at least."""

    a_member: float
    every_days: int
    at_least: int = 1


RATES: dict[Kind, Rate] = {
    "arrive": Rate(0.001, 2),
    "leave": Rate(0.0004, 3),
    "revoke_member": Rate(0.0002, 10),
    "rotate": Rate(0.001, 2),
    "withdraw": Rate(0.001, 2),
    "give": Rate(0.001, 2),
    "replace_robot": Rate(0.0, 15),
    "setting": Rate(0.0, 10),
    "deny": Rate(0.0001, 5),
    "restrict": Rate(0.0005, 2),
    "object": Rate(0.0005, 3),
    "erase": Rate(0.004, 1),
    "erase_frame": Rate(0.001, 1),
    "share": Rate(0.002, 1),
    "look": Rate(0.005, 1),
    "visit": Rate(0.05, 1, 6),
}
"""In the order in which a day is drawn: who leaves today is not visited any more."""


@dataclass(slots=True)
class PlannedVisit:
    """What is kept of a visit: by record until which day, and how many of its frames are left."""

    number: int
    member: int
    until_day: dict[int, int]
    frames: dict[int, list[int]]
    is_held: bool = False
    is_denied: bool = False

    def left(self, day: int) -> tuple[int, ...]:
        """Records that stay at least until tomorrow."""
        return tuple(index for index, until in self.until_day.items() if self.is_held or until > day)


class HospitalPlan:
    """Draws one day after the other; the same options draw the same days."""

    def __init__(self, options: YearOptions) -> None:
        self.options, self.day = options, -1
        self.members = list(range(options.members))
        self.members_count = options.members
        self.visits: dict[int, PlannedVisit] = {}
        self.grants_count = self.settings_count = self._visits_count = 0
        self._dice = random.Random(f"year {options}")  # noqa: S311 - a simulation's dice
        self._refusing: set[int] = set()
        self._touched: set[tuple[str, int]] = set()
        self._due: defaultdict[int, list[tuple[Kind, int]]] = defaultdict(list)

    def next_day(self) -> list[Event]:
        """In order; nobody and no visit is in two events of a day, but for a member's visits."""
        self.day += 1
        self._touched.clear()
        self.visits = {number: each for number, each in self.visits.items() if each.is_held or each.left(self.day)}
        events = [event for kind, subject in self._due.pop(self.day, ()) if (event := self._end(kind, subject))]
        for kind, rate in RATES.items():
            for _ in range(self._count(rate)):
                event = _DRAWERS[kind](self)
                if event is not None:
                    events.append(event)
        return sorted(events, key=lambda event: event.slot)

    def _count(self, rate: Rate) -> int:
        drawn = int(rate.a_member * self.options.members + self._dice.random())
        is_due = self.day % rate.every_days == min(1, rate.every_days - 1)
        return max(drawn, rate.at_least if is_due else 0)

    def _slot(self) -> int:
        """The first hour is for who comes, leaves and changes keys."""
        return self._dice.randrange(1, SLOTS_A_DAY_COUNT)

    def _touch(self, what: str, number: int) -> bool:
        if (what, number) in self._touched:
            return False
        self._touched.add((what, number))
        return True

    def _choose_visit(self, fits: Callable[[PlannedVisit], bool] = lambda _visit: True) -> PlannedVisit | None:
        numbers = list(self.visits)
        for _ in range(_TRIES_COUNT if numbers else 0):
            visit = self.visits[self._dice.choice(numbers)]
            is_there = not visit.is_denied and visit.left(self.day) and ("member", visit.member) not in self._touched
            if is_there and fits(visit) and self._touch("visit", visit.number):
                return visit
        return None

    def _choose_member(self, fits: Callable[[int], bool] = lambda _number: True) -> int | None:
        for _ in range(_TRIES_COUNT):
            number = self._dice.choice(self.members)
            if fits(number) and self._touch("member", number):
                return number
        return None

    def _end(self, kind: Kind, subject: int) -> Event | None:
        """What was to end today: a restriction, or a grant before its time."""
        if kind == "revoke_grant":
            return Event(self._slot(), kind, subject)
        visit = self.visits[subject]
        self._touch("visit", subject)
        visit.is_held = False
        return Event(self._slot(), kind, subject)

    # What is drawn

    def draw_visit(self) -> Event | None:
        member = self._dice.choice(self.members)
        if ("member", member) in self._touched:
            return None
        number, self._visits_count = self._visits_count, self._visits_count + 1
        robot, kept_days = self._dice.randrange(self.options.robots), self._dice.choice(RETENTIONS_DAYS)
        count = 0 if member in self._refusing else self._dice.choice(RECORDS_A_VISIT)
        frames = tuple(self._dice.choice(FRAMES_A_RECORD) for _ in range(count))
        if frames:
            until = dict.fromkeys(range(count), self.day + kept_days)
            left = {index: list(range(many)) for index, many in enumerate(frames)}
            self.visits[number] = PlannedVisit(number, member, until, left)
            self._touch("visit", number)
        return Event(self._slot(), "visit", number, amounts=(member, robot, kept_days, *frames))

    def draw_look(self) -> Event | None:
        visit = self._choose_visit()
        return None if visit is None else Event(self._slot(), "look", visit.number, visit.left(self.day))

    def draw_share(self) -> Event | None:
        visit = self._choose_visit(lambda each: not each.is_held)
        if visit is None:
            return None
        number, self.grants_count = self.grants_count, self.grants_count + 1
        days = self._dice.randint(1, SHARED_MAX_DAYS)
        if days > 1 and self._dice.random() < 0.5:
            self._due[self.day + self._dice.randrange(1, days)].append(("revoke_grant", number))
        doctor = self._dice.randrange(self.options.staff)
        return Event(self._slot(), "share", visit.number, visit.left(self.day), (doctor, days, number))

    def draw_erase(self) -> Event | None:
        visit = self._choose_visit()
        if visit is None:
            return None
        left = visit.left(self.day)
        chosen = left if self._dice.random() < 0.7 else (self._dice.choice(left),)
        for index in chosen:
            del visit.until_day[index]
        return Event(self._slot(), "erase", visit.number, chosen)

    def draw_erase_frame(self) -> Event | None:
        def has_many(visit: PlannedVisit) -> bool:
            return any(len(visit.frames[index]) > 1 for index in visit.left(self.day))

        visit = self._choose_visit(has_many)
        if visit is None:
            return None
        index = next(each for each in visit.left(self.day) if len(visit.frames[each]) > 1)
        frame = self._dice.choice(visit.frames[index])
        visit.frames[index].remove(frame)
        return Event(self._slot(), "erase_frame", visit.number, (index,), (frame,))

    def draw_restrict(self) -> Event | None:
        visit = self._choose_visit(lambda each: not each.is_held)
        if visit is None:
            return None
        visit.is_held = True
        self._due[self.day + self._dice.randint(1, HELD_MAX_DAYS)].append(("lift", visit.number))
        return Event(self._slot(), "restrict", visit.number)

    def draw_object(self) -> Event | None:
        visit = self._choose_visit()
        return None if visit is None else Event(self._slot(), "object", visit.number)

    def draw_deny(self) -> Event | None:
        visit = self._choose_visit(lambda each: not each.is_held)
        if visit is None:
            return None
        chosen = visit.left(self.day)
        visit.is_denied = True
        visit.until_day.clear()
        return Event(self._slot(), "deny", visit.number, chosen)

    def draw_withdraw(self) -> Event | None:
        number = self._choose_member(lambda each: each not in self._refusing)
        if number is None:
            return None
        self._refusing.add(number)
        return Event(0, "withdraw", number)

    def draw_give(self) -> Event | None:
        for number in sorted(self._refusing):
            if self._touch("member", number):
                self._refusing.discard(number)
                return Event(0, "give", number)
        return None

    def draw_arrive(self) -> Event | None:
        number, self.members_count = self.members_count, self.members_count + 1
        self.members.append(number)
        self._touch("member", number)
        return Event(0, "arrive", number)

    def _draw_end(self, kind: Kind) -> Event | None:
        number = self._choose_member() if len(self.members) > 1 else None
        if number is None:
            return None
        self.members.remove(number)
        self._refusing.discard(number)
        return Event(0, kind, number)

    def draw_leave(self) -> Event | None:
        return self._draw_end("leave")

    def draw_revoke(self) -> Event | None:
        return self._draw_end("revoke_member")

    def draw_rotate(self) -> Event | None:
        number = self._choose_member()
        return None if number is None else Event(0, "rotate", number)

    def draw_robot(self) -> Event | None:
        return Event(0, "replace_robot", self._dice.randrange(self.options.robots))

    def draw_setting(self) -> Event | None:
        self.settings_count += 1
        return Event(self._slot(), "setting", self.settings_count)


_DRAWERS: dict[Kind, Callable[[HospitalPlan], Event | None]] = {
    "visit": HospitalPlan.draw_visit,
    "look": HospitalPlan.draw_look,
    "share": HospitalPlan.draw_share,
    "erase": HospitalPlan.draw_erase,
    "erase_frame": HospitalPlan.draw_erase_frame,
    "restrict": HospitalPlan.draw_restrict,
    "object": HospitalPlan.draw_object,
    "deny": HospitalPlan.draw_deny,
    "withdraw": HospitalPlan.draw_withdraw,
    "give": HospitalPlan.draw_give,
    "arrive": HospitalPlan.draw_arrive,
    "leave": HospitalPlan.draw_leave,
    "revoke_member": HospitalPlan.draw_revoke,
    "rotate": HospitalPlan.draw_rotate,
    "replace_robot": HospitalPlan.draw_robot,
    "setting": HospitalPlan.draw_setting,
}
