"""Collects runs and gas per line, and traced steps.

A line's gas excludes nested statements and called functions; gas of no statement counts for the entry's line.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from contracts.kit.arguments import format_short
from contracts.vm.compiler.line_watch import Place
from contracts.vm.model.closures import Frame
from contracts.vm.model.values import Mark

STEPS_MAX_COUNT = 5_000
VALUE_SHOWN_CHARS = 80


@dataclass(slots=True)
class LineFigures:
    """How often a line's statements ran, and their gas."""

    runs: int = 0
    gas: int = 0


@dataclass(slots=True)
class Step:
    """One executed statement: place, depth, own gas and changed names."""

    contract: str
    function: str
    line: int
    depth: int
    gas: int = 0
    values: dict[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class _Running:
    began: int
    inside: int
    step: Step | None
    texts: dict[str, str]


class Recorder:
    """Collects from all contracts of a chain; `steps` are those of the last traced call."""

    def __init__(self) -> None:
        self.lines: dict[str, dict[int, LineFigures]] = {}
        self.steps: list[Step] = []
        self.left_out_count = 0
        self._tracing = False
        self._running: list[_Running] = []
        self._roots_gas = 0
        self._frames: dict[int, tuple[Frame, dict[str, str]]] = {}

    def watch(self, contract: str) -> ContractWatch:
        watch = ContractWatch(self, contract)
        self.lines[contract] = watch.lines
        return watch

    def begin(self, *, tracing: bool) -> None:
        self.steps, self.left_out_count, self._tracing = [], 0, tracing
        self._running, self._frames, self._roots_gas = [], {}, 0

    def finish(self, contract: str, line: int, gas_used: int) -> None:
        """End a call; assign remaining gas to the entry's line. Tracing records no figures."""
        if line and not self._tracing and contract in self.lines:
            self.count(self.lines[contract], line, max(gas_used - self._roots_gas, 0))
        self._tracing = False

    def count(self, lines: dict[int, LineFigures], line: int, gas: int) -> None:
        figures = lines.setdefault(line, LineFigures())
        figures.runs += 1
        figures.gas += gas

    def enter(self, contract: str, place: Place, frame: Frame, gas: int) -> None:
        step, texts = None, {}
        if self._tracing:
            texts = self._texts_of(frame)
            if len(self.steps) < STEPS_MAX_COUNT:
                step = Step(contract, place.function, place.line, len(self._running))
                self.steps.append(step)
                if not texts:
                    self._note_values(step, place, frame, texts)
            else:
                self.left_out_count += 1
        self._running.append(_Running(gas + place.static_gas, 0, step, texts))

    def leave(self, lines: dict[int, LineFigures], place: Place, frame: Frame, gas: int) -> None:
        running = self._running.pop()
        used = running.began - gas
        own = used - running.inside
        if self._running:
            self._running[-1].inside += used
        else:
            self._roots_gas += used
        if not self._tracing:
            self.count(lines, place.line, own)
        elif running.step is not None:
            running.step.gas = own
            self._note_values(running.step, place, frame, running.texts)

    def _texts_of(self, frame: Frame) -> dict[str, str]:
        """The frame is retained: its id must stay unique."""
        return self._frames.setdefault(id(frame), (frame, {}))[1]

    def _note_values(self, step: Step, place: Place, frame: Frame, texts: dict[str, str]) -> None:
        for name, slot in place.slots.items():
            value: Any = frame[slot]
            if isinstance(value, Mark):
                continue
            text = format_short(value, VALUE_SHOWN_CHARS)
            if texts.get(name) != text:
                texts[name] = step.values[name] = text


class ContractWatch:
    """Reports one contract's statements to a recorder."""

    def __init__(self, recorder: Recorder, contract: str) -> None:
        self.lines: dict[int, LineFigures] = {}
        self._recorder = recorder
        self._contract = contract

    def declare(self, place: Place) -> None:
        self.lines.setdefault(place.line, LineFigures())

    def enter(self, place: Place, frame: Frame, gas: int) -> None:
        self._recorder.enter(self._contract, place, frame, gas)

    def leave(self, place: Place, frame: Frame, gas: int) -> None:
        self._recorder.leave(self.lines, place, frame, gas)
