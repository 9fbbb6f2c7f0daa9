"""Short random scenes by stratum, for training and evaluation. Deterministic by seed."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from clients.robot.synthetic.scenario import (
    Aid,
    Arms,
    Bed,
    Door,
    Environment,
    Manner,
    Person,
    Reader,
    Scenario,
    check_scenario,
    joined,
    without,
)

__all__ = ["PAIR_STRATA", "SINGLE_STRATA", "STRATA", "Stratum", "draw_scene", "without"]

Stratum = Literal[
    "apart",
    "close",
    "touching",
    "crossing",
    "companion",
    "bearer-behind",
    "moving-robot",
    "single",
    "wheelchair",
    "rollator",
    "stick",
    "iv-pole",
    "child",
    "bed",
]
STRATA: tuple[Stratum, ...] = get_args(Stratum)
PAIR_STRATA: tuple[Stratum, ...] = STRATA[:7]
SINGLE_STRATA: tuple[Stratum, ...] = STRATA[7:]
OWNER, OTHER, THIRD = "owner", "other", "third"

DURATION_DEFAULT_S = 12.0
FRAME_RATE_DEFAULT = 10
NEAREST_M, FARTHEST_M = 1.7, 4.6
VIEW_SHARE = 0.42  # of the depth to either side that is surely in the picture
THIRD_SHARE = 0.3
TAGGED_SHARE = 0.5
HOLES = (0.004, 0.012, 0.025)
COMPANIONS: tuple[tuple[Manner, str, float], ...] = (
    ("arm-in-arm", "adult", 0.25),
    ("embrace", "adult", 0.2),
    ("pushing", "adult", 0.2),
    ("close-behind", "adult", 0.15),
    ("arm-in-arm", "child", 0.2),
)

Path = tuple[tuple[float, float, float], ...]
DrawPath = Callable[[np.random.Generator, float], Path]


def draw_scene(
    seed: int,
    stratum: Stratum,
    *,
    duration_s: float = DURATION_DEFAULT_S,
    frame_rate: int = FRAME_RATE_DEFAULT,
    manner: Manner | None = None,
    child: bool | None = None,
    third: bool | None = None,
) -> Scenario:
    """Return a random scene of "owner" (tagged), "other" (half are tagged), "third". `bearer-behind`: owner behind the
    robot.
    """
    rng = np.random.default_rng([seed, STRATA.index(stratum), 0xC0221D02])
    people = _cast(rng, stratum, duration_s, manner, child)
    wants_third = bool(rng.random() < THIRD_SHARE) if third is None else third
    if wants_third and stratum in PAIR_STRATA:
        people = (*people, _third(rng, people, duration_s))
    scenario = Scenario(
        name=f"{stratum}-{seed}",
        duration_s=duration_s,
        frame_rate=frame_rate,
        width=640,
        height=480,
        focal_px=525.0,
        camera_height_m=float(rng.uniform(1.0, 1.35)),
        seed=int(rng.integers(2**31)),
        empty_frames=31,
        reader=Reader(float(rng.choice([0.3, 0.5])), 1, 2, 0.1, missed=0.3, late_s=float(rng.choice([0.0, 0.0, 2.0]))),
        people=joined(people),
        digest="",
        environment=_environment(rng, stratum, duration_s),
    )
    check_scenario(scenario)
    return replace(scenario, digest=hashlib.sha256(repr(scenario).encode()).hexdigest())


def _cast(
    rng: np.random.Generator, stratum: Stratum, duration_s: float, manner: Manner | None, child: bool | None
) -> tuple[Person, ...]:
    if stratum == "companion":
        return draw_companions(rng, duration_s, manner, child)
    aids: dict[str, Aid] = {name: name for name in ("wheelchair", "rollator", "stick", "iv-pole", "bed")}
    aid = aids.get(stratum, "")
    if not aid and stratum in PAIR_STRATA and rng.random() < 0.2:
        aid = draw_walking_aid(rng)
    owner = draw_person(rng, OWNER, _walk(rng, duration_s), aid=aid, child=stratum == "child")
    if stratum in SINGLE_STRATA:
        return (tagged(owner, duration_s),)
    other = draw_person(rng, OTHER, owner.path)
    paths = _paths(rng, stratum, owner.path, duration_s)
    owner, other = replace(owner, path=paths[0]), replace(other, path=paths[1])
    if stratum in ("close", "touching"):  # side by side: both look the same way
        facing = draw_turning(rng, duration_s)
        owner, other = replace(owner, facing=facing), replace(other, facing=facing)
    owner = tagged(owner, duration_s)
    return owner, tagged(other, duration_s) if rng.random() < TAGGED_SHARE else other


def draw_walking_aid(rng: np.random.Generator) -> Aid:
    aids: tuple[Aid, ...] = ("rollator", "stick", "iv-pole", "bag")
    return aids[int(rng.integers(len(aids)))]


def draw_companions(
    rng: np.random.Generator,
    duration_s: float,
    manner: Manner | None = None,
    child: bool | None = None,
    *,
    walk: DrawPath | None = None,
    stand: DrawPath | None = None,
) -> tuple[Person, ...]:
    """Return two people who keep together; `walk` and `stand` draw the way of the one who leads."""
    fitting = [row for row in COMPANIONS if manner in (None, row[0]) and child in (None, row[1] == "child")]
    if not fitting:
        fitting = [(manner or "arm-in-arm", "child" if child else "adult", 1.0)]
    weights = np.array([row[2] for row in fitting])
    chosen, kind, _ = fitting[int(rng.choice(len(fitting), p=weights / weights.sum()))]
    pushed: Aid = "" if chosen != "pushing" else ("bed" if rng.random() < 0.1 else "wheelchair")
    leads = bool(kind == "child" or rng.random() < 0.6)  # a child keeps to the owner, not the other way round
    names = (OWNER, OTHER) if leads else (OTHER, OWNER)
    leader = draw_person(rng, names[0], (walk or _walk)(rng, duration_s), aid=pushed)
    if chosen == "embrace" or rng.random() < 0.35:
        leader = replace(leader, path=(stand or _stand)(rng, duration_s), facing=draw_turning(rng, duration_s))
    follower = draw_person(rng, names[1], (), child=kind == "child")
    follower = replace(follower, accompanies=leader.alias, manner=chosen, facing=(), arms="")
    leader = replace(leader, arms="")
    leader, follower = joined((leader, follower))
    others_tagged = rng.random() < TAGGED_SHARE
    made = [tagged(p, duration_s) if p.alias == OWNER or others_tagged else p for p in (leader, follower)]
    return (made[0], made[1]) if leads else (made[1], made[0])


def draw_person(rng: np.random.Generator, alias: str, path: Path, *, aid: Aid = "", child: bool = False) -> Person:
    height = rng.uniform(0.95, 1.45) if child else np.clip(rng.normal(1.70, 0.095), 1.48, 1.98)
    old = aid in ("rollator", "stick") or rng.random() < 0.12
    free: tuple[Arms, ...] = ("folded", "raised", "forward")
    arms: Arms = free[int(rng.integers(3))] if not aid and rng.random() < 0.15 else ""
    return Person(
        alias=alias,
        height_m=float(height),
        girth=float(np.clip(rng.normal(1.02, 0.12), 0.8, 1.4)),
        cadence=float(rng.uniform(0.8, 1.2)),
        path=path,
        readings_s=(),
        also_every_s=0.0,
        kind="child" if child else "adult",
        aid=aid if aid or child or rng.random() > 0.12 else "bag",
        arms=arms,
        shoulders=float(np.clip(rng.normal(1.0, 0.07), 0.85, 1.2)),
        belly=float(np.clip(rng.normal(0.1, 0.35), 0.0, 1.0)) if rng.random() < 0.6 else 0.0,
        stoop=math.radians(float(rng.uniform(5, 28))) if old and aid != "wheelchair" else 0.0,
        limp=float(rng.uniform(0.3, 1.0)) if old else 0.0,
        coat=bool(rng.random() < 0.25),
    )


def tagged(person: Person, duration_s: float) -> Person:
    return replace(person, readings_s=(0.05, duration_s - 0.05), also_every_s=0.5)


def _walk(rng: np.random.Generator, duration_s: float) -> Path:
    times, points = [0.0], [_spot(rng)]
    while times[-1] < duration_s:
        if rng.random() < 0.3:
            times.append(times[-1] + float(rng.uniform(1.0, 4.0)))
            points.append(points[-1])
            continue
        goal = _spot(rng)
        length = math.dist(points[-1], goal)
        if length < 0.3:
            continue
        times.append(times[-1] + length / float(rng.uniform(0.45, 1.2)))
        points.append(goal)
    return cut_off(times, points, duration_s)


def _stand(rng: np.random.Generator, duration_s: float) -> Path:
    x, z = _spot(rng)
    return ((0.0, x, z), (duration_s, x, z))


def _spot(rng: np.random.Generator) -> tuple[float, float]:
    z = float(rng.uniform(NEAREST_M, FARTHEST_M))
    return float(rng.uniform(-1, 1)) * min(VIEW_SHARE * z, 1.5), z


def cut_off(times: list[float], points: list[tuple[float, float]], duration_s: float) -> Path:
    kept = [(t, *p) for t, p in zip(times, points, strict=True) if t < duration_s]
    x, z = (float(np.interp(duration_s, times, [p[i] for p in points])) for i in (0, 1))
    return (*kept, (duration_s, x, z))


def draw_turning(rng: np.random.Generator, duration_s: float) -> tuple[tuple[float, float], ...]:
    start = float(rng.uniform(-math.pi, math.pi))
    turn_s = float(rng.uniform(0.2, 0.6)) * duration_s
    end = start + float(rng.uniform(-math.pi, math.pi))
    return ((0.0, start), (turn_s, start), (turn_s + 0.3 * duration_s, end))


def _paths(rng: np.random.Generator, stratum: Stratum, owner: Path, duration_s: float) -> tuple[Path, Path]:
    if stratum in ("apart", "moving-robot"):
        return _apart(rng, duration_s)
    if stratum == "bearer-behind":
        behind = tuple((t, 0.6 * x, -z) for t, x, z in owner)
        return behind, owner
    if stratum == "crossing":
        return _crossing(rng, duration_s)
    gap = float(rng.uniform(0.4, 0.6) if stratum == "touching" else rng.uniform(0.65, 1.1))
    deep = float(rng.uniform(-0.15, 0.15) if stratum == "touching" else rng.uniform(-0.5, 0.5))
    gap *= float(rng.choice([-1.0, 1.0]))
    return owner, tuple((t, x + gap, z + deep) for t, x, z in owner)


def _apart(rng: np.random.Generator, duration_s: float) -> tuple[Path, Path]:
    near_z, far_z = float(rng.uniform(1.8, 2.5)), float(rng.uniform(3.6, 4.8))
    side = float(rng.choice([-1.0, 1.0]))
    made = []
    for z, sign in ((near_z, side), (far_z, -side)):
        steps = max(2, round(duration_s / 2.5) + 1)
        times = [float(t) for t in np.linspace(0, duration_s, steps)]
        centre = sign * 0.26 * z
        points = [(centre + float(rng.uniform(-0.18, 0.18)), z + float(rng.uniform(-0.35, 0.35))) for _ in times]
        made.append(cut_off(times, points, duration_s))
    return (made[0], made[1]) if rng.random() < 0.5 else (made[1], made[0])


def _crossing(rng: np.random.Generator, duration_s: float) -> tuple[Path, Path]:
    near_z = float(rng.uniform(1.9, 2.8))
    far_z = near_z + float(rng.uniform(0.6, 1.8))
    made = []
    side = float(rng.choice([-1.0, 1.0]))
    for z, sign in ((near_z, side), (far_z, -side)):
        reach = min(0.45 * z, 1.3)
        begin = float(rng.uniform(0.1, 0.3)) * duration_s
        end = begin + 2 * reach / float(rng.uniform(0.35, 0.7))
        drift = float(rng.uniform(-0.3, 0.3))
        times = [0.0, begin, max(end, begin + 0.5), max(end, duration_s) + 1.0]
        points = [(sign * reach, z), (sign * reach, z), (-sign * reach, z + drift), (-sign * reach, z + drift)]
        made.append(cut_off(times, points, duration_s))
    return (made[0], made[1]) if rng.random() < 0.5 else (made[1], made[0])


def _third(rng: np.random.Generator, people: tuple[Person, ...], duration_s: float) -> Person:
    deepest = max(z for person in people for _, _, z in person.path) if people else FARTHEST_M
    z = max(4.8, min(deepest + 1.0, 6.4))
    times = [float(t) for t in np.linspace(0, duration_s, 5)]
    points = [(float(rng.uniform(-0.35, 0.35)) * z, z + float(rng.uniform(-0.3, 0.6))) for _ in times]
    return draw_person(rng, THIRD, cut_off(times, points, duration_s))


def _environment(rng: np.random.Generator, stratum: Stratum, duration_s: float) -> Environment:
    doors: tuple[Door, ...] = ()
    if rng.random() < 0.25:
        opens = float(rng.uniform(0.1, 0.6)) * duration_s
        side: Literal["left", "right"] = "left" if rng.random() < 0.5 else "right"
        doors = (Door(side, float(rng.uniform(3.2, 5.5)), 0.9, opens, opens + float(rng.uniform(2.0, 6.0))),)
    beds = (Bed(float(rng.choice([-1.95, 1.95])), float(rng.uniform(4.5, 6.0)), 0.0),) if rng.random() < 0.2 else ()
    mirror = float(rng.uniform(0.1, 0.6)) if rng.random() < 0.35 else 0.0
    holes = float(rng.choice(HOLES)) if rng.random() < 0.7 else 0.0
    path = _drive(rng, duration_s) if stratum == "moving-robot" else ()
    return Environment(mirror, holes, doors, beds, path)


def _drive(rng: np.random.Generator, duration_s: float) -> tuple[tuple[float, float, float, float], ...]:
    begin = float(rng.uniform(0.0, 0.3)) * duration_s
    ahead, yaw = float(rng.uniform(0.15, 0.6)), math.radians(float(rng.uniform(-12, 12)))
    return (
        (0.0, 0.0, 0.0, 0.0),
        (begin + 0.01, 0.0, 0.0, 0.0),
        (0.7 * duration_s, float(rng.uniform(-0.1, 0.1)), ahead, yaw),
        (duration_s, float(rng.uniform(-0.1, 0.1)), ahead, 0.5 * yaw),
    )
