"""In the contract machine nothing that grows with a contract's values is made before it is charged.

A function that has the runtime is read in the order in which Python runs it. What makes a new value out of given ones
(a comprehension, `list(...)`, `join`, a slice, `+` of two parameters ...) must come after memory was taken for it, on every
way to it. What is left out is listed with the reason.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2] / "contracts" / "vm"
CONVERSIONS = frozenset({"list", "tuple", "dict", "set", "sorted", "bytes", "bytearray", "encode_value"})
MAKING = frozenset(
    {"join", "replace", "split", "copy", "encode", "decode", "hex", "fromhex", "translate", "upper", "lower", "strip"}
    | {"lstrip", "rstrip", "to_bytes", "format", "extend", "update", "append", "insert", "put"}
)
CHARGING = frozenset(
    {"allocate", "list_of", "sorted_list", "iterate", "_charge_stripped", "charge_decoded", "read_stored"}
)
BOUNDED: dict[str, str] = {
    "methods._strip_left": "its callers take the memory of the whole text first",
    "methods._strip_right": "the same",
    "operations.charge_search": "one letter",
    "values.encode_walked": "at most 16 KiB: the walk before it ends at what may be encoded",
    "host._state_put": "at most 16 KiB, encoded and paid for",
    "host._emit": "at most 64 events, of 8 KiB each",
    "host._call": "as many arguments as stand in the source",
    "invoke._find": "the kinds of an entry, for a message",
    "invoke._copy_arguments": "as many arguments as stand in the source or in a transaction; what is in them is charged",
    "invoke._run": "as many parameters as stand in the source",
    "values.encode_checked": "an int: at most 33 bytes",
    "dict_shapes.encode_by_shape": "at most 32 keys and 16 KiB",
    "host._check_source": "a source of at most 60,000 bytes, paid for by the byte before",
    "closures.call_contract.run": "as many arguments as stand in the source",
    "closures.call_method.many": "the same",
    "compiler_expressions.ExpressionCompiler._joinedstr": "the references to as many parts as stand in the source",
    "compiler_expressions._user_call.run": "a frame: its room is counted in the depth of calls",
}
"""Functions in which something is made before memory is taken, and why that is bounded."""


class Reading:
    """One function, read in the order in which it runs; `found` are the lines that make something too early."""

    def __init__(self, function: ast.FunctionDef | ast.Lambda) -> None:
        typed = {"str", "int", "Runtime", "Frame"}
        self.given = {one.arg for one in function.args.args if getattr(one.annotation, "id", "") not in typed}
        if function.args.vararg is not None:
            self.given.add(function.args.vararg.arg)
        self.found: list[int] = []
        if isinstance(function, ast.Lambda):
            self._expression(function.body, charged=False)
        else:
            self._block(function.body, charged=False)

    def _block(self, body: list[ast.stmt], *, charged: bool) -> bool | None:
        """Return whether memory was taken at the end of a block; None if its end is never reached."""
        state: bool | None = charged
        for statement in body:
            if state is None:
                return None
            state = self._statement(statement, charged=state)
        return state

    def _statement(self, node: ast.stmt, *, charged: bool) -> bool | None:
        match node:
            case ast.FunctionDef():
                return charged
            case ast.Return() | ast.Raise():
                self._expressions(node, charged=charged)
                return None
            case ast.If():
                state = self._expression(node.test, charged=charged)
                if _is_of_ints(node.test):
                    self._block(node.body, charged=True)
                    return self._block(node.orelse, charged=state)
                ends = [self._block(part, charged=state) for part in (node.body, node.orelse)]
                return None if ends == [None, None] else all(end is not False for end in ends)
            case ast.For() | ast.While():
                state = self._expression(node.iter if isinstance(node, ast.For) else node.test, charged=charged)
                self._block(node.body, charged=state)
                return state
            case ast.Try():
                state = self._block(node.body, charged=charged)
                for handler in node.handlers:
                    self._block(handler.body, charged=charged)
                return state
            case ast.AugAssign(target=ast.Attribute(attr="memory")):
                return True
        return self._expressions(node, charged=charged)

    def _expressions(self, node: ast.AST, *, charged: bool) -> bool:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.expr):
                charged = self._expression(child, charged=charged)
        return charged

    def _expression(self, node: ast.AST, *, charged: bool) -> bool:
        """Read an expression, what is inside first; return whether memory was taken."""
        if isinstance(node, ast.Lambda):
            return charged
        if isinstance(node, ast.IfExp):
            charged = self._expression(node.test, charged=charged)
            ends = [self._expression(part, charged=charged) for part in (node.body, node.orelse)]
            return all(ends)
        comprehension = isinstance(node, ast.ListComp | ast.DictComp | ast.SetComp)
        for child in ast.iter_child_nodes(node):
            charged = self._expression(child, charged=charged)
        if isinstance(node, ast.Call) and self._name(node) in CHARGING:
            return True
        if not charged and (comprehension or self._makes(node)):
            self.found.append(getattr(node, "lineno", 0))
        return charged

    @staticmethod
    def _name(node: ast.Call) -> str:
        return node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")

    def _makes(self, node: ast.AST) -> bool:
        match node:
            case ast.Call(func=ast.Name(id=name), args=arguments):
                return name in CONVERSIONS and bool(arguments)
            case ast.Call(func=ast.Attribute(attr=name)):
                return name in MAKING
            case ast.Subscript(slice=ast.Slice(upper=upper), ctx=ast.Load()):
                return not isinstance(upper, ast.Constant)
            case ast.List() | ast.Tuple():
                return any(isinstance(item, ast.Starred) for item in node.elts)
            case ast.BinOp(left=ast.Name(id=left), op=ast.Add() | ast.Mult(), right=ast.Name(id=right)):
                return left in self.given and right in self.given
            case ast.FormattedValue(value=ast.Name(id=name)):
                return name in self.given
        return False


def _is_of_ints(test: ast.expr) -> bool:
    """Whether a test asks for an int: what is made of those has at most 256 bits."""
    match test:
        case ast.Compare(ops=[ast.Is()], comparators=[ast.Name(id="int")]):
            return True
    return False


def has_runtime(function: ast.FunctionDef) -> bool:
    """Whether a function runs in a call: it takes the runtime, or a frame, which has it."""
    return bool({argument.arg for argument in function.args.args} & {"runtime", "frame"})


def early(source: str, module: str) -> set[str]:
    """Return the functions of a source in which something is made before memory is taken for it."""
    found: set[str] = set()

    def look(node: ast.AST, path: str) -> None:
        for child in ast.iter_child_nodes(node):
            here = f"{path}.{child.name}" if isinstance(child, ast.FunctionDef | ast.ClassDef) else path
            reads = isinstance(child, ast.FunctionDef) and has_runtime(child)
            reads = reads or (isinstance(child, ast.Lambda) and [one.arg for one in child.args.args] == ["frame"])
            if reads and Reading(child).found:  # type: ignore[arg-type]
                found.add(here)
            look(child, here)

    look(ast.parse(source), module)
    return found


def test_nothing_is_made_before_it_is_charged():
    found = set().union(*(early(path.read_text("utf-8"), path.stem) for path in sorted(ROOT.rglob("*.py"))))
    assert found - set(BOUNDED) == set(), "take memory first, or say in BOUNDED what bounds it"
    assert set(BOUNDED) - found == set(), "no longer needed"


OLD_JOIN = """
def join_texts(runtime, parts):
    runtime.charge(2 + 2 * len(parts))
    text = "".join(parts)
    runtime.allocate(text_bytes(text))
    return text
"""
OLD_KEYS = """
def _keys(runtime, entries):
    runtime.charge(2 + (len(entries) >> 4))
    return allocate_list(runtime, list(entries))
"""
ONE_WAY = """
def f(runtime, left, right):
    if left:
        runtime.allocate(len(left))
    return left + right
"""


@pytest.mark.parametrize("source", [OLD_JOIN, OLD_KEYS, ONE_WAY, ONE_WAY.replace("left + right", "list(right)")])
def test_what_was_wrong_once_is_found(source):
    assert len(early(source, "it")) == 1


@pytest.mark.parametrize(
    "source",
    [
        ONE_WAY.replace("if left:\n        runtime", "runtime"),
        ONE_WAY.replace("    return", "    else:\n        raise Fault\n    return"),
        OLD_JOIN.replace('text = "".join(parts)\n    ', "").replace("return text", 'return "".join(parts)'),
    ],
)
def test_what_is_right_is_let_be(source):
    assert early(source, "it") == set()
