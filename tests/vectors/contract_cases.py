"""What the golden vectors of contracts call: from here they are written. Run as a script it writes them anew.

What the calls come to is not decided here: see `contracts.vectors`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from consensus.primitives.keys import PrivateKey
from contracts import vectors

FOLDER = Path(__file__).resolve().parent / "contracts"

SOURCES = Path(__file__).resolve().parent / "sources"
STATEMENTS, LEDGER, CALLER = (
    (SOURCES / f"{name}.txt").read_text("utf-8") for name in ("statements", "ledger", "caller")
)

REFUSED = [
    "",
    "x",
    "import os\n",
    "RATE = 1.5\n",
    "@export\ndef f(a, b: set):\n    return a / 2\n",
    "@export\ndef f():\n\treturn 1\n",
    "@export\ndef f():\n    return f'{'a'}'\n",
    "type X = int\n",
    "def f[T](a):\n    pass\n",
    "@export\ndef f():\n    x = (1\n",
    "@export\ndef f():\n    return [*x]\n",
    "@export\ndef f():\n    x = 1 1\n",
    "@export\ndef f():\n    return f'{a}' + b\n",
    "@export\ndef f():\n    try:\n        pass\n    except A, B:\n        pass\n",
    "@export\ndef f():\n    return t'{a}'\n",
    "@export\ndef f():\n    return 'ä' + nobody\n",
    "@export\ndef f():\n    return f'{*a}'\n",
    "X = 2 ** 256\n",
    "X = 017\n",
    "@view\ndef f():\n    emit('e', {})\n",
    "@export\ndef f():\n    return '\\d' + \"\\N{BULLET}\"\n",
    "X = " + "(" * 17 + ")" * 17,
    "@migrate\ndef m(a: int):\n    pass\n@view\ndef v():\n    pass\n",
    "@export\ndef f():\n    return len(value=[1])\n",
]


def expression_contract(expressions: list[str]) -> str:
    return "\n".join(
        f"@export\ndef e{place}(a: object = 7):\n    return {one}\n" for place, one in enumerate(expressions)
    )


def lines_of(source: str) -> list[str]:
    return source.split("\n")


def read_expressions() -> dict[str, list[str]]:
    """Return the expressions by section: one a line, a section begins with '# name'."""
    found: dict[str, list[str]] = {}
    for line in (SOURCES / "expressions.txt").read_text("utf-8").splitlines():
        if line.startswith("# "):
            found[line[2:]] = []
        else:
            found[list(found)[-1]].append(line)
    return found


def expression_documents() -> dict[str, dict[str, Any]]:
    return {
        f"{name}.json": {
            "about": f"Expressions: {name}, one an entry.",
            "contracts": {"it": lines_of(expression_contract(expressions))},
            "calls": [{"call": f"it.e{place}"} for place in range(len(expressions))],
        }
        for name, expressions in read_expressions().items()
    }


def calls(contract: str, *rows: tuple[Any, ...]) -> list[dict[str, Any]]:
    """Rows are (entry, arguments, and what else the call says)."""
    return [
        {"call": f"{contract}.{row[0]}", "args": vectors.to_json(list(row[1])), **(row[2] if len(row) > 2 else {})}
        for row in rows
    ]


def statement_calls() -> list[dict[str, Any]]:
    wrong = [("wrong_items", [number]) for number in range(13)]
    arguments: list[tuple[Any, ...]] = [
        ("typed", [1]),
        ("typed", [1, "y", [2], {"k": b"v", "n": None}, (1, [2])]),
        ("typed", []),
        ("typed", ["1"]),
        ("typed", [True]),
        ("typed", [1, "y", ["2"]]),
        ("typed", [1, "y", [], {"k": 1}]),
        ("typed", [1, "y", [], {5: b""}]),
        ("typed", [1, 2, 3, 4, 5, 6]),
        ("typed", [2**256 - 1]),
        ("promises", [1]),
        ("promises", [None]),
        ("promises", ["x"]),
        ("nobody", []),
        ("helper", [1]),
    ]
    needs = [
        ("needs", [5]),
        ("needs", [1]),
        ("needs", [0, "MINE"]),
        ("needs", [0, "OUT_OF_GAS"]),
        ("needs", [0, "low"]),
        ("needs", [200]),
    ]
    tight = [("loops", [9], {"gas_limit": limit}) for limit in (0, 49, 60, 100, 200, 400, 600)]
    return calls(
        "statements",
        ("loops", [9]),
        ("loops", [0]),
        ("variables", [True]),
        ("variables", [False]),
        ("lists", []),
        ("calls", []),
        ("calls", []),
        ("grows", []),
        ("forgets", []),
        *wrong,
        *needs,
        *arguments,
        ("reads", [], {"mode": "view"}),
        ("reads", [], {"mode": "export"}),
        ("loops", [1], {"mode": "view"}),
        *tight,
    )


def ledger_calls() -> list[dict[str, Any]]:
    view = {"mode": "view"}
    signature = PrivateKey(b"\x07" * 32).sign("blockrobot/vector", b"message")
    high = signature[:32] + (2**256 - 1 - int.from_bytes(signature[32:64], "big")).to_bytes(32, "big") + signature[64:]
    deep: Any = []
    for _ in range(20):
        deep = [deep]
    stored = [None, True, -1, 2**64, -(2**200), "ä", b"\x00", [1, [2]], {"b": 1, "a": {b"x": 2, 3: 4}}, (1, 2)]
    return calls(
        "ledger",
        ("begin", [12], {"mode": "genesis", "gas_limit": 1_000_000}),
        ("begin", [1]),
        ("carry_over", []),
        ("carry_over", [], {"mode": "migrate"}),
        ("begin", [1], {"mode": "migrate"}),
        ("get", [b"new/" + bytes(4)], view),
        *[("put", [b"v%d" % place, value]) for place, value in enumerate(stored)],
        *[("get", [b"v%d" % place], view) for place in range(len(stored))],
        ("put", [b"", 1]),
        ("put", [b"x" * 129, 1]),
        ("put", [b"x" * 128, 1]),
        ("put", [b"k", "x" * 17_000]),
        ("put", [b"k", deep]),
        ("put", [b"k", {"z": 1, "a": 2}]),
        ("get", [5], view),
        ("get", [b"nothing", "default"], view),
        ("get", [b"nothing"], view),
        ("has", [b"k"], view),
        ("has", ["k"], view),
        ("delete", [b"k"]),
        ("delete", [b"k"]),
        ("scan", [b"item/", 256], view),
        ("scan", [b"", 3], view),
        ("scan", [b"v", 0], view),
        ("scan", [b"v", 257], view),
        ("scan", ["v", 1], view),
        ("scan", [b"v" * 200, 1], view),
        ("tell", ["named", {"k": [1, b"x", 2**100]}]),
        ("tell", ["", {}]),
        ("tell", ["e", 5]),
        ("tell", [5, {}]),
        ("tell", ["ä", {}]),
        ("tell", ["e", {"k": "x" * 9000}]),
        ("tell", ["e" * 65, {}]),
        ("both", [b"b"]),
        ("undone", [b"u"]),
        ("get", [b"u"], view),
        ("writes", [256]),
        ("writes", [257]),
        ("events", [64]),
        ("events", [65]),
        ("put", [b"k", 1], {"mode": "view"}),
        ("deep", [10]),
        ("deep", [20]),
        ("recurse", [20]),
        ("recurse", [500]),
        ("endless", []),
        ("endless", [], {"gas_limit": 1000}),
        ("fills", [], {"gas_limit": 50_000_000}),
        ("itself", []),
        ("spent_in_words", [300]),
        ("spent_in_words", [100_000]),
        ("recovered", ["blockrobot/vector", signature, b"message"], view),
        ("recovered", ["blockrobot/vector", signature, b"other"], view),
        ("recovered", ["blockrobot/vector", high, b"message"], view),
        ("recovered", ["blockrobot/vector", signature[:64], b"message"], view),
        ("recovered", ["blockrobot/vector", signature[:64] + b"\x09", b"message"], view),
        ("tries_to_write", [], view),
        ("sneaks", [True]),
        ("sneaks", [False]),
    )


def caller_calls() -> list[dict[str, Any]]:
    view = {"mode": "view"}
    return calls(
        "caller",
        ("relay", ["ledger", "put", [b"k", 5]]),
        ("relay", ["ledger", "get", [b"k"]]),
        ("ask", []),
        ("shares", [[5]]),
        ("relay", ["nobody", "f", []]),
        ("relay", ["ledger", "nothing", []]),
        ("relay", ["ledger", "put", [1, 2]]),
        ("relay", ["ledger", "put", [b"k"]]),
        ("relay", ["caller", "who", []]),
        ("relay", ["ledger", "undone", [b"k"]]),
        ("relay", ["ledger", "begin", [1]]),
        ("relay", ["ledger", "carry_over", []]),
        ("look", ["ledger", "put"], view),
        ("look", ["ledger", "get"], view),
        ("look", ["ledger", "put"]),
        ("relay", ["other", "relay", ["caller", "who"]]),
        ("relay", ["ledger", "endless", []]),
        ("relay", [5, "f", []]),
    )


def documents() -> dict[str, dict[str, Any]]:
    """Return every document but those of the shipped contracts, without outcomes, by file name."""
    ledger, caller = lines_of(LEDGER), lines_of(CALLER)
    return {
        **expression_documents(),
        "statements.json": {
            "about": "Statements, functions, arguments and codes.",
            "contracts": {"statements": lines_of(STATEMENTS)},
            "calls": statement_calls(),
        },
        "ledger.json": {
            "about": "State, events, budgets, signatures.",
            "contracts": {"ledger": ledger},
            "calls": ledger_calls(),
        },
        "calls.json": {
            "about": "Contracts that call contracts.",
            "contracts": {"ledger": ledger, "caller": caller, "other": caller},
            "calls": caller_calls(),
        },
        "refused.json": {
            "about": "Sources that no Python may accept, and what is said of them.",
            "refused": [{"source": source} for source in REFUSED],
        },
    }


if __name__ == "__main__":
    from tests.vectors import shipped_stories

    everything = documents() | shipped_stories.documents()
    vectors.write_vectors({name: vectors.play(document) for name, document in everything.items()}, FOLDER)
