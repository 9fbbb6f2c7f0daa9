"""Other custodians, over node connections; clips are limited to their announced size."""

from __future__ import annotations

from typing import Protocol

from consensus.errors import BlockRobotError
from consensus.limits import CLIP_SIZE_MAX_BYTES
from consensus.primitives.encoding import decode, encode
from consensus.records.clips import ClipDownload
from node.p2p.wire import ClipPart, ClipRequest, RequestKind

CLIP_WIRE_MAX_BYTES = CLIP_SIZE_MAX_BYTES + 1024 * 1024


class PeerCustodian(Protocol):
    """Another custodian."""

    @property
    def name(self) -> str: ...

    async def fetch(self, record_id: bytes) -> ClipDownload | None: ...


class PeerRequests(Protocol):
    """Asks peers."""

    @property
    def connected(self) -> list[str]: ...

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Raises PEER_UNAVAILABLE."""
        ...


class PeerLink:
    """A `PeerCustodian` over a node's connections."""

    def __init__(self, name: str, peers: PeerRequests) -> None:
        self.name = name
        self._peers = peers

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        """Return a confirmed clip, or None. Raises PEER_*, ENCODING_*."""
        data = bytearray()
        while True:
            request = ClipRequest(record_id=record_id, offset=len(data))
            part = decode(await self._peers.request(self.name, RequestKind.CLIP, encode(request)), ClipPart)
            if part.total > CLIP_WIRE_MAX_BYTES or (not part.data and len(data) < part.total):
                raise BlockRobotError("PEER_MESSAGE_INVALID", "The peer's clip is not what it announced.")
            data += part.data
            if len(data) >= part.total:
                return decode(bytes(data), ClipDownload) if data else None
