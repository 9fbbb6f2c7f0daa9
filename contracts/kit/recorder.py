"""What watched contracts tell, gathered: runs and gas by line, and the steps of a call with values.

The gas of a line is what its statements used up themselves: their static cost and what was charged while they ran, less
what the statements inside them and the functions they called used. What belongs to no statement (entering, copying
arguments and results) stands on the line of the entry. The sum over all lines is the gas of the calls.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from contracts.kit.telling import told_short
from contracts.vm.compiler.line_watch import Place
from contracts.vm.model.closures import Frame
from contracts.vm.model.values import Mark

STEPS_MAX_COUNT = 5_000
VALUE_SHOWN_CHARS = 80


@dataclass(slots=True)
class LineFigures:
    """How often a line's statements ran, and how much gas they used."""

    runs: int = 0
    gas: int = 0


@dataclass(slots=True)
class Step:
    """One statement that ran: where, how deep, its own gas, and the names that have another value after it."""

    contract: str
    function: str
    line: int
    depth: int
    gas: int = 0
    values: dict[str, str] = field(default_factory=dict)


@dataclass(slots=True)
class _Running:
    """A statement that has begun: the gas that was left before it and its static cost, and what is used inside it."""

    began: int
    inside: int
    step: Step | None
    texts: dict[str, str]


class Recorder:
    """Gathers from all contracts of a chain. `steps` holds the statements of the last call that was traced, in order."""

    def __init__(self) -> None:
        self.lines: dict[str, dict[int, LineFigures]] = {}
        self.steps: list[Step] = []
        self.left_out_count = 0
        self._tracing = False
        self._running: list[_Running] = []
        self._roots_gas = 0
        self._frames: dict[int, tuple[Frame, dict[str, str]]] = {}

    def watch(self, contract: str) -> ContractWatch:
        """Return the watch with which a contract of this name is to be compiled, with figures of its own.

        They are `lines[contract]` from then on, until another contract is compiled under the name.
        """
        watch = ContractWatch(self, contract)
        self.lines[contract] = watch.lines
        return watch

    def begin(self, *, tracing: bool) -> None:
        """Begin a call; with `tracing` its steps are kept."""
        self.steps, self.left_out_count, self._tracing = [], 0, tracing
        self._running, self._frames, self._roots_gas = [], {}, 0

    def finish(self, contract: str, line: int, gas_used: int) -> None:
        """End a call: put the gas of no statement on the line of its entry. With tracing no figures are gathered."""
        if line and not self._tracing and contract in self.lines:
            self.count(self.lines[contract], line, max(gas_used - self._roots_gas, 0))
        self._tracing = False

    def count(self, lines: dict[int, LineFigures], line: int, gas: int) -> None:
        """Add a run and its gas to a line."""
        figures = lines.setdefault(line, LineFigures())
        figures.runs += 1
        figures.gas += gas

    def enter(self, contract: str, place: Place, frame: Frame, gas: int) -> None:
        """Hear that a statement begins."""
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
        """Hear that it ended; `lines` are the figures of its contract."""
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
        """Return what is known of the names of a frame, as text. The frame is kept, so that its id stays its own."""
        return self._frames.setdefault(id(frame), (frame, {}))[1]

    def _note_values(self, step: Step, place: Place, frame: Frame, texts: dict[str, str]) -> None:
        for name, slot in place.slots.items():
            value: Any = frame[slot]
            if isinstance(value, Mark):
                continue
            text = told_short(value, VALUE_SHOWN_CHARS)
            if texts.get(name) != text:
                texts[name] = step.values[name] = text


class ContractWatch:
    """Tells a recorder what one contract does."""

    def __init__(self, recorder: Recorder, contract: str) -> None:
        self.lines: dict[int, LineFigures] = {}
        self._recorder = recorder
        self._contract = contract

    def declare(self, place: Place) -> None:
        """Note a line that could run."""
        self.lines.setdefault(place.line, LineFigures())

    def enter(self, place: Place, frame: Frame, gas: int) -> None:
        """Pass on that a statement begins."""
        self._recorder.enter(self._contract, place, frame, gas)

    def leave(self, place: Place, frame: Frame, gas: int) -> None:
        """Pass on that it ended."""
        self._recorder.leave(self.lines, place, frame, gas)
