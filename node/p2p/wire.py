"""Frames between nodes: 4-byte big-endian length (type and payload), type byte, canonical payload."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from enum import IntEnum

from consensus.chain.block import FinalityProof
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire

PROTOCOL_VERSION = 3
HEADER_SIZE_BYTES = 5
SMALL_FRAME_MAX_BYTES = 64 * 1024
EPOCH_FRAME_MAX_BYTES = 512 * 1024
BLOCK_FRAME_MAX_BYTES = 2 * 1024 * 1024
BULK_FRAME_MAX_BYTES = 8 * 1024 * 1024
REQUEST_HEADER_SIZE_BYTES = 5

_LENGTH = struct.Struct(">IB")
_REQUEST = struct.Struct(">IB")


class FrameKind(IntEnum):
    """The type byte of a frame."""

    HELLO = 1
    PROPOSAL = 2
    VOTE = 3
    TIMEOUT = 4
    NOTICE = 5
    TRANSACTIONS = 6
    HEIGHT = 7
    REQUEST = 8
    RESPONSE = 9
    EPOCH = 10
    REFUSAL = 11
    LAST_SIGNED_REQUEST = 12
    LAST_SIGNED_RESPONSE = 13


class RequestKind(IntEnum):
    """The request kind: the byte behind its number."""

    BRANCH = 1
    FINALIZED = 2
    CLIP = 3
    BACKGROUND = 4
    SNAPSHOT = 5


FRAME_MAX_BYTES: dict[int, int] = {
    FrameKind.HELLO: 1024,
    FrameKind.PROPOSAL: BLOCK_FRAME_MAX_BYTES,
    FrameKind.VOTE: 1024,
    FrameKind.TIMEOUT: SMALL_FRAME_MAX_BYTES,
    FrameKind.NOTICE: SMALL_FRAME_MAX_BYTES,
    FrameKind.TRANSACTIONS: BLOCK_FRAME_MAX_BYTES,
    FrameKind.HEIGHT: 64,
    FrameKind.REQUEST: 1024,
    FrameKind.RESPONSE: BULK_FRAME_MAX_BYTES,
    FrameKind.EPOCH: EPOCH_FRAME_MAX_BYTES,
    FrameKind.REFUSAL: 128,
    FrameKind.LAST_SIGNED_REQUEST: 64,
    FrameKind.LAST_SIGNED_RESPONSE: SMALL_FRAME_MAX_BYTES,
}
FIRST_KINDS = frozenset({FrameKind.HELLO, FrameKind.REFUSAL})
"""What a peer may say that has not said hello yet."""
GOSSIP_KINDS = frozenset({FrameKind.TRANSACTIONS, FrameKind.HEIGHT})


class Hello(Wire, frozen=True):
    """First frame of both sides: protocol, chain and height; `genesis`: digests of the parts of its genesis file."""

    version: int
    chain_id: bytes
    name: str
    finalized_height: int
    genesis: tuple[bytes, ...] = ()


class Refusal(Wire, frozen=True):
    """Last frame to a proven but rejected node: the error code."""

    code: str


class HeightNotice(Wire, frozen=True):
    """The sender's height, its epoch (or the one it begins), and oldest body's height."""

    finalized_height: int
    epoch: int
    earliest_height: int = 0


class TransactionBatch(Wire, frozen=True):
    """Wire bytes of transactions, as received or signed."""

    transactions: tuple[bytes, ...]


class BranchRequest(Wire, frozen=True):
    """Ask for a block and its ancestors above a height."""

    block_id: bytes
    above_height: int


class FinalizedRequest(Wire, frozen=True):
    """Ask for finalized blocks from a height, with a proof of the last."""

    from_height: int
    count: int


class BlockBatch(Wire, frozen=True):
    """Canonical blocks, oldest first; `proof` proves the last; no bodies below `earliest_height`."""

    blocks: tuple[bytes, ...]
    proof: FinalityProof | None
    earliest_height: int = 0


class SnapshotRequest(Wire, frozen=True):
    """Ask for a snapshot chunk by content id; index -1: manifest above a height."""

    content_id: bytes
    index: int
    above_height: int


class ClipRequest(Wire, frozen=True):
    """Ask a custodian for an upload's bytes from an offset."""

    record_id: bytes
    offset: int


class ClipPart(Wire, frozen=True):
    """Part of an upload's canonical bytes, and their total (0: none here)."""

    total: int
    data: bytes


def encode_frame(kind: FrameKind, payload: bytes) -> bytes:
    """Raises PEER_MESSAGE_INVALID if the frame exceeds its kind's limit."""
    if len(payload) > FRAME_MAX_BYTES[kind]:
        raise BlockRobotError("PEER_MESSAGE_INVALID", f"A {kind.name} of {len(payload)} bytes is too large.")
    return _LENGTH.pack(len(payload) + 1, kind) + payload


def encode_request(number: int, kind: int, body: bytes) -> bytes:
    """Return a request's payload, or (status as `kind`) its response's."""
    return _REQUEST.pack(number, kind) + body


def decode_request(payload: bytes) -> tuple[int, int, bytes]:
    """Return (number, kind or status, body). Raises PEER_MESSAGE_INVALID."""
    if len(payload) < REQUEST_HEADER_SIZE_BYTES:
        raise BlockRobotError("PEER_MESSAGE_INVALID", "A request is shorter than its head.")
    number, kind = _REQUEST.unpack_from(payload)
    return number, kind, payload[REQUEST_HEADER_SIZE_BYTES:]


class FrameDecoder:
    """Cuts bytes into frames; holds one at most, its size checked first."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._position = 0

    def take(self, data: bytes) -> None:
        if self._position:
            del self._buffer[: self._position]
            self._position = 0
        self._buffer += data

    @property
    def has_begun(self) -> bool:
        return len(self._buffer) > self._position

    def next_frame(self, *, is_greeted: bool = True) -> tuple[FrameKind, bytes] | None:
        """Return the next (kind, payload), or None. Raises PEER_MESSAGE_INVALID; the stream is then lost."""
        buffer, position = self._buffer, self._position
        if len(buffer) - position < HEADER_SIZE_BYTES:
            return None
        length, kind = _LENGTH.unpack_from(buffer, position)
        limit = FRAME_MAX_BYTES.get(kind)
        if limit is None or not 1 <= length <= limit + 1:
            raise BlockRobotError("PEER_MESSAGE_INVALID", f"A frame of type {kind} and {length} bytes.")
        if not is_greeted and kind not in FIRST_KINDS:
            raise BlockRobotError("PEER_MESSAGE_INVALID", "The peer spoke before it said hello.")
        end = position + 4 + length
        if len(buffer) < end:
            return None
        self._position = end
        return FrameKind(kind), bytes(memoryview(buffer)[position + HEADER_SIZE_BYTES : end])

    def feed(self, data: bytes) -> Iterator[tuple[FrameKind, bytes]]:
        """Yield whole frames as (kind, payload). Raises PEER_MESSAGE_INVALID; the stream is then lost."""
        self.take(data)
        while (frame := self.next_frame()) is not None:
            yield frame
