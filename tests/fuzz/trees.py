"""Changes values inside of MessagePack and JSON, so that what comes out is well-formed and only its content is wrong."""

from __future__ import annotations

from random import Random
from typing import Any

import msgspec

from consensus.primitives.hashing import sha256
from tests.fuzz.target import FlipBytes

EDGES = (-1, 0, 1, 2, 255, 2**31 - 1, 2**32 - 1, 2**32, 2**53 - 1, 2**53, 2**63 - 1, 2**64 - 1, -(2**63))
KINDS = (None, True, 0, "", b"", [], {}, 0.5)
TEXTS = ("", "\x00", "a" * 300, "\u202e", "0" * 64, "__class__", "../x", "é")
_GOES_IN = 0.7


def change(value: Any, random: Random, flip: FlipBytes) -> Any:
    """Return the value with one thing in it changed."""
    if isinstance(value, list) and value and random.random() < _GOES_IN:
        place = random.randrange(len(value))
        return [*value[:place], change(value[place], random, flip), *value[place + 1 :]]
    if isinstance(value, dict) and value and random.random() < _GOES_IN:
        key = random.choice(list(value))
        return value | {key: change(value[key], random, flip)}
    if random.random() < 0.05:
        return random.choice(KINDS)
    return _change_here(value, random, flip)


def _change_here(value: Any, random: Random, flip: FlipBytes) -> Any:
    if isinstance(value, bool) or value is None:
        return not value
    if isinstance(value, int):
        return random.choice(
            (value + 1, value - 1, random.choice(EDGES), random.getrandbits(random.choice((8, 32, 63))))
        )
    if isinstance(value, bytes):
        return _change_bytes(value, random, flip)
    if isinstance(value, str):
        return _change_text(value, random, flip)
    if isinstance(value, list):
        return _change_list(value, random)
    if isinstance(value, dict) and value:
        return {key: item for key, item in value.items() if key != random.choice(list(value))}
    return random.choice(KINDS)


def _change_bytes(value: bytes, random: Random, flip: FlipBytes) -> bytes:
    inside = change_msgpack(value, random, flip) if random.random() < 0.6 else None
    if inside is not None:
        return inside
    return random.choice((b"", bytes(len(value)), value[:-1], value + b"\0", sha256(value), flip(value, random)))


def _change_text(value: str, random: Random, flip: FlipBytes) -> str:
    try:
        data = bytes.fromhex(value) if value else b""
    except ValueError:
        data = b""
    if data and random.random() < 0.7:
        return _change_bytes(data, random, flip).hex()
    return random.choice(
        (*TEXTS, value[:-1], value * 2, flip(value.encode("utf-8", "replace"), random).decode("latin-1"))
    )


def _change_list(value: list[Any], random: Random) -> list[Any]:
    if not value:
        return [random.choice(KINDS)]
    place, other = random.randrange(len(value)), random.randrange(len(value))
    if random.random() < 0.4:
        return [*value[:place], *value[place + 1 :]]
    if random.random() < 0.4:
        return [*value[:place], value[other], *value[place:]]
    return [*value[:place], value[other], *value[place + 1 :]]


def change_msgpack(data: bytes, random: Random, flip: FlipBytes) -> bytes | None:
    """Return other MessagePack of about the same shape; None if these bytes are no list or dict in it."""
    try:
        value = msgspec.msgpack.decode(data)
        return msgspec.msgpack.encode(change(value, random, flip)) if isinstance(value, list | dict) else None
    except (ValueError, OverflowError, RecursionError, TypeError, msgspec.MsgspecError):
        return None


def change_json(data: bytes, random: Random, flip: FlipBytes) -> bytes | None:
    """Return other JSON of about the same shape, indented as a bundle's is; None if these bytes are none."""
    try:
        value = change(msgspec.json.decode(data), random, flip)
        return msgspec.json.format(msgspec.json.encode(value), indent=1) + b"\n"
    except (ValueError, OverflowError, RecursionError, TypeError, msgspec.MsgspecError):
        return None
