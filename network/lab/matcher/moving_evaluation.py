"""How often a robot that drives takes a tag's bearer for somebody else, and whom it keeps, on drawn drives.

Two rules over the same tracks: the robot's own, and that every reading counts, also while it drives.
"""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import product

import numpy as np

from clients.robot.hiding.frame_redactor import BUFFER_DEFAULT_MS
from clients.robot.hiding.hider import in_odometry
from clients.robot.hiding.moving.scan_match import CHECK_EVERY_MS
from clients.robot.hiding.own_motion import OwnMotion
from clients.robot.hiding.segmentation import Silhouette
from clients.robot.hiding.standing_readings import StandingReadings
from clients.robot.matching.matcher import Matcher
from clients.robot.matching.tracking import Tracker
from network.bench.conditions import measure_conditions
from network.lab.matcher.matcher_draws import FRAME_EVERY_MS, TRACK_MS, Bearer, Setting
from network.lab.matcher.matcher_evaluation import (
    BEARERS,
    GROUPS,
    WRONG_MAX_RATE,
    Job,
    MatcherResult,
    Progress,
    Stratum,
    judge_all,
    settings_of,
    wrong_figures,
)
from network.lab.matcher.moving_draws import FRONT_UNTIL_DEG, STORIES, MovingDraw, Story, draw_moving

MOVING_GROUPS = tuple(group for group in GROUPS if group not in ("no-distance", "aside", "bearings-aside"))
MOVING_BEARERS: tuple[Bearer, ...] = (*BEARERS, "aside")
GOAL_GROUPS = ("facing", "sigma-understated", "drifting")
SEEN_EVERY = 2  # every other of the draw's times is a frame: five a second
AHEAD_UNSEEN_MS = 1_000
TAG = "tag"


@dataclass(slots=True)
class Ruled:
    """What a rule came to. `wrong`: at any time the tag was bound to somebody else; `kept`: frames that show the bearer."""

    wrong: bool = False
    kept: dict[bool, int] = field(default_factory=lambda: {False: 0, True: 0})


@dataclass(frozen=True, slots=True)
class MovingOutcome:
    """Of one draw. `in_view`: frames with the bearer in view, by whether the robot drives; `ahead_unseen`: while it stood,
    the bearer was for a second before it, but not in its picture.
    """

    group: str
    story: Story
    bearer: Bearer
    in_view: dict[bool, int]
    ahead_unseen: bool
    standing: Ruled
    every: Ruled


@dataclass(frozen=True, slots=True)
class _Frame:
    at_ms: int
    driving: bool
    shows: Mapping[int, int]  # whom each track shows


class _Follower:
    """Counts what is bound, and what a redactor would keep once a frame has waited its time."""

    def __init__(self, bearer: int) -> None:
        self.matcher, self.ruled = Matcher(drives=True), Ruled()
        self._bearer = bearer
        self._frames: deque[_Frame] = deque()
        self._numbers: set[int] = set()
        self._bound: set[int] = set()

    def advance(self, frame: _Frame) -> None:
        self._frames.append(frame)
        self._numbers |= frame.shows.keys()
        self.matcher.advance(frame.at_ms)
        self._look()
        while self._frames[0].at_ms <= frame.at_ms - BUFFER_DEFAULT_MS:
            self._keep(self._frames.popleft())

    def finish(self) -> Ruled:
        self.matcher.finish()
        self._look()
        for frame in self._frames:
            self._keep(frame)
        return self.ruled

    def _look(self) -> None:
        bound = {number for number in self._numbers if self.matcher.bound_track(TAG, [number]) is not None}
        frames = list(self._frames) if bound != self._bound else [self._frames[-1]]
        self._bound = bound
        others = (frame.shows[number] != self._bearer for frame in frames for number in bound & frame.shows.keys())
        self.ruled.wrong |= any(others)

    def _keep(self, frame: _Frame) -> None:
        number = self.matcher.bound_track(TAG, list(frame.shows))
        if number is not None and frame.shows[number] == self._bearer:
            self.ruled.kept[frame.driving] += 1


def play_moving(drawn: MovingDraw) -> tuple[Ruled, Ruled]:
    """Return what comes of the robot's rule, and of the rule that every reading counts."""
    motion, tracker = OwnMotion(), Tracker()
    waiting = StandingReadings(motion)
    followers = standing, every = _Follower(drawn.bearer), _Follower(drawn.bearer)
    places, readings = deque(drawn.places), deque(drawn.readings)
    for index in range(0, TRACK_MS // FRAME_EVERY_MS + 1, SEEN_EVERY):
        at_ms = index * FRAME_EVERY_MS
        while places and places[0][0] <= at_ms:
            motion.add(places.popleft()[1])
        while readings and readings[0].middle_ms <= at_ms:
            waiting.push(TAG, readings[0])
            every.matcher.add_sighting(TAG, readings.popleft())
        shows: dict[int, int] = {}
        place = motion.place_at(at_ms)
        if place is not None:
            seen = [in_odometry(silhouette, place) for silhouette in silhouettes(drawn, index)]
            tracks = tracker.step(seen, at_ms)
            unfollowed = [one.range_m for one, track in zip(seen, tracks, strict=True) if track is None]
            unfollowed += tracker.hidden_ranges
            for follower in followers:
                for one, track in zip(seen, tracks, strict=True):
                    if track is not None:
                        follower.matcher.add_track(track)
                        shows[track.number] = one.label
                if unfollowed:
                    follower.matcher.note_unfollowed(at_ms, unfollowed)
        if at_ms % CHECK_EVERY_MS == 0:
            motion.confirm(at_ms)
        waiting.weigh(standing.matcher, at_ms)
        for follower in followers:
            follower.advance(_Frame(at_ms, bool(drawn.driving[index]), shows))
    return standing.finish(), every.finish()


def silhouettes(drawn: MovingDraw, index: int) -> list[Silhouette]:
    """Return who is seen before the camera; two who touch are one silhouette, also if one is hidden by the other."""
    found = []
    for person in np.flatnonzero(drawn.in_view[:, index]).tolist():
        with_them = [person, *np.flatnonzero(drawn.touching[person, :, index]).tolist()]
        if any(one < person and drawn.in_view[one, index] for one in with_them):
            continue
        where = [(float(drawn.measured[one, index]), math.radians(drawn.bearings[one, index])) for one in with_them]
        right = sum(range_m * math.sin(angle) for range_m, angle in where) / len(where)
        ahead = sum(range_m * math.cos(angle) for range_m, angle in where) / len(where)
        reason = "merged" if len(with_them) > 1 else ""
        place = (right, ahead, math.hypot(right, ahead), round(1000 * ahead), reason)
        found.append(Silhouette(person, (0, 0, 1, 1), *place, ahead_m=ahead, right_m=right))
    return found


def judge_moving(group: str, drawn: MovingDraw) -> MovingOutcome:
    seen = drawn.in_view[drawn.bearer, ::SEEN_EVERY]
    driving = drawn.driving[::SEEN_EVERY]
    in_view = {moves: int(np.count_nonzero(seen & (driving == moves))) for moves in (False, True)}
    unseen = ~seen & ~driving & (np.abs(drawn.bearings[drawn.bearer, ::SEEN_EVERY]) <= FRONT_UNTIL_DEG)
    ahead_unseen = bool(np.count_nonzero(unseen) * SEEN_EVERY * FRAME_EVERY_MS >= AHEAD_UNSEEN_MS)
    return MovingOutcome(group, drawn.story, drawn.setting.bearer, in_view, ahead_unseen, *play_moving(drawn))


def case_of(group: str, number: int) -> tuple[Setting, Story]:
    """Both change from one draw to the next; the numbers have no common divisor, so every pair comes up."""
    settings = _settings_of(group)
    return settings[number % len(settings)], STORIES[number % len(STORIES)]


@cache
def _settings_of(group: str) -> list[Setting]:
    return settings_of(group, MOVING_BEARERS)


def _judge_chunk(job: Job) -> list[MovingOutcome]:
    group, first, end, seed = job
    base = list(GROUPS).index(group) << 32
    return [judge_moving(group, draw_moving(*case_of(group, i), seed, base + i)) for i in range(first, end)]


def judge_moving_matcher(
    tracks: int,
    seed: int,
    *,
    workers: int | None = None,
    on: str = "",
    groups: Iterable[str] = MOVING_GROUPS,
    progress: Progress | None = None,
) -> MatcherResult:
    """Judge `tracks` drives in each group with facing (fewer in others); independent of `workers`."""
    workers = workers or len(os.sched_getaffinity(0))
    conditions = measure_conditions(nodes=0, seed=seed, tracks=tracks, workers=on or workers)
    counts = {group: max(1, round(tracks * GROUPS[group][1])) for group in groups}
    outcomes = judge_all(_judge_chunk, counts, seed, workers=workers, on=on, progress=progress)
    figures, rows = moving_headline(outcomes), moving_strata(outcomes)
    ok = figures.get("wrong_owner_rate", 0.0) <= WRONG_MAX_RATE
    return MatcherResult(name="matcher-moving", ok=ok, figures=figures, conditions=conditions, strata=rows)


def moving_headline(outcomes: Sequence[MovingOutcome]) -> dict[str, float]:
    """`wrong_owner`: the goal, as of a robot that stands without who is in front but beside the picture at the start."""
    goal = [o for o in outcomes if o.group in GOAL_GROUPS and o.bearer != "aside"]
    figures: dict[str, float] = {"tracks": len(outcomes), **_both(goal, "_owner")}
    figures |= _wrong("wrong_owner_ahead_unseen", [o.standing for o in goal if o.ahead_unseen])
    figures |= _wrong("wrong_owner_never_ahead_unseen", [o.standing for o in goal if not o.ahead_unseen])
    figures |= _wrong("wrong_aside", [o.standing for o in outcomes if o.bearer == "aside"])
    for group in MOVING_GROUPS:
        mine = [o for o in outcomes if o.group == group and o.bearer != "aside"]
        name = group.replace("-", "_")
        figures |= _wrong(f"wrong_{name}", [o.standing for o in mine])
        figures |= _wrong(f"every_wrong_{name}", [o.every for o in mine])
    return figures


def moving_strata(outcomes: Sequence[MovingOutcome]) -> list[Stratum]:
    rows = []
    for story, group in product(STORIES, MOVING_GROUPS):
        mine = [o for o in outcomes if (o.story, o.group) == (story, group)]
        if not mine:
            continue
        row: Stratum = {"story": story, "group": group, "tracks": len(mine)}
        for bearer in MOVING_BEARERS:
            row[f"bearer_{bearer}"] = _both([o for o in mine if o.bearer == bearer])
        rows.append(row)
    return rows


def _both(outcomes: Sequence[MovingOutcome], name: str = "") -> dict[str, float]:
    figures = _wrong(f"wrong{name}", [o.standing for o in outcomes]) | _kept(
        "", outcomes, [o.standing for o in outcomes]
    )
    figures |= _wrong(f"every_wrong{name}", [o.every for o in outcomes])
    return figures | _kept("every_", outcomes, [o.every for o in outcomes])


def _wrong(name: str, ruled: Sequence[Ruled]) -> dict[str, float]:
    return wrong_figures(name, [one.wrong for one in ruled])


def _kept(name: str, outcomes: Sequence[MovingOutcome], ruled: Sequence[Ruled]) -> dict[str, float]:
    figures: dict[str, float] = {}
    for driving, when in ((False, "standing"), (True, "driving")):
        of = sum(o.in_view[driving] for o in outcomes)
        if of:
            kept = sum(one.kept[driving] for one in ruled)
            figures |= {f"{name}kept_{when}_rate": round(kept / of, 5), f"{name}kept_{when}_of": of}
    return figures
