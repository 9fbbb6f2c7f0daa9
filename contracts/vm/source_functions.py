"""What the contract `lifecycle` alone may do: have a source compiled, and pay for that. Must never tell of a refused
source what only one version of Python would say: the sentence is part of a receipt.
"""

from __future__ import annotations

from typing import Any

from contracts.vm.builtins_table import Builtin
from contracts.vm.faults import LIFECYCLE_ONLY, SOURCE_INVALID, TYPE_ERROR, ContractSourceError, Fault
from contracts.vm.meter import Runtime
from contracts.vm.values import charge_decoded, need_bytes, need_str, type_name

LIFECYCLE = "lifecycle"
SOURCE_PART_BYTE_GAS = 40
SOURCE_CHECK_GAS = 2000


def _require_lifecycle(runtime: Runtime, what: str) -> None:
    if runtime.contract != LIFECYCLE:
        raise Fault(LIFECYCLE_ONLY, f"Only the contract {LIFECYCLE} may use {what}.")


def _charge_source(runtime: Runtime, data: Any) -> None:
    """Take the price of compiling a part of a source when it comes: that of the whole would not fit into one call."""
    _require_lifecycle(runtime, "charge_source")
    runtime.charge(SOURCE_PART_BYTE_GAS * len(need_bytes(data, "charge_source")))


def _check_source(runtime: Runtime, name: Any, parts: Any) -> dict[str, Any]:
    """Return the facts about a source (see `contracts.vm.sources.describe_source`) whose parts were paid for."""
    _require_lifecycle(runtime, "check_source")
    need_str(name, "check_source")
    if type(parts) is not list:
        raise Fault(TYPE_ERROR, f"check_source takes a list of parts, not {type_name(parts)}.")
    data = b"".join([need_bytes(part, "check_source") for part in parts])
    runtime.charge(SOURCE_CHECK_GAS + len(data))
    # The compiler knows these functions by name, so that it can only be looked up when it is needed.
    from contracts.vm.sources import compile_once, describe_source  # noqa: PLC0415

    try:
        facts = describe_source(data, compile_once(data.decode(), name))
    except UnicodeDecodeError:
        raise Fault(SOURCE_INVALID, "The source is not UTF-8.") from None
    except ContractSourceError as error:
        found = error.verdict
        raise Fault(SOURCE_INVALID, f"Line {found.line} of the source: {found.code}: {found.message}") from None
    charge_decoded(runtime, facts)
    return facts


SOURCE_FUNCTIONS: dict[str, Builtin] = {
    "charge_source": Builtin(_charge_source, ("data",), 1),
    "check_source": Builtin(_check_source, ("name", "parts"), 2),
}
