"""Scenarios (TOML): people, paths, aids and tag readings. They hold aliases, no tag UIDs."""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np

from clients.sdk.new_files import read_given_text
from consensus.bounded_text import TextInvalidError, read_toml_text
from consensus.errors import BlockRobotError

SHIPPED_FOLDER = Path(str(resources.files("clients.robot"))) / "scenarios"
SCENARIO_FILE_MAX_BYTES = 256 * 1024
DURATION_MAX_S = 3600.0
PEOPLE_MAX_COUNT = 16
THINGS_MAX_COUNT = 8
SAME_READING_S = 0.1
WALKING_MPS = 0.15
HEADING_STEP_S = 0.35
COMPANION_STEP_S = 0.1
CHEST_HEIGHT_SHARE = 0.74
SEATED_CHEST_M, SEATED_CHEST_SHARE = 0.46, 0.26
LYING_CHEST_M = 0.82

Kind = Literal["adult", "child"]
Aid = Literal["", "wheelchair", "rollator", "stick", "iv-pole", "bed", "bag"]
Arms = Literal["", "hooked-left", "hooked-right", "around", "forward", "folded", "raised"]
Manner = Literal["arm-in-arm", "embrace", "pushing", "close-behind"]
Side = Literal["left", "right"]

# Where a companion is, seen by the one who is accompanied: to the right, ahead (metres), turned by (radians).
MANNERS: dict[str, tuple[float, float, float]] = {
    "arm-in-arm": (0.46, 0.0, 0.0),
    "embrace": (0.06, 0.30, math.pi),
    "pushing": (0.0, -0.72, 0.0),
    "close-behind": (0.10, -0.45, 0.0),
}
MANNER_ARMS: dict[str, tuple[Arms, Arms]] = {  # of the companion, of the one who is accompanied
    "arm-in-arm": ("hooked-left", "hooked-right"),
    "embrace": ("around", "around"),
    "pushing": ("forward", ""),
    "close-behind": ("", ""),
}


@dataclass(frozen=True, slots=True)
class Antenna:
    """One that looks `looks_deg` to the right of the camera's axis."""

    number: int
    looks_deg: float


@dataclass(frozen=True, slots=True)
class Reader:
    """Synthetic tag reader: distance error, antennas, error rates. With `antennas`, readings follow their beams."""

    distance_sigma_m: float
    antenna_front: int
    antenna_back: int
    front_misread: float
    missed: float = 0.0
    late_s: float = 0.0
    antennas: tuple[Antenna, ...] = ()


@dataclass(frozen=True, slots=True)
class Person:
    """One person with waypoints (t, x, z) and tag readings. `facing` is (t, radians), 0 = to the robot; companions
    follow `accompanies`.
    """

    alias: str
    height_m: float
    girth: float
    cadence: float
    path: tuple[tuple[float, float, float], ...]
    readings_s: tuple[float, ...]
    also_every_s: float
    kind: Kind = "adult"
    aid: Aid = ""
    arms: Arms = ""
    facing: tuple[tuple[float, float], ...] = ()
    accompanies: str = ""
    manner: Manner | Literal[""] = ""
    shoulders: float = 1.0
    belly: float = 0.0
    stoop: float = 0.0
    limp: float = 0.0
    coat: bool = False

    @property
    def tagged(self) -> bool:
        return bool(self.readings_s)

    @property
    def chest_height_m(self) -> float:
        if self.aid == "wheelchair":
            return SEATED_CHEST_M + SEATED_CHEST_SHARE * self.height_m
        return LYING_CHEST_M if self.aid == "bed" else CHEST_HEIGHT_SHARE * self.height_m

    def place(self, at_s: float) -> tuple[float, float] | None:
        """(x, z) in metres; None while absent."""
        times = [point[0] for point in self.path]
        if not times[0] <= at_s <= times[-1]:
            return None
        return (
            float(np.interp(at_s, times, [point[1] for point in self.path])),
            float(np.interp(at_s, times, [point[2] for point in self.path])),
        )

    def heading(self, at_s: float) -> tuple[float, float]:
        """Return (heading in radians, 0 = to the robot; speed in m/s)."""
        before = self.place(max(at_s - HEADING_STEP_S, self.path[0][0]))
        after = self.place(min(at_s + HEADING_STEP_S, self.path[-1][0]))
        if before is None or after is None:
            return 0.0, 0.0
        dx, dz = after[0] - before[0], after[1] - before[1]
        speed = math.hypot(dx, dz) / (2 * HEADING_STEP_S)
        if self.facing:
            times = [point[0] for point in self.facing]
            return float(np.interp(at_s, times, [point[1] for point in self.facing])), speed
        if speed < WALKING_MPS:
            return 0.0, speed
        return math.atan2(dx, -dz), speed

    def walked_m(self, at_s: float) -> float:
        times = np.array([point[0] for point in self.path])
        steps = np.diff(np.array([point[1:] for point in self.path]), axis=0)
        lengths = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
        return float(np.interp(at_s, times, lengths))

    def reading_times_s(self) -> list[float]:
        if not self.readings_s:
            return []
        times = list(self.readings_s)
        if self.also_every_s > 0:
            count = int((self.readings_s[-1] - self.readings_s[0]) / self.also_every_s)
            regular = [self.readings_s[0] + self.also_every_s * step for step in range(1, count + 1)]
            times += [t for t in regular if all(abs(t - listed) > SAME_READING_S for listed in self.readings_s)]
        return sorted(times)


@dataclass(frozen=True, slots=True)
class Door:
    """A side-wall door from `z_m` to `z_m + width_m`, opening inwards."""

    side: Side
    z_m: float
    width_m: float
    opens_s: float
    closes_s: float


@dataclass(frozen=True, slots=True)
class Bed:
    """An empty bed along a wall, from a time (0: always)."""

    x_m: float
    z_m: float
    from_s: float


@dataclass(frozen=True, slots=True)
class Environment:
    """Difficulties of the corridor. `camera_path`: (t, x, z, yaw in radians, right); empty: standing."""

    mirror_floor: float = 0.0
    holes: float = 0.0
    doors: tuple[Door, ...] = ()
    beds: tuple[Bed, ...] = ()
    camera_path: tuple[tuple[float, float, float, float], ...] = ()


@dataclass(frozen=True, slots=True)
class Scenario:
    """A scene; `digest` is its file's SHA-256; `absent` people are omitted, all else unchanged."""

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
    environment: Environment = Environment()
    absent: frozenset[str] = frozenset()

    @property
    def frame_count(self) -> int:
        return round(self.duration_s * self.frame_rate)

    @property
    def tagged_aliases(self) -> tuple[str, ...]:
        return tuple(person.alias for person in self.people if person.tagged and person.alias not in self.absent)

    def camera_at(self, at_s: float) -> tuple[float, float, float]:
        """Return the robot's (x, z, yaw); zeros while standing still."""
        path = self.environment.camera_path
        if not path:
            return 0.0, 0.0, 0.0
        times = [point[0] for point in path]
        x, z, yaw = (float(np.interp(at_s, times, [point[i] for point in path])) for i in (1, 2, 3))
        return x, z, yaw

    def seen_from_robot(self, person: Person, at_s: float) -> tuple[float, float, float] | None:
        """Return the tag's (right, up, ahead) metres from the camera; None while absent."""
        place = person.place(at_s)
        if place is None:
            return None
        x, z, yaw = self.camera_at(at_s)
        dx, dz = place[0] - x, place[1] - z
        cos, sin = math.cos(yaw), math.sin(yaw)
        return dx * cos - dz * sin, person.chest_height_m - self.camera_height_m, dx * sin + dz * cos


def without(scenario: Scenario, *aliases: str) -> Scenario:
    """All else stays unchanged."""
    known = {person.alias for person in scenario.people}
    if not set(aliases) <= known:
        raise BlockRobotError("CONFIGURATION_INVALID", "Nobody in the scenario has that alias.")
    absent = scenario.absent | set(aliases)
    digest = hashlib.sha256(f"{scenario.digest} without {sorted(absent)}".encode()).hexdigest()
    return replace(scenario, absent=absent, digest=digest)


def joined(people: tuple[Person, ...]) -> tuple[Person, ...]:
    by_alias = {person.alias: person for person in people}
    for person in people:
        if not person.accompanies:
            continue
        leader = by_alias.get(person.accompanies)
        if leader is None or leader.alias == person.alias or leader.accompanies or not person.manner:
            raise BlockRobotError(
                "CONFIGURATION_INVALID",
                f"Scenario: {person.alias} must be with another person, who leads, and in a manner.",
            )
        if person.manner == "pushing" and leader.aid not in ("wheelchair", "bed"):
            raise BlockRobotError("CONFIGURATION_INVALID", f"Scenario: {leader.alias} has nothing to be pushed in.")
        own, theirs = MANNER_ARMS[person.manner]
        by_alias[leader.alias] = replace(leader, arms=leader.arms or theirs)
        by_alias[person.alias] = _beside(replace(person, arms=person.arms or own), leader)
    return tuple(by_alias[person.alias] for person in people)


def _beside(person: Person, leader: Person) -> Person:
    right, ahead, turned = MANNERS[person.manner]
    if leader.aid == "bed":
        ahead -= 0.55
    grown = min(leader.girth * leader.shoulders, 1.3) if person.manner == "arm-in-arm" else 1.0
    first, last = leader.path[0][0], leader.path[-1][0]
    count = max(2, round((last - first) / COMPANION_STEP_S) + 1)
    path, facing, before = [], [], 0.0
    for at_s in np.linspace(first, last, count):
        place = leader.place(float(at_s)) or (0.0, 0.0)
        heading, _ = leader.heading(float(at_s))
        heading = before + math.remainder(heading - before, 2 * math.pi)  # no whole turn between two samples
        before = heading
        cos, sin = math.cos(heading), math.sin(heading)
        x, z = place[0] + right * grown * cos + ahead * sin, place[1] + right * grown * sin - ahead * cos
        path.append((float(at_s), x, z))
        facing.append((float(at_s), heading + turned))
    return replace(person, path=tuple(path), facing=person.facing or tuple(facing))


def parse_scenario(text: str) -> Scenario:
    """From TOML. Raises CONFIGURATION_INVALID at the first error."""
    with named_faults():
        scenario = _scenario(read_toml_text(text), hashlib.sha256(text.encode()).hexdigest())
    check_scenario(scenario)
    return scenario


@contextlib.contextmanager
def named_faults() -> Iterator[None]:
    """Raise CONFIGURATION_INVALID for what is no TOML, missing, or of the wrong kind."""
    try:
        yield
    except TextInvalidError as error:
        raise BlockRobotError("CONFIGURATION_INVALID", f"The scenario is not valid TOML: {error}.") from error
    except KeyError as error:
        raise BlockRobotError("CONFIGURATION_INVALID", f"The scenario lacks {error.args[0]!r}.") from error
    except (TypeError, ValueError, AttributeError) as error:
        raise BlockRobotError(
            "CONFIGURATION_INVALID", f"The scenario has a value of the wrong kind: {error}."
        ) from error


def load_scenario(path: Path) -> Scenario:
    """Raises CONFIGURATION_INVALID, also for a file whose robot drives."""
    try:
        text = read_given_text(path, SCENARIO_FILE_MAX_BYTES)
    except BlockRobotError as error:
        raise BlockRobotError("CONFIGURATION_INVALID", error.detail) from None
    except OSError as error:
        raise BlockRobotError("CONFIGURATION_INVALID", f"The scenario {path.name} cannot be read.") from error
    scenario = parse_scenario(text)
    if "room" in read_toml_text(text):
        raise BlockRobotError(
            "CONFIGURATION_INVALID",
            f"The scenario {path.name} has a [room], and its robot drives: the demonstration and experiment 5 play such.",
        )
    return scenario


def published_run_1() -> Scenario:
    """The bundled scenario: the prototype's first published run."""
    return parse_scenario((SHIPPED_FOLDER / "published-run-1.toml").read_text(encoding="utf-8"))


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
            missed=float(reader.get("missed", 0.0)),
            late_s=float(reader.get("late_s", 0.0)),
        ),
        people=_people(table.get("people", [])),
        digest=digest,
        environment=_environment(table.get("environment", {})),
    )


def _people(rows: list[dict[str, Any]]) -> tuple[Person, ...]:
    people = tuple(_person(row) for row in rows)
    for person in people:
        if not person.accompanies:
            check_times(person.alias, [point[0] for point in person.path], "path")
    return joined(people)


def _person(row: dict[str, Any]) -> Person:
    alias = str(row["alias"])
    accompanies = str(row.get("with", ""))
    path = row.get("path", []) if accompanies else row["path"]
    if bool(accompanies) == bool(path):
        raise BlockRobotError(
            "CONFIGURATION_INVALID", f"Scenario: {alias} needs a path, or somebody to be with, and not both."
        )
    return Person(
        alias=alias,
        height_m=float(row["height_m"]),
        girth=float(row["girth"]),
        cadence=float(row["cadence"]),
        path=tuple((float(t), float(x), float(z)) for t, x, z in path),
        readings_s=tuple(sorted(float(t) for t in row.get("readings_s", []))),
        also_every_s=float(row.get("also_every_s", 0.0)),
        kind=cast(Kind, _one_of(row, "kind", "adult", get_args(Kind))),
        aid=cast(Aid, _one_of(row, "aid", "", get_args(Aid))),
        arms=cast(Arms, _one_of(row, "arms", "", get_args(Arms))),
        facing=tuple((float(t), math.radians(float(degrees))) for t, degrees in row.get("facing_deg", [])),
        accompanies=accompanies,
        manner=cast(Manner, _one_of(row, "manner", "", ("", *get_args(Manner)))),
        shoulders=float(row.get("shoulders", 1.0)),
        belly=float(row.get("belly", 0.0)),
        stoop=math.radians(float(row.get("stoop_deg", 0.0))),
        limp=float(row.get("limp", 0.0)),
        coat=_flag(row, "coat"),
    )


def _environment(table: dict[str, Any]) -> Environment:
    return Environment(
        mirror_floor=float(table.get("mirror_floor", 0.0)),
        holes=float(table.get("holes", 0.0)),
        doors=tuple(
            Door(
                side=cast(Side, _one_of(row, "side", "right", get_args(Side))),
                z_m=float(row["z_m"]),
                width_m=float(row.get("width_m", 0.9)),
                opens_s=float(row["opens_s"]),
                closes_s=float(row.get("closes_s", DURATION_MAX_S)),
            )
            for row in table.get("doors", [])
        ),
        beds=tuple(
            Bed(float(row["x_m"]), float(row["z_m"]), float(row.get("from_s", 0.0))) for row in table.get("beds", [])
        ),
        camera_path=tuple(
            (float(t), float(x), float(z), math.radians(float(degrees)))
            for t, x, z, degrees in table.get("camera_path", [])
        ),
    )


def _one_of(row: dict[str, Any], key: str, default: str, allowed: tuple[str, ...]) -> str:
    value = row.get(key, default)
    if value not in allowed:
        known = ", ".join(name for name in allowed if name)
        raise BlockRobotError("CONFIGURATION_INVALID", f"Scenario: {key} = {value!r} is none of {known}.")
    return str(value)


def _flag(row: dict[str, Any], key: str) -> bool:
    value = row.get(key, False)
    if not isinstance(value, bool):
        raise TypeError(f"{key} must be true or false")
    return value


def check_scenario(scenario: Scenario) -> None:
    """Raise CONFIGURATION_INVALID for unrenderable scenarios."""
    reader, environment = scenario.reader, scenario.environment
    problems = (
        (not 0 < scenario.duration_s <= DURATION_MAX_S, "duration_s must be above 0 and at most an hour"),
        (not 1 <= scenario.frame_rate <= 120, "frame_rate must be between 1 and 120"),
        (not (64 <= scenario.width <= 2048 and 48 <= scenario.height <= 2048), "width or height is out of range"),
        (not scenario.focal_px > 0, "focal_px must be above 0"),
        (not 0.2 <= scenario.camera_height_m <= 2.4, "camera_height_m must be between 0.2 and 2.4"),
        (not 1 <= scenario.empty_frames <= 300, "empty_frames must be between 1 and 300"),
        (not reader.distance_sigma_m > 0, "reader.distance_sigma_m must be above 0"),
        (not 0 <= reader.front_misread <= 1, "reader.front_misread must be a share, 0 to 1"),
        (not 0 <= reader.missed <= 1, "reader.missed must be a share, 0 to 1"),
        (not 0 <= reader.late_s <= 60, "reader.late_s must be between 0 and 60"),
        (len(scenario.people) > PEOPLE_MAX_COUNT, "there are too many people"),
        (len({person.alias for person in scenario.people}) < len(scenario.people), "two people share an alias"),
        (not 0 <= environment.mirror_floor <= 1, "environment.mirror_floor must be a share, 0 to 1"),
        (not 0 <= environment.holes <= 0.5, "environment.holes must be between 0 and 0.5"),
        (len(environment.doors) + len(environment.beds) > THINGS_MAX_COUNT, "there are too many doors and beds"),
        (any(door.closes_s <= door.opens_s for door in environment.doors), "a door must close after it opens"),
    )
    for wrong, sentence in problems:
        if wrong:
            raise BlockRobotError("CONFIGURATION_INVALID", f"Scenario: {sentence}.")
    if environment.camera_path:
        check_times("the robot", [point[0] for point in environment.camera_path], "camera_path")
    for person in scenario.people:
        _check_person(person)


def _check_person(person: Person) -> None:
    check_times(person.alias, [point[0] for point in person.path], "path")
    if person.facing:
        check_times(person.alias, [point[0] for point in person.facing], "facing_deg")
    ranges: tuple[tuple[str, float, float, float], ...] = (
        ("height_m", person.height_m, 0.5, 2.3),
        ("girth", person.girth, 0.5, 2.0),
        ("shoulders", person.shoulders, 0.6, 1.5),
        ("belly", person.belly, 0.0, 1.0),
        ("stoop_deg", math.degrees(person.stoop), 0.0, 60.0),
        ("limp", person.limp, 0.0, 1.0),
    )
    for name, value, low, high in ranges:
        if not low <= value <= high:
            raise BlockRobotError(
                "CONFIGURATION_INVALID", f"Scenario: {name} of {person.alias} must be between {low:g} and {high:g}."
            )
    if not all(math.isfinite(value) for point in (*person.path, *person.facing) for value in point):
        raise BlockRobotError("CONFIGURATION_INVALID", f"Scenario: the path of {person.alias} is not all numbers.")
    if any(person.place(at) is None for at in person.reading_times_s()):
        raise BlockRobotError("CONFIGURATION_INVALID", f"Scenario: {person.alias} is read while not there.")


def check_times(whose: str, times: list[float], what: str) -> None:
    if (
        len(times) < 2
        or not all(map(math.isfinite, times))
        or any(after <= before for before, after in pairwise(times))
    ):
        raise BlockRobotError(
            "CONFIGURATION_INVALID",
            f"Scenario: the {what} of {whose} needs two or more points in rising time.",
        )
