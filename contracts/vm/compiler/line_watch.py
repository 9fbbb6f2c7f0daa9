"""Statement-level watching for the author's kit; changes neither results nor costs.

Static cost is charged with the block beforehand, so a statement's use is `Place` cost plus the gas drop from `enter` to
`leave`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from contracts.vm.model.closures import Frame, Run


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A statement: function, line, static gas, and names by frame slot."""

    function: str
    line: int
    static_gas: int
    slots: Mapping[str, int]


class Watch(Protocol):
    """Observes one contract."""

    def declare(self, place: Place) -> None:
        """Called while compiling, once per statement."""
        ...

    def enter(self, place: Place, frame: Frame, gas: int) -> None:
        """Called before a statement, with its frame and remaining gas."""
        ...

    def leave(self, place: Place, frame: Frame, gas: int) -> None:
        """Called after a statement, also after a fault."""
        ...


def watched(step: Run, place: Place, watch: Watch) -> Run:
    watch.declare(place)

    def run(frame: Frame) -> Any:
        watch.enter(place, frame, frame[0].gas)
        try:
            return step(frame)
        finally:
            watch.leave(place, frame, frame[0].gas)

    return run
