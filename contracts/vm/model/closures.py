"""Closures of compiled contracts, shared by all calls, without call state.

A frame is a list: slot 0 runtime, slot 1 result, then `ctx` fields, parameters, variables, constants.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

from contracts.vm.model.faults import NAME_UNSET, Fault
from contracts.vm.model.meter import ALLOCATION_GAS, ALLOCATION_SHIFT
from contracts.vm.model.values import HEADER_BYTES, INT_FLOOR, INT_LIMIT, MISSING, UNSET, check_int

Frame = list[Any]
Run = Callable[[Frame], Any]
RESULT_SLOT = 1
CONTEXT_SLOTS = {"caller": 2, "height": 3, "time": 4, "txid": 5, "chain": 6}
"""Where a frame has what `ctx.<name>` reads and no call changes: the runtime's `context_values`."""
FIRST_FREE_SLOT = 7


@dataclass(frozen=True, slots=True)
class Code:
    """A compiled expression.

    `slot`: it only reads that surely set slot; `constant`: fixed value; `gives`: its type; `measures`: it is the length
    of that slot.
    """

    run: Run
    slot: int | None = None
    constant: Any = MISSING
    gives: type | None = None
    measures: int | None = None


def read_slot(slot: int, constant: Any = MISSING) -> Code:
    return Code(lambda frame: frame[slot], slot, constant, None if constant is MISSING else type(constant))


def read_constant(value: Any) -> Code:
    return Code(lambda _: value)


def read_variable(slot: int, name: str) -> Code:
    """Read a possibly unset variable. Raises NAME_UNSET."""

    def run(frame: Frame) -> Any:
        value = frame[slot]
        if value is UNSET:
            raise Fault(NAME_UNSET, f"The variable {name} has no value yet.")
        return value

    return Code(run)


def unary(operation: Callable[[Any, Any], Any], operand: Code) -> Code:
    inner, i = operand.run, operand.slot
    if i is not None:
        return Code(lambda frame: operation(frame[0], frame[i]))

    def run(frame: Frame) -> Any:
        return operation(frame[0], inner(frame))

    return Code(run)


def binary(operation: Callable[[Any, Any, Any], Any], left: Code, right: Code) -> Code:
    first, second, i, j = left.run, right.run, left.slot, right.slot

    def both_slots(frame: Frame) -> Any:
        return operation(frame[0], frame[i], frame[j])  # type: ignore[index]

    def left_slot(frame: Frame) -> Any:
        return operation(frame[0], frame[i], second(frame))  # type: ignore[index]

    def right_slot(frame: Frame) -> Any:
        return operation(frame[0], first(frame), frame[j])  # type: ignore[index]

    def general(frame: Frame) -> Any:
        return operation(frame[0], first(frame), second(frame))

    if i is not None and j is not None:
        return Code(both_slots)
    if i is not None:
        return Code(left_slot)
    return Code(right_slot if j is not None else general)


def fast_arithmetic(
    operation: Callable[[Any, Any, Any], Any], of_ints: Callable[[int, int], int], left: Code, right: Code
) -> Code:
    first, second, constant, i, j = left.run, right.run, right.constant, left.slot, right.slot

    def run(frame: Frame) -> Any:
        one, other = first(frame), second(frame)
        if type(one) is int and type(other) is int:
            total = of_ints(one, other)
            return total if INT_FLOOR < total < INT_LIMIT else check_int(total)
        return operation(frame[0], one, other)

    def with_constant(frame: Frame) -> Any:
        one = first(frame)
        if type(one) is int:
            total = of_ints(one, constant)
            return total if INT_FLOOR < total < INT_LIMIT else check_int(total)
        return operation(frame[0], one, constant)

    def both_slots(frame: Frame) -> Any:
        one, other = frame[i], frame[j]  # type: ignore[index]
        if type(one) is int and type(other) is int:
            total = of_ints(one, other)
            return total if INT_FLOOR < total < INT_LIMIT else check_int(total)
        return operation(frame[0], one, other)

    if i is not None and j is not None:
        return Code(both_slots)
    return Code(with_constant if type(constant) is int else run)


def add_to_bytes(operation: Callable[[Any, Any, Any], Any], left: Code, right: Code) -> Code:
    first, second, prefix, j = left.run, right.run, left.constant, right.slot
    header = HEADER_BYTES + (0 if prefix is MISSING else len(prefix))

    def to_constant(frame: Frame) -> Any:
        runtime, rest = frame[0], frame[j]  # type: ignore[index]
        if type(rest) is not bytes:
            return operation(runtime, prefix, rest)
        size = header + len(rest)
        runtime.memory -= size
        runtime.gas -= ALLOCATION_GAS + (size >> ALLOCATION_SHIFT)
        if runtime.memory < 0 or runtime.gas < 0:
            runtime.exhausted()
        return prefix + rest

    def general(frame: Frame) -> Any:
        runtime, one, rest = frame[0], first(frame), second(frame)
        if type(rest) is not bytes:
            return operation(runtime, one, rest)
        size = HEADER_BYTES + len(one) + len(rest)
        runtime.memory -= size
        runtime.gas -= ALLOCATION_GAS + (size >> ALLOCATION_SHIFT)
        if runtime.memory < 0 or runtime.gas < 0:
            runtime.exhausted()
        return one + rest

    return Code(general if prefix is MISSING or j is None else to_constant, gives=bytes)


def fast_compare(
    operation: Callable[[Any, Any, Any], Any], of_ints: Callable[[Any, Any], bool], left: Code, right: Code
) -> Code:
    first, second, constant, i, j = left.run, right.run, right.constant, left.slot, right.slot

    def run(frame: Frame) -> Any:
        one, other = first(frame), second(frame)
        if type(one) is int and type(other) is int:
            return of_ints(one, other)
        return operation(frame[0], one, other)

    def to_constant(frame: Frame) -> Any:
        one = first(frame)
        return of_ints(one, constant) if type(one) is int else operation(frame[0], one, constant)

    def both_slots(frame: Frame) -> Any:
        one, other = frame[i], frame[j]  # type: ignore[index]
        if type(one) is int and type(other) is int:
            return of_ints(one, other)
        return operation(frame[0], one, other)

    def left_slot(frame: Frame) -> Any:
        one, other = frame[i], second(frame)  # type: ignore[index]
        if type(one) is int and type(other) is int:
            return of_ints(one, other)
        return operation(frame[0], one, other)

    if i is not None:
        return Code(left_slot if j is None else both_slots)
    return Code(to_constant if type(constant) is int else run)


def length_is(operation: Callable[[Any, Any], Any], left: Code, number: int) -> Code:
    i = left.measures

    def run(frame: Frame) -> Any:
        value = frame[i]  # type: ignore[index]
        return (len(value) if type(value) is bytes else operation(frame[0], value)) == number

    return Code(run)


def equals_text(left: Code, text: str | bytes, *, wanted: bool) -> Code:
    first, i = left.run, left.slot
    if i is not None:
        return Code((lambda frame: frame[i] == text) if wanted else (lambda frame: frame[i] != text))
    if wanted:
        return Code(lambda frame: first(frame) == text)
    return Code(lambda frame: first(frame) != text)


def get_named(get_item: Callable[[Any, Any, Any], Any], container: Code, name: str) -> Code:
    i = container.slot
    if i is None:
        return binary(get_item, container, read_constant(name))

    def run(frame: Frame) -> Any:
        value = frame[i]
        if type(value) is dict and name in value:
            return value[name]
        return get_item(frame[0], value, name)

    return Code(run)


def length_of(operation: Callable[[Any, Any], Any], operand: Code) -> Code:
    i = operand.slot
    if i is None:
        return unary(operation, operand)

    def run(frame: Frame) -> Any:
        value = frame[i]
        return len(value) if type(value) is bytes else operation(frame[0], value)

    return Code(run, gives=int, measures=i)


def gather(parts: list[Code], new_slot: Callable[[], int]) -> Callable[[Frame], tuple[Any, ...]]:
    """Return a closure evaluating parts in order to a tuple; non-slot parts get slots."""
    if not parts:
        return lambda _: ()
    if len(parts) == 1:
        only = parts[0].run
        return lambda frame: (only(frame),)
    slots = [new_slot() if part.slot is None else part.slot for part in parts]
    moves = [(slot, part.run) for slot, part in zip(slots, parts, strict=True) if part.slot is None]
    read: Callable[[Frame], tuple[Any, ...]] = itemgetter(*slots)
    if not moves:
        return read

    def run(frame: Frame) -> tuple[Any, ...]:
        for slot, part in moves:
            frame[slot] = part(frame)
        return read(frame)

    return run


def is_none(operand: Code, *, wanted: bool) -> Code:
    inner, i = operand.run, operand.slot
    if i is not None:
        return Code((lambda frame: frame[i] is None) if wanted else (lambda frame: frame[i] is not None))
    if wanted:
        return Code(lambda frame: inner(frame) is None)
    return Code(lambda frame: inner(frame) is not None)


def call_function(function: Callable[..., Any], arguments: list[Code], new_slot: Callable[[], int]) -> Code:
    runs = [argument.run for argument in arguments]
    if not runs:
        return Code(lambda frame: function(frame[0]))
    if len(runs) == 1:
        return unary(function, arguments[0])
    if len(runs) == 2:
        return binary(function, arguments[0], arguments[1])
    read = gather(arguments, new_slot)
    return Code(lambda frame: function(frame[0], *read(frame)))


def call_contract(function: Callable[..., Any], arguments: list[Code], new_slot: Callable[[], int]) -> Code:
    """`call("contract", "entry", ...)`; constant names are resolved at compile time."""
    contract, entry = arguments[0].constant, arguments[1].constant
    if type(contract) is not str or type(entry) is not str:
        return call_function(function, arguments, new_slot)
    read = gather(arguments[2:], new_slot)

    def run(frame: Frame) -> Any:
        runtime = frame[0]
        return runtime.enter(runtime, contract, entry, [*read(frame)])

    return Code(run)


def call_method(
    name: str, table: dict[type, Callable[..., Any]], subject: Code, arguments: list[Code], fault: Any
) -> Code:
    inner, runs = subject.run, [argument.run for argument in arguments]
    find = table.get

    def none(frame: Frame) -> Any:
        value = inner(frame)
        function = find(type(value))
        if function is None:
            raise fault(name, value)
        return function(frame[0], value)

    def one(frame: Frame) -> Any:
        value = inner(frame)
        function = find(type(value))
        if function is None:
            raise fault(name, value)
        return function(frame[0], value, first(frame))

    def many(frame: Frame) -> Any:
        value = inner(frame)
        function = find(type(value))
        if function is None:
            raise fault(name, value)
        return function(frame[0], value, *[run(frame) for run in runs])

    if not runs:
        return Code(none)
    first = runs[0]
    return Code(one if len(runs) == 1 else many)
