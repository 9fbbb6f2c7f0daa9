"""Who is in a drive, and where they walk, stand and turn. Deterministic by generator."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from clients.robot.synthetic.driving.placing import ROBOT_M, Space, reach_of
from clients.robot.synthetic.driving.room import Panel, Wall
from clients.robot.synthetic.scenario import WALKING_MPS, Aid, Person, joined
from clients.robot.synthetic.scenes import (
    OTHER,
    OWNER,
    TAGGED_SHARE,
    THIRD,
    Path,
    cut_off,
    draw_companions,
    draw_person,
    draw_turning,
    tagged,
)

ALIASES = (OWNER, OTHER, THIRD, "fourth", "fifth", "sixth", "seventh", "eighth")
COUNTS, COUNT_SHARES = (1, 2, 3), (0.25, 0.45, 0.3)
AIDS: tuple[Aid, ...] = ("stick", "rollator", "iv-pole", "wheelchair", "bag")
AID_SHARE, CHILD_SHARE, AIDS_STRATUM_SHARE = 0.2, 0.08, 0.8
WALKS_SHARE, TURNS_SHARE = 0.6, 0.2
OWNER_LIES_SHARE = 0.4
TRIES_COUNT, SPOT_TRIES_COUNT = 40, 12
FACING_STEP_S = 0.2
TURN_MAX_RADPS = 2.5


class NoRoomError(Exception):
    """A person who has to be in a drive found no place: another drive is drawn."""


def draw_people(rng: np.random.Generator, space: Space, stratum: str, duration_s: float) -> tuple[Person, ...]:
    """Return "owner" (tagged) and the others (half are tagged), who all are in `space` then. Raises NoRoomError."""
    count = len(ALIASES) if stratum == "crowd" else int(rng.choice(COUNTS, p=COUNT_SHARES))
    people: list[Person] = []
    if stratum == "companions":
        people += _companions(rng, space, duration_s)
    elif stratum == "bed":
        people.append(_lying(rng, space, OWNER if rng.random() < OWNER_LIES_SHARE else OTHER, duration_s))
        count = max(count, 2)
    elif stratum == "past":
        people.append(_passed(rng, space, duration_s))
    for alias in ALIASES:
        if alias not in {person.alias for person in people} and (alias == OWNER or len(people) < count):
            needed = alias == OWNER or stratum == "crowd"
            people += _anybody(rng, space, alias, duration_s, needed=needed, aids=stratum == "aids")
    return tuple(
        tagged(person, duration_s)
        if person.alias == OWNER or rng.random() < TAGGED_SHARE
        else replace(person, readings_s=(), also_every_s=0.0)
        for person in sorted(people, key=lambda person: ALIASES.index(person.alias))
    )


def draw_behind(rng: np.random.Generator, space: Space, panel: Panel, duration_s: float) -> Person:
    """Outside the room."""
    x, z = space.room.place_by(panel.wall, panel.at_m + float(rng.uniform(-0.3, 0.3)), -float(rng.uniform(0.6, 1.6)))
    person = draw_person(rng, "behind", ((0.0, x, z), (duration_s, x, z)))
    return replace(person, facing=draw_turning(rng, duration_s))


def _drawn(rng: np.random.Generator, alias: str, duration_s: float, *, aids: bool = False) -> Person:
    """`aids`: all but a few have one, or are children."""
    aid: Aid = AIDS[int(rng.integers(len(AIDS)))] if rng.random() < (AIDS_STRATUM_SHARE if aids else AID_SHARE) else ""
    child = bool(not aid and rng.random() < (AIDS_STRATUM_SHARE if aids else CHILD_SHARE))
    person = draw_person(rng, alias, ((0.0, 0.0, 0.0), (duration_s, 0.0, 0.0)), aid=aid, child=child)
    return person if aid else replace(person, aid="")  # the draw gives some a bag: here only the share above


def _anybody(
    rng: np.random.Generator, space: Space, alias: str, duration_s: float, *, needed: bool, aids: bool
) -> tuple[Person, ...]:
    person = _drawn(rng, alias, duration_s, aids=aids)
    walks = bool(rng.random() < WALKS_SHARE)
    for number in range(TRIES_COUNT):
        if walks and number < TRIES_COUNT // 2:
            placed = replace(person, path=_walk(rng, space, reach_of(person), duration_s))
        else:
            placed = _standing(rng, space, person, duration_s)
        if space.admits(placed):
            space.add(placed)
            return (placed if placed.facing else facing_along(rng, placed),)
    if needed:
        raise NoRoomError
    return ()


def _standing(rng: np.random.Generator, space: Space, person: Person, duration_s: float) -> Person:
    x, z = _spot(rng, space, reach_of(person))
    placed = replace(person, path=((0.0, x, z), (duration_s, x, z)))
    if rng.random() < TURNS_SHARE:
        return replace(placed, facing=draw_turning(rng, duration_s))
    heading = float(rng.uniform(-math.pi, math.pi))
    if rng.random() < 0.5:
        robot_x, robot_z = space.robot[0]
        heading = math.atan2(robot_x - x, z - robot_z)
    return replace(placed, facing=((0.0, heading), (duration_s, heading)))


def _passed(rng: np.random.Generator, space: Space, duration_s: float) -> Person:
    """Next to the robot's path."""
    person = _drawn(rng, OWNER if rng.random() < 0.5 else OTHER, duration_s)
    for _ in range(TRIES_COUNT):
        moment = int(rng.uniform(0.45, 0.75) * len(space.times))
        aside = float(rng.choice([-1.0, 1.0])) * (reach_of(person) + ROBOT_M + float(rng.uniform(0.03, 0.5)))
        yaw = float(space.yaws[moment])
        x, z = space.robot[moment] + aside * np.array([math.cos(yaw), -math.sin(yaw)])
        placed = replace(person, path=((0.0, float(x), float(z)), (duration_s, float(x), float(z))))
        placed = replace(placed, facing=draw_turning(rng, duration_s))
        if space.admits(placed):
            space.add(placed)
            return placed
    raise NoRoomError


def _lying(rng: np.random.Generator, space: Space, alias: str, duration_s: float) -> Person:
    """In a bed along a side wall."""
    person = draw_person(rng, alias, (), aid="bed")
    for _ in range(TRIES_COUNT):
        wall: Wall = "left" if rng.random() < 0.5 else "right"
        _, along = space.draw_spot(rng)
        x, z = space.room.place_by(wall, along, float(rng.uniform(0.55, 0.75)))
        heading = math.pi * float(rng.integers(2)) + float(rng.uniform(-0.08, 0.08))
        placed = replace(
            person, path=((0.0, x, z), (duration_s, x, z)), facing=((0.0, heading), (duration_s, heading)), arms=""
        )
        if space.admits(placed):
            space.add(placed)
            return placed
    raise NoRoomError


def _companions(rng: np.random.Generator, space: Space, duration_s: float) -> tuple[Person, ...]:
    for _ in range(TRIES_COUNT):
        drawn = draw_companions(
            rng,
            duration_s,
            walk=lambda rng, duration_s: _walk(rng, space, 0.7, duration_s),
            stand=lambda rng, duration_s: _stand(rng, space, 0.7, duration_s),
        )
        leads = next(person for person in drawn if not person.accompanies)
        follows = next(person for person in drawn if person.accompanies)
        if not space.admits(leads):
            continue
        leads = leads if leads.facing else facing_along(rng, leads)
        pair = joined((leads, replace(follows, path=(), facing=())))
        if all(space.admits(person) for person in pair):
            for person in pair:
                space.add(person)
            return pair
    raise NoRoomError


def _spot(rng: np.random.Generator, space: Space, margin_m: float) -> tuple[float, float]:
    """Return a place in view that keeps clear of the walls, if one is found soon."""
    place = space.draw_spot(rng)
    for _ in range(SPOT_TRIES_COUNT):
        if space.room.inside(np.array([place]), margin_m):
            break
        place = space.draw_spot(rng)
    return place


def _stand(rng: np.random.Generator, space: Space, margin_m: float, duration_s: float) -> Path:
    place = _spot(rng, space, margin_m)
    return ((0.0, *place), (duration_s, *place))


def _walk(rng: np.random.Generator, space: Space, margin_m: float, duration_s: float) -> Path:
    times, points = [0.0], [_spot(rng, space, margin_m)]
    while times[-1] < duration_s:
        goal = points[-1] if rng.random() < 0.25 else _spot(rng, space, margin_m)
        length = math.dist(points[-1], goal)
        takes_s = float(rng.uniform(1.0, 3.0)) if length < 0.3 else length / float(rng.uniform(0.4, 1.2))
        times.append(times[-1] + takes_s)
        points.append(points[-1] if length < 0.3 else goal)
    return cut_off(times, points, duration_s)


def facing_along(rng: np.random.Generator, person: Person) -> Person:
    """Return the person looking along their way, and on where they stop."""
    first, last = person.path[0][0], person.path[-1][0]
    times = [float(at_s) for at_s in np.arange(first, last, FACING_STEP_S)] + [last]
    seen = [replace(person, facing=()).heading(at_s) for at_s in times]
    moving = [heading for heading, speed in seen if speed >= WALKING_MPS]
    looks = moving[0] if moving else float(rng.uniform(-math.pi, math.pi))
    facing = []
    for at_s, (heading, speed) in zip(times, seen, strict=True):
        if speed >= WALKING_MPS:
            most = TURN_MAX_RADPS * FACING_STEP_S
            looks += min(max(math.remainder(heading - looks, 2 * math.pi), -most), most)
        facing.append((at_s, looks))
    return replace(person, facing=tuple(facing))
