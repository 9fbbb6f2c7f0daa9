"""What the contract machine needs of msgspec and coincurve, in plain Python. Must never be used but by a test.

A Python for which these libraries cannot be installed can still show that the machine itself (parser, numbers, texts,
meter) does there what it does elsewhere. The vectors were written with the real libraries, so they judge these too.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

P = 2**256 - 2**32 - 977
N = 0xFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFFEBAAEDCE6AF48A03BBFD25E8CD0364141
G = (
    0x79BE667EF9DCBBAC55A06295CE870B07029BFCDB2DCE28D959F2815B16F81798,
    0x483ADA7726A3C4655DA4FBFC0E1108A8FD17B448A68554199C47D08FFB10D4B8,
)
Point = tuple[int, int] | None


class Struct:
    """A class with fields, as `msgspec.Struct` makes it."""

    _names: tuple[str, ...] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        own = [name for name in cls.__annotations__ if not name.startswith("_")]
        cls._names = tuple(dict.fromkeys([*cls._names, *own]))

    def __init__(self, *values: Any, **named: Any) -> None:
        given = dict(zip(self._names, values, strict=False)) | named
        for name in self._names:
            setattr(self, name, given[name] if name in given else getattr(type(self), name))

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and vars(self) == vars(other)

    __hash__ = object.__hash__


class Ext:
    """A value of an extension type."""

    def __init__(self, code: int, data: bytes) -> None:
        self.code, self.data = code, data


class Raw(bytes):
    """A value that is encoded already."""


class DecodeError(Exception):
    """Bytes that hold no value."""


def pack(value: Any) -> bytes:
    """Return a value as MessagePack, in the shortest form."""
    if value is None or value is True or value is False:
        return {None: b"\xc0", False: b"\xc2", True: b"\xc3"}[value]
    if type(value) is int:
        return pack_int(value)
    if type(value) is str:
        data = value.encode()
        short = bytes([0xA0 | len(data)]) if len(data) < 32 else b""
        return (short or head(len(data), (0xD9, 0xDA, 0xDB))) + data
    if type(value) is bytes:
        return head(len(value), (0xC4, 0xC5, 0xC6)) + value
    if isinstance(value, Raw):
        return bytes(value)
    if isinstance(value, Ext):
        fixed = {1: b"\xd4", 2: b"\xd5", 4: b"\xd6", 8: b"\xd7", 16: b"\xd8"}.get(len(value.data))
        return (fixed or head(len(value.data), (0xC7, 0xC8, 0xC9))) + bytes([value.code]) + value.data
    short = bytes([(0x80 if type(value) is dict else 0x90) | len(value)]) if len(value) < 16 else b""
    if type(value) is dict:
        parts = [pack(part) for pair in value.items() for part in pair]
        return (short or head(len(value), (0, 0xDE, 0xDF))) + b"".join(parts)
    return (short or head(len(value), (0, 0xDC, 0xDD))) + b"".join([pack(item) for item in value])


def head(count: int, codes: tuple[int, int, int]) -> bytes:
    width = 0 if count < 256 and codes[0] else 1 if count < 65536 else 2
    return bytes([codes[width]]) + count.to_bytes(1 << width, "big")


def pack_int(value: int) -> bytes:
    if -32 <= value < 128:
        return value.to_bytes(1, "big", signed=value < 0)
    for place in range(4):
        size = 1 << place
        if value >= 0 and value < 1 << 8 * size:
            return bytes([0xCC + place]) + value.to_bytes(size, "big")
        if value < 0 and value >= -(1 << (8 * size - 1)):
            return bytes([0xD0 + place]) + value.to_bytes(size, "big", signed=True)
    raise OverflowError(value)


class Unpacker:
    """Reads one value from bytes."""

    def __init__(self, data: bytes, ext_hook: Any) -> None:
        self.data, self.place, self.ext_hook = data, 0, ext_hook

    def take(self, size: int) -> bytes:
        self.place += size
        if self.place > len(self.data):
            raise DecodeError("too short")
        return self.data[self.place - size : self.place]

    def number(self, size: int) -> int:
        return int.from_bytes(self.take(size), "big")

    def value(self) -> Any:
        code = self.number(1)
        if code < 0x80 or code >= 0xE0:
            return code if code < 0x80 else code - 256
        if code < 0xC0:
            kind = "dict" if code < 0x90 else "list" if code < 0xA0 else "str"
            return self.filled(kind, code & (0x1F if kind == "str" else 0x0F))
        if code in (0xC0, 0xC2, 0xC3):
            return {0xC0: None, 0xC2: False, 0xC3: True}[code]
        if 0xCC <= code <= 0xCF:
            return self.number(1 << (code - 0xCC))
        if 0xD0 <= code <= 0xD3:
            return int.from_bytes(self.take(1 << (code - 0xD0)), "big", signed=True)
        if 0xD4 <= code <= 0xD8:
            return self.ext_hook(self.number(1), memoryview(self.take(1 << (code - 0xD4))))
        if 0xC7 <= code <= 0xC9:
            size = self.number(1 << (code - 0xC7))
            return self.ext_hook(self.number(1), memoryview(self.take(size)))
        for first, kind, smallest in ((0xC4, "bytes", 0), (0xD9, "str", 0), (0xDC, "list", 1), (0xDE, "dict", 1)):
            if first <= code < first + 3 - smallest:
                return self.filled(kind, self.number(1 << (code - first + smallest)))
        raise DecodeError(f"code {code}")

    def filled(self, kind: str, count: int) -> Any:
        if kind in ("str", "bytes"):
            data = self.take(count)
            return data.decode() if kind == "str" else data
        if kind == "list":
            return [self.value() for _ in range(count)]
        return {self.value(): self.value() for _ in range(count)}


class Encoder:
    """Stands for `msgspec.msgpack.Encoder`."""

    def encode(self, value: Any) -> bytes:
        return pack(value)


class Decoder:
    """Stands for `msgspec.msgpack.Decoder`; it reads values, not structs."""

    def __init__(self, kind: Any = None, ext_hook: Any = None) -> None:
        self.ext_hook = ext_hook

    def __class_getitem__(cls, item: Any) -> Any:
        return cls

    def decode(self, data: bytes) -> Any:
        reader = Unpacker(bytes(data), self.ext_hook)
        value = reader.value()
        if reader.place != len(data):
            raise DecodeError("too long")
        return value


def add(one: Point, other: Point) -> Point:
    if one is None or other is None:
        return one or other
    if one[0] == other[0] and (one[1] + other[1]) % P == 0:
        return None
    if one == other:
        slope = 3 * one[0] * one[0] * pow(2 * one[1], -1, P) % P
    else:
        slope = (other[1] - one[1]) * pow(other[0] - one[0], -1, P) % P
    x = (slope * slope - one[0] - other[0]) % P
    return x, (slope * (one[0] - x) - one[1]) % P


def multiply(point: Point, scalar: int) -> Point:
    result: Point = None
    for bit in bin(scalar % N)[2:]:
        result = add(result, result)
        if bit == "1":
            result = add(result, point)
    return result


def lift(x: int, odd: int) -> Point:
    square = (pow(x, 3, P) + 7) % P
    y = pow(square, (P + 1) // 4, P)
    if x >= P or y * y % P != square:
        raise ValueError("no point of the curve")
    return x, y if y & 1 == odd else P - y


class PublicKey:
    """Stands for `coincurve.PublicKey`: read, recovered, written."""

    def __init__(self, data: bytes) -> None:
        if len(data) != 33 or data[0] not in (2, 3):
            raise ValueError("no compressed point")
        self.point = lift(int.from_bytes(data[1:], "big"), data[0] & 1)

    @classmethod
    def from_signature_and_message(cls, signature: bytes, message: bytes, hasher: Any = None) -> PublicKey:
        r, s, odd = int.from_bytes(signature[:32], "big"), int.from_bytes(signature[32:64], "big"), signature[64]
        if not (0 < r < N and 0 < s < N and odd < 4):
            raise ValueError("no signature")
        start = lift(r + (N if odd & 2 else 0), odd & 1)
        total = add(multiply(start, s), multiply(G, -int.from_bytes(message, "big")))
        key = cls.__new__(cls)
        key.point = multiply(total, pow(r, -1, N))
        if key.point is None:
            raise ValueError("no key")
        return key

    def format(self) -> bytes:
        assert self.point is not None
        return bytes([2 + (self.point[1] & 1)]) + self.point[0].to_bytes(32, "big")


def install() -> None:
    """Put the stand-ins where the machine imports the libraries from."""

    def module(name: str, **content: Any) -> ModuleType:
        made = sys.modules[name] = ModuleType(name)
        vars(made).update(content)
        return made

    msgpack = module("msgspec.msgpack", Encoder=Encoder, Decoder=Decoder, Ext=Ext)
    structs = module("msgspec.structs", replace=None, astuple=None, asdict=None, fields=None)
    errors = {"DecodeError": DecodeError, "MsgspecError": DecodeError, "ValidationError": DecodeError}
    module("msgspec", Struct=Struct, Raw=Raw, msgpack=msgpack, structs=structs, **errors)
    ecdsa = module("coincurve.ecdsa", cdata_to_der=None, deserialize_compact=None)
    utils = module("coincurve.utils", GROUP_ORDER_INT=N)
    module("coincurve", PrivateKey=None, PublicKey=PublicKey, ecdsa=ecdsa, utils=utils)
