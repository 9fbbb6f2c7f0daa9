"""The attacked days from start to end, with the truth."""

from __future__ import annotations

import asyncio
import os
import random
from collections.abc import Coroutine
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec

from clients.sdk.chain.announcements import Announcement
from clients.wallet.ledger.visit_scan import find_own_visits, owner_key
from clients.wallet.records.rights_requests import SPREAD_MAX_MS
from consensus.records.clips import ClipUpload
from consensus.state.records import ANNOUNCEMENT, ANNOUNCEMENT_COUNT
from network.lab.privacy.hospital.attacked_chain import START_MS, Chain
from network.lab.privacy.hospital.attacked_recording import SENSOR, RobotDay, RobotLink, frames_before
from network.lab.privacy.hospital.household import (
    PURPOSE,
    Holder,
    Unit,
    make_holder,
    make_roster,
    make_unit,
    publics_of,
    register,
)
from network.lab.privacy.hospital.population import DAY_MS, HOUR_MS, ROUND_WINDOW_MS, ROUNDS_AT_HOUR, Population, Stay
from network.sim.world.sim_cluster import quiet_logs
from network.sim.world.virtual_time import SimLoop

ROSTER_HOUR, EVENING_HOUR, NIGHT_HOUR = 6, 19, 22
WALLETS_A_DAY_SHARE = 0.3
TOGETHER, PAUSING, OVER_HOURS = MANNERS = ("together", "with_pauses", "over_hours")
HOURS_SPREAD_MS = 2 * HOUR_MS
STOLEN_ROBOTS_COUNT = 3
TICK_S, LIMIT_S = 60, 400 * 86_400
_PAUSE_BETWEEN_SESSIONS_MS = (15, 60)
_MEMORY_FOLDER = Path("/dev/shm")  # noqa: S108 - in memory, and below a folder of our own


@dataclass(frozen=True, slots=True)
class SessionSeen:
    """A session seen by a node: opening time, address, key (33 bytes)."""

    at_ms: int
    address: str
    key: bytes


@dataclass(frozen=True, slots=True)
class Asked:
    """A wallet's access request: owner, day, visit, time, manner (`MANNERS`)."""

    person: int
    day: int
    owner: bytes
    at_ms: int
    manner: str


@dataclass(slots=True)
class Truth:
    """What happened, for judging alone. Owner keys: 33 bytes."""

    stay_of_owner: dict[bytes, int] = field(default_factory=dict)
    sealed_at_ms: dict[bytes, int] = field(default_factory=dict)
    """When each record's clip was sealed, by record id."""
    asked: list[Asked] = field(default_factory=list)
    words: list[tuple[int, int]] = field(default_factory=list)
    """(person, chain's time in ms) of each withdrawal."""

    def owners_of(self, stay: int) -> list[bytes]:
        return [owner for owner, known in self.stay_of_owner.items() if known == stay]


@dataclass(slots=True)
class Played:
    """All remains of the days, and the truth."""

    population: Population
    chain: Chain
    loop: SimLoop
    units: list[Unit]
    holders: dict[int, Holder]
    uploads: dict[bytes, ClipUpload]
    sessions: list[SessionSeen]
    stolen: list[RobotDay]
    truth: Truth

    def person_of(self, owner: bytes) -> int:
        return self.population.stays[self.truth.stay_of_owner[owner]].person

    def run(self, work: Coroutine[Any, Any, None]) -> None:
        finish(self.loop, work)


class _Days:
    def __init__(self, population: Population, folder: Path, seed: int, *, at_once: bool) -> None:
        self.population, self.folder, self.seed, self.at_once = population, folder, seed, at_once
        self.loop = SimLoop(seed)
        self.dice = random.Random(seed)  # noqa: S311 - a simulation's dice
        self.chain = Chain(self.loop)
        self.truth = Truth()
        self.uploads: dict[bytes, ClipUpload] = {}
        self.sessions: list[SessionSeen] = []
        self.holders = {person.number: make_holder(person) for person in population.enrolled}
        self.units = [make_unit(number, folder / f"robot-{number}") for number in range(population.robots)]
        self.stolen: list[RobotDay] = []

    async def until(self, at_ms: int) -> None:
        await asyncio.sleep(max(0.0, (at_ms - self.loop.now_ms) / 1000))

    async def all_of_it(self) -> None:
        for unit in self.units:
            identity = unit.identity
            handle = unit.member[1:]
            await register(self.chain, handle, "robot", identity.identity, publics_of(identity))
        await asyncio.gather(*(self.enrol(holder) for holder in self.holders.values()))
        for day in range(self.population.days):
            await self.until((day + 1) * DAY_MS + ROSTER_HOUR * HOUR_MS)
            await asyncio.gather(*(self.robot_day(unit, day) for unit in self.units), self.evening(day))

    async def enrol(self, holder: Holder) -> None:
        await self.until(holder.person.registers_at_ms)
        keys = holder.keys
        await register(self.chain, holder.handle, "subject", keys.identity, publics_of(keys))

    async def robot_day(self, unit: Unit, day: int) -> None:
        roster = make_roster(self.chain, unit, list(self.holders.values()))
        # Dice of its own: how often a robot sends must not change what people do.
        dice = random.Random(f"{self.seed} {unit.number} {day}")  # noqa: S311 - a simulation's dice
        link = RobotLink(self.chain, unit, self.uploads, dice)
        robot = RobotDay(self.chain, unit, roster, link, at_once=self.at_once)
        stays = [stay for stay in self.population.stays if (stay.robot, stay.day) == (unit.number, day)]
        is_stolen = day == self.population.days - 1 and unit.number < STOLEN_ROBOTS_COUNT
        if not is_stolen:
            await asyncio.gather(*(self.stay(robot, stay) for stay in stays))
            await self.until((day + 1) * DAY_MS + (EVENING_HOUR - 1) * HOUR_MS)
            await robot.end()
            return
        self.stolen.append(robot)
        last = len(ROUNDS_AT_HOUR) - 1
        await asyncio.gather(*(self.stay(robot, stay) for stay in stays if stay.round < last))
        await self.until((day + 1) * DAY_MS + ROUNDS_AT_HOUR[last] * HOUR_MS)
        link.is_cut = True  # in the last round it is out of touch, and then it is stolen
        await asyncio.gather(*(self.stay(robot, stay) for stay in stays if stay.round == last and not stay.is_long))
        await self.until(int(self.loop.now_ms) + ROUND_WINDOW_MS)
        await robot.stop()

    async def stay(self, robot: RobotDay, stay: Stay) -> None:
        holder = self.holders[stay.person]
        says_no = asyncio.ensure_future(self.say_no(holder, stay.says_no_at_ms)) if stay.says_no_at_ms else None
        for clip, (at_ms, sizes) in enumerate(zip(stay.clips_at_ms, stay.frame_bytes, strict=True)):
            await self.until(at_ms)
            sealed = robot.see(holder.person.uid, sizes, frames_before(stay, clip))
            if sealed is not None:
                self.truth.stay_of_owner[sealed.owner] = stay.number
                self.truth.sealed_at_ms[sealed.upload.record_id] = self.chain.now_ms()
        if says_no is not None:
            await says_no

    async def say_no(self, holder: Holder, at_ms: int) -> None:
        await self.until(at_ms)
        key = holder.keys.identity
        call = self.chain.sign(key, "consent", "withdraw", [holder.handle, [PURPOSE], [SENSOR]])
        self.truth.words.append((holder.person.number, self.chain.now_ms()))
        await self.chain.submit(call)
        await self.until(at_ms - at_ms % DAY_MS + NIGHT_HOUR * HOUR_MS + self.dice.randrange(HOUR_MS))
        seen = len(self.chain.blocks)
        arguments = [holder.handle, [PURPOSE], [SENSOR], 0, 0, 0, seen]
        await self.chain.submit(self.chain.sign(key, "consent", "give", arguments))

    async def evening(self, day: int) -> None:
        await self.until((day + 1) * DAY_MS + EVENING_HOUR * HOUR_MS)
        chosen = [holder for holder in self.holders.values() if self.dice.random() < WALLETS_A_DAY_SHARE]
        await asyncio.gather(*(self.open_wallet(holder, day) for holder in chosen))

    async def open_wallet(self, holder: Holder, day: int) -> None:
        await self.until((day + 1) * DAY_MS + EVENING_HOUR * HOUR_MS + self.dice.randrange(HOUR_MS))
        address = f"10.0.{holder.person.number // 250}.{holder.person.number % 250 + 1}"
        count = ANNOUNCEMENT_COUNT.read(self.chain.state) or 0
        announced = [self.chain.state.get(ANNOUNCEMENT.key(number)) or b"" for number in range(count)]
        rows = enumerate(map(ANNOUNCEMENT.decode, announced))
        items = [Announcement(number, *msgspec.structs.astuple(row)) for number, row in rows]
        keys = holder.keys
        self.sessions.append(SessionSeen(self.chain.now_ms(), address, keys.identity.public_key))
        found = find_own_visits(items, keys, self.chain.chain_id)
        for visit in found:
            await asyncio.sleep(self.dice.uniform(*_PAUSE_BETWEEN_SESSIONS_MS) / 1000)
            self.sessions.append(SessionSeen(self.chain.now_ms(), address, visit.owner))
        manner = self.dice.choice(MANNERS)
        for visit, pause_ms in zip(self.dice.sample(found, len(found)), self.pauses(manner, len(found)), strict=True):
            await asyncio.sleep(pause_ms / 1000)
            key = owner_key(visit, keys, self.chain.chain_id)
            self.truth.asked.append(Asked(holder.person.number, day, visit.owner, self.chain.now_ms(), manner))
            await self.chain.submit(self.chain.sign(key, "access", "request", [[], "own-access"]))

    def pauses(self, manner: str, count: int) -> list[int]:
        if manner == PAUSING:
            return [self.dice.randrange(SPREAD_MAX_MS) for _ in range(count)]
        if manner == OVER_HOURS:
            times = sorted(self.dice.randrange(HOURS_SPREAD_MS) for _ in range(count))
            return [at_ms - before for before, at_ms in pairwise([0, *times])]
        return [0] * count


def finish(loop: SimLoop, work: Coroutine[Any, Any, None]) -> None:
    """Run to the end on the virtual clock; re-raises its errors, also background ones."""
    with quiet_logs():
        task = loop.create_task(work)
        loop.run_until(task.done, loop.time() + LIMIT_S)
    task.result()
    if loop.faults:
        raise AssertionError(loop.faults[0])


async def _tick() -> None:
    """Keep a timer pending: an idle virtual clock would jump to its limit."""
    while True:  # noqa: ASYNC110 - nothing is waited for
        await asyncio.sleep(TICK_S)


def play(population: Population, folder: Path, *, seed: int, at_once: bool = False) -> Played:
    """Play all days into `folder`. `at_once` submits without delay (`robot replay --now`)."""
    days = _Days(population, folder, seed, at_once=at_once)
    days.loop.create_task(_tick())
    finish(days.loop, days.all_of_it())
    return Played(
        population=population,
        chain=days.chain,
        loop=days.loop,
        units=days.units,
        holders=days.holders,
        uploads=days.uploads,
        sessions=days.sessions,
        stolen=days.stolen,
        truth=days.truth,
    )


def day_of(time_ms: int) -> int:
    return (time_ms - START_MS) // DAY_MS - 1


def working_folder() -> str | None:
    """Return an in-memory folder if there is one: fsync is costly."""
    usable = _MEMORY_FOLDER.is_dir() and os.access(_MEMORY_FOLDER, os.W_OK)
    if not usable:
        return None
    space = os.statvfs(_MEMORY_FOLDER)
    return str(_MEMORY_FOLDER) if space.f_bavail * space.f_frsize > 2 * 1024**3 else None
