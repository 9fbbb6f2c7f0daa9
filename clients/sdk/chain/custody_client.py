"""Clips and empty frames at custodians."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence
from typing import Protocol

from clients.sdk.connections import NO_LANE, NodeAddress
from clients.sdk.proof_checks import ProvedState
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipDownload, ClipUpload
from consensus.records.sharing import GrantUpload, SharedDownload, SharedRequest
from consensus.state.records import EMPTY_FRAME

TRANSFER_TIMEOUT_MS = 60_000


class RequestFn(Protocol):
    """How one request is made (`NetworkClient.ask_node`)."""

    async def __call__(
        self,
        node: NodeAddress,
        method: str,
        path: str,
        *,
        key: PrivateKey | None = None,
        lane: bytes = NO_LANE,
        body: bytes | None = None,
        media_type: str = "application/json",
        query: dict[str, str | int] | None = None,
        timeout_ms: int = TRANSFER_TIMEOUT_MS,
    ) -> bytes:
        """Return the answer's body, or raise the refusal."""
        ...


StateProver = Callable[[Sequence[bytes], PrivateKey], Awaitable[ProvedState]]
"""Returns values by flat key as the chain proves them (`NetworkClient.state_values`)."""


class CustodyClient:
    """The custodians of a network, each asked by itself: an upload goes to all of them, a download to any."""

    def __init__(self, find: Callable[[], tuple[NodeAddress, ...]], ask: RequestFn, prove: StateProver) -> None:
        """`find` names those who are custodians now."""
        self._find = find
        self._ask = ask
        self._prove = prove

    @property
    def custodians(self) -> tuple[NodeAddress, ...]:
        """The custodians, as far as this client knows; that may change while it runs."""
        return self._find()

    async def upload_clip(self, node: NodeAddress, upload: ClipUpload, key: PrivateKey) -> None:
        """Stage a clip at one custodian, in the robot's session. Repeating is harmless.

        Raises UPLOAD_INVALID, UPLOAD_CONFLICT, STORE_UNAVAILABLE, NODE_UNREACHABLE.
        """
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
        """Fetch a clip from one custodian, in the session of its owner key. Check it with `check_clip_download`.

        Raises ACCESS_NOT_GRANTED, CLIP_NOT_CONFIRMED, CLIP_ERASED, NOT_FOUND, UPLOAD_INVALID.
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
        """Stage one custodian's parts of a shared record, in the session of its owner key. Repeating is harmless.

        Raises UPLOAD_INVALID, UPLOAD_CONFLICT, STORE_UNAVAILABLE, NODE_UNREACHABLE.
        """
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
        """Fetch from one custodian what it has of a shared record, in the session of the grant's key.

        Raises ACCESS_NOT_GRANTED, GRANT_ENDED, GRANTEE_NOT_A_MEMBER, CLIP_NOT_CONFIRMED, CLIP_ERASED, UPLOAD_INVALID.
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
        """Store a recorded empty frame at one custodian and return its SHA-256."""
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
        """Return an empty frame by its hash, or None: `missing` says why then, and what it names is not asked for again.

        EMPTY_FRAME_WITHDRAWN stands there only if the chain proves that no robot may publish the frame any more.
        """
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
        """Fetch an empty frame by its hash from whichever custodian has it whole.

        If none does, raises one custodian's refusal: NOT_FOUND only if all say so.
        """
        failure = BlockRobotError("NOT_FOUND", "There is no custodian to ask for the empty frame.")
        for node in self.custodians:
            try:
                return await self.get_background_of(node, digest, key)
            except BlockRobotError as error:
                failure = error if failure.code == "NOT_FOUND" else failure
        raise failure

    async def get_background_of(self, node: NodeAddress, digest: bytes, key: PrivateKey) -> bytes:
        """Fetch an empty frame from one custodian. Raises UPLOAD_HASH_MISMATCH for a damaged one, NOT_FOUND."""
        path = f"/v1/backgrounds/{digest.hex()}"
        content = await self._ask(node, "GET", path, key=key, timeout_ms=TRANSFER_TIMEOUT_MS)
        if sha256(content) != digest:
            raise BlockRobotError("UPLOAD_HASH_MISMATCH", f"Custodian {node.name} sent a damaged empty frame.")
        return content
