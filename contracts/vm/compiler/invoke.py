"""Runs an entry: the only way into the machine.

Unforeseen exceptions never decide a result. On failure the caller discards the host's writes and events.
"""

from __future__ import annotations

import gc
import sys
from collections.abc import Mapping
from functools import partial
from typing import Any, Literal

import msgspec

from contracts.vm.compiler.compile_cache import judge_source
from contracts.vm.compiler.compiled_contract import CompiledContract, CompiledEntry
from contracts.vm.frontend.abi import check_arguments
from contracts.vm.model.closures import RESULT_SLOT
from contracts.vm.model.faults import (
    ARGUMENTS_INVALID,
    CALL_DEPTH,
    ENTRY_UNKNOWN,
    MEMORY_BUDGET,
    OK,
    OUT_OF_GAS,
    REENTRANT,
    TYPE_ERROR,
    Fault,
    InternalFault,
)
from contracts.vm.model.meter import (
    GENESIS_WRITES_MAX_COUNT,
    MEMORY_MAX_BYTES,
    MIGRATE_WRITES_MAX_COUNT,
    WRITES_MAX_COUNT,
    CallContext,
    HostInterface,
    Runtime,
)
from contracts.vm.model.values import INT_FLOOR, INT_LIMIT, copy_across, count_items, fresh_constant

Mode = Literal["export", "view", "genesis", "migrate"]

ENTRY_GAS = 30
CROSS_CALL_GAS = 15
CROSS_CALL_FRAMES = 40
CHOICE_GAS = 2
_RECURSION_LIMIT_FRAMES = 6000
GARBAGE_MAX_BYTES = 8 * MEMORY_MAX_BYTES
_WRITES_MAX_COUNT: dict[Mode, int] = {
    "export": WRITES_MAX_COUNT,
    "view": 0,
    "genesis": GENESIS_WRITES_MAX_COUNT,
    "migrate": MIGRATE_WRITES_MAX_COUNT,
}

_PLAIN = frozenset((bytes, bool, type(None)))
"""The types of values that cross from one contract to another as they are, and leave one as a result."""

if sys.getrecursionlimit() < _RECURSION_LIMIT_FRAMES:
    sys.setrecursionlimit(_RECURSION_LIMIT_FRAMES)


class Outcome(msgspec.Struct, frozen=True):
    """A call's result: `code` is "OK" or an error code; `line` locates a failure."""

    ok: bool
    code: str
    message: str
    line: int | None
    result: Any
    gas_used: int
    events: list[tuple[str, str, bytes]]


class _Garbage:
    """Collects cyclic garbage after calls, by the bytes they made."""

    def __init__(self) -> None:
        self._made_bytes = 0

    def note(self, made_bytes: int) -> None:
        self._made_bytes += made_bytes
        if self._made_bytes > GARBAGE_MAX_BYTES:
            self._made_bytes = 0
            gc.collect()


_garbage = _Garbage()


def invoke(
    contracts: Mapping[str, CompiledContract],
    contract: str,
    entry: str,
    args: list[Any],
    *,
    host: HostInterface,
    context: CallContext,
    gas_limit: int,
    mode: Mode,
) -> Outcome:
    """Run one entry; gas in reference units. Raises InternalFault on unforeseen failure."""
    runtime = Runtime(
        host,
        context,
        gas_limit,
        partial(_enter_by_call, contracts),
        judge_source,
        mode == "view",
        _WRITES_MAX_COUNT[mode],
    )
    try:
        found = _find(contracts, runtime, contract, entry, (mode,))
        given = _copy_arguments(runtime, args)
        result = _run(runtime, contracts[contract], found, given)
        return Outcome(True, OK, "", None, result, gas_limit - runtime.gas, runtime.events)
    except Fault as fault:
        used = gas_limit if fault.code == OUT_OF_GAS else gas_limit - max(runtime.gas, 0)
        message = fault.message
        if runtime.contract not in ("", contract):
            message = f"In contract {runtime.contract}: {message}"
        return Outcome(False, fault.code, message, fault.line, None, used, [])
    except Exception as error:
        where = f"{contract}.{entry} in {runtime.contract or contract}"
        raise InternalFault(f"{where}: {type(error).__name__}: {error}") from error
    finally:
        _garbage.note(MEMORY_MAX_BYTES - runtime.memory)


def _find(
    contracts: Mapping[str, CompiledContract], runtime: Runtime, contract: str, entry: str, kinds: tuple[str, ...]
) -> CompiledEntry:
    runtime.gas -= ENTRY_GAS
    if runtime.gas < 0:
        runtime.exhausted()
    compiled = contracts.get(contract)
    if compiled is None:
        raise Fault(ENTRY_UNKNOWN, f"There is no contract {contract[:32]}.")
    found = compiled.entries.get(entry)
    if found is None:
        raise Fault(ENTRY_UNKNOWN, f"The contract {contract} has no entry {entry[:64]}.")
    if found.entry.kind not in kinds:
        message = f"{contract}.{entry} is a {found.entry.kind} and cannot be called as {' or '.join(kinds)}."
        raise Fault(ENTRY_UNKNOWN, message)
    return found


def _copy_arguments(runtime: Runtime, args: list[Any]) -> list[Any]:
    try:
        return [
            value
            if type(value) is bytes or (type(value) is int and INT_FLOOR < value < INT_LIMIT)
            else copy_across(runtime, value, "An argument", 1)
            for value in args
        ]
    except Fault as fault:
        if fault.code in (OUT_OF_GAS, MEMORY_BUDGET):
            raise
        raise Fault(ARGUMENTS_INVALID, fault.message) from None


def _run(runtime: Runtime, compiled: CompiledContract, found: CompiledEntry, arguments: list[Any]) -> Any:
    runtime.stack.append(compiled.name)
    runtime.contract, runtime.prefix = compiled.name, compiled.prefix
    runtime.gas -= len(found.accepts) + 1
    if runtime.gas < 0:
        runtime.exhausted()
    if list(map(type, arguments)) != found.plain:
        if found.choices[0]:
            runtime.charge(CHOICE_GAS * found.choices[0] * sum(map(count_items, arguments)))
        check_arguments(found.entry, found.accepts, arguments)
    missing = len(found.accepts) - len(arguments)
    if missing:
        defaults = found.defaults[len(found.defaults) - missing :]
        arguments = [*arguments, *[fresh_constant(runtime, value) for value in defaults]]
    function = found.function
    runtime.depth -= function.depth
    if runtime.depth < 0:
        raise Fault(CALL_DEPTH, "Functions call each other too deep.")
    frame = [runtime, None, *runtime.context_values, *arguments, *function.tail]
    function.body(frame)
    runtime.depth += function.depth
    result = frame[RESULT_SLOT]
    if type(result) not in _PLAIN:
        result = copy_across(runtime, result, "A result")
        if found.choices[1]:
            runtime.charge(CHOICE_GAS * found.choices[1] * count_items(result))
    if found.accepts_result is not None and not found.accepts_result(result):
        message = f"{found.entry.name} did not return {found.entry.returns}."
        raise Fault(TYPE_ERROR, message, found.entry.line)
    runtime.stack.pop()
    return result


def _enter_by_call(
    contracts: Mapping[str, CompiledContract], runtime: Runtime, contract: str, entry: str, arguments: list[Any]
) -> Any:
    runtime.gas -= CROSS_CALL_GAS
    if runtime.gas < 0:
        runtime.exhausted()
    runtime.depth -= CROSS_CALL_FRAMES
    if runtime.depth < 0:
        raise Fault(CALL_DEPTH, "Contracts call each other too deep.")
    if contract in runtime.stack:
        raise Fault(REENTRANT, f"The contract {contract} is already running in this call.")
    found = _find(contracts, runtime, contract, entry, ("export", "view"))
    given = arguments if _PLAIN.issuperset(map(type, arguments)) else _copy_arguments(runtime, arguments)
    caller, prefix, before, read_only = runtime.contract, runtime.prefix, runtime.calling_contract, runtime.read_only
    runtime.calling_contract = caller
    if found.entry.kind == "view":
        runtime.read_only = True
    result = _run(runtime, contracts[contract], found, given)
    runtime.contract, runtime.prefix, runtime.calling_contract, runtime.read_only = caller, prefix, before, read_only
    runtime.depth += CROSS_CALL_FRAMES
    return result
