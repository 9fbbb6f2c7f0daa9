"""A scenario: who walks where in front of a synthetic robot, and when their tags are read.

Read from TOML and checked here, once. A scenario names people by alias; it must never hold a tag's UID.
"""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import dataclass
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from consensus.errors import BlockRobotError

SCENARIO_FILE_MAX_BYTES = 256 * 1024
DURATION_MAX_S = 3600.0
PEOPLE_MAX_COUNT = 16
SAME_READING_S = 0.1


@dataclass(frozen=True, slots=True)
class Reader:
    """The synthetic tag reader: its distance error, its two antennas, and how often the wrong one hears a tag."""

    distance_sigma_m: float
    antenna_front: int
    antenna_back: int
    front_misread: float


@dataclass(frozen=True, slots=True)
class Person:
    """One person: build, gait and path (waypoints t, x, z), and the tag's readings if the person wears one."""

    alias: str
    height_m: float
    girth: float
    cadence: float
    path: tuple[tuple[float, float, float], ...]
    readings_s: tuple[float, ...]
    also_every_s: float

    @property
    def tagged(self) -> bool:
        """Whether this person wears a tag that is read in this scenario."""
        return bool(self.readings_s)

    def place(self, at_s: float) -> tuple[float, float] | None:
        """Return (x, z) in metres at a time, or None while the person is not there."""
        times = [point[0] for point in self.path]
        if not times[0] <= at_s <= times[-1]:
            return None
        return (
            float(np.interp(at_s, times, [point[1] for point in self.path])),
            float(np.interp(at_s, times, [point[2] for point in self.path])),
        )

    def walked_m(self, at_s: float) -> float:
        """Return the length of the path walked until a time, which drives the gait."""
        times = np.array([point[0] for point in self.path])
        steps = np.diff(np.array([point[1:] for point in self.path]), axis=0)
        lengths = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
        return float(np.interp(at_s, times, lengths))

    def reading_times_s(self) -> list[float]:
        """Return all times of reading: the listed ones and, between first and last, every `also_every_s`."""
        if not self.readings_s:
            return []
        times = list(self.readings_s)
        if self.also_every_s > 0:
            count = int((self.readings_s[-1] - self.readings_s[0]) / self.also_every_s)
            regular = [self.readings_s[0] + self.also_every_s * step for step in range(1, count + 1)]
            times += [t for t in regular if all(abs(t - listed) > SAME_READING_S for listed in self.readings_s)]
        return sorted(times)


@dataclass(frozen=True, slots=True)
class Scenario:
    """A whole scene. `digest` is the SHA-256 of its file, which names the recording made from it."""

    name: str
    duration_s: float
    frame_rate: int
    width: int
    height: int
    focal_px: float
    camera_height_m: float
    seed: int
    empty_frames: int
    reader: Reader
    people: tuple[Person, ...]
    digest: str

    @property
    def frame_count(self) -> int:
        """How many frames the camera publishes."""
        return round(self.duration_s * self.frame_rate)

    @property
    def tagged_aliases(self) -> tuple[str, ...]:
        """Aliases of the people whose tags are read, for whom UIDs must be given."""
        return tuple(person.alias for person in self.people if person.tagged)


def parse_scenario(text: str) -> Scenario:
    """Return the scenario of a TOML text; raises CONFIGURATION_INVALID with the first thing that is wrong."""
    try:
        table = tomllib.loads(text)
        scenario = _scenario(table, hashlib.sha256(text.encode()).hexdigest())
    except tomllib.TOMLDecodeError as error:
        raise BlockRobotError("CONFIGURATION_INVALID", f"The scenario is not valid TOML: {error}.") from error
    except KeyError as error:
        raise BlockRobotError("CONFIGURATION_INVALID", f"The scenario lacks {error.args[0]!r}.") from error
    except (TypeError, ValueError) as error:
        raise BlockRobotError(
            "CONFIGURATION_INVALID", f"The scenario has a value of the wrong kind: {error}."
        ) from error
    _check(scenario)
    return scenario


def load_scenario(path: Path) -> Scenario:
    """Return the scenario of a file; raises CONFIGURATION_INVALID."""
    try:
        if path.stat().st_size > SCENARIO_FILE_MAX_BYTES:
            raise BlockRobotError("CONFIGURATION_INVALID", "The scenario file is too large.")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BlockRobotError("CONFIGURATION_INVALID", f"The scenario {path.name} cannot be read.") from error
    return parse_scenario(text)


def published_run_1() -> Scenario:
    """Return the scenario that ships with the robot: the prototype's first published run."""
    file = resources.files("clients.robot") / "scenarios" / "published-run-1.toml"
    return parse_scenario(file.read_text(encoding="utf-8"))


def _scenario(table: dict[str, Any], digest: str) -> Scenario:
    reader = table["reader"]
    return Scenario(
        name=str(table["name"]),
        duration_s=float(table["duration_s"]),
        frame_rate=int(table["frame_rate"]),
        width=int(table["width"]),
        height=int(table["height"]),
        focal_px=float(table["focal_px"]),
        camera_height_m=float(table["camera_height_m"]),
        seed=int(table["seed"]),
        empty_frames=int(table["empty_frames"]),
        reader=Reader(
            distance_sigma_m=float(reader["distance_sigma_m"]),
            antenna_front=int(reader["antenna_front"]),
            antenna_back=int(reader["antenna_back"]),
            front_misread=float(reader["front_misread"]),
        ),
        people=tuple(_person(row) for row in table.get("people", [])),
        digest=digest,
    )


def _person(row: dict[str, Any]) -> Person:
    return Person(
        alias=str(row["alias"]),
        height_m=float(row["height_m"]),
        girth=float(row["girth"]),
        cadence=float(row["cadence"]),
        path=tuple((float(t), float(x), float(z)) for t, x, z in row["path"]),
        readings_s=tuple(sorted(float(t) for t in row.get("readings_s", []))),
        also_every_s=float(row.get("also_every_s", 0.0)),
    )


def _check(scenario: Scenario) -> None:
    """Refuse what could not be rendered; each refusal names the field."""
    problems = (
        (not 0 < scenario.duration_s <= DURATION_MAX_S, "duration_s must be above 0 and at most an hour"),
        (not 1 <= scenario.frame_rate <= 120, "frame_rate must be between 1 and 120"),
        (not (64 <= scenario.width <= 2048 and 48 <= scenario.height <= 2048), "width or height is out of range"),
        (scenario.focal_px <= 0, "focal_px must be above 0"),
        (not 0.2 <= scenario.camera_height_m <= 2.4, "camera_height_m must be between 0.2 and 2.4"),
        (not 1 <= scenario.empty_frames <= 300, "empty_frames must be between 1 and 300"),
        (scenario.reader.distance_sigma_m <= 0, "reader.distance_sigma_m must be above 0"),
        (len(scenario.people) > PEOPLE_MAX_COUNT, "there are too many people"),
        (len({person.alias for person in scenario.people}) < len(scenario.people), "two people share an alias"),
    )
    for wrong, sentence in problems:
        if wrong:
            raise BlockRobotError("CONFIGURATION_INVALID", f"Scenario: {sentence}.")
    for person in scenario.people:
        times = [point[0] for point in person.path]
        if len(times) < 2 or any(after <= before for before, after in pairwise(times)):
            raise BlockRobotError(
                "CONFIGURATION_INVALID",
                f"Scenario: the path of {person.alias} needs two or more points in rising time.",
            )
        if any(person.place(at) is None for at in person.reading_times_s()):
            raise BlockRobotError("CONFIGURATION_INVALID", f"Scenario: {person.alias} is read while not there.")
