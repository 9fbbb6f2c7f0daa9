"""Who walked beside an owner, told from which of the owner's pictures are missing on a drive."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from msgspec import Struct

from clients.robot.sensing.sensor_events import Mask
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.scenario import Person
from network.lab.hiding.features import Floats
from network.lab.hiding.gait import Clip, describe, draw_population, height_m, learn_people
from network.lab.hiding.moving.run_drive import Rendition, show_everybody
from network.lab.hiding.run_scene import spread_cutout
from network.lab.hiding.scoring import mean_of, paired_bound

FRAMES_COUNT = 40  # of each drive: the shortest has so many
KEPT_MIN_COUNT = 4
CHANGED_MIN_COUNT = 3  # frames that are missing, or not, only because of the neighbour
TAKES_COUNT = 2  # of the same drive with the same neighbour, each with noise of its own
RHYTHMS_COUNT = 12
PATTERN, PICTURES, KNOWING = "pattern", "pattern-and-pictures", "knows-the-drive"
BLIND = (PATTERN, PICTURES)  # those who know other drives with these people only


@dataclass(frozen=True, slots=True, eq=False)
class Clue:
    """What is known of a drive with one person as the neighbour: which frames are missing, and the owner's pictures."""

    person: int
    take: int
    missing: Mask
    pictures: Floats

    @property
    def pattern(self) -> Floats:
        told = self.missing.astype(np.float32)
        rhythm = np.abs(np.fft.rfft(told - told.mean()))[1 : 1 + RHYTHMS_COUNT]
        begun = np.count_nonzero(self.missing[1:] & ~self.missing[:-1])
        return np.concatenate([told, rhythm, [told.mean(), begun]]).astype(np.float32)


class NeighbourRow(Struct, frozen=True, kw_only=True):
    """Share of right guesses. The bound is over drives."""

    rate: float
    rate_upper95: float


class NeighbourFigures(Struct, kw_only=True):
    """`rate_upper95`: of the better of those who know these people from other drives only. `knows-the-drive` knows every
    path too, and has seen once what is missing with each of them on it.
    """

    people: int
    chance: float
    drives: int
    drives_without_pattern: int
    clips: int
    missing: float | None
    rate_upper95: float | None
    attackers: dict[str, NeighbourRow]


def watch_neighbours(drive: Drive, seed: int, people: int) -> list[Clue]:
    """The owner is who is shown most; each of `people` takes the place of who comes nearest to them.

    Empty if hardly a frame is missing because of somebody there.
    """
    played = show_everybody(drive)
    counts = Counter(one.number - 1 for one in played if one.released and one.sequence < FRAMES_COUNT)
    owner, kept = counts.most_common(1)[0] if counts else (0, 0)
    neighbour = _nearest_to(drive, owner)
    if kept < KEPT_MIN_COUNT or neighbour is None:
        return []
    beside, alone = _clue(drive, played, owner, 0, 0), _see(_without(drive, neighbour), owner, 0, 0)
    if np.count_nonzero(beside.missing != alone.missing) < CHANGED_MIN_COUNT:
        return []
    rng = np.random.default_rng([drive.scenario.seed, 0x4E1])
    return [
        _see(_with(drive, neighbour, build, int(rng.integers(2**31))), owner, number, take)
        for number, build in enumerate(draw_population(seed, people))
        for take in range(TAKES_COUNT)
    ]


def _nearest_to(drive: Drive, owner: int) -> int | None:
    times = (np.arange(FRAMES_COUNT) / drive.scenario.frame_rate).tolist()
    ways = [[person.place(at_s) for at_s in times] for person in drive.scenario.people]

    def nearest_m(place: int) -> float:
        pairs = zip(ways[owner], ways[place], strict=True)
        return min((math.dist(one, other) for one, other in pairs if one and other), default=math.inf)

    return min((place for place in range(len(ways)) if place != owner), key=nearest_m, default=None)


def _without(drive: Drive, place: int) -> Drive:
    return drive.without(drive.scenario.people[place].alias)


def _with(drive: Drive, place: int, build: Person, seed: int) -> Drive:
    people = list(drive.scenario.people)
    people[place] = replace(
        people[place], kind="adult", height_m=build.height_m, girth=build.girth, cadence=build.cadence
    )
    return replace(drive, scenario=replace(drive.scenario, people=tuple(people), seed=seed))


def _see(drive: Drive, owner: int, person: int, take: int) -> Clue:
    return _clue(drive, show_everybody(drive), owner, person, take)


def _clue(drive: Drive, played: Sequence[Rendition], owner: int, person: int, take: int) -> Clue:
    scenario = drive.scenario
    nothing = np.zeros((scenario.height // 2, scenario.width // 2), dtype=bool)
    masks, metres = [nothing] * FRAMES_COUNT, [0.0] * FRAMES_COUNT
    for one in played:
        if one.released and one.number == owner + 1 and one.sequence < FRAMES_COUNT:
            picture = spread_cutout(one.cutout, (scenario.height, scenario.width))[::2, ::2]
            masks[one.sequence] = picture > 0
            metres[one.sequence] = height_m(picture > 0, picture, scenario.focal_px / 2)
    missing = np.array([not mask.any() for mask in masks])
    return Clue(person, take, missing, describe(Clip(person, masks, metres)))


def summarise_neighbours(drives: Sequence[Sequence[Clue]], people: int, seed: int) -> NeighbourFigures:
    """Each drive is guessed by who learned from all others. Raises EXTRA_MISSING."""
    seen = [clues for clues in drives if clues]
    shares: dict[str, list[float]] = {name: [] for name in (*BLIND, KNOWING)}
    for held, clues in enumerate(seen):
        known = [clue for place, others in enumerate(seen) if place != held for clue in others]
        shares[KNOWING].append(_share_known(clues))
        if known:
            for name in BLIND:
                guesses = learn_people(_table(known, name), [clue.person for clue in known])(_table(clues, name))
                shares[name].append(float(np.mean(guesses == [clue.person for clue in clues])))
    bounds = {name: paired_bound(found, seed=seed) for name, found in shares.items() if found}
    rows = {
        name: NeighbourRow(rate=round(bound.mean, 4), rate_upper95=round(bound.upper, 4))
        for name, bound in bounds.items()
    }
    return NeighbourFigures(
        people=people,
        chance=round(1 / people, 4),
        drives=len(seen),
        drives_without_pattern=len(drives) - len(seen),
        clips=sum(len(clues) for clues in seen),
        missing=mean_of([float(clue.missing.mean()) for clues in seen for clue in clues]),
        rate_upper95=max((rows[name].rate_upper95 for name in BLIND if name in rows), default=None),
        attackers=rows,
    )


def _table(clues: Sequence[Clue], name: str) -> Floats:
    rows = [clue.pattern if name == PATTERN else np.concatenate([clue.pattern, clue.pictures]) for clue in clues]
    return np.stack(rows)


def _share_known(clues: Sequence[Clue]) -> float:
    """Guess whose missing frames in another take are most alike; among several, any of them."""
    rights = []
    for clue in clues:
        off: dict[int, int] = {
            other.person: int(np.count_nonzero(other.missing != clue.missing))
            for other in clues
            if other.take == (clue.take + 1) % TAKES_COUNT
        }
        best = [person for person, count in off.items() if count == min(off.values())]
        rights.append((clue.person in best) / len(best))
    return float(np.mean(rights))
