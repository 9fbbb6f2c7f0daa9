"""Messages between node and contract worker; they carry neither keys nor code.

A frame is a 4-byte big-endian length and one MessagePack message. The worker sends one answer per request, and may ask
back for state rows before.
"""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec

from consensus.chain.block import Receipt
from consensus.errors import BlockRobotError

FRAME_MAX_BYTES = 256 * 1024 * 1024
READ_AT_ONCE_BYTES = 1024 * 1024
_LENGTH = struct.Struct(">I")
_M = TypeVar("_M")


class _Message(msgspec.Struct, array_like=True, frozen=True, forbid_unknown_fields=True, tag=True):
    pass


class Begin(_Message, frozen=True):
    """First message: genesis file, ledger location, memory limit (0: unlimited)."""

    genesis_json: str
    ledger_dir: str
    memory_max_bytes: int


class SandboxFeature(msgspec.Struct, array_like=True, frozen=True):
    """One sandbox part: whether it is active, and why not."""

    name: str
    had: bool
    detail: str = ""


class Hello(_Message, frozen=True):
    """The worker's first message: ready and sandboxed."""

    parts: tuple[SandboxFeature, ...]


class Execute(_Message, frozen=True):
    """Execute transactions (txid, wire bytes) on the state with this root.

    `leader` builds, otherwise verifies. `renew` rereads the ledger first. `gives_up_change` fails the due contract
    version.
    """

    parent_root: bytes
    height: int
    time_ms: int
    transactions: tuple[tuple[bytes, bytes], ...]
    leader: bool
    renew: bool
    gives_up_change: bool = False


class Executed(_Message, frozen=True):
    """The block's result, the worker's ledger height and cached layer count."""

    receipts: tuple[Receipt, ...]
    writes: dict[bytes, bytes | None]
    page_writes: dict[bytes, bytes | None]
    state_root: bytes
    receipt_root: bytes
    gas_used: int
    left_out: tuple[bytes, ...]
    base_height: int
    layers_count: int


class ExecuteRun(_Message, frozen=True):
    """Verify consecutive blocks on each other's states; only the first may ask back."""

    blocks: tuple[Execute, ...]


class ExecutedRun(_Message, frozen=True):
    """Results of a run's first blocks, up to any failure."""

    blocks: tuple[Executed, ...]


class View(_Message, frozen=True):
    """Run a view on the state with this root, block height and time."""

    root: bytes
    height: int
    time_ms: int
    contract: str
    view: str
    arguments: bytes


class Viewed(_Message, frozen=True):
    """The encoded result of a view."""

    result: bytes


class Refused(_Message, frozen=True):
    """A refused block or call: error code and sentence."""

    code: str
    detail: str


class Broken(_Message, frozen=True):
    """Interpreter failure, no verdict; `exhausted` means memory was full."""

    text: str
    exhausted: bool = False


class Get(_Message, frozen=True):
    """Requests a value of the parent's state by flat key."""

    key: bytes


class Page(_Message, frozen=True):
    """Requests a page of the parent's trie."""

    path: bytes


class Scan(_Message, frozen=True):
    """Requests rows of the parent's state in [start, end)."""

    start: bytes
    end: bytes
    limit: int


class Value(_Message, frozen=True):
    """The answer to `Get` and `Page`."""

    data: bytes | None


class Rows(_Message, frozen=True):
    """The answer to `Scan`."""

    rows: list[tuple[bytes, bytes]]


FromNode = Begin | Execute | ExecuteRun | View | Value | Rows
FromWorker = Hello | Executed | ExecutedRun | Viewed | Refused | Broken | Get | Page | Scan
FROM_NODE: msgspec.msgpack.Decoder[FromNode] = msgspec.msgpack.Decoder(FromNode)
FROM_WORKER: msgspec.msgpack.Decoder[FromWorker] = msgspec.msgpack.Decoder(FromWorker)
_ENCODER = msgspec.msgpack.Encoder()
_PLACES = re.compile(rb"@(-?[0-9]{1,6})\n")


def pack_place(place: int) -> bytes:
    return b"@%d\n" % place


def newest_place(notes: bytes) -> int | None:
    found = _PLACES.findall(notes)
    return int(found[-1]) if found else None


def pack(message: Any) -> bytearray:
    """Raises VALUE_INVALID if too large."""
    frame = bytearray(_LENGTH.size)
    _ENCODER.encode_into(message, frame, _LENGTH.size)
    size = len(frame) - _LENGTH.size
    if size > FRAME_MAX_BYTES:
        raise BlockRobotError("VALUE_INVALID", f"A message of {size} bytes is more than a worker's pipe takes.")
    _LENGTH.pack_into(frame, 0, size)
    return frame


class Pipe:
    """Two-way pipe between processes; `wait_read` and `wait_write` precede each system call."""

    def __init__(
        self,
        read_fd: int,
        write_fd: int,
        wait_read: Callable[[], None] = lambda: None,
        wait_write: Callable[[], None] = lambda: None,
    ) -> None:
        self._read_fd = read_fd
        self._write_fd = write_fd
        self._wait_read = wait_read
        self._wait_write = wait_write

    def send(self, message: Any) -> None:
        """Raises OSError without a reader, and `wait_write` errors."""
        rest = memoryview(pack(message))
        while rest:
            self._wait_write()
            try:
                rest = rest[os.write(self._write_fd, rest) :]
            except BlockingIOError:
                continue

    def receive(self, decoder: msgspec.msgpack.Decoder[_M]) -> _M:
        """Raises EOFError at the end, msgspec.MsgspecError if malformed."""
        (size,) = _LENGTH.unpack(self._read(_LENGTH.size))
        if size > FRAME_MAX_BYTES:
            raise msgspec.ValidationError(f"a frame of {size} bytes")
        return decoder.decode(self._read(size))

    def _read(self, size: int) -> bytes:
        parts: list[bytes] = []
        while size:
            self._wait_read()
            part = os.read(self._read_fd, min(size, READ_AT_ONCE_BYTES))
            if not part:
                raise EOFError("the other end of the pipe is closed")
            parts.append(part)
            size -= len(part)
        return parts[0] if len(parts) == 1 else b"".join(parts)
