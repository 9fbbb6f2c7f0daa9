"""The contract language under plain CPython: `exec` with a small shim for the ledger and the documented differences.

Only tests do this. What the reference names as different from Python is put into the tree before it runs: limits of 256
bits, `+=` that makes a new list, generators computed whole, keys and pairs as lists, texts that know ASCII only.
"""

from __future__ import annotations

import ast
import copy
import hashlib
import operator
import re
import warnings
from types import SimpleNamespace
from typing import Any

from consensus.primitives.encoding import encode_value

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


def same(left: Any, right: Any) -> bool:
    """Values of different types are never equal; so are items."""
    if type(left) is not type(right):
        return False
    if type(left) in (list, tuple):
        return len(left) == len(right) and all(same(*pair) for pair in zip(left, right, strict=True))
    if type(left) is dict:
        return left.keys() == right.keys() and all(same(value, right[key]) for key, value in left.items())
    return bool(left == right)


def order(apply: Any) -> Any:
    def compared(left: Any, right: Any) -> bool:
        if type(left) is not type(right) or type(left) not in (int, str, bytes):
            raise TypeError
        return bool(apply(left, right))

    return compared


def contains(item: Any, container: Any) -> bool:
    if type(container) in (list, tuple):
        return any(same(one, item) for one in container)
    if type(container) is bytes and type(item) is int:
        return item in list(container)
    if type(item) is bool or (type(container) is range and type(item) is not int):
        raise TypeError
    return item in container


COMPARE: dict[str, Any] = {
    "Eq": same, "NotEq": lambda left, right: not same(left, right), "Lt": order(operator.lt), "LtE": order(operator.le),
    "Gt": order(operator.gt), "GtE": order(operator.ge), "In": contains,
    "NotIn": lambda item, container: not contains(item, container), "Is": operator.is_, "IsNot": operator.is_not,
}  # fmt: skip


def compare(names: str, *operands: Any) -> bool:
    """A chain: each operand is computed once, and those behind the first that fails not at all."""
    left = operands[0]()
    for name, operand in zip(names.split(), operands[1:], strict=True):
        right = operand()
        if not COMPARE[name](left, right):
            return False
        left = right
    return True


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
        return ast.Expr(call("_update", name, node.target.value, node.target.slice, later(node.value)))

    def visit_Compare(self, node: ast.Compare) -> ast.AST:
        self.generic_visit(node)
        names = " ".join(type(one).__name__ for one in node.ops)
        return call("_compare", ast.Constant(names), *[later(one) for one in (node.left, *node.comparators)])

    def visit_Name(self, node: ast.Name) -> ast.AST:
        """A constant that holds a list or dict is made anew each time it is used."""
        constant = node.id.isupper() and isinstance(node.ctx, ast.Load)
        return call("_anew", node) if constant else node

    def visit_Assign(self, node: ast.Assign) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.targets[0], ast.Tuple):
            node.value = call("_row", node.value)
        return node

    def visit_comprehension(self, node: ast.comprehension) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.target, ast.Tuple):
            node.iter = call("_rows", node.iter)
        return node

    def visit_GeneratorExp(self, node: ast.GeneratorExp) -> ast.AST:
        self.generic_visit(node)
        return ast.ListComp(node.elt, node.generators)

    def visit_For(self, node: ast.For) -> ast.AST:
        self.generic_visit(node)
        node.iter = call("_snapshot", node.iter)
        if isinstance(node.target, ast.Tuple):
            node.iter = call("_rows", node.iter)
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        self.generic_visit(node)
        node.decorator_list = []
        defaults, node.args.defaults = node.args.defaults, [ast.Name("_unset", ast.Load()) for _ in node.args.defaults]
        for one, default in zip(reversed(node.args.args), reversed(defaults), strict=False):
            unset = ast.Compare(ast.Name(one.arg, ast.Load()), [ast.Is()], [ast.Name("_unset", ast.Load())])
            node.body.insert(0, ast.If(unset, [ast.Assign([ast.Name(one.arg, ast.Store())], default)], []))
        return node

    def visit_Call(self, node: ast.Call) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.func, ast.Attribute) and node.func.attr == "fromhex":
            return call("_from_hex", *node.args)
        if isinstance(node.func, ast.Attribute) and node.func.attr in METHODS:
            named = call("_method", ast.Constant(node.func.attr), node.func.value, *node.args)
            named.keywords = node.keywords
            return named
        return node


def call(name: str, *arguments: ast.expr) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])


def row(value: Any) -> Any:
    """Only a list or tuple is unpacked."""
    if type(value) not in (list, tuple):
        raise TypeError
    return value


def from_hex(text: str) -> bytes:
    """Python takes spaces between the pairs."""
    if type(text) is str and re.fullmatch("[0-9A-Fa-f]*", text) is None:
        raise ValueError
    return bytes.fromhex(text)


def later(node: ast.expr) -> ast.expr:
    return ast.Lambda(ast.arguments([], [], None, [], [], None, []), node)


def update(name: str, container: Any, key: Any, value: Any) -> None:
    before = container[key]
    container[key] = calculate(name, before, value())


def ascii_case(text: str, first: str, last: str, change: int) -> str:
    return "".join(chr(ord(one) + change) if first <= one <= last else one for one in text)


SPACE = " \t\n\r\x0b\x0c"


def space_of(text: Any) -> Any:
    return SPACE if type(text) is str else SPACE.encode()


def find_same(items: Any, wanted: Any) -> int:
    if type(items) not in (list, tuple):
        raise TypeError
    return next((place for place, item in enumerate(items) if same(item, wanted)), -1)


def index_of(items: Any, wanted: Any) -> int:
    place = find_same(items, wanted)
    if place < 0:
        raise ValueError
    return place


def remove(items: Any, wanted: Any) -> None:
    del items[index_of(items, wanted)]


def sort(items: Any, reverse: bool = False) -> None:
    items[:] = in_order(items, reverse=reverse)


def in_order(items: Any, *, reverse: bool = False) -> list[Any]:
    """`sorted` takes only ints, only texts or only bytes."""
    found = list(items)
    if len({type(item) for item in found}) > 1 or any(type(item) not in (int, str, bytes) for item in found):
        raise TypeError
    return sorted(found, reverse=reverse)


METHODS: dict[str, Any] = {
    "index": index_of,
    "sort": sort,
    "remove": remove,
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
    "strip": lambda text, characters=None: text.strip(space_of(text) if characters is None else characters),
    "lstrip": lambda text, characters=None: text.lstrip(space_of(text) if characters is None else characters),
    "rstrip": lambda text, characters=None: text.rstrip(space_of(text) if characters is None else characters),
    "insert": lambda items, index, item: items.insert(max(min(index, len(items)), -len(items)), item),
    "split": lambda text, separator=None: text.split(
        (" " if type(text) is str else b" ") if separator is None else separator
    ),
}


def pop(subject: Any, *arguments: Any) -> Any:
    """Python says of an index beyond 64 bits that it overflows; the language that no such item is there."""
    try:
        return subject.pop(*arguments)
    except OverflowError:
        raise IndexError from None


METHODS["pop"] = pop
OWN = {"upper": str, "lower": str, "isdigit": str, "isalpha": str, "isalnum": str, "isupper": str, "islower": str}


def method(name: str, subject: Any, *arguments: Any, **named: Any) -> Any:
    if name in OWN and type(subject) is not OWN[name]:
        raise TypeError
    return METHODS[name](subject, *arguments, **named)


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
        self.entries[key] = stored(value)

    def has(self, key: bytes) -> bool:
        return key in self.entries

    def delete(self, key: bytes) -> None:
        self.entries.pop(key, None)

    def scan(self, prefix: bytes, limit: int) -> list[list[Any]]:
        keys = [key for key in sorted(self.entries) if key.startswith(prefix)]
        return [[key, copy.deepcopy(self.entries[key])] for key in keys[:limit]]


def plain(value: Any) -> Any:
    """Return a value as it crosses a border: copied, tuples as lists."""
    if type(value) in (list, tuple):
        return [plain(item) for item in value]
    if type(value) is dict:
        return {key: plain(item) for key, item in value.items()}
    return value


def stored(value: Any) -> Any:
    """Return a value as the state gives it back: the keys of dicts in the order of their encoding."""
    if type(value) in (list, tuple):
        return [stored(item) for item in value]
    if type(value) is dict:
        return {key: stored(value[key]) for key in sorted(value, key=encode_value)}
    return value


def is_a(value: Any, kind: Any) -> bool:
    return type(value) is (int if isinstance(kind, Whole) else kind)


CONTEXT = SimpleNamespace(
    caller=b"c" * 33, height=1, time=2, txid=b"t" * 32, chain=b"i" * 32, contract="it", calling_contract=""
)


def tagged(tag: str, data: bytes) -> bytes:
    head = hashlib.sha256(tag.encode()).digest()
    return hashlib.sha256(head + head + data).digest()


def call_other(contract: str, entry: str, value: Any) -> Any:
    """What the other contract does, which random programs call."""
    value = plain(value)
    return total(value) if entry == "total" else value if entry == "echo" else None


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

    def require(condition: Any, code: str, message: str = "") -> None:
        if not condition:
            raise RequiredError(code)

    names: dict[str, Any] = {
        "_calculate": calculate, "_limited": limited, "_update": update, "_method": method, "state": state,
        "_snapshot": lambda values: list(values) if type(values) is dict else values, "require": require,
        "emit": lambda name, data: events.append((name, plain(data))), "int": Whole(), "isinstance": is_a, "sum": total,
        "enumerate": lambda values, start=0: list(enumerate(values, start)),
        "zip": lambda *columns: list(zip(*columns, strict=False)),
        "reversed": lambda values: list(values)[::-1], "u32": lambda number: number.to_bytes(4, "big"),
        "u64": lambda number: number.to_bytes(8, "big"), "_compare": compare, "_anew": copy.deepcopy, "_unset": object(),
        "_row": row, "_rows": lambda values: (row(value) for value in values), "_from_hex": from_hex,
        "sorted": in_order, "ctx": CONTEXT, "call": call_other, "sha256": lambda data: hashlib.sha256(data).digest(),
        "tagged_hash": tagged, "recover": lambda tag, signature, message: None,
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
