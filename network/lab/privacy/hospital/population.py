"""The attacked population: people, robots they pass, picture sizes. Seeded."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

PERSONS_A_WARD_COUNT = 20
ROUNDS_AT_HOUR = (8, 12, 17)
ROUND_WINDOW_MS = 180_000
ATTENDING_SHARE, FAVOURITE_ROUND_SHARE = 0.3, 0.8
LONG_STAYS_SHARE = 0.05
LONG_STAY_MS = 640_000
LONG_STAY_EVERY_MS = 40_000
CLIP_MS = 500
FRAMES_A_CLIP_COUNT = 2
RECORDS_MEDIAN_COUNT = 4.0
RECORDS_MAX_COUNT = 14
RECORDS_PERSON_SPREAD, RECORDS_VISIT_SPREAD = 0.25, 0.5
RENDITION_MEDIAN_BYTES = 16_000
BUILD_SPREAD = 0.12
DISTANCE_SPREAD = 0.35
FRAME_SPREAD = 0.08
COMPANIONS_SHARE = 0.3
WORDS_SHARE = 0.04
HOUR_MS = 3_600_000
DAY_MS = 24 * HOUR_MS
UID_PREFIX = "E2801160600002"
SERIAL_BITS_MAX = 40


@dataclass(frozen=True, slots=True)
class Person:
    """An admitted person. `uid`: tag; only `enrolled` ones have handles. Times: ms from start.

    `build` scales picture size, `staying` number of records; `favourite`: usual round.
    """

    number: int
    ward: int
    uid: str
    build: float
    staying: float
    favourite: int
    admitted_at_ms: int
    registers_at_ms: int
    enrolled: bool


@dataclass(frozen=True, slots=True)
class Stay:
    """One pass at a robot: clips' sealing times (ms), frames' pixel bytes.

    `says_no_at_ms`: time of consent withdrawal, if any.
    """

    number: int
    person: int
    robot: int
    day: int
    round: int
    clips_at_ms: tuple[int, ...]
    frame_bytes: tuple[tuple[int, ...], ...]
    says_no_at_ms: int | None = None

    @property
    def is_long(self) -> bool:
        return self.clips_at_ms[-1] - self.clips_at_ms[0] > 9 * 60_000


@dataclass(frozen=True, slots=True)
class Population:
    """All people and stays by time. `serial_bits`: UID bits unknown to outsiders."""

    people: tuple[Person, ...]
    stays: tuple[Stay, ...]
    robots: int
    days: int
    serial_bits: int
    companions: dict[int, int] = field(default_factory=dict)

    @property
    def enrolled(self) -> tuple[Person, ...]:
        return tuple(person for person in self.people if person.enrolled)


def make_uid(serial: int, serial_bits: int) -> str:
    """Return a UID of 24 hex digits (EPC): delivery prefix, then serial."""
    if not 0 <= serial < 1 << serial_bits:
        raise ValueError("a serial number has no more bits than there are")
    return f"{UID_PREFIX}{serial:010X}"


def draw_population(seed: int, *, people: int, days: int, serial_bits: int) -> Population:
    rng = np.random.default_rng([seed, 0xA77AC])
    persons = tuple(_draw_people(rng, people, serial_bits))
    robots = max(1, round(people / PERSONS_A_WARD_COUNT))
    companions = _draw_companions(rng, persons)
    stays: list[Stay] = []
    for day in range(days):
        for number, hour in enumerate(ROUNDS_AT_HOUR):
            for robot in range(robots):
                begins_ms = (day + 1) * DAY_MS + hour * HOUR_MS
                stays.extend(_draw_round(rng, persons, companions, (robot, day, number, begins_ms), len(stays)))
    return Population(persons, tuple(stays), robots, days, serial_bits, companions)


def _draw_people(rng: np.random.Generator, people: int, serial_bits: int) -> list[Person]:
    serials = rng.choice(1 << min(serial_bits, 30), size=2 * people, replace=False)
    enrols = rng.permutation(np.arange(2 * people) % 2 == 0)
    wards = iter(np.arange(people) % max(1, round(people / PERSONS_A_WARD_COUNT)))
    found = []
    for number in range(2 * people):
        admitted = int(rng.integers(0, DAY_MS - 3 * HOUR_MS))
        enrolled = bool(enrols[number])
        found.append(
            Person(
                number=number,
                ward=int(next(wards)) if enrolled else -1,
                uid=make_uid(int(serials[number]), serial_bits),
                build=float(rng.lognormal(0, BUILD_SPREAD)),
                staying=float(rng.lognormal(0, RECORDS_PERSON_SPREAD)),
                favourite=int(rng.integers(len(ROUNDS_AT_HOUR))),
                admitted_at_ms=admitted,
                registers_at_ms=admitted + int(rng.integers(10 * 60_000, 2 * HOUR_MS)),
                enrolled=enrolled,
            )
        )
    return found


def _draw_companions(rng: np.random.Generator, persons: tuple[Person, ...]) -> dict[int, int]:
    pairs: dict[int, int] = {}
    wards = {person.ward for person in persons if person.enrolled}
    for ward in sorted(wards):
        present = [person.number for person in persons if person.ward == ward]
        drawn = rng.permutation(present)[: 2 * int(COMPANIONS_SHARE * len(present) / 2)]
        for first, second in zip(drawn[::2], drawn[1::2], strict=True):
            pairs[int(first)], pairs[int(second)] = int(second), int(first)
    return pairs


def _draw_round(
    rng: np.random.Generator,
    persons: tuple[Person, ...],
    companions: dict[int, int],
    place: tuple[int, int, int, int],
    first_number: int,
) -> list[Stay]:
    robot, _, number, begins_ms = place
    starts: dict[int, int] = {}
    for person in persons:
        if not person.enrolled or person.ward != robot or person.number in starts:
            continue
        if rng.random() < (FAVOURITE_ROUND_SHARE if person.favourite == number else ATTENDING_SHARE):
            start = begins_ms + int(rng.integers(0, ROUND_WINDOW_MS))
            starts[person.number] = start
            if person.number in companions:
                starts[companions[person.number]] = start + int(rng.integers(-400, 400))
    ordered = sorted(starts.items(), key=lambda item: item[1])
    return [_draw_stay(rng, persons[who], place, at, first_number + n) for n, (who, at) in enumerate(ordered)]


def _draw_stay(
    rng: np.random.Generator, person: Person, place: tuple[int, int, int, int], start_ms: int, number: int
) -> Stay:
    robot, day, round_number, _ = place
    if rng.random() < LONG_STAYS_SHARE:
        clips = tuple(range(start_ms, start_ms + LONG_STAY_MS, LONG_STAY_EVERY_MS))
    else:
        count = RECORDS_MEDIAN_COUNT * person.staying * float(rng.lognormal(0, RECORDS_VISIT_SPREAD))
        clips = tuple(start_ms + CLIP_MS * n for n in range(min(RECORDS_MAX_COUNT, max(2, round(count)))))
    distance = float(rng.lognormal(0, DISTANCE_SPREAD))
    scale = RENDITION_MEDIAN_BYTES * person.build * distance
    sizes = tuple(tuple(int(scale * rng.lognormal(0, FRAME_SPREAD)) for _ in range(FRAMES_A_CLIP_COUNT)) for _ in clips)
    says_no = None
    if len(clips) >= 4 and clips[-1] - clips[0] < LONG_STAY_MS // 2 and rng.random() < WORDS_SHARE * 2:
        says_no = clips[len(clips) // 2] + CLIP_MS // 2
    return Stay(number, person.number, robot, day, round_number, clips, sizes, says_no)
