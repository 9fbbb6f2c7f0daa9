"""Fault plans: TOML with a seed, timed and random steps, as in docs/how-to/break-the-network.md.

Random steps are drawn at parsing, so a dry run shows them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

from consensus.bounded_text import TextInvalidError, read_toml_text
from consensus.errors import BlockRobotError
from consensus.visible_text import split_lines
from network.byzantine import BEHAVIOURS
from network.faults.actions import (
    LINK_PROFILES,
    Action,
    ActionReader,
    GoByzantine,
    Heal,
    Kill,
    Partition,
    Pause,
    Restart,
    Resume,
    SetLink,
    Skew,
    make_link_fault,
    read_duration,
)
from node.faults import SEED_MAX
from node.p2p.link_faults import SOUND

STEPS_MAX_COUNT = 1_000
PLAN_MAX_MS = 24 * 3_600_000
RANDOM_SKEW_MAX_S = 3_600
_FIGURES = ("profile", "delay_ms", "jitter_ms", "loss", "bandwidth_kbytes_per_s", "cut")
_NUMBERS = ("delay_ms", "jitter_ms", "loss", "bandwidth_kbytes_per_s")
_TABLE = re.compile(r"^\s*\[\[\s*(\w+)\s*\]\]")
RANDOM_KINDS = ("kill", "pause", "partition", "link", "skew", "byzantine")
STEP_FIELDS: dict[str, frozenset[str]] = {
    "kill": frozenset({"node"}),
    "restart": frozenset({"node"}),
    "pause": frozenset({"node"}),
    "resume": frozenset({"node"}),
    "partition": frozenset({"groups"}),
    "heal": frozenset({"node"}),
    "link": frozenset({"link", *_FIGURES}),
    "skew": frozenset({"node", "offset"}),
    "disk": frozenset({"node", "disk", "full"}),
    "byzantine": frozenset({"node", "behaviour", "seed"}),
}
"""The fields of each kind of step, beside `at` and `do`."""
_OF_ONE_NODE: dict[str, Callable[[str], Action]] = {"kill": Kill, "restart": Restart, "pause": Pause, "resume": Resume}


@dataclass(frozen=True, slots=True)
class Step:
    """An action at a time after the plan's start, with its source line."""

    at_ms: int
    action: Action
    line: int


@dataclass(frozen=True, slots=True)
class FaultPlan:
    """Steps in order of time."""

    seed: int
    steps: tuple[Step, ...]


def parse_plan(text: str, names: Sequence[str]) -> FaultPlan:
    """Raises FAULT_PLAN_INVALID, whose detail begins with the line."""
    try:
        document = read_toml_text(text)
    except TextInvalidError as error:
        found = re.search(r"line (\d+)", str(error))
        line = int(found[1]) if found else max(1, len(split_lines(text)))
        raise _wrong(line, f"it is not TOML: {error}.") from None
    reader = _PlanReader(text, document, names)
    steps = sorted(reader.steps(), key=lambda step: step.at_ms)
    if not steps:
        raise _wrong(1, "there is nothing to do: write a [[step]] or a [[random]].")
    if len(steps) > STEPS_MAX_COUNT:
        raise _wrong(1, f"there are more than {STEPS_MAX_COUNT} steps.")
    return FaultPlan(reader.seed, tuple(steps))


def _wrong(line: int, detail: str) -> BlockRobotError:
    return BlockRobotError("FAULT_PLAN_INVALID", f"line {line}: {detail}", line=line)


class _PlanReader:
    """One document, with its tables' first lines."""

    def __init__(self, text: str, document: dict[str, Any], names: Sequence[str]) -> None:
        self._lines = split_lines(text)
        self._document = document
        self._reader = ActionReader(tuple(names))
        self._names = tuple(names)
        for key in document:
            if key not in {"seed", "step", "random"}:
                raise _wrong(self._line_of(key, 1), f"there is no {key!r} in a plan; there are seed, step and random.")
        self.seed = document.get("seed", 0)
        if not isinstance(self.seed, int) or isinstance(self.seed, bool) or not 0 <= self.seed <= SEED_MAX:
            raise _wrong(self._line_of("seed", 1), f"the seed is a whole number from 0 to {SEED_MAX}.")

    def _line_of(self, key: str, from_line: int) -> int:
        for number, line in enumerate(self._lines[from_line - 1 :], start=from_line):
            if number > from_line and line.lstrip().startswith("["):
                break
            if re.match(rf"\s*\[*\s*[\"']?{re.escape(key)}[\"']?\s*[=\].]", line):
                return number
        return from_line

    def _tables(self, kind: str) -> list[tuple[int, dict[str, Any]]]:
        tables = self._document.get(kind, [])
        lines = [
            number
            for number, line in enumerate(self._lines, start=1)
            if (found := _TABLE.match(line)) is not None and found[1] == kind
        ]
        if not isinstance(tables, list) or len(lines) != len(tables):
            raise _wrong(self._line_of(kind, 1), f"write each {kind} as a table of its own: [[{kind}]].")
        return list(zip(lines, tables, strict=True))

    def steps(self) -> list[Step]:
        steps = [self._step(line, dict(table)) for line, table in self._tables("step")]
        chance = Random(self.seed)  # noqa: S311 - a plan is to be repeated
        for line, table in self._tables("random"):
            steps += _Draws(self, line, dict(table), self._names, chance).steps()
        return steps

    def _step(self, line: int, table: dict[str, Any]) -> Step:
        at_ms = self.duration(line, table, "at")
        kind = table.pop("do", None)
        if not isinstance(kind, str) or kind not in STEP_FIELDS:
            raise _wrong(self._line_of("do", line), f"do is one of {', '.join(STEP_FIELDS)}.")
        for key in table:
            if key not in STEP_FIELDS[kind]:
                raise _wrong(
                    self._line_of(key, line), f"{kind} has no {key!r}; it has {', '.join(sorted(STEP_FIELDS[kind]))}."
                )
        return Step(at_ms, self.checked(line, table, lambda: action_of(self._reader, kind, table)), line)

    def checked(self, line: int, table: dict[str, Any], read: Callable[[], Action]) -> Action:
        try:
            return read()
        except BlockRobotError as error:
            key = error.context.get("field") or next((key for key in table if repr(table[key]) in error.detail), "")
            raise _wrong(self._line_of(str(key), line) if key else line, error.detail) from None

    def duration(self, line: int, table: dict[str, Any], key: str) -> int:
        value = table.pop(key, None)
        place = self._line_of(key, line)
        if not isinstance(value, str):
            raise _wrong(place, f'{key} is missing or no text such as {key} = "2s".')
        try:
            duration_ms = read_duration(value) if value != "0" else 0
        except BlockRobotError as error:
            raise _wrong(place, error.detail) from None
        if not 0 <= duration_ms <= PLAN_MAX_MS:
            raise _wrong(place, f"{key} lies between 0 and 24h.")
        return duration_ms


def action_of(reader: ActionReader, kind: str, table: Mapping[str, Any]) -> Action:
    """Raises FAULT_UNKNOWN, FAULT_INVALID."""
    make = _OF_ONE_NODE.get(kind)
    if make is not None:
        return make(reader.node(_text(table, "node")))
    makers: dict[str, Callable[[], Action]] = {
        "partition": lambda: reader.partition(_text(table, "groups")),
        "link": lambda: reader.link(_text(table, "link"), make_link_fault(**_figures(table))),
        "heal": lambda: Heal((reader.node(_text(table, "node")),) if "node" in table else ()),
        "skew": lambda: reader.skew(_text(table, "node"), _text(table, "offset")),
        "disk": lambda: reader.disk(
            _text(table, "node"), _text(table, "disk"), is_full=_typed(table, "full", bool, True)
        ),
        "byzantine": lambda: reader.byzantine(
            _text(table, "node"), _text(table, "behaviour"), _typed(table, "seed", int, 0)
        ),
    }
    return makers[kind]()


def _typed(table: Mapping[str, Any], key: str, kind: type, default: Any = None) -> Any:
    value = table.get(key, default)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        what = {str: "a text", bool: "true or false", int: "a whole number"}[kind]
        raise BlockRobotError("FAULT_INVALID", f"{key} is missing or not {what}.", field=key)
    return value


def _text(table: Mapping[str, Any], key: str) -> str:
    return str(_typed(table, key, str))


def _figures(table: Mapping[str, Any]) -> dict[str, Any]:
    given: dict[str, Any] = {}
    for key in _FIGURES:
        if key not in table:
            continue
        value = table[key]
        if key in _NUMBERS:
            if not isinstance(value, int | float) or isinstance(value, bool):
                raise BlockRobotError("FAULT_INVALID", f"{key} is not a number.", field=key)
            given[key] = value
        else:
            given[key] = _typed(table, key, bool if key == "cut" else str)
    return given


class _Draws:
    """The steps of one random table."""

    def __init__(
        self, plan: _PlanReader, line: int, table: dict[str, Any], names: tuple[str, ...], chance: Random
    ) -> None:
        self._line, self._names, self._chance = line, names, chance
        self._from_ms = plan.duration(line, table, "from")
        self._to_ms = plan.duration(line, table, "to")
        self._every_ms = plan.duration(line, table, "every")
        self._lasting_ms = plan.duration(line, table, "lasting")
        self._kinds = table.pop("do", None)
        if not isinstance(self._kinds, list) or not self._kinds or not set(map(str, self._kinds)) <= set(RANDOM_KINDS):
            raise _wrong(line, f"do is a list of {', '.join(RANDOM_KINDS)}.")
        if table:
            raise _wrong(line, f"a random table has no {next(iter(table))!r}.")
        if not 0 < self._lasting_ms <= self._every_ms or self._to_ms < self._from_ms:
            raise _wrong(line, "to is not before from, and a fault lasts no longer than the time to the next one.")
        if (self._to_ms - self._from_ms) // self._every_ms >= STEPS_MAX_COUNT:
            raise _wrong(line, f"that is more than {STEPS_MAX_COUNT} faults.")

    def steps(self) -> list[Step]:
        drawn: list[Step] = []
        for at_ms in range(self._from_ms, self._to_ms + 1, self._every_ms):
            begin, end = self._draw(self._chance.choice(self._kinds))
            drawn += [Step(at_ms, begin, self._line), Step(at_ms + self._lasting_ms, end, self._line)]
        return drawn

    def _draw(self, kind: str) -> tuple[Action, Action]:
        chance, reader = self._chance, ActionReader(self._names)
        node = chance.choice(self._names)
        match kind:
            case "kill":
                return Kill(node), Restart(node)
            case "pause":
                return Pause(node), Resume(node)
            case "skew":
                offset_ms = 1000 * chance.randint(-RANDOM_SKEW_MAX_S, RANDOM_SKEW_MAX_S)
                return Skew(node, offset_ms), Skew(node, 0)
            case "byzantine":
                behaviour = chance.choice(sorted(BEHAVIOURS))
                return GoByzantine(node, behaviour, chance.randrange(1 << 16)), Restart(node)
        if len(self._names) < 2:
            raise _wrong(self._line, f"a network of one node has no {kind}.")
        if kind == "partition":
            count = chance.randint(1, len(self._names) - 1)
            return reader.partition(",".join(chance.sample(self._names, count))), Partition((self._names,))
        source, target = chance.sample(self._names, 2)
        fault = make_link_fault(profile=chance.choice(sorted(LINK_PROFILES)))
        return SetLink(source, target, fault, is_both=True), SetLink(source, target, SOUND, is_both=True)
