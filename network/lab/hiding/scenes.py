"""The judge's scenes by seed and stratum; training and judging draws are disjoint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from clients.robot.synthetic.scenario import Scenario, without
from clients.robot.synthetic.scenes import PAIR_STRATA, draw_scene

LEARNING, JUDGING = 1, 2
DURATION_S = 12.0


@dataclass(frozen=True, slots=True)
class Scene:
    """One drawn scene: seed, number, stratum, scenario."""

    seed: int
    number: int
    stratum: str
    scenario: Scenario

    @property
    def owners(self) -> dict[str, int]:
        return {person.alias: n for n, person in enumerate(self.scenario.people, start=1) if person.tagged}

    def alone(self, alias: str) -> Scenario:
        return without(self.scenario, *(person.alias for person in self.scenario.people if person.alias != alias))


def draw_scenes(seed: int, count: int, purpose: int, *, duration_s: float = DURATION_S) -> list[Scene]:
    """Return `count` scenes of two or three people, cycling through the strata.

    No scene of one purpose is drawn for another.
    """
    scenes = []
    for number in range(count):
        stratum = PAIR_STRATA[number % len(PAIR_STRATA)]
        entropy = int(np.random.SeedSequence([seed, purpose, number]).generate_state(1)[0])
        scenes.append(Scene(seed, number, stratum, draw_scene(entropy, stratum, duration_s=duration_s)))
    return scenes
