"""Every container method and operator, at each place of its item."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import product

from consensus.primitives.hashing import tagged_hash
from consensus.primitives.keys import GROUP_ORDER, PrivateKey, point_of
from network.lab.hostile.program import SPENT, Program, forever

REPEATS_COUNT = 4
TAG, MESSAGE = "t", b"m"
FIELD_ORDER = 2**256 - 2**32 - 977
"""Of how many elements the field of secp256k1 is (SEC 2, section 2.4.1)."""
LIST_SIZES = (2_000, 300_000)
DICT_SIZES = (2_000, 50_000)
TEXT_SIZES = (2_000, 1_000_000)

LIST_STEPS = {
    "in": "y = WANTED in x",
    "item": "y = x[PLACE]",
    "assign": "x[PLACE] = WANTED",
    "slice-from": "y = x[PLACE : PLACE + 1]",
    "delete": "x.append(FILL)\ndel x[PLACE]",
    "append": "x.append(WANTED)\nx.pop()",
    "extend": "y = []\ny.extend(x)",
    "insert": "x.insert(PLACE, WANTED)\nx.pop()",
    "pop": "x.append(FILL)\nx.pop(PLACE)",
    "remove": "x.append(FILL)\nx.remove(WANTED)\nx[PLACE] = WANTED",
    "index": "y = x.index(WANTED)",
    "reverse": "x.reverse()\nx.reverse()",
    "clear": "y = x.copy()\ny.clear()",
    "copy": "y = x.copy()",
    "sort": "x.sort()\nx[PLACE] = WANTED",
}
"""By method or sign. x holds FILL everywhere and WANTED at PLACE; each step leaves it so, or nearly."""
LIST_ITEMS = {
    "ints": ("0", "1"),
    "texts": ("'a' * 120", "'a' * 119 + 'b'"),
    "wide-texts": ("'\\u20ac' * 120", "'\\u20ac' * 119 + '\\u20ad'"),
    "lists": ("[1, 2, 3]", "[1, 2, 4]"),
}
LOOKING = {**dict.fromkeys(("in", "remove", "index"), tuple(LIST_ITEMS)), "sort": ("ints", "texts", "wide-texts")}
"""The steps that look at the items, by the kinds of items that they are tried with; the others are tried with ints."""
TUPLE_STEPS = ("in", "item", "slice-from", "index")
DICT_STEPS = {
    "in": "y = WANTED in x",
    "item": "x[WANTED] = 1\ny = x[WANTED]",
    "delete": "x[WANTED] = 1\ndel x[WANTED]",
    "for": "for i in x:\n    break",
    "equal": "y = x == z",
    "get": "y = x.get(WANTED)",
    "pop": "x[WANTED] = 1\ny = x.pop(WANTED)",
    "setdefault": "y = x.setdefault(WANTED, 1)",
    "update": "x.update({WANTED: 1})",
    "keys": "y = x.keys()",
    "values": "y = x.values()",
    "items": "y = x.items()",
    "copy": "y = x.copy()",
    "clear": "y = x.copy()\ny.clear()",
}
DICT_KEYS = {
    "ints": "i",
    "alike-ints": "i * (2 ** 61 - 1)",
    "texts": "str(i)",
    "bytes": "u64(i)",
}
"""Of which kind the keys are: multiples of 2 ** 61 - 1 all have one hash in CPython."""
ALIKE_MAX_COUNT = 2_000
TEXT_STEPS = {
    "in": "y = PART in x",
    "item": "y = x[PLACE]",
    "slice-from": "y = x[PLACE : PLACE + 1]",
    "equal": "y = x == z",
    "less": "y = x < z",
    "find": "y = x.find(PART)",
    "count": "y = x.count(PART)",
    "replace": "y = x.replace(PART, LETTER)",
    "split": "y = x.split(PART)",
    "startswith": "y = x.startswith(z)",
    "endswith": "y = x.endswith(z)",
    "strip": "y = x.strip(FILL)",
    "lstrip": "y = x.lstrip(FILL)",
    "rstrip": "y = x.rstrip(FILL)",
    "join": "y = x.join([PART, PART])",
    "upper": "y = x.upper()",
    "lower": "y = x.lower()",
    "isdigit": "y = x.isdigit()",
    "isalpha": "y = x.isalpha()",
    "isalnum": "y = x.isalnum()",
    "isupper": "y = x.isupper()",
    "islower": "y = x.islower()",
    "isascii": "y = x.isascii()",
    "encode": "y = x.encode()",
    "decode": "y = x.decode()",
    "hex": "y = x.hex()",
}
"""By method or sign: x is FILL with LETTER at PLACE, z the same again; PART is LETTER behind none or 50 of FILL."""
ONLY_TEXT = {"upper", "lower", "isdigit", "isalpha", "isalnum", "isupper", "islower", "isascii", "encode"}
ONLY_BYTES = {"decode", "hex"}
TEXT_LETTERS = {
    "text": ("'a'", "'b'"),
    "wide-text": ("'\\u20ac'", "'\\u20ad'"),
    "bytes": ("b'a'", "b'b'"),
}
_STATE_SOURCE = """\
@export
def f(kind: str, first: int):
    if kind == 'write':
        for i in range(first, first + 250):
            state.put(b's' + u32(i), 1)
    elif kind == 'delete':
        for i in range(first, first + 250):
            state.delete(b's' + u32(i))
    else:
        i = 0
        while True:
            i += 1
            STEP
"""
STATE_STEPS = {
    "state.get": "state.get(b's' + u32(i % 3000))",
    "state.has": "state.has(b's' + u32(i % 3000))",
    "state.put": "state.put(b's' + u32(i % 3000), i)",
    "state.delete": "state.delete(b's' + u32(i % 3000))",
    "state.scan": "state.scan(b's', 1)",
    "state.scan-many": "state.scan(b's', 1 + i % 256)",
    "state.scan-one-key": "state.scan(b's' + u32(i % 3000), 1)",
    "state.scan-after-a-write": "state.put(b's' + u32(i % 3000), i)\n            state.scan(b's', 3)",
    "state.scan-after-a-deletion": "state.delete(b's' + u32(i % 3000))\n            state.scan(b's', 3)",
}
_CALLS = tuple(range(0, 3_000, 250))


def _places(size: int, step: str) -> list[tuple[str, int]]:
    places = [("first", 0), ("middle", size // 2), ("last", size - 1)]
    return places if re.search("PLACE|WANTED|PART|FILL|z", step) else places[-1:]


def _repeat(name: str, setup: str, step: str, **values: str | int) -> Program:
    for word, value in values.items():
        setup, step = setup.replace(word, str(value)), step.replace(word, str(value))
    return forever(f"place-{name}", setup, step, REPEATS_COUNT)


def _of_sequences() -> Iterator[Program]:
    for size, (kind, (fill, wanted)), (operation, step) in product(LIST_SIZES, LIST_ITEMS.items(), LIST_STEPS.items()):
        if kind not in LOOKING.get(operation, ("ints",)):
            continue
        for place, number in _places(size, step):
            values: dict[str, str | int] = {"PLACE": number, "WANTED": "w", "FILL": "v"}
            setup = f"v = {fill}\nw = {wanted}\nx = [v] * {size}\nx[{number}] = w"
            yield _repeat(f"list-{operation}-{kind}-{place}-{size}", setup, step, **values)
            if operation in TUPLE_STEPS and size == LIST_SIZES[0]:
                yield _repeat(f"tuple-{operation}-{kind}-{place}-{size}", f"{setup}\nx = tuple(x)", step, **values)


def _of_dicts() -> Iterator[Program]:
    for size, (kind, key), (operation, step) in product(DICT_SIZES, DICT_KEYS.items(), DICT_STEPS.items()):
        if kind == "alike-ints" and size > ALIKE_MAX_COUNT:
            continue
        for place, number in (*_places(size, step), ("missing", size))[: 4 if "WANTED" in step else 1]:
            wanted = key.replace("i", str(number), 1) if kind.endswith("ints") else key.replace("(i)", f"({number})")
            setup = f"w = {wanted}\nx = {{{key}: i for i in range({size})}}" + ("\nz = x.copy()" if "z" in step else "")
            yield _repeat(f"dict-{operation}-{kind}-{place}-{size}", setup, step, WANTED="w")
        setup = f"x = {{{key}: i for i in range({size})}}\nfor w in x.keys()[: {size} * 3 // 5]:\n    del x[w]\nz = x"
        yield _repeat(f"dict-{operation}-{kind}-deleted-{size}", setup, step, WANTED="w")


def _of_texts() -> Iterator[Program]:
    for size, (kind, (fill, letter)), (operation, step) in product(
        TEXT_SIZES, TEXT_LETTERS.items(), TEXT_STEPS.items()
    ):
        if operation in (ONLY_TEXT if kind == "bytes" else ONLY_BYTES):
            continue
        count = size // 4 if kind == "wide-text" else size
        for place, number in _places(count, step):
            setup = f"x = {fill} * {number} + {letter} + {fill} * {count - 1 - number}\n"
            setup += f"z = {fill} * {number} + {letter} + {fill} * {count - 1 - number}\n" if "z" in step else ""
            for part, before in (("letter", 0), ("part", 50))[: 2 if "PART" in step else 1]:
                setup_of_part = setup + (f"p = {fill} * {before} + {letter}" if "PART" in step else "")
                words: dict[str, str | int] = {"PLACE": number, "PART": "p", "FILL": fill, "LETTER": letter}
                yield _repeat(f"{kind}-{operation}-{part}-{place}-{size}", setup_of_part, step, **words)


def _of_state() -> Iterator[Program]:
    write, delete = (tuple((kind, first) for first in _CALLS) for kind in ("write", "delete"))
    before = {
        "after-writes": (write,),
        "after-deletions": (write, delete),
        "after-writes-not-final": (write, ()),
        "after-deletions-not-final": (write, delete, (), ()),
        "after-both-not-final": (write, delete, write, delete, ()),
    }
    for (operation, step), (when, calls) in product(STATE_STEPS.items(), before.items()):
        text = _STATE_SOURCE.replace("STEP", step)
        yield Program(f"place-{operation}-{when}", SPENT, text, args=("step", 0), blocks_before=calls)


def _signed_for_nothing() -> bytes:
    """For `MESSAGE`; it recovers to the point at infinity."""
    digest = int.from_bytes(tagged_hash(TAG, MESSAGE), "big")
    for secret in range(2, 64):
        point = point_of(secret.to_bytes(32, "big"))
        s = digest * pow(secret, -1, GROUP_ORDER) % GROUP_ORDER
        if s <= GROUP_ORDER // 2:
            break
    return point[1:] + s.to_bytes(32, "big") + bytes([point[0] & 1])


def _signatures() -> dict[str, bytes]:
    good = PrivateKey(bytes([1]) * 32).sign(TAG, MESSAGE)
    no_point = next(
        x
        for x in (number.to_bytes(32, "big") for number in range(2, 64))
        if pow(pow(int.from_bytes(x, "big"), 3, FIELD_ORDER) + 7, (FIELD_ORDER - 1) // 2, FIELD_ORDER) != 1
    )
    return {
        "good": good,
        "infinity": _signed_for_nothing(),
        "of-another": PrivateKey(bytes([2]) * 32).sign(TAG, b"other"),
        "no-point": no_point + good[32:],
        "zero": bytes(65),
        "r-too-large": b"\xff" * 32 + good[32:],
        "high-s": good[:32] + b"\xff" * 32 + good[64:],
        "r-overflows": good[:64] + b"\x02",
        "no-recovery-id": good[:64] + b"\x09",
        "short": good[:64],
        "long": good * 8,
    }


HOST_STEPS = {
    "sha256": {"empty": "sha256(b'')", "long": "sha256(x)"},
    "tagged_hash": {"empty": f"tagged_hash({TAG!r}, b'')", "long": f"tagged_hash({TAG!r}, x)"},
    "recover": {how: f"recover({TAG!r}, {value!r}, {MESSAGE!r})" for how, value in _signatures().items()},
}
"""What works on bytes alone, once for each answer that it can give. A fault ends the call, so it costs at most once."""


def _of_host() -> Iterator[Program]:
    for operation, steps in HOST_STEPS.items():
        for how, step in steps.items():
            yield _repeat(f"host-{operation}-{how}", "x = b'a' * 100_000", f"y = {step}")


PLACES: tuple[Program, ...] = (*_of_sequences(), *_of_dicts(), *_of_texts(), *_of_state(), *_of_host())
