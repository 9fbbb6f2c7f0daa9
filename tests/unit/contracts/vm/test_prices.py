"""What the reference says that things cost is what they cost: each row of its table is tried.

A step's gas is told apart into what every node costs and what the row says beside that; both are worked out here from
the words of the reference alone.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from consensus.limits import CALL_GAS_MAX
from contracts.execution.executor import WIRE_BYTES_A_GAS
from contracts.vm import LANGUAGE_VERSION
from contracts.vm.builtins.host import (
    SOURCE_CHECK_BYTE_GAS,
    SOURCE_CHECK_GAS,
    SOURCE_KEPT_GAS,
    SOURCE_PART_BYTE_GAS,
)
from contracts.vm.frontend.name_binding import CALLABLES, dotted_name
from contracts.vm.model.meter import EVENTS_MAX_COUNT, MEMORY_MAX_BYTES, MIGRATE_WRITES_MAX_COUNT, WRITES_MAX_COUNT

REFERENCE = (Path(__file__).resolve().parents[4] / "docs" / "reference" / "contract-language.md").read_text("utf-8")
PRICES = REFERENCE.split("## What it costs")[1].split("## Codes")[0]


def memory(size: int) -> int:
    """The gas of an allocation of so many modelled bytes: "1, and 1 per 512 modelled bytes"."""
    return 1 + size // 512


LIST, TEXT = 64, 64
MANY = "x = [1] * 1000\n"
LONG = "x = 'a' * 1000\n"
DATA = "x = b'a' * 1000\n"
TABLE = "x = {i: i for i in range(100)}\n"
OTHER = "call('other', 'g', 1)"
# What the reference says, the lines before, the step, and its gas beside that of its nodes.
ROWS: tuple[tuple[str, str, str, int], ...] = (
    ("statement, expression node | 1 each", "", "y = 1 + 2", 0),
    ("call of anything, a dict with entries | +2", "", "y = abs(-5)", 0),
    ("`for` | +1; step of a loop", "", "for i in (1, 2, 3):\n    pass", 1 + memory(LIST + 3 * 24) + 2 + 3),
    ("loop / comprehension 1 / 3", MANY, "y = [1 for i in x]", (3 + 1 + 1) * 1000 - 1),
    ("`container[key] += value` +5", "x = [1]\n", "x[0] += 1", 5),
    ("`container[key]` +1", "x = [1]\n", "y = x[0]", 1),
    ("`container[key] = value` 2", "x = [1]\n", "x[0] = 1", 2),
    ("a name that is unpacked into 2", "x = (1, 2)\n", "y, z = x", 4),
    ("a comparison of several +2 each", "", "y = 1 < 2 < 3", 4),
    ("`// % ** << >> & \\| ^` +1", "", "y = 7 % 3", 1),
    ("function of the contract | 10, 1 per 32 variables and constants in it, and the body", "", "y = h(1)", 10 + 2),
    ("`append` 64", MANY, "x.append(1)", memory(64)),
    ("list or tuple 64 + 24 an item", "", "y = [1, 2, 3]", memory(LIST + 72)),
    ("dict entry 128", "", "y = {'a': 1, 'b': 2, 'c': 3, 'd': 4}", 2 + memory(64 + 4 * 128)),
    (
        "text and bytes 64 + length (4 a character if not ASCII)",
        "x = '\u20ac' * 1000\n",
        "y = x + x",
        4 + memory(TEXT + 8000),
    ),
    ("int to text 96", "", "y = str(5)", memory(96)),
    ("`==` of containers | 6 + 4 an item", MANY + "z = [1] * 1000\n", "y = x == z", 6 + 4 * 1000),
    ("of texts and bytes 1 per 1,024 (beyond ASCII: per 256)", "x = 'a' * 5000\nz = 'a' * 5000\n", "y = x == z", 4),
    ("`in`, `index`, `remove` of a list | 1 + 3 an item", MANY, "y = 2 in x", 1 + 3 * 1000),
    ("slice | 12", LONG, "y = x[1:]", 13 + memory(TEXT + 999)),
    ("`startswith`, `endswith` 1 + 1 per 1,024", "x = 'a' * 5000\n", "y = x.startswith(x)", 1 + 4),
    ("`+` of lists and tuples | 1 per 64 items, and the memory", MANY, "y = x + x", 2000 // 64 + memory(LIST + 48_000)),
    ("5 + 1 per 16 items", MANY, "y = list(x)", 5 + 1000 // 16 + memory(LIST + 24_000)),
    ("(of a range: per 4; of a dict 3 more)", "", "y = list(range(1000))", 1 + 5 + 5 + 250 + memory(LIST + 24_000)),
    ("an int looked for in a dict of more than 256", "x = {i: i for i in range(640)}\n", "y = 1 in x", 10),
    ("`del` of an entry, `pop` of a key | 3", TABLE, "del x[5]", 3),
    ("`range` 5", "", "y = range(3)", 5 + memory(64)),
    ("`u32`, `u64` 3", "", "y = u32(3)", 3 + memory(64 + 4)),
    ("`to_bytes` 4", "x = 5\n", "y = x.to_bytes(3)", 4 + memory(64 + 3)),
    ("`get` of a dict 1", TABLE, "y = x.get(1)", 1),
    ("a loop over a dict 3", TABLE, "for i in x:\n    break", 1 + 3 + memory(LIST + 2400) + 1),
    ("`setdefault` 2", TABLE, "y = x.setdefault(1, 2)", 2),
    ("`*` of what is no int 4", LONG, "y = x * 3", 4 + memory(TEXT + 3000)),
    (
        "3 + 1 per 1,024 (beyond ASCII: per 32)",
        "x = '\u20ac' * 5000\nz = '\u20ac' * 5000\n",
        "y = x < z",
        3 + 5000 // 32,
    ),
    ("(beyond ASCII: per 256)", "x = '\u20ac' * 5000\nz = '\u20ac' * 5000\n", "y = x == z", 5000 // 256),
    ("`zip` 4 + 4 a column + 1 a row", "", "y = zip((), ())", 2 * (1 + 5 + 1) + 4 + 8 + 1),
    ("`sum` 1 + 2 an item", MANY, "y = sum(x)", 5 + 1000 // 16 + memory(LIST + 24_000) + 1 + 2000),
    ("`any`, `all` 1 per 8", MANY, "y = all(x)", 5 + 1000 // 16 + memory(LIST + 24_000) + 125),
    ("`join` 4 + 2 a part", "x = ['a'] * 1000\n", "y = ''.join(x)", 4 + 2000 + memory(TEXT + 1000)),
    ("an f-string 4 + 3 a part", LONG, "y = f'{x}b{x}'", 4 + 3 * 3 + memory(TEXT + 2001)),
    ("`upper`, `lower` | 1 + 1 per 64 characters", LONG, "y = x.upper()", 1 + 1000 // 64 + memory(TEXT + 1000)),
    ("`decode` 1 + 1 per 128", DATA, "y = x.decode()", 1 + 1000 // 128 + memory(TEXT + 4000)),
    ("`hex` 1 + 1 per 64", DATA, "y = x.hex()", 1 + 1000 // 64 + memory(TEXT + 2000)),
    ("`fromhex` 3 + 1 per 16", LONG, "y = bytes.fromhex(x)", 3 + 62 + memory(TEXT + 1000)),
    ("`insert` | 3 + 1 per 256 items", MANY, "x.insert(0, 1)", 3 + 1000 // 256 + memory(64)),
    ("`pop(i)`, `reverse` 1 + 1 per 256", MANY, "x.reverse()", 1 + 1000 // 256),
    ("`del` of a list 1 per 256", MANY, "del x[0]", 1000 // 256),
    ("`keys`, `values` 2 + 1 per 16", TABLE, "y = x.keys()", 2 + 100 // 16 + memory(LIST + 2400)),
    ("`items` 2 + 1 per 2", TABLE, "y = x.items()", 2 + 100 // 2 + memory(LIST + 100 * (24 + 64 + 48))),
    ("`**` 8", "x = 3\n", "y = x ** x", 1 + 8),
    ("`int(text)` 16", "x = '12'\n", "y = int(x)", 16),
    ("`state.has` 15", "", "y = state.has(b'k')", 15),
    ("`state.get` | 15 + 1 per 256 stored bytes", "", "y = state.get(b'k')", 15),
    ("`state.delete` 120", "", "state.delete(b'k')", 120),
    ("`state.put` | 120 + 1 per 8 bytes of key and value", DATA, "state.put(b'k', x)", 120 + (1 + 1003) // 8),
    ("`emit` | 50 + 1 per 16 bytes", "", "emit('name', {})", memory(64) + 4 + 50),
    (
        "`sha256` / `tagged_hash` | 15 / 30, + 1 per 64 bytes",
        DATA,
        "y = sha256(x)",
        15 + 1000 // 64 + memory(TEXT + 32),
    ),
    ("`sha256` / `tagged_hash` | 15 / 30", DATA, "y = tagged_hash('t', x)", 30 + 1000 // 64 + memory(TEXT + 32)),
    ("`recover` | 680 + 1 per 64 bytes", DATA, "y = recover('t', b'', x)", 680 + 1000 // 64 + memory(TEXT + 33)),
    ("`remove` 1 per 256 items of the list", "x = [5] * 1000\n", "x.remove(5)", 1 + 3 + 1000 // 256),
    ("`get` of a dict 1, `update` 6", TABLE, "x.update(x)", 6 + memory(100 * 128)),
    ("`state.scan` | 120", "", "y = state.scan(b'k', 5)", 120),
    ("1 per write of this call", "state.put(b'k', 1)\nstate.delete(b'k')\n", "y = state.scan(b'k', 5)", 120 + 2),
    ("from 64 characters on +1 per 256 for one letter", LONG, "y = x.find('b')", 6 + 1000 // 256),
    ("which look for all of them: per 32", LONG, "y = x.count('b')", 6 + 1000 // 32),
    ("for longer parts +1 per 32", LONG, "y = x.find('bb')", 6 + 1000 // 32),
    ("`split` searches twice", LONG, "y = x.split('bb')", 6 + 2 * (1000 // 32) + 4 + memory(TEXT + 24 + 64 + 1000)),
    ("`replace` three times", LONG, "y = x.replace('bb', '')", 6 + 3 * (1000 // 32) + 10 + memory(TEXT + 1000)),
    (
        "sorting, `min`, `max` | 9 + n / 4 + n / 16 +",
        MANY,
        "x.sort()",
        9 + 1000 // 4 + 1000 // 16 + 1000 * 10 // 12 + memory(LIST + 24_000),
    ),
    ("`strip` and its kin | 5 + 10 per 64 characters", LONG, "y = x.strip()", 5 + 2 * 10 + memory(TEXT + 1000)),
    (
        "one for each 2 characters to strip if one is beyond ASCII",
        LONG + "z = '\u0161' * 64\n",
        "y = x.strip(z)",
        5 + 2 * (10 + 32) + memory(TEXT + 1000),
    ),
    ("at each use | 4 + 2 an item, 4 + 3 an entry", "", "y = CONSTANT", 8 + 8 + 6 + 3 * memory(LIST + 48)),
    ("walking a value (stored, emitted) | list 2 + 3 an item", MANY, "state.put(b'k', x)", 2 + 3000 + 120 + 1004 // 8),
    ("dict 4 + 4 an entry", TABLE, "state.put(b'k', x)", 4 + 400 + 120 + 204 // 8),
    (
        "copying a value (passed, returned) | list 2 + 2 an item",
        MANY,
        "call('other', 'g', x)",
        58 + 2 + 2000 + memory(LIST + 24_000),
    ),
    (
        "reading a stored value",
        MANY + "state.put(b'k', x)\n",
        "y = state.get(b'k')",
        15 + 1003 // 256 + 24_064 // 256 + 2 + 1000,
    ),
    (
        "`state.scan` | 120 + 1 per write of this call, and per entry 16",
        "state.put(b'k', 1)\n",
        "y = state.scan(b'', 9)",
        120 + 1 + 16 + memory(2 * 64 + 3 * 24 + 1),
    ),
    ("entering an entry | 30; by `call` +15; 1 a parameter, +1", "", OTHER, 30 + 15 + 1 + 1 + 10 + 1),
)


def static(step: str) -> int:
    """One for a statement and for an expression node, two more for a call; a name that is assigned to is free."""
    count = 0
    for node in ast.walk(ast.parse(step)):
        if isinstance(node, ast.Call):
            named = isinstance(node.func, ast.Name) or dotted_name(node.func) in CALLABLES
            count += 2 - (1 if isinstance(node.func, ast.Name) else 2 if named else 1)
        free = isinstance(node, ast.Slice | ast.FormattedValue) or isinstance(
            getattr(node, "ctx", None), ast.Store | ast.Del
        )
        count += isinstance(node, ast.stmt | ast.expr) and not free
    return count


@pytest.mark.parametrize(("words", "before", "step", "beside"), ROWS, ids=[row[2] for row in ROWS])
def test_a_row(run, bench, words, before, step, beside):
    assert words in PRICES
    bench.deploy("other", "@export\ndef g(x: object):\n    pass\n")
    helper = "CONSTANT = [[1, 2], [3]]\n\n\ndef h(x):\n    return x\n"
    without, found = (run(before + more, before=helper) for more in ("pass", "pass\n" + step))
    assert (without.ok, found.ok) == (True, True), found
    assert found.gas_used - without.gas_used == static(step) + beside


def test_budgets_and_prices_of_bytes_and_sources_are_those_of_the_code():
    told = PRICES.split("Budgets of one call")[1]
    numbers = {f"{number:,}" for number in (CALL_GAS_MAX, WRITES_MAX_COUNT, EVENTS_MAX_COUNT, MEMORY_MAX_BYTES >> 20)}
    assert numbers <= set(re.findall(r"[0-9][0-9,]*[0-9]|[0-9]", told))
    assert f"up to {MIGRATE_WRITES_MAX_COUNT:,} state writes" in REFERENCE
    assert f"(now {LANGUAGE_VERSION})" in PRICES
    assert f"| transaction | 1 per {WIRE_BYTES_A_GAS} of its bytes on the wire" in PRICES
    assert (
        f"| `charge_source` | {SOURCE_PART_BYTE_GAS} a byte; `check_source` {SOURCE_CHECK_GAS:,} + "
        f"{SOURCE_CHECK_BYTE_GAS} a byte, with {SOURCE_KEPT_GAS:,} more to be left |" in PRICES
    )


def test_every_row_of_the_table_is_tried():
    """A row that nobody tries is one that nobody would notice to be wrong. Two are tried below."""
    rows = [line for line in PRICES.split("\n") if line.startswith("| ") and not line.startswith("| Item")]
    assert {row.split(" | ")[0].strip("| ") for row in rows if not any(words in row for words, *_ in ROWS)} == {
        "`charge_source`",
        "transaction",
    }
