"""Endless conversions between all types that the language converts."""

from __future__ import annotations

from network.lab.hostile.program import Program, body, bomb, refused, source, spent

_FOREVER = "while True:\n    "
_MIGRATION = "@migrate\ndef m():\n    state.put(b'k', 1)\n\n\n@export\ndef g():\n    pass\n"

PROGRAMS: tuple[Program, ...] = (
    spent("ints-to-texts", "x = [2 ** 255] * 1000\n" + _FOREVER + "y = [str(i) for i in x]"),
    spent("texts-to-ints", "x = ['9' * 77] * 1000\n" + _FOREVER + "y = [int(i) for i in x]"),
    spent("ints-to-bytes", "x = 2 ** 255\n" + _FOREVER + "y = x.to_bytes(33, 'big', signed=True)"),
    spent("bytes-to-ints", "x = b'\\xff' * 32\n" + _FOREVER + "y = int.from_bytes(x, 'little', signed=True)"),
    spent("ints-to-bytes-and-back", "x = 1\n" + _FOREVER + "x = int.from_bytes(x.to_bytes(32)) * 2 % (2 ** 254 - 1)"),
    spent("ints-to-keys", "x = 1\n" + _FOREVER + "y = u32(x) + u64(x)"),
    spent("ints-to-truths", "x = 2 ** 255\n" + _FOREVER + "y = bool(x) and abs(-x) and int(True)"),
    spent("ints-to-lengths", "x = 2 ** 255\n" + _FOREVER + "y = x.bit_length() + len([x])"),
    bomb("int-to-more-bytes-than-there-are", "y = bytes(2 ** 59) + (1).to_bytes(8)"),
    body("int-to-bytes-of-a-huge-length", "VALUE_ERROR", "return (1).to_bytes(2 ** 200)"),
    body("int-to-bytes-of-less-than-nothing", "VALUE_ERROR", "return (1).to_bytes(-1)"),
    body("int-to-bytes-in-no-order", "VALUE_ERROR", "return (1).to_bytes(8, 'middle')"),
    body("bytes-to-int-in-no-order", "VALUE_ERROR", "return int.from_bytes(b'ab', 'x' * 10 ** 6)"),
    body("negative-to-keys", "VALUE_ERROR", "return u64(-1)"),
    body("huge-to-keys", "VALUE_ERROR", "return u64(2 ** 64)"),
    spent("lists-to-bytes", "x = [255] * 10 ** 4\n" + _FOREVER + "y = bytes(x)"),
    body("lists-to-bytes-too-large-at-the-end", "VALUE_ERROR", "return bytes([0] * 10 ** 4 + [256])"),
    spent("bytes-to-lists", "x = b'\\xff' * 10 ** 5\n" + _FOREVER + "y = list(x)"),
    spent("bytes-to-tuples", "x = b'\\xff' * 10 ** 5\n" + _FOREVER + "y = tuple(x)"),
    spent("texts-to-tuples", "x = '\\u20ac' * 10 ** 5\n" + _FOREVER + "y = tuple(x)"),
    spent("lists-to-tuples-and-back", "x = [0] * 10 ** 4\n" + _FOREVER + "x = list(tuple(x))"),
    spent(
        "pairs-to-dicts-and-back", "x = [(i, i) for i in range(500)]\n" + _FOREVER + "y = dict(x)\n    x = y.items()"
    ),
    spent("dicts-to-lists", "x = {str(i): i for i in range(500)}\n" + _FOREVER + "y = list(x) + sorted(x)"),
    spent("texts-to-hex-and-back", "x = '\\u20ac' * 10 ** 4\n" + _FOREVER + "y = bytes.fromhex(x.encode().hex())"),
    spent("texts-of-texts-in-f-strings", "x = 'a' * 1000\n" + _FOREVER + "y = f'{x}{1}{True}{None}{x}'"),
    spent("bytes-stripped", "x = b' ' * 10 ** 5\n" + _FOREVER + "y = x.strip()"),
    spent("bytes-stripped-on-the-left", "x = b'a' * 10 ** 5 + b'b'\n" + _FOREVER + "y = x.lstrip(b'a')"),
    spent("bytes-stripped-on-the-right", "x = b'b' + b'a' * 10 ** 5\n" + _FOREVER + "y = x.rstrip(b'a')"),
    spent("texts-stripped-on-the-left", "x = 'a' * 10 ** 5 + 'b'\n" + _FOREVER + "y = x.lstrip('a')"),
    spent("texts-stripped-on-the-right", "x = 'b' + '\\u20ac' * 10 ** 5\n" + _FOREVER + "y = x.rstrip('\\u20ac')"),
    spent(
        "texts-tested",
        "x = '1' * 10 ** 6\ny = 'A' * 10 ** 6\nwhile x.isdigit() and y.isupper() and x.isascii():\n    pass",
    ),
    spent("text-ends-with-itself", "x = 'a' * 10 ** 6\ny = 'a' * 10 ** 6\nwhile x.endswith(y):\n    pass"),
    spent("bytes-start-with-themselves", "x = b'a' * 10 ** 6\ny = b'a' * 10 ** 6\nwhile x.startswith(y):\n    pass"),
    spent("bytes-searched", "x = b'ab' * 50000\ny = b'ab' * 5000 + b'aa'\n" + _FOREVER + "z = x.find(y)"),
    spent("tuples-searched", "x = (0,) * 10000 + (1,)\n" + _FOREVER + "y = x.index(1)"),
    spent("dicts-asked", "x = {'a' * 1000: 1}\n" + _FOREVER + "y = x.pop('b', 0) or x.get('a' * 1000)"),
    spent("least-of-many", "x = [2 ** 255 - i for i in range(1000)]\n" + _FOREVER + "y = min(x)"),
    spent("requirements-without-end", "x = 'a' * 10 ** 5\n" + _FOREVER + "require(x, 'NO_WAY', 'a' * 10)"),
    body("source-charged", "LIFECYCLE_ONLY", "charge_source(bytes(10 ** 6))"),
    body("source-compiled", "LIFECYCLE_ONLY", "check_source(b'x' * 60000)"),
    body("migration-called-by-another", "ENTRY_UNKNOWN", "call('other', 'm')", others={"other": _MIGRATION}),
    source(
        "migration-called",
        "ENTRY_UNKNOWN",
        "@migrate\ndef f():\n    state.put(b'k', 1)\n\n\n@export\ndef g():\n    pass\n",
    ),
    refused("int-by-another-base", "ARGUMENTS", "return int('zz', 36)"),
    refused("text-by-an-encoding", "ARGUMENTS", "return b'a'.decode('unicode_escape')"),
    refused("bytes-by-an-encoding", "ARGUMENTS", "return bytes('a', 'utf-7')"),
)
"""One type from another, in both directions."""
