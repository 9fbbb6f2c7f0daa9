"""The contract language under plain CPython: `exec` with a small shim for the ledger and the documented differences.

Only tests do this. What the reference names as different from Python is put into the tree before it runs: limits of 256
bits, `+=` that makes a new list, generators computed whole, keys and pairs as lists, texts that know ASCII only.
"""

from __future__ import annotations

import ast
import copy
import operator
import re
import warnings
from typing import Any

LIMIT = 1 << 256
BINARY = {
    "Add": operator.add, "Sub": operator.sub, "Mult": operator.mul, "FloorDiv": operator.floordiv, "Mod": operator.mod,
    "Pow": operator.pow, "LShift": operator.lshift, "RShift": operator.rshift, "BitAnd": operator.and_,
    "BitOr": operator.or_, "BitXor": operator.xor,
}  # fmt: skip


class TooLargeError(Exception):
    pass


class RequiredError(Exception):
    pass


def limited(value: Any) -> Any:
    if type(value) is int and not -LIMIT < value < LIMIT:
        raise TooLargeError
    return value


def calculate(name: str, left: Any, right: Any) -> Any:
    if type(left) is int and type(right) is int:
        if name in ("Pow", "LShift", "RShift") and right < 0:
            raise ValueError
        if name in ("Pow", "LShift") and right > 600 and left not in (0, 1, -1):
            raise TooLargeError
    elif bool in (type(left), type(right)):
        raise TypeError
    return limited(BINARY[name](left, right))


class Differences(ast.NodeTransformer):
    """Puts the documented differences into a program's tree."""

    def visit_BinOp(self, node: ast.BinOp) -> ast.AST:
        self.generic_visit(node)
        return call("_calculate", ast.Constant(type(node.op).__name__), node.left, node.right)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.AST:
        self.generic_visit(node)
        return node if isinstance(node.op, ast.Not) else call("_limited", node)

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        self.generic_visit(node)
        name = ast.Constant(type(node.op).__name__)
        if isinstance(node.target, ast.Name):
            old = ast.Name(node.target.id, ast.Load())
            return ast.Assign([node.target], call("_calculate", name, old, node.value))
        assert isinstance(node.target, ast.Subscript)
        later = ast.Lambda(ast.arguments([], [], None, [], [], None, []), node.value)
        return ast.Expr(call("_update", name, node.target.value, node.target.slice, later))

    def visit_GeneratorExp(self, node: ast.GeneratorExp) -> ast.AST:
        self.generic_visit(node)
        return ast.ListComp(node.elt, node.generators)

    def visit_For(self, node: ast.For) -> ast.AST:
        self.generic_visit(node)
        node.iter = call("_snapshot", node.iter)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        self.generic_visit(node)
        node.decorator_list = []
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.func, ast.Attribute) and node.func.attr in METHODS:
            return call("_method", ast.Constant(node.func.attr), node.func.value, *node.args)
        return node


def call(name: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])


def update(name: str, container: Any, key: Any, value: Any) -> None:
    before = container[key]
    container[key] = calculate(name, before, value())


def ascii_case(text: str, first: str, last: str, change: int) -> str:
    return "".join(chr(ord(one) + change) if first <= one <= last else one for one in text)


SPACE = " \t\n\r\x0b\x0c"
METHODS: dict[str, Any] = {
    "keys": lambda table: list(table.keys()),
    "values": lambda table: list(table.values()),
    "items": lambda table: list(table.items()),
    "upper": lambda text: ascii_case(text, "a", "z", -32),
    "lower": lambda text: ascii_case(text, "A", "Z", 32),
    "isdigit": lambda text: re.fullmatch(r"[0-9]+", text) is not None,
    "isalpha": lambda text: re.fullmatch(r"[A-Za-z]+", text) is not None,
    "isalnum": lambda text: re.fullmatch(r"[A-Za-z0-9]+", text) is not None,
    "isupper": lambda text: text.isascii() and text.isupper(),
    "islower": lambda text: text.isascii() and text.islower(),
    "strip": lambda text, characters=SPACE: text.strip(characters),
    "lstrip": lambda text, characters=SPACE: text.lstrip(characters),
    "rstrip": lambda text, characters=SPACE: text.rstrip(characters),
    "insert": lambda items, index, item: items.insert(max(min(index, len(items)), -len(items)), item),
    "split": lambda text, separator=" ": text.split(separator),
}


def pop(subject: Any, *arguments: Any) -> Any:
    """Python says of an index beyond 64 bits that it overflows; the language that no such item is there."""
    try:
        return subject.pop(*arguments)
    except OverflowError:
        raise IndexError from None


METHODS["pop"] = pop
OWN = {"upper": str, "lower": str, "isdigit": str, "isalpha": str, "isalnum": str, "isupper": str, "islower": str}


def method(name: str, subject: Any, *arguments: Any) -> Any:
    if name in OWN and type(subject) is not OWN[name]:
        raise TypeError
    return METHODS[name](subject, *arguments)


def whole(value: Any) -> int:
    if type(value) is str and re.fullmatch(r"[+-]?[0-9]{1,78}", value, re.ASCII) is None:
        raise ValueError
    return int(limited(int(value)))


class Whole:
    """`int` of the language: a function, and `int.from_bytes`."""

    from_bytes = staticmethod(int.from_bytes)

    def __call__(self, value: Any) -> int:
        return whole(value)


class State:
    def __init__(self) -> None:
        self.entries: dict[bytes, Any] = {}

    def get(self, key: bytes, default: Any = None) -> Any:
        return copy.deepcopy(self.entries[key]) if key in self.entries else default

    def put(self, key: bytes, value: Any) -> None:
        self.entries[key] = plain(value)


def plain(value: Any) -> Any:
    """Return a value as it crosses a border: copied, tuples as lists."""
    if type(value) in (list, tuple):
        return [plain(item) for item in value]
    if type(value) is dict:
        return {key: plain(item) for key, item in value.items()}
    return value


def is_a(value: Any, kind: Any) -> bool:
    return type(value) is (int if isinstance(kind, Whole) else kind)


def total(values: Any) -> int:
    result = 0
    for value in values:
        result = calculate("Add", result, value)
        if type(value) is not int:
            raise TypeError
    return result


def run_plainly(source: str, arguments: list[Any]) -> tuple[str, Any, list[Any], dict[bytes, Any]]:
    """Return (code, result, events, state) of a program's entry `f` under CPython."""
    state, events = State(), []

    def require(condition: Any, code: str) -> None:
        if not condition:
            raise RequiredError(code)

    names: dict[str, Any] = {
        "_calculate": calculate, "_limited": limited, "_update": update, "_method": method, "state": state,
        "_snapshot": lambda values: list(values) if type(values) is dict else values, "require": require,
        "emit": lambda name, data: events.append((name, plain(data))), "int": Whole(), "isinstance": is_a, "sum": total,
        "enumerate": lambda values, start=0: list(enumerate(values, start)),
        "zip": lambda *columns: list(zip(*columns, strict=False)),
        "reversed": lambda values: list(values)[::-1], "u32": lambda value: value.to_bytes(4, "big"),
    }  # fmt: skip
    tree = ast.fix_missing_locations(Differences().visit(ast.parse(source)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exec(compile(tree, "contract", "exec"), names)  # the oracle of a test
    try:
        return "OK", plain(names["f"](*arguments)), events, state.entries
    except RequiredError as fault:
        return str(fault), None, [], {}
    except TooLargeError:
        return "INT_OVERFLOW", None, [], {}
    except tuple(CODES) as error:
        code = next(code for kind, code in CODES.items() if isinstance(error, kind))
        return code, None, [], {}


CODES: dict[type[Exception], str] = {
    ZeroDivisionError: "ZERO_DIVISION", KeyError: "KEY_ERROR", IndexError: "INDEX_ERROR", NameError: "NAME_UNSET",
    OverflowError: "VALUE_ERROR", ValueError: "VALUE_ERROR", TypeError: "TYPE_ERROR", AttributeError: "TYPE_ERROR",
}  # fmt: skip
