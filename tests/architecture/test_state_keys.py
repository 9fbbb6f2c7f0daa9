"""The keys of the ledger's state are written in consensus/state and in the contracts, and nowhere else."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from consensus.state.layout import LAYOUT

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("clients", "consensus", "network", "node", "pages")
STATE = Path("consensus", "state")
CONTRACTS = frozenset(rows.flat.partition(b"\x00")[0].decode() for rows in LAYOUT)
TO_BE_MOVED = frozenset(
    {
        "node/api/routes/notices.py",
        "node/api/standing.py",
        "node/candidacy.py",
        "node/consent_receipts.py",
        "node/directory.py",
        "node/offchain/chain_facts.py",
        "node/offchain/grantees.py",
        "node/offchain/robots.py",
    }
)
"""Files that still write keys by hand. None comes in; who moves one takes it out."""


def raw_keys(source: str) -> Iterator[str]:
    """Yield what in a module is a key written by hand: a literal, a name joined by a zero byte, or in parts to a call."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, bytes | str):
            text = node.value.decode("latin-1") if isinstance(node.value, bytes) else node.value
            name, zero, _ = text.partition("\x00")
            if zero and name in CONTRACTS:
                yield ast.unparse(node)
        elif isinstance(node, ast.BinOp) and _first(node) in CONTRACTS and b"\x00" in map(_value, ast.walk(node)):
            yield ast.unparse(node)
        elif isinstance(node, ast.Call) and len(node.args) > 1:
            name, key = _first(node.args[0]), _first(node.args[1])
            if name in CONTRACTS and isinstance(node.args[0], ast.Constant) and isinstance(key, bytes):
                yield ast.unparse(node)


def _value(node: ast.AST) -> object:
    return node.value if isinstance(node, ast.Constant) else None


def _first(node: ast.AST) -> object:
    """Return the literal with which a sum begins; bytes that say a contract's name as its text, without a zero byte."""
    while isinstance(node, ast.BinOp):
        node = node.left
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "encode":
        node = node.func.value
    value = _value(node)
    is_name = isinstance(value, bytes) and value.decode("latin-1") in CONTRACTS
    return value.decode() if is_name and isinstance(value, bytes) else value


def files_with_raw_keys() -> set[str]:
    paths = [path.relative_to(ROOT) for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    own = [path for path in paths if STATE not in path.parents]
    return {path.as_posix() for path in own if any(raw_keys((ROOT / path).read_text(encoding="utf-8")))}


def test_no_other_module_writes_keys_of_the_state_by_hand() -> None:
    assert files_with_raw_keys() - TO_BE_MOVED == set(), "Build them with consensus.state."


def test_whoever_writes_none_any_more_is_off_the_list() -> None:
    assert TO_BE_MOVED - files_with_raw_keys() == set()


@pytest.mark.parametrize(
    ("line", "is_key"),
    [
        ('KEY = b"records\\x00record/" + record_id', True),
        ('KEY = b"officers\\x00proposal-count"', True),
        ('KEY = f"identity\\x00member/{name}"', True),
        ('KEY = b"records" + b"\\x00" + name', True),
        ('KEY = "records".encode() + b"\\x00" + name', True),
        ('KEY = flat("identity", b"member/" + key)', True),
        ('KEY = state_value("records", b"announcement-count", key)', True),
        ('KEY = RECORD.key(record_id)', False),
        ('KEY = tagged_hash(b"padding\\x00", data)', False),
        ('KEY = call(key, "records", "record", [b"record/"])', False),
    ],
)  # fmt: skip
def test_a_key_is_found_however_it_is_put_together(line: str, is_key: bool) -> None:
    assert any(raw_keys(line)) == is_key
