"""Client for clips and empty frames at custodians."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import Protocol

from clients.sdk.connections import ANONYMOUS_LANE, NodeAddress
from clients.sdk.proof_checks import ProvedState
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipDownload, ClipUpload
from consensus.records.renditions import NO_BACKGROUND
from consensus.records.sharing import GrantUpload, SharedDownload, SharedRequest
from consensus.state.records import EMPTY_FRAME

TRANSFER_TIMEOUT_MS = 60_000


class RequestFn(Protocol):
    """Makes one request, as `NetworkClient.ask_node`."""

    async def __call__(
        self,
        node: NodeAddress,
        method: str,
        path: str,
        *,
        key: PrivateKey | None = None,
        lane: bytes = ANONYMOUS_LANE,
        body: bytes | None = None,
        media_type: str = "application/json",
        query: dict[str, str | int] | None = None,
        timeout_ms: int = TRANSFER_TIMEOUT_MS,
    ) -> bytes: ...


class CustodianBook(Protocol):
    """The known custodians, as `NodeDirectory`."""

    @property
    def custodians(self) -> tuple[NodeAddress, ...]: ...

    def rank_custodians(self, record_id: bytes) -> tuple[tuple[NodeAddress, ...], tuple[NodeAddress, ...]]:
        """Those that keep a record's clip, and the others."""
        ...


StateProver = Callable[[Sequence[bytes], PrivateKey], Awaitable[ProvedState]]
"""Returns values by flat key as the chain proves them (`NetworkClient.state_values`)."""


class CustodyClient:
    """A network's custodians: a clip goes to its keepers, and is asked of them first."""

    def __init__(self, book: CustodianBook, ask: RequestFn, prove: StateProver) -> None:
        self._book = book
        self._ask = ask
        self._prove = prove

    @property
    def custodians(self) -> tuple[NodeAddress, ...]:
        return self._book.custodians

    def rank(self, record_id: bytes) -> tuple[tuple[NodeAddress, ...], tuple[NodeAddress, ...]]:
        """The keepers of a record's clip, and the others: who has it if a keeper has not, since it was away or is new."""
        return self._book.rank_custodians(record_id)

    def keepers_first(self, record_id: bytes) -> tuple[NodeAddress, ...]:
        keepers, others = self.rank(record_id)
        return (*keepers, *others)

    async def upload_clip(self, node: NodeAddress, upload: ClipUpload, key: PrivateKey) -> None:
        """Stage a clip; idempotent. Raises UPLOAD_INVALID, UPLOAD_CONFLICT, STORE_UNAVAILABLE, NODE_UNREACHABLE."""
        await self._ask(
            node,
            "PUT",
            f"/v1/clips/{upload.record_id.hex()}",
            key=key,
            body=encode(upload),
            media_type="application/msgpack",
            query={"owner": upload.owner.hex()},
            timeout_ms=TRANSFER_TIMEOUT_MS,
        )

    async def download_clip(
        self, node: NodeAddress, record_id: bytes, access_id: bytes, key: PrivateKey
    ) -> ClipDownload:
        """Fetch a clip, to verify with `check_clip_download`. Raises ACCESS_NOT_GRANTED, CLIP_NOT_CONFIRMED,
        CLIP_ERASED, NOT_FOUND, UPLOAD_INVALID.
        """
        content = await self._ask(
            node,
            "GET",
            f"/v1/clips/{record_id.hex()}",
            key=key,
            query={"access_id": access_id.hex()},
            timeout_ms=TRANSFER_TIMEOUT_MS,
        )
        clip = decode(content, ClipDownload)
        if clip.record_id != record_id:
            raise BlockRobotError("UPLOAD_INVALID", f"Custodian {node.name} sent another record's clip.")
        return clip

    async def upload_grant(self, node: NodeAddress, upload: GrantUpload, key: PrivateKey) -> None:
        """Stage a custodian's parts of a shared record. Raises as `upload_clip`."""
        await self._ask(
            node,
            "PUT",
            f"/v1/grants/{upload.grant_txid.hex()}/{upload.record_id.hex()}",
            key=key,
            body=encode(upload),
            media_type="application/msgpack",
            timeout_ms=TRANSFER_TIMEOUT_MS,
        )

    async def download_shared(
        self, node: NodeAddress, grant_id: bytes, request: SharedRequest, key: PrivateKey
    ) -> SharedDownload:
        """Fetch a custodian's part. Raises ACCESS_NOT_GRANTED, GRANT_ENDED, GRANTEE_NOT_A_MEMBER, CLIP_NOT_CONFIRMED,
        CLIP_ERASED, UPLOAD_INVALID.
        """
        content = await self._ask(
            node,
            "POST",
            f"/v1/grants/{grant_id.hex()}/{request.record_id.hex()}",
            key=key,
            body=encode(request),
            media_type="application/msgpack",
            timeout_ms=TRANSFER_TIMEOUT_MS,
        )
        shared = decode(content, SharedDownload)
        if shared.record_id != request.record_id:
            raise BlockRobotError("UPLOAD_INVALID", f"Custodian {node.name} sent another record's pictures.")
        return shared

    async def put_background(self, node: NodeAddress, content: bytes, key: PrivateKey) -> bytes:
        """Store an empty frame and return its SHA-256."""
        digest = sha256(content)
        await self._ask(
            node,
            "PUT",
            f"/v1/backgrounds/{digest.hex()}",
            key=key,
            body=content,
            media_type="application/octet-stream",
            timeout_ms=TRANSFER_TIMEOUT_MS,
        )
        return digest

    async def find_background(
        self, digest: bytes, key: PrivateKey, missing: dict[bytes, BlockRobotError]
    ) -> bytes | None:
        """Return None with the reason in `missing` (skipped later); EMPTY_FRAME_WITHDRAWN there is proven.

        ROOM_NOT_RECORDED: the robot drove, and shows the owner on nothing.
        """
        if digest == NO_BACKGROUND:
            missing[digest] = BlockRobotError("ROOM_NOT_RECORDED")
        if digest in missing:
            return None
        try:
            return await self.get_background(digest, key)
        except BlockRobotError as error:
            missing[digest] = error
        try:
            proved = await self._prove([EMPTY_FRAME.key(digest)], key)
        except BlockRobotError:
            return None  # what no custodian gave is told, not that nobody can say why
        if EMPTY_FRAME.among(proved.values, digest) is None:
            missing[digest] = BlockRobotError("EMPTY_FRAME_WITHDRAWN")
        return None

    async def get_background(self, digest: bytes, key: PrivateKey) -> bytes:
        """From any custodian. Raises NOT_FOUND only if all do."""
        failure = BlockRobotError("NOT_FOUND", "There is no custodian to ask for the empty frame.")
        for node in self.custodians:
            try:
                return await self.get_background_of(node, digest, key)
            except BlockRobotError as error:
                failure = error if failure.code == "NOT_FOUND" else failure
        raise failure

    async def get_background_of(self, node: NodeAddress, digest: bytes, key: PrivateKey) -> bytes:
        """Raises UPLOAD_HASH_MISMATCH, NOT_FOUND."""
        path = f"/v1/backgrounds/{digest.hex()}"
        content = await self._ask(node, "GET", path, key=key, timeout_ms=TRANSFER_TIMEOUT_MS)
        if sha256(content) != digest:
            raise BlockRobotError("UPLOAD_HASH_MISMATCH", f"Custodian {node.name} sent a damaged empty frame.")
        return content
