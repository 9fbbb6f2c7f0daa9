"""What must come out the same in every process: nothing asks whether two values are one object, or the order of a set.

A value that went through pickle, a file or a socket equals the one that was sent and is not that one; and the order of a
set of texts or of objects differs between processes. So identity is asked of what can be only one (None, a class, a
member of an enum, a sentinel, an object with a life of its own), and sets are sorted before anything is made of them.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path

import pytest

from tests.architecture.trees import nodes_of, tree_of

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("consensus", "contracts", "node", "clients", "network", "pages")
DIALECT_FOLDERS = (ROOT / "contracts" / "privacy", ROOT / "contracts" / "system")
REPLAYED = ("consensus", "contracts", "node", "network/sim", "network/byzantine")
"""What the simulator replays bit for bit, and what nodes have to agree on."""
BESIDE_THE_SIMULATOR = ("node/p2p/", "node/snapshot/")
"""Sockets and files, which the simulator replaces."""


def modules(*packages: str) -> tuple[tuple[Path, ast.Module], ...]:
    paths = (path for package in packages for path in sorted((ROOT / package).rglob("*.py")))
    return tuple((path, tree_of(path)) for path in paths if path.parent not in DIALECT_FOLDERS)


# Identity


def is_singleton(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and (node.value is None or isinstance(node.value, bool) or node.value is ...)


def is_value(node: ast.expr, values: frozenset[str] = frozenset()) -> bool:
    """Tell whether an expression is a text, number, tuple or the like: what may be equal and yet another object."""
    match node:
        case ast.Constant():
            return not is_singleton(node)
        case ast.Name(id=name):
            return name in values
        case ast.Attribute(value=ast.Name(id=module), attr=name) if module.islower():
            return name in values
        case ast.Call(func=ast.Name(id=name)):
            return name in {"str", "int", "bytes", "tuple", "frozenset", "float", "len"}
        case _:
            literals = (ast.UnaryOp, ast.BinOp, ast.JoinedStr, ast.Tuple, ast.List, ast.Dict, ast.Set)
            return isinstance(node, literals)


@cache
def value_constants() -> frozenset[str]:
    """Return the names of module-level constants that are values; of a name that stands in two modules, one is enough."""
    found: set[str] = set()
    for _, tree in modules(*PACKAGES):
        for item in tree.body:
            match item:
                case (
                    ast.Assign(targets=[ast.Name(id=name)], value=value)
                    | ast.AnnAssign(target=ast.Name(id=name), value=ast.expr() as value)
                ) if is_value(value):
                    found.add(name)
    return frozenset(found)


def identities_of_values(tree: ast.AST, values: frozenset[str]) -> Iterator[ast.Compare]:
    """Yield the comparisons by identity one side of which is a value, and the other one no singleton."""
    for node in ast.walk(tree):
        if not isinstance(node, ast.Compare):
            continue
        sides = [node.left, *node.comparators]
        for operator, left, right in zip(node.ops, sides, sides[1:], strict=False):
            is_identity = isinstance(operator, ast.Is | ast.IsNot) and not (is_singleton(left) or is_singleton(right))
            if is_identity and (is_value(left, values) or is_value(right, values)):
                yield node


def test_no_value_is_told_from_another_by_identity() -> None:
    assert [
        f"{path.relative_to(ROOT)}:{node.lineno} {ast.unparse(node)}"
        for path, tree in modules(*PACKAGES)
        for node in identities_of_values(tree, value_constants())
    ] == []


def test_no_struct_leaves_its_defaults_out() -> None:
    """With `omit_defaults` msgspec tells a default by identity: a value that was unpickled is written otherwise."""
    assert [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path, _ in modules(*PACKAGES)
        for node in nodes_of(path)
        if isinstance(node, ast.keyword) and node.arg == "omit_defaults"
    ] == []


ADDRESSES_THAT_DECIDE_NOTHING = {
    # The key of a dictionary which keeps the object, so that nothing else can have that address.
    "contracts/vm/compiler/compiler_expressions.py constant",
    "contracts/kit/recorder.py _texts_of",
    "node/process_memory.py wipe",  # where a secret is overwritten
}


def test_addresses_and_salted_hashes_decide_nothing_that_is_replayed() -> None:
    found = {
        f"{path.relative_to(ROOT)} {function.name}"
        for path, _ in modules(*REPLAYED)
        for function in nodes_of(path)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        for node in ast.walk(function)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in {"id", "hash"}
    }
    assert found == ADDRESSES_THAT_DECIDE_NOTHING


# Sets

SETS = {"set", "frozenset", "Set", "AbstractSet", "MutableSet", "KeysView"}
UNORDERED = {"sorted", "set", "frozenset", "len", "any", "all", "sum", "union"}
ORDERED = {"list", "tuple", "iter", "enumerate", "join", "extend", "map", "next"}
MAKES_SETS = {"union", "intersection", "difference", "symmetric_difference"}


def is_set_type(annotation: ast.expr | None) -> bool:
    match annotation:
        case ast.Name(id=name) | ast.Subscript(value=ast.Name(id=name)):
            return name in SETS
        case ast.BinOp(left=left, right=right):
            return is_set_type(left) or is_set_type(right)
        case _:
            return False


def names_of_sets(tree: ast.AST, *, attributes: bool) -> frozenset[str]:
    """Return the attributes and functions of a module, or else the local names of a function, that are sets."""
    found: set[str] = set()
    for node in ast.walk(tree):
        match node:
            case ast.AnnAssign(target=target, annotation=annotation) if is_set_type(annotation):
                found.add(name_of(target, attributes=attributes))
            case ast.Assign(targets=[target], value=value) if is_set(value, frozenset()):
                found.add(name_of(target, attributes=attributes))
            case ast.arg(arg=name, annotation=annotation) if not attributes and is_set_type(annotation):
                found.add(name)
            case ast.FunctionDef(name=name, returns=annotation) if attributes and is_set_type(annotation):
                found.add(name)
    return frozenset(found - {""})


def name_of(target: ast.expr, *, attributes: bool) -> str:
    match target:
        case ast.Attribute(value=ast.Name(id="self"), attr=name) if attributes:
            return f"self.{name}"
        case ast.Name(id=name) if not attributes:
            return name
        case _:
            return ""


def is_set(node: ast.expr, names: frozenset[str]) -> bool:
    """Tell whether an expression gives a set of something other than small numbers, as far as its text shows."""
    match node:
        case ast.Set() | ast.SetComp():
            return True
        case ast.Call(func=ast.Name(id=name)):
            return name in {"set", "frozenset"} or name in names
        case ast.Call(func=ast.Attribute(attr=name)):
            return name in MAKES_SETS or name in names
        case ast.Name() | ast.Attribute(value=ast.Name(id="self")):
            return ast.unparse(node) in names
        case ast.BinOp(op=ast.BitOr() | ast.BitAnd() | ast.Sub() | ast.BitXor(), left=left, right=right):
            return any(is_set(side, names) or is_keys(side) for side in (left, right))
        case _:
            return False


def is_keys(node: ast.expr) -> bool:
    return isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in {"keys", "items"}


def orders_of_sets(tree: ast.Module) -> Iterator[ast.AST]:
    """Yield where the order of a set decides: a loop over it, or a list, text or generator made of it."""
    of_module = names_of_sets(tree, attributes=True)
    loose = [item for item in tree.body if not isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)]
    functions = [[item] for item in ast.walk(tree) if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef)]
    bodies: list[Sequence[ast.AST]] = [loose, *functions]
    for body in bodies:
        local = [names_of_sets(statement, attributes=False) for statement in body]
        yield from orders_within(body, of_module.union(*local))


def orders_within(body: Sequence[ast.AST], names: frozenset[str]) -> Iterator[ast.AST]:
    nodes = [node for statement in body for node in ast.walk(statement)]
    harmless = {
        each for node in nodes if isinstance(node, ast.Call) and called(node) in UNORDERED for each in node.args
    }
    for node in nodes:
        if isinstance(node, ast.Call) and called(node) in ORDERED and node not in harmless:
            sources: list[ast.expr] = node.args
        elif isinstance(node, ast.For | ast.AsyncFor) and not only_cancels(node):
            sources = [node.iter]
        elif isinstance(node, ast.ListComp | ast.GeneratorExp | ast.DictComp) and node not in harmless:
            sources = [each.iter for each in node.generators]
        else:
            continue
        if any(is_set(source, names) for source in sources):
            yield node


def called(node: ast.Call) -> str:
    return node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")


def only_cancels(loop: ast.For | ast.AsyncFor) -> bool:
    """Tell whether a loop does nothing but end tasks, which happens when a node stops."""
    return [ast.unparse(statement) for statement in loop.body] == [f"{ast.unparse(loop.target)}.cancel()"]


def test_the_order_of_a_set_decides_nothing_that_is_replayed() -> None:
    found = {
        f"{path.relative_to(ROOT)}:{getattr(node, 'lineno', 0)} {ast.unparse(node).splitlines()[0]}"
        for path, tree in modules(*REPLAYED)
        if not str(path.relative_to(ROOT)).startswith(BESIDE_THE_SIMULATOR)
        for node in orders_of_sets(tree)
    }
    assert found == set()


@pytest.mark.parametrize("text", ["point is not 'now'", "data is -1", "name is DEFAULT_POINT", "profile is str(text)"])
def test_the_check_finds_an_identity_of_values(text: str) -> None:
    assert list(identities_of_values(ast.parse(text), frozenset({"DEFAULT_POINT"})))


@pytest.mark.parametrize("text", ["a is None", "getattr(a, 'b') is not None", "kind is Kind.VOTE", "x is MISSING"])
def test_the_check_lets_an_identity_of_what_there_is_one_of_pass(text: str) -> None:
    assert not list(identities_of_values(ast.parse(text), frozenset({"VOTE"})))


@pytest.mark.parametrize(
    "text",
    [
        "for name in {one, other}: send(name)",
        "def f(names: set[str]) -> list[str]:\n    return [name for name in names]",
        "def f(names: frozenset[bytes]) -> bytes:\n    return b''.join(names)",
        "def f(a, b):\n    return list(a.keys() | b.keys())",
        "class A:\n    def __init__(self): self.names: set[str] = set()\n    def f(self): return tuple(self.names)",
    ],
)
def test_the_check_finds_the_order_of_a_set(text: str) -> None:
    assert list(orders_of_sets(ast.parse(text)))


@pytest.mark.parametrize(
    "text",
    [
        "for name in sorted({one, other}): send(name)",
        "def f(names: set[str]) -> bool:\n    return any(name for name in names)",
        "def f(names: list[str]) -> list[str]:\n    return [name for name in names]",
        "def f(tasks: set[Task]) -> None:\n    for task in tasks:\n        task.cancel()",
    ],
)
def test_the_check_lets_pass_what_no_order_decides(text: str) -> None:
    assert not list(orders_of_sets(ast.parse(text)))
