"""Shrinks a failing plan by delta debugging over its faults."""

from __future__ import annotations

from collections.abc import Callable

import msgspec

from network.sim.plan import Fault, Plan
from network.sim.plan_file import ROUNDS_MIN_COUNT
from network.sim.run import RunResult

RUNS_MAX_COUNT = 80
SHORTEST_MS = 4


def shrink_plan(plan: Plan, result: RunResult, play: Callable[[Plan], RunResult]) -> tuple[Plan, RunResult]:
    """Needs violations."""
    return _Shrinking(plan, result, play).shrink()


class _Shrinking:
    def __init__(self, plan: Plan, result: RunResult, play: Callable[[Plan], RunResult]) -> None:
        self._plan, self._result, self._play = plan, result, play
        self._checkers = {violation.checker for violation in result.violations}
        self._left = RUNS_MAX_COUNT

    def shrink(self) -> tuple[Plan, RunResult]:
        self._leave_out_faults()
        for index in list(self._plan.byzantine):
            rest = {other: name for other, name in self._plan.byzantine.items() if other != index}
            self._try(msgspec.structs.replace(self._plan, byzantine=rest))
        for number in range(len(self._plan.faults)):
            while self._plan.faults[number].for_ms > SHORTEST_MS and self._shorten(number):
                pass
        while self._plan.rounds >= 2 * ROUNDS_MIN_COUNT and self._try(
            msgspec.structs.replace(self._plan, rounds=self._plan.rounds // 2)
        ):
            pass
        return self._plan, self._result

    def _shorten(self, number: int) -> bool:
        faults = list(self._plan.faults)
        faults[number] = msgspec.structs.replace(faults[number], for_ms=faults[number].for_ms // 2)
        return self._try(self._with(faults))

    def _leave_out_faults(self) -> None:
        """Zeller's ddmin over the faults."""
        parts = 2
        while self._plan.faults and self._left:
            faults = list(self._plan.faults)
            size = -(-len(faults) // parts)
            rests = [faults[:start] + faults[start + size :] for start in range(0, len(faults), size)]
            if any(self._try(self._with(rest)) for rest in rests):
                parts = max(2, parts - 1)
            elif size == 1:
                return
            else:
                parts = min(len(faults), parts * 2)

    def _with(self, faults: list[Fault]) -> Plan:
        return msgspec.structs.replace(self._plan, faults=tuple(faults))

    def _try(self, plan: Plan) -> bool:
        if self._left == 0:
            return False
        self._left -= 1
        result = self._play(plan)
        if not self._checkers & {violation.checker for violation in result.violations}:
            return False
        self._plan, self._result = plan, result
        return True
