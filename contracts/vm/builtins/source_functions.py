"""What the contract `lifecycle` alone may do: have a source compiled, and pay for that. Must never tell of a refused
source what only one version of Python would say: the sentence is part of a receipt.
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
    """Take the price of compiling a part of a source when it comes: that of the whole would not fit into one call."""
    _require_lifecycle(runtime, "charge_source")
    runtime.charge(SOURCE_PART_BYTE_GAS * len(need_bytes(data, "charge_source")))


def _check_source(runtime: Runtime, data: Any) -> list[Any]:
    """Have a source compiled that was paid for. Return [what is wrong with it or an empty text, the facts about it].

    The facts are those of `compile_cache.describe_source`, or {} of a source that is refused. A refusal is a
    result and no failure, so that it can be kept: what costs this much must not be asked twice.
    """
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
