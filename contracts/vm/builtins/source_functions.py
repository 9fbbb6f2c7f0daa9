"""Compilation of sources, for the contract `lifecycle` only.

Refusals are part of a receipt, so they contain nothing that depends on Python's version.
"""

from __future__ import annotations

from typing import Any

from contracts.vm.builtins.builtins_table import Builtin
from contracts.vm.model.faults import LIFECYCLE_ONLY, Fault
from contracts.vm.model.meter import Runtime
from contracts.vm.model.values import charge_decoded, need_bytes

LIFECYCLE = "lifecycle"
SOURCE_PART_BYTE_GAS = 40
SOURCE_CHECK_BYTE_GAS = 3
SOURCE_CHECK_GAS = 2000
SOURCE_KEPT_GAS = 20_000
"""What must be left to keep the verdict, or nothing is compiled; it is not taken."""
PROBLEM_MAX_CHARS = 200
"""What may be kept of a source: so that what follows the compiling is bounded, and no call fails for it."""


def _require_lifecycle(runtime: Runtime, what: str) -> None:
    if runtime.contract != LIFECYCLE:
        raise Fault(LIFECYCLE_ONLY, f"Only the contract {LIFECYCLE} may use {what}.")


def _charge_source(runtime: Runtime, data: Any) -> None:
    _require_lifecycle(runtime, "charge_source")
    runtime.charge(SOURCE_PART_BYTE_GAS * len(need_bytes(data, "charge_source")))


def _check_source(runtime: Runtime, data: Any) -> list[Any]:
    """Return [problem or empty text, facts]; refusals are results, so they are kept."""
    _require_lifecycle(runtime, "check_source")
    price = SOURCE_CHECK_GAS + SOURCE_CHECK_BYTE_GAS * len(need_bytes(data, "check_source"))
    runtime.charge(price + SOURCE_KEPT_GAS)
    runtime.gas += SOURCE_KEPT_GAS
    problem, facts = runtime.judge_source(data)
    problem = problem.encode("ascii", "backslashreplace").decode()
    if len(problem) > PROBLEM_MAX_CHARS:
        problem = problem[: PROBLEM_MAX_CHARS - 3] + "..."
    charge_decoded(runtime, [problem, facts])
    return [problem, facts]


SOURCE_FUNCTIONS: dict[str, Builtin] = {
    "charge_source": Builtin(_charge_source, ("data",), 1),
    "check_source": Builtin(_check_source, ("data",), 1),
}
