"""What node and contract worker say to each other, and how it lies in a pipe. Must never carry a key, or code.

A frame is four bytes of length (big-endian) and one MessagePack message. The node asks, the worker answers with one
message; before that it may ask back for rows of the state that the node has and it has not.
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
    """The first message to a worker: the chain's genesis file, where its ledger lies, the memory it may take (0: all)."""

    genesis_json: str
    ledger_dir: str
    memory_max_bytes: int


class SandboxFeature(msgspec.Struct, array_like=True, frozen=True):
    """One part of the wall, whether it stands, and why not if it does not."""

    name: str
    had: bool
    detail: str = ""


class Hello(_Message, frozen=True):
    """The worker's first word: it is ready, behind this wall."""

    parts: tuple[SandboxFeature, ...]


class Execute(_Message, frozen=True):
    """Execute these transactions (txid, wire bytes) on the state with this root.

    `leader` builds a block, otherwise one is verified. `renew`: begin to read the ledger anew first. `gives_up_change`:
    the version of a contract that is due fails.
    """

    parent_root: bytes
    height: int
    time_ms: int
    transactions: tuple[tuple[bytes, bytes], ...]
    leader: bool
    renew: bool
    gives_up_change: bool = False


class Executed(_Message, frozen=True):
    """What the block gave, and what the worker stands on: the ledger's height, and how many blocks it keeps above."""

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
    """Verify consecutive blocks, each on the state that the one before says it gives; only the first may ask back."""

    blocks: tuple[Execute, ...]


class ExecutedRun(_Message, frozen=True):
    """What the first blocks of a run gave, up to one that failed in any way."""

    blocks: tuple[Executed, ...]


class View(_Message, frozen=True):
    """Run a view with these encoded arguments on the state with this root, of the block of this height and time."""

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
    """The block or the call is not right: a code of the catalogue of errors, and a sentence."""

    code: str
    detail: str


class Broken(_Message, frozen=True):
    """The interpreter itself failed: no verdict. `exhausted`: its memory was full."""

    text: str
    exhausted: bool = False


class Get(_Message, frozen=True):
    """The worker asks for the value under a flat key of the parent's state."""

    key: bytes


class Page(_Message, frozen=True):
    """The worker asks for a page of the parent's trie."""

    path: bytes


class Scan(_Message, frozen=True):
    """The worker asks for rows of the parent's state, from `start` up to but without `end`."""

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
    """Return what a worker notes of how far it is, apart from its answers: read only if it does not come to one."""
    return b"@%d\n" % place


def newest_place(notes: bytes) -> int | None:
    """Return the place in the last whole note, or None."""
    found = _PLACES.findall(notes)
    return int(found[-1]) if found else None


def pack(message: Any) -> bytearray:
    """Return the frame of a message. Raises VALUE_INVALID if it is larger than a frame may be."""
    frame = bytearray(_LENGTH.size)
    _ENCODER.encode_into(message, frame, _LENGTH.size)
    size = len(frame) - _LENGTH.size
    if size > FRAME_MAX_BYTES:
        raise BlockRobotError("VALUE_INVALID", f"A message of {size} bytes is more than a worker's pipe takes.")
    _LENGTH.pack_into(frame, 0, size)
    return frame


class Pipe:
    """Both directions between two processes. `wait_read` and `wait_write` are called before each system call."""

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
        """Write one message. Raises OSError if nobody reads any more, and what `wait_write` raises."""
        rest = memoryview(pack(message))
        while rest:
            self._wait_write()
            try:
                rest = rest[os.write(self._write_fd, rest) :]
            except BlockingIOError:
                continue

    def receive(self, decoder: msgspec.msgpack.Decoder[_M]) -> _M:
        """Read one message. Raises EOFError if nobody writes any more, msgspec.MsgspecError for nonsense."""
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
