"""Watching a run, statement by statement: for the author's kit. Must never change what a call does or what it costs.

A contract that was compiled to be watched tells its `Watch` of each statement when it begins and when it ends; one that
was not has nothing of this in it. The static cost of a statement is charged with its block, before the block begins, so
that a place carries it: what a statement uses up is that and what the gas falls by between `enter` and `leave`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from contracts.vm.model.closures import Frame, Run


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A statement: its function, its line, its static cost in gas, and in which slot of a frame each name lives."""

    function: str
    line: int
    static_gas: int
    slots: Mapping[str, int]


class Watch(Protocol):
    """Who watches one contract."""

    def declare(self, place: Place) -> None:
        """Hear, while the contract is compiled, of a statement that it has."""
        ...

    def enter(self, place: Place, frame: Frame, gas: int) -> None:
        """Hear that a statement begins, with the frame it runs in and the gas that is left."""
        ...

    def leave(self, place: Place, frame: Frame, gas: int) -> None:
        """Hear that it ended, also by a fault."""
        ...


def watched(step: Run, place: Place, watch: Watch) -> Run:
    """Return a statement that tells its watch when it begins and when it ends."""
    watch.declare(place)

    def run(frame: Frame) -> Any:
        watch.enter(place, frame, frame[0].gas)
        try:
            return step(frame)
        finally:
            watch.leave(place, frame, frame[0].gas)

    return run
