"""The keys of the ledger's state are written in consensus/state and in the contracts' sources, and nowhere else."""

from __future__ import annotations

import ast
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from consensus.state.layout import LAYOUT

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("clients", "consensus", "contracts", "network", "node", "pages")
OWN = (Path("consensus", "state"), Path("contracts", "privacy"), Path("contracts", "system"))
CONTRACTS = frozenset(rows.flat.partition(b"\x00")[0].decode() for rows in LAYOUT)


def raw_keys(source: str) -> Iterator[str]:
    """Yield what in a module is a key written by hand: a literal, a name joined by a zero byte, or in parts to a call."""
    tree = ast.parse(source)
    names = {
        target.id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
        for target in node.targets
        if isinstance(target, ast.Name)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, bytes | str):
            text = node.value.decode("latin-1") if isinstance(node.value, bytes) else node.value
            name, zero, _ = text.partition("\x00")
            if zero and name in CONTRACTS:
                yield ast.unparse(node)
        elif isinstance(node, ast.BinOp) and b"\x00" in map(_value, ast.walk(node)):
            if _first(node, names) in CONTRACTS:
                yield ast.unparse(node)
        elif isinstance(node, ast.Call) and len(node.args) > 1:
            name, key = _first(node.args[0], {}), _first(node.args[1], {})
            if name in CONTRACTS and isinstance(node.args[0], ast.Constant) and isinstance(key, bytes):
                yield ast.unparse(node)


def _value(node: ast.AST) -> object:
    return node.value if isinstance(node, ast.Constant) else None


def _first(node: ast.AST, names: Mapping[str, ast.Constant]) -> object:
    """Return the literal with which a sum begins, also by one of the module's own `names`.

    Bytes that say a contract's name are its text, without a zero byte.
    """
    while isinstance(node, ast.BinOp):
        node = node.left
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "encode":
        node = node.func.value
    value = _value(names.get(node.id, node) if isinstance(node, ast.Name) else node)
    is_name = isinstance(value, bytes) and value.decode("latin-1") in CONTRACTS
    return value.decode() if is_name and isinstance(value, bytes) else value


def files_with_raw_keys() -> set[str]:
    paths = [path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    others = [path for path in paths if not any(folder in path.parents for folder in OWN)]
    return {path.as_posix() for path in others if any(raw_keys((ROOT / path).read_text(encoding="utf-8")))}


def test_no_other_module_writes_keys_of_the_state_by_hand() -> None:
    assert files_with_raw_keys() == set(), "Build them with consensus.state."


@pytest.mark.parametrize(
    ("line", "is_key"),
    [
        ('KEY = b"records\\x00record/" + record_id', True),
        ('KEY = b"officers\\x00proposal-count"', True),
        ('KEY = f"identity\\x00member/{name}"', True),
        ('KEY = b"records" + b"\\x00" + name', True),
        ('KEY = "records".encode() + b"\\x00" + name', True),
        ('HERE = "records"\nKEY = HERE.encode() + b"\\x00" + name', True),
        ('KEY = flat("identity", b"member/" + key)', True),
        ('KEY = state_value("records", b"announcement-count", key)', True),
        ('KEY = RECORD.key(record_id)', False),
        ('KEY = tagged_hash(b"padding\\x00", data)', False),
        ('KEY = call(key, "records", "record", [b"record/"])', False),
    ],
)  # fmt: skip
def test_a_key_is_found_however_it_is_put_together(line: str, is_key: bool) -> None:
    assert any(raw_keys(line)) == is_key
