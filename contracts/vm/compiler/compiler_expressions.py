"""Compiles checked expressions to closures.

Static cost (one unit per node, two more per call) gathers in `cost`; the enclosing block charges it.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable
from typing import Any

from contracts.vm.builtins.builtins_table import TYPES, join_texts, text_of
from contracts.vm.builtins.host import CONTEXT_FIELDS
from contracts.vm.builtins.operations import (
    ARITHMETIC,
    BINARY,
    COMPARE,
    ORDER,
    UNARY,
    add,
    equal,
    get_item,
    get_slice,
    is_short_text,
    iterate,
    not_equal,
    unpack,
)
from contracts.vm.frontend.name_binding import CALLABLES, Bound, FunctionFacts, bind, bind_method, dotted_name
from contracts.vm.model.closures import (
    FIRST_FREE_SLOT,
    RESULT_SLOT,
    Code,
    Frame,
    add_to_bytes,
    binary,
    call_contract,
    call_function,
    call_method,
    equals_text,
    fast_arithmetic,
    fast_compare,
    gather,
    get_named,
    is_none,
    length_is,
    length_of,
    read_slot,
    read_variable,
    unary,
)
from contracts.vm.model.faults import CALL_DEPTH, TYPE_ERROR, Fault
from contracts.vm.model.meter import ALLOCATION_GAS, ALLOCATION_SHIFT
from contracts.vm.model.values import (
    DICT_ENTRY_BYTES,
    DICT_KEY_MAX_CHARS,
    HEADER_BYTES,
    ITEM_BYTES,
    UNSET,
    charge_key,
    fresh_constant,
    is_mutable,
    type_name,
)

CALL_NODE_GAS = 2
FUNCTION_GAS = 10
SLOTS_SHIFT = 5
"""A call costs one unit more for each 32 (2 to this power) variables and constants of the function."""
COMPREHENSION_STEP_GAS = 3
UNPACKED_GAS = 2
CHAIN_STEP_GAS = 2
ITEM_GAS = 1
DICT_DISPLAY_GAS = 2


class FunctionCode:
    """A compiled function; `body` is filled in later, allowing mutual calls."""

    __slots__ = ("body", "depth", "name", "param_count", "tail")

    def __init__(self, name: str, param_count: int) -> None:
        self.name = name
        self.param_count = param_count
        self.body: Callable[[Frame], Any] = _unfinished
        self.tail: list[Any] = []
        self.depth = 0


def _unfinished(frame: Frame) -> Any:
    raise AssertionError(f"a function ran before it was compiled ({len(frame)} slots)")


class Scope:
    """Frame slots of one function's names and constants."""

    def __init__(self, facts: FunctionFacts) -> None:
        self.initial: list[Any] = []
        self._next = FIRST_FREE_SLOT
        self.slots: dict[str, int] = {}
        self._constants: dict[tuple[type, Any], int] = {}
        self.definite: set[int] = set()
        for name in facts.params:
            self.slots[name] = self._next
            self.definite.add(self._next)
            self._next += 1
        for name in sorted(facts.local_names - set(facts.params)):
            self.slots[name] = self.new_slot()

    def new_slot(self, initial: Any = UNSET) -> int:
        self.initial.append(initial)
        self._next += 1
        return self._next - 1

    def constant(self, value: Any) -> int:
        """Return an immutable constant's slot; tuples are matched by identity."""
        key = (tuple, id(value)) if type(value) is tuple else (type(value), value)
        if key not in self._constants:
            self._constants[key] = self.new_slot(value)
        return self._constants[key]


class ExpressionCompiler:
    """Compiles the expressions of one function."""

    def __init__(self, constants: dict[str, Any], functions: dict[str, FunctionFacts], codes: dict[str, FunctionCode],
                 defaults: dict[str, list[Any]], scope: Scope) -> None:  # fmt: skip
        self.constants = constants
        self.functions = functions
        self.codes = codes
        self.defaults = defaults
        self.scope = scope
        self.cost = 0
        self._by_type: dict[type[ast.expr], Callable[[Any], Code]] = {
            ast.Constant: self._constant, ast.Name: self._name, ast.BinOp: self._binop, ast.UnaryOp: self._unaryop,
            ast.BoolOp: self._boolop, ast.Compare: self._compare, ast.IfExp: self._ifexp, ast.Call: self._call,
            ast.Attribute: self._attribute, ast.Subscript: self._subscript, ast.List: self._list,
            ast.Tuple: self._tuple, ast.Dict: self._dict, ast.ListComp: self._listcomp,
            ast.GeneratorExp: self._listcomp, ast.DictComp: self._dictcomp, ast.JoinedStr: self._joinedstr,
        }  # fmt: skip

    def expression(self, node: ast.expr) -> Code:
        self.cost += 1
        return self._by_type[type(node)](node)

    def constant(self, value: Any) -> Code:
        """Compile a constant; lists and dicts are built anew each time."""
        if is_mutable(value):
            return Code(lambda frame: fresh_constant(frame[0], value))
        return read_slot(self.scope.constant(value), value)

    def _constant(self, node: ast.Constant) -> Code:
        return self.constant(node.value)

    def _name(self, node: ast.Name) -> Code:
        slot = self.scope.slots.get(node.id)
        if slot is None:
            return self.constant(self.constants[node.id])
        return read_slot(slot) if slot in self.scope.definite else read_variable(slot, node.id)

    def _binop(self, node: ast.BinOp) -> Code:
        operation = BINARY[type(node.op).__name__]
        left, right = self.expression(node.left), self.expression(node.right)
        if operation is add and left.gives is bytes:
            return add_to_bytes(operation, left, right)
        of_ints = ARITHMETIC.get(operation)
        self.cost += of_ints is None
        return binary(operation, left, right) if of_ints is None else fast_arithmetic(operation, of_ints, left, right)

    def _unaryop(self, node: ast.UnaryOp) -> Code:
        operand = self.expression(node.operand)
        if isinstance(node.op, ast.Not):
            inner = operand.run
            return Code(lambda frame: not inner(frame))
        return unary(UNARY[type(node.op).__name__], operand)

    def _boolop(self, node: ast.BoolOp) -> Code:
        runs = [self.expression(value).run for value in node.values]
        last = runs.pop()
        stop_at = isinstance(node.op, ast.Or)
        if len(runs) == 1:
            first = runs[0]
            if stop_at:
                return Code(lambda frame: first(frame) or last(frame))
            return Code(lambda frame: first(frame) and last(frame))

        def run(frame: Frame) -> Any:
            for part in runs:
                value = part(frame)
                if bool(value) is stop_at:
                    return value
            return last(frame)

        return Code(run)

    def _compare(self, node: ast.Compare) -> Code:
        operands = [self.expression(part) for part in (node.left, *node.comparators)]
        if len(node.ops) == 1:
            return self._comparison(node.ops[0], operands[0], operands[1])
        self.cost += CHAIN_STEP_GAS * len(node.ops)
        holders = [self.scope.new_slot() for _ in operands]
        tests = [
            self._comparison(op, read_slot(holders[place]), read_slot(holders[place + 1])).run
            for place, op in enumerate(node.ops)
        ]
        values = [operand.run for operand in operands]

        def run(frame: Frame) -> bool:
            frame[holders[0]] = values[0](frame)
            for place, test in enumerate(tests):
                frame[holders[place + 1]] = values[place + 1](frame)
                if not test(frame):
                    return False
            return True

        return Code(run)

    def _comparison(self, op: ast.cmpop, left: Code, right: Code) -> Code:
        if isinstance(op, ast.Is | ast.IsNot):
            return is_none(left, wanted=isinstance(op, ast.Is))
        operation = COMPARE[type(op).__name__]
        if operation in (equal, not_equal) and is_short_text(right.constant):
            return equals_text(left, right.constant, wanted=operation is equal)
        if operation is equal and left.measures is not None and type(right.constant) is int:
            return length_is(CALLABLES["len"].run, left, right.constant)
        of_ints = operator.eq if operation is equal else ORDER.get(type(op).__name__)
        return binary(operation, left, right) if of_ints is None else fast_compare(operation, of_ints, left, right)

    def _ifexp(self, node: ast.IfExp) -> Code:
        test, body, orelse = (self.expression(part).run for part in (node.test, node.body, node.orelse))
        return Code(lambda frame: body(frame) if test(frame) else orelse(frame))

    def _attribute(self, node: ast.Attribute) -> Code:
        return CONTEXT_FIELDS[node.attr]

    def _subscript(self, node: ast.Subscript) -> Code:
        container = self.expression(node.value)
        self.cost += ITEM_GAS
        if not isinstance(node.slice, ast.Slice):
            key = self.expression(node.slice)
            if type(key.constant) is str:
                return get_named(get_item, container, key.constant)
            return binary(get_item, container, key)
        nothing = read_slot(self.scope.constant(None))
        start = nothing if node.slice.lower is None else self.expression(node.slice.lower)
        stop = nothing if node.slice.upper is None else self.expression(node.slice.upper)
        return call_function(get_slice, [container, start, stop], self.scope.new_slot)

    def _items(self, nodes: list[ast.expr]) -> tuple[list[Callable[[Frame], Any]], int]:
        return [self.expression(element).run for element in nodes], HEADER_BYTES + ITEM_BYTES * len(nodes)

    def _list(self, node: ast.List) -> Code:
        runs, size = self._items(node.elts)
        gas = ALLOCATION_GAS + (size >> ALLOCATION_SHIFT)

        def run(frame: Frame) -> list[Any]:
            runtime = frame[0]
            runtime.memory -= size
            runtime.gas -= gas
            if runtime.memory < 0 or runtime.gas < 0:
                runtime.exhausted()
            return [part(frame) for part in runs] if runs else []

        return Code(run)

    def _tuple(self, node: ast.Tuple) -> Code:
        runs, size = self._items(node.elts)

        def run(frame: Frame) -> tuple[Any, ...]:
            frame[0].allocate(size)
            return tuple([part(frame) for part in runs])

        return Code(run)

    def _dict(self, node: ast.Dict) -> Code:
        size = HEADER_BYTES + DICT_ENTRY_BYTES * len(node.keys)
        self.cost += DICT_DISPLAY_GAS if node.keys else 0
        values = [self.expression(value) for value in node.values]
        if all(_is_plain_key(key) for key in node.keys):
            self.cost += len(node.keys)
            names = [key.value for key in node.keys if isinstance(key, ast.Constant)]
            read = gather(values, self.scope.new_slot)
            gas = ALLOCATION_GAS + (size >> ALLOCATION_SHIFT)

            def run_named(frame: Frame) -> dict[Any, Any]:
                runtime = frame[0]
                runtime.memory -= size
                runtime.gas -= gas
                if runtime.memory < 0 or runtime.gas < 0:
                    runtime.exhausted()
                return dict(zip(names, read(frame))) if names else {}  # noqa: B905 - as many as names; `strict` takes time

            return Code(run_named)
        entries = [(self.expression(key).run, value.run) for key, value in zip(node.keys, values, strict=True) if key]

        def run(frame: Frame) -> dict[Any, Any]:
            frame[0].allocate(size)
            result: dict[Any, Any] = {}
            for name, value in entries:
                key = name(frame)
                charge_key(frame[0], result, key)
                result[key] = value(frame)
            return result

        return Code(run)

    def _joinedstr(self, node: ast.JoinedStr) -> Code:
        parts: list[Callable[[Frame], str]] = []
        for part in node.values:
            inner = part.value if isinstance(part, ast.FormattedValue) else part
            parts.append(unary(text_of, self.expression(inner)).run)
        return Code(lambda frame: join_texts(frame[0], [part(frame) for part in parts]))

    def _listcomp(self, node: ast.ListComp | ast.GeneratorExp) -> Code:
        source = self.expression(node.generators[0].iter).run
        outer = self._enter_comprehension(node.generators[0])
        bind_item, tests = outer[0], outer[1]
        element = self.expression(node.elt).run
        cost = self._leave_comprehension(outer)

        def run(frame: Frame) -> list[Any]:
            runtime = frame[0]
            result: list[Any] = []
            for item in iterate(runtime, source(frame)):
                runtime.charge(cost)
                bind_item(frame, item)
                if all_pass(tests, frame):
                    runtime.allocate(HEADER_BYTES)
                    result.append(element(frame))
            return result

        return Code(run)

    def _dictcomp(self, node: ast.DictComp) -> Code:
        source = self.expression(node.generators[0].iter).run
        outer = self._enter_comprehension(node.generators[0])
        bind_item, tests = outer[0], outer[1]
        name, value = self.expression(node.key).run, self.expression(node.value).run
        cost = self._leave_comprehension(outer)

        def run(frame: Frame) -> dict[Any, Any]:
            runtime = frame[0]
            result: dict[Any, Any] = {}
            for item in iterate(runtime, source(frame)):
                runtime.charge(cost)
                bind_item(frame, item)
                if all_pass(tests, frame):
                    key = name(frame)
                    charge_key(runtime, result, key)
                    runtime.allocate(DICT_ENTRY_BYTES)
                    result[key] = value(frame)
            return result

        return Code(run)

    def _enter_comprehension(self, generator: ast.comprehension) -> tuple[Any, ...]:
        before, cost = dict(self.scope.slots), self.cost
        self.cost = COMPREHENSION_STEP_GAS
        elements = generator.target.elts if isinstance(generator.target, ast.Tuple) else [generator.target]
        slots: list[int] = []
        for element in elements:
            assert isinstance(element, ast.Name)
            slot = self.scope.new_slot()
            self.scope.slots[element.id] = slot
            self.scope.definite.add(slot)
            slots.append(slot)
        unpacks = isinstance(generator.target, ast.Tuple)
        self.cost += UNPACKED_GAS * len(slots) if unpacks else 0
        bind_item = bind_many(slots) if unpacks else bind_one(slots[0])
        tests = [self.expression(test).run for test in generator.ifs]
        return bind_item, tests, before, cost

    def _leave_comprehension(self, entered: tuple[Any, ...]) -> int:
        cost = self.cost
        self.scope.slots, self.cost = entered[2], entered[3]
        return cost

    def _call(self, node: ast.Call) -> Code:
        self.cost += CALL_NODE_GAS
        name = dotted_name(node.func)
        if name == "isinstance":
            return self._isinstance(node)
        if name is not None and name in CALLABLES:
            builtin = CALLABLES[name]
            bound = bind(builtin.params, builtin.required, node, variadic=builtin.variadic)
            assert isinstance(bound, Bound)
            if name == "len":
                assert bound.arguments[0] is not None
                return length_of(builtin.run, self.expression(bound.arguments[0]))
            arguments = [self.expression(part) for part in bound.arguments if part is not None]
            compile_call = call_contract if name == "call" else call_function
            return compile_call(builtin.run, arguments, self.scope.new_slot)
        if name is not None and name in self.functions:
            return self._function_call(node, name)
        assert isinstance(node.func, ast.Attribute)
        methods = bind_method(node.func.attr, node)
        assert isinstance(methods, dict)
        subject = self.expression(node.func.value)
        bound = next(iter(methods.values()))[1]
        arguments = [self.expression(part) for part in bound.arguments if part is not None]
        table = {kind: method.run for kind, (method, _) in methods.items()}
        return call_method(node.func.attr, table, subject, arguments, _method_fault)

    def _isinstance(self, node: ast.Call) -> Code:
        assert isinstance(node.args[1], ast.Name)
        value, kind = self.expression(node.args[0]).run, TYPES[node.args[1].id]
        return Code(lambda frame: type(value(frame)) is kind)

    def _function_call(self, node: ast.Call, name: str) -> Code:
        facts, function = self.functions[name], self.codes[name]
        bound = bind(facts.params, facts.required, node)
        assert isinstance(bound, Bound)
        parts: list[Code] = []
        for place in range(len(facts.params)):
            given = bound.arguments[place] if place < len(bound.arguments) else None
            if given is not None:
                parts.append(self.expression(given))
            else:
                parts.append(self.constant(self.defaults[name][place - facts.required]))
        return Code(_user_call(function, gather(parts, self.scope.new_slot)))


def _user_call(function: FunctionCode, read: Callable[[Frame], tuple[Any, ...]]) -> Callable[[Frame], Any]:
    def run(frame: Frame) -> Any:
        runtime = frame[0]
        arguments = read(frame)
        runtime.depth -= function.depth
        if runtime.depth < 0:
            raise Fault(CALL_DEPTH, "Functions call each other too deep.")
        inner = [runtime, None, *runtime.context_values, *arguments, *function.tail]
        function.body(inner)
        runtime.depth += function.depth
        return inner[RESULT_SLOT]

    return run


def _is_plain_key(node: ast.expr | None) -> bool:
    return isinstance(node, ast.Constant) and type(node.value) is str and len(node.value) <= DICT_KEY_MAX_CHARS


def _method_fault(name: str, value: Any) -> Fault:
    return Fault(TYPE_ERROR, f"A {type_name(value)} has no method {name} with these arguments.")


def all_pass(tests: list[Callable[[Frame], Any]], frame: Frame) -> bool:
    for test in tests:  # noqa: SIM110 - a generator would cost a frame of its own
        if not test(frame):
            return False
    return True


def bind_one(slot: int) -> Callable[[Frame, Any], None]:
    def run(frame: Frame, item: Any) -> None:
        frame[slot] = item

    return run


def bind_many(slots: list[int]) -> Callable[[Frame, Any], None]:
    count = len(slots)

    def run(frame: Frame, item: Any) -> None:
        values = unpack(frame[0], item, count)
        for place, slot in enumerate(slots):
            frame[slot] = values[place]

    return run
