"""The small closures that compiled contracts are made of. Must never hold anything of one call: they serve all calls.

A frame is a list: slot 0 the runtime, slot 1 the result, then parameters, variables and constants. A closure takes the
frame. Where an operand is simply a slot, a shape of the closure exists that reads it without a call.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

from contracts.vm.faults import NAME_UNSET, Fault
from contracts.vm.values import INT_LIMIT, UNSET, check_int

Frame = list[Any]
Run = Callable[[Frame], Any]


@dataclass(frozen=True, slots=True)
class Code:
    """A compiled expression; `slot` is set if it only reads that slot, which certainly holds a value."""

    run: Run
    slot: int | None = None


def read_slot(slot: int) -> Code:
    """Read a slot that certainly holds a value."""
    return Code(itemgetter(slot), slot)


def read_variable(slot: int, name: str) -> Code:
    """Read a variable that may not hold a value yet. Raises NAME_UNSET then."""

    def run(frame: Frame) -> Any:
        value = frame[slot]
        if value is UNSET:
            raise Fault(NAME_UNSET, f"The variable {name} has no value yet.")
        return value

    return Code(run)


def unary(operation: Callable[[Any, Any], Any], operand: Code) -> Code:
    """Apply a checked operation of one operand."""
    inner = operand.run

    def run(frame: Frame) -> Any:
        return operation(frame[0], inner(frame))

    return Code(run)


def binary(operation: Callable[[Any, Any, Any], Any], left: Code, right: Code) -> Code:
    """Apply a checked operation of two operands, left first."""
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


def fast_add(operation: Callable[[Any, Any, Any], Any], left: Code, right: Code) -> Code:
    """`left + right` where the right one is a slot: two ints are added on the spot."""
    first, j = left.run, right.slot
    if j is None:
        return binary(operation, left, right)

    def run(frame: Frame) -> Any:
        one, other = first(frame), frame[j]
        if type(one) is int and type(other) is int:
            total = one + other
            return total if -INT_LIMIT < total < INT_LIMIT else check_int(total)
        return operation(frame[0], one, other)

    return Code(run)


def fast_compare(
    operation: Callable[[Any, Any, Any], Any], of_ints: Callable[[Any, Any], bool], left: Code, right: Code
) -> Code:
    """A comparison where the right one is a slot: two ints are compared on the spot, by `of_ints`."""
    first, j = left.run, right.slot
    if j is None:
        return binary(operation, left, right)

    def run(frame: Frame) -> Any:
        one, other = first(frame), frame[j]
        if type(one) is int and type(other) is int:
            return of_ints(one, other)
        return operation(frame[0], one, other)

    return Code(run)


def is_none(operand: Code, *, wanted: bool) -> Code:
    """`operand is None` (or `is not None`)."""
    inner = operand.run
    if wanted:
        return Code(lambda frame: inner(frame) is None)
    return Code(lambda frame: inner(frame) is not None)


def call_function(function: Callable[..., Any], arguments: list[Code]) -> Code:
    """Call a builtin with the runtime and its arguments, in order."""
    runs = [argument.run for argument in arguments]
    slots = [argument.slot for argument in arguments]
    if not runs:
        return Code(lambda frame: function(frame[0]))
    if len(runs) == 1:
        return unary(function, arguments[0])
    if len(runs) == 2:
        return binary(function, arguments[0], arguments[1])
    if None not in slots and len(runs) == 3:
        i, j, k = slots
        return Code(lambda frame: function(frame[0], frame[i], frame[j], frame[k]))  # type: ignore[index]
    if len(runs) == 3:
        first, second, third = runs
        return Code(lambda frame: function(frame[0], first(frame), second(frame), third(frame)))
    return Code(lambda frame: function(frame[0], *[run(frame) for run in runs]))


def call_method(
    name: str, table: dict[type, Callable[..., Any]], subject: Code, arguments: list[Code], fault: Any
) -> Code:
    """Call the method that the table lists for the type of the subject; `fault(name, subject)` makes the refusal."""
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
