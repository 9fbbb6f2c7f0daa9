"""Floods of keys, values, events, calls, scans, hashes, signatures."""

from __future__ import annotations

from network.lab.hostile.program import REFUSED, Program, body, source, spent

_FOREVER = "i = 0\nwhile True:\n    i += 1\n    "
_NESTED = [[[[[[[[[[[[[[[["x"] * 8]]]]]]]]]]]]]]]

PROGRAMS: tuple[Program, ...] = (
    body("keys", "WRITE_BUDGET", _FOREVER + "state.put(u64(i), i)"),
    body("one-key-again-and-again", "WRITE_BUDGET", _FOREVER + "state.put(b'k', i)"),
    spent("large-values", "x = bytes(16000)\n" + _FOREVER + "state.put(u64(i), x)"),
    body("deletes", "WRITE_BUDGET", _FOREVER + "state.delete(u64(i))"),
    body("writes-and-deletes", "WRITE_BUDGET", _FOREVER + "state.put(b'k', 1)\n    state.delete(b'k')"),
    body("value-too-large", "VALUE_ERROR", "state.put(b'k', bytes(20000))"),
    body("value-too-large-in-parts", "VALUE_ERROR", "state.put(b'k', [bytes(1000)] * 1000)"),
    body(
        "value-too-shared", "VALUE_ERROR", "x = [0] * 100\nfor i in range(10):\n    x = [x] * 100\nstate.put(b'k', x)"
    ),
    body("value-of-nothings", "VALUE_ERROR|OUT_OF_GAS", "state.put(b'k', [[]] * 100000)"),
    body("key-too-long", "VALUE_ERROR", "state.put(b'k' * 129, 1)"),
    body("key-empty", "VALUE_ERROR", "state.put(b'', 1)"),
    body("key-of-a-text", "TYPE_ERROR", "state.put('k', 1)"),
    body(
        "key-of-another-contract",
        "OK",
        "require(state.get(b'\\x00other\\x00k') is None, 'SEEN')\nrequire(not state.has(b'other\\x00k'), 'SEEN')",
        others={"other": "@export\ndef f():\n    state.put(b'k', 1)\n"},
    ),
    spent("reads", _FOREVER + "state.get(u64(i))"),
    spent("reads-of-one-key", _FOREVER + "state.get(b'k')", state={b"k": 1}),
    spent("reads-of-large-values", _FOREVER + "state.get(b'k')", state={b"k": b"v" * 16000}),
    spent("reads-of-nested-values", _FOREVER + "state.get(b'k')", state={b"k": _NESTED}),
    spent("reads-of-many-empty-lists", _FOREVER + "state.get(b'k')", state={b"k": [[] for _ in range(15000)]}),
    spent("reads-of-many-empty-dicts", _FOREVER + "state.get(b'k')", state={b"k": [{} for _ in range(15000)]}),
    spent("reads-of-large-ints", _FOREVER + "state.get(b'k')", state={b"k": [2**255 + n for n in range(400)]}),
    spent("reads-kept", "x = []\n" + _FOREVER + "x.append(state.get(b'k'))", state={b"k": [[] for _ in range(15000)]}),
    spent("existence", _FOREVER + "state.has(u64(i))"),
    spent("scans", _FOREVER + "state.scan(b'', 256)", state={bytes([n]): n for n in range(256)}),
    spent("scans-of-nothing", _FOREVER + "state.scan(b'k', 256)"),
    spent(
        "scans-of-large-values", _FOREVER + "state.scan(b'', 256)", state={bytes([n]): b"v" * 16000 for n in range(16)}
    ),
    spent(
        "scans-of-ones-own-writes",
        "for i in range(250):\n    state.put(u32(i), i)\nwhile True:\n    state.scan(b'', 1)",
    ),
    spent(
        "scans-of-deleted-keys",
        "for i in range(250):\n    state.delete(u32(i))\nwhile True:\n    state.scan(b'', 1)",
        state={n.to_bytes(4, "big"): n for n in range(250)},
    ),
    body("scan-without-limit", "VALUE_ERROR", "state.scan(b'', 2 ** 70)"),
    body("scan-of-minus-one", "VALUE_ERROR", "state.scan(b'', -1)"),
    body("scan-of-a-long-prefix", "VALUE_ERROR", "state.scan(b'k' * 200, 1)"),
    body("events", "EVENT_BUDGET", _FOREVER + "emit('a', {})"),
    body("large-events", "EVENT_BUDGET", "x = bytes(1000)\n" + _FOREVER + "emit('a', {'x': x})"),
    body("event-too-large", "VALUE_ERROR", "emit('a', {'x': bytes(9000)})"),
    body("event-with-a-long-name", "VALUE_ERROR", "emit('a' * 10 ** 5, {})"),
    body("event-with-an-odd-name", "VALUE_ERROR", "emit('a\\n', {})"),
    body("event-of-a-list", "TYPE_ERROR", "emit('a', [])"),
    spent("hashes", _FOREVER + "sha256(b'')"),
    spent("hashes-of-large-data", "x = bytes(10 ** 6)\n" + _FOREVER + "sha256(x)"),
    spent("tagged-hashes", _FOREVER + "tagged_hash('t', b'')"),
    spent("tagged-hashes-of-many-tags", _FOREVER + "tagged_hash(f't{i}', b'')"),
    body("tag-too-long", "VALUE_ERROR", "tagged_hash('t' * 100, b'')"),
    spent("signatures", _FOREVER + "recover('t', bytes(65), b'')"),
    spent("signatures-that-recover", "x = b'\\x01' * 64 + b'\\x00'\n" + _FOREVER + "recover('t', x, u64(i))"),
    spent(
        "signatures-of-large-messages",
        "x = bytes(10 ** 6)\ny = b'\\x01' * 64 + b'\\x01'\n" + _FOREVER + "recover('t', y, x)",
    ),
    spent("signatures-of-odd-sizes", _FOREVER + "recover('t', bytes(i % 99), b'')"),
    source("writes-in-a-view", REFUSED + "VIEW_WRITES", "@view\ndef f():\n    state.put(b'a', 1)\n", mode="view"),
    source(
        "keys-in-genesis-only",
        "ENTRY_UNKNOWN",
        "@genesis\ndef f():\n    for i in range(5000):\n        state.put(u32(i), i)\n",
    ),
)
"""More of everything the ledger gives than a call may have."""
