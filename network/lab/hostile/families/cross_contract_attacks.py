"""Attacks between contracts: re-entrance, borrowed rights, calls into views."""

from __future__ import annotations

from network.lab.hostile.program import SPENT, Program, body, source

_BACK = "@export\ndef f():\n    return call('it', 'f')\n\n\n@view\ndef look():\n    return call('it', 'g')\n"
_WRITER = (
    "@export\ndef write(x: object = 1):\n    state.put(b'k', x)\n\n\n"
    "@view\ndef read() -> object:\n    return state.get(b'k')\n"
)
_VIEW = "@view\ndef f() -> object:\n    return call('deep', 'write')\n"
_SPOILER = "@export\ndef spoil(x: list) -> list:\n    x.append(666)\n    x[0].append(1)\n    return x\n"
_LIAR = "@export\ndef f() -> int:\n    return 'no number'\n"
_FAILS = "@export\ndef f():\n    state.put(b'k', 1)\n    emit('done', {})\n    require(False, 'NO_WAY')\n"
_CHAIN = {f"c{n}": f"@export\ndef f():\n    return call('c{n + 1}', 'f')\n" for n in range(1, 80)}
_FLOOD = "@export\ndef f():\n    for i in range(30):\n        state.put(u32(i), i)\n        emit('x', {})\n"


def _beside(name: str, expect: str, text: str, other: str) -> Program:
    return body(name, expect, text, others={"other": other})


PROGRAMS: tuple[Program, ...] = (
    _beside("re-entered", "REENTRANT", "return call('other', 'f')", _BACK),
    _beside("re-entered-at-another-entry", "REENTRANT", "return call('other', 'look')", _BACK),
    body(
        "re-entered-through-three",
        "REENTRANT",
        "return call('a', 'f')",
        others={"a": _CHAIN["c1"].replace("c2", "b"), "b": _BACK},
    ),
    body("calls-itself", "REENTRANT", "return call('it', 'f')"),
    body("calls-itself-by-a-view", "REENTRANT", "return call('it', 'g')", before="@view\ndef g():\n    pass\n"),
    body("calls-deeper-and-deeper", "CALL_DEPTH", "return call('c1', 'f')", others=_CHAIN),
    _beside("calls-without-end", SPENT, "while True:\n    call('other', 'read')", _WRITER),
    _beside(
        "calls-with-large-arguments",
        SPENT,
        "x = [bytes(1000)] * 1000\nwhile True:\n    call('other', 'write', x)",
        "@export\ndef write(x: list):\n    pass\n",
    ),
    _beside("calls-with-many-arguments", "ARGUMENTS_INVALID", "call('other', 'write', 1, 2, 3, 4, 5, 6)", _WRITER),
    body("calls-nobody", "ENTRY_UNKNOWN", "call('nobody', 'f')"),
    body("calls-nobody-with-a-long-name", "ENTRY_UNKNOWN", "call('n' * 10 ** 6, 'f' * 10 ** 6)"),
    _beside(
        "calls-a-helper", "ENTRY_UNKNOWN", "call('other', 'g')", "@export\ndef f():\n    pass\n\n\ndef g():\n    pass\n"
    ),
    _beside("calls-genesis", "ENTRY_UNKNOWN", "call('other', 'f')", "@genesis\ndef f():\n    state.put(b'k', 1)\n"),
    _beside("calls-a-dunder", "ENTRY_UNKNOWN", "call('other', '__init__')", _WRITER),
    body("calls-a-list", "TYPE_ERROR", "call([], {})"),
    _beside(
        "calls-with-itself-as-argument", "ARGUMENTS_INVALID", "x = []\nx.append(x)\ncall('other', 'write', x)", _WRITER
    ),
    _beside("calls-with-a-range", "ARGUMENTS_INVALID", "call('other', 'write', range(5))", _WRITER),
    source(
        "view-writes-through-another",
        "VIEW_WRITES",
        "@view\ndef f() -> object:\n    return call('other', 'write')\n",
        others={"other": _WRITER},
        mode="view",
    ),
    source(
        "view-writes-through-a-view",
        "VIEW_WRITES",
        "@view\ndef f() -> object:\n    return call('middle', 'f')\n",
        others={"middle": _VIEW, "deep": _WRITER},
        mode="view",
    ),
    body(
        "export-writes-through-a-view",
        "VIEW_WRITES",
        "return call('middle', 'f')",
        others={"middle": _VIEW, "deep": _WRITER},
    ),
    source(
        "view-emits-through-another",
        "VIEW_WRITES",
        "@view\ndef f() -> object:\n    return call('other', 'f')\n",
        others={"other": "@export\ndef f():\n    emit('a', {})\n"},
        mode="view",
    ),
    source(
        "view-called-back-to-write",
        "REENTRANT",
        "@view\ndef f() -> object:\n    return call('other', 'ask')\n\n\n"
        "@export\ndef write():\n    state.put(b'k', 1)\n",
        others={"other": "@view\ndef ask() -> object:\n    return call('it', 'write')\n"},
        mode="view",
    ),
    body(
        "view-called-back-to-look",
        "REENTRANT",
        "state.put(b'k', 1)\nreturn call('other', 'ask')",
        before="@view\ndef look() -> object:\n    return state.get(b'k')\n",
        others={"other": "@view\ndef ask() -> object:\n    return call('it', 'look')\n"},
    ),
    source("view-called-as-export", "ENTRY_UNKNOWN", "@view\ndef f():\n    pass\n"),
    source("export-called-as-view", "ENTRY_UNKNOWN", "@export\ndef f():\n    state.put(b'k', 1)\n", mode="view"),
    _beside(
        "arguments-are-copies", "OK", "x = [[0]]\ncall('other', 'spoil', x)\nrequire(x == [[0]], 'SPOILT')", _SPOILER
    ),
    _beside(
        "results-are-copies",
        "OK",
        "x = call('other', 'f')\nx.append(1)\nrequire(call('other', 'f') == [[1]], 'SPOILT')",
        "X = [[1]]\n\n\n@export\ndef f() -> list:\n    return X\n",
    ),
    _beside("result-of-a-wrong-type", "TYPE_ERROR", "return call('other', 'f')", _LIAR),
    _beside("failure-is-not-caught", "NO_WAY", "call('other', 'f')", _FAILS),
    _beside(
        "keys-of-the-callee-are-its-own",
        "OK",
        "call('other', 'write', 5)\nrequire(state.get(b'k') is None, 'LEAKED')\n"
        "require(call('other', 'read') == 5, 'LOST')",
        _WRITER,
    ),
    _beside(
        "prefix-comes-back",
        "OK",
        "call('other', 'write', 5)\nstate.put(b'k', 6)\nrequire(call('other', 'read') == 5, 'MIXED')",
        _WRITER,
    ),
    _beside(
        "caller-stays",
        "OK",
        "require(call('other', 'f') == ctx.caller, 'OTHER')",
        "@view\ndef f() -> bytes:\n    return ctx.caller\n",
    ),
    _beside(
        "calling-contract-is-told",
        "OK",
        "require(call('other', 'f') == 'it' and ctx.calling_contract == '', 'LIED')",
        "@view\ndef f() -> str:\n    return ctx.calling_contract\n",
    ),
    _beside("budgets-are-shared-writes", "EVENT_BUDGET", "while True:\n    call('other', 'f')", _FLOOD),
    _beside(
        "budgets-are-shared-gas", SPENT, "call('other', 'f')", "@export\ndef f():\n    while True:\n        pass\n"
    ),
    _beside(
        "budgets-are-shared-memory",
        "MEMORY_BUDGET",
        "x = bytes(5 * 10 ** 6)\ncall('other', 'f')",
        "@export\ndef f():\n    x = bytes(5 * 10 ** 6)\n",
    ),
    body(
        "budgets-are-shared-depth",
        "CALL_DEPTH",
        "return g(15)",
        before="def g(n):\n    return g(n - 1) if n else call('c1', 'f')\n",
        others=_CHAIN,
    ),
    _beside("depth-comes-back", "OK", "for i in range(300):\n    call('other', 'read')", _WRITER),
)
"""Contracts that call contracts."""
