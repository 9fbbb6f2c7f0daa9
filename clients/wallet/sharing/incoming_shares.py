"""Views records shared with this wallet under the grant's own key, and tracks later changes."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any

from clients.sdk.chain.proved_rows import proved_row
from clients.sdk.connections import NodeAddress
from clients.wallet.ledger.visit_audit import AuditEntry, audit_visit
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.records.viewing import STATUS_CORRUPTED, STATUS_ERASED, FrameView, judge_frame
from clients.wallet.sharing.chain_grants import (
    Grant,
    cut_since,
    find_received,
    grantee_key,
    grantee_salt,
    read_custodians,
    read_grants,
)
from clients.wallet.store.keystore import KnownVisit, ReceivedGrant, SharedCopy
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.renditions import Rendition
from consensus.records.sharing import (
    KeyPart,
    SharedDownload,
    SharedFrame,
    SharedRequest,
    check_shared_download,
    check_shared_parts,
    join_parts,
    open_package,
)
from consensus.state.records import RECORD, RecordRow
from consensus.state.rights import CORRECTION, CORRECTION_COUNT, QUARANTINE, RESTRICTION, correction_keys

FOLLOW_MAX_MS = 15_000
_FOLLOW_PAUSE_S = 0.25
_NOT_YET = frozenset({"ACCESS_NOT_GRANTED", "CLIP_NOT_CONFIRMED"})
KIND_ERASED = "erased"
KIND_FRAMES_ERASED = "pictures-erased"
KIND_CORRECTED = "corrected"
KIND_RESTRICTED = "restricted"
KIND_DENIED = "denied"
KIND_REVOKED = "revoked"
KIND_ENDED = "ended"
TO_DELETE = frozenset({KIND_ERASED, KIND_FRAMES_ERASED, KIND_DENIED, KIND_REVOKED, KIND_ENDED})
"""After these a copy has to go."""
_NOT_TO_SEE = frozenset({KIND_ERASED, KIND_FRAMES_ERASED, KIND_DENIED, KIND_RESTRICTED})
Sleep = Callable[[float], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class ChangeNotice:
    """A change to a shared record (GDPR Art. 19), and whether the grantee confirmed acting."""

    record_id: bytes
    kind: str
    confirmed: bool


@dataclass(frozen=True, slots=True)
class IncomingShare:
    """A proven grant for this wallet; `is_open` means viewable by its terms.

    `looked`: the grantee requested pictures from any wallet, by the audit trail.
    """

    grant: Grant
    received: ReceivedGrant
    is_open: bool
    notices: tuple[ChangeNotice, ...]
    looked: bool = True

    @property
    def to_look(self) -> list[bytes]:
        """Viewable: not erased even in part, denied or restricted."""
        barred = {notice.record_id for notice in self.notices if notice.kind in _NOT_TO_SEE}
        return [record_id for record_id in self.grant.row.records if record_id not in barred] if self.is_open else []

    @property
    def to_confirm(self) -> list[bytes]:
        """Deleted copies await confirmation to the owner."""
        due = [notice.record_id for notice in self.notices if notice.kind in TO_DELETE and not notice.confirmed]
        return list(dict.fromkeys(due))


@dataclass(frozen=True, slots=True)
class SharedView:
    """A shared record's frames and the custodians that released it."""

    record_id: bytes
    frames: tuple[FrameView, ...]
    custodians: tuple[str, ...]

    @property
    def corrupted(self) -> list[int]:
        return [frame.index for frame in self.frames if frame.status == STATUS_CORRUPTED]


@dataclass(frozen=True, slots=True)
class UnreadableGrant:
    """A grant that could not be read, and why."""

    received: ReceivedGrant
    error: BlockRobotError


class IncomingShares:
    """Access to what was shared with this wallet."""

    def __init__(self, wallet: Wallet, *, follow_max_ms: int = FOLLOW_MAX_MS, sleep: Sleep = asyncio.sleep) -> None:
        self._wallet = wallet
        self._follow_max_ms = follow_max_ms
        self._sleep = sleep
        self.reads_new = True
        self.faded: list[ReceivedGrant] = []
        self.unread: list[UnreadableGrant] = []
        self.missing_rooms: dict[bytes, BlockRobotError] = {}
        """Empty frames that were asked for in vain, by their hash, and why."""

    async def inbox(self) -> list[IncomingShare]:
        """Return all received grants, oldest first, each read in its own session.

        Sets `reads_new`, `faded` (keys expired) and `unread` (other failures). Raises transient errors.
        """
        known, self.reads_new = await find_received(self._wallet)
        self.faded, self.unread, found = [], [], []
        for received in known:
            try:
                found.append(await self.read(received))
            except BlockRobotError as error:
                if error.code == "SESSION_REFUSED":
                    self.faded.append(received)
                elif error.entry.retryable:
                    raise
                else:
                    self.unread.append(UnreadableGrant(received, error))
        return sorted(found, key=lambda share: (share.grant.row.time, share.grant.grant_id))

    async def read(self, received: ReceivedGrant) -> IncomingShare:
        """Current state and notices. Raises PROOF_INVALID if it is gone. Expiry gives a notice only where pictures were
        written on this machine.
        """
        key = grantee_key(received, self._wallet)
        grants = await read_grants(self._wallet, [received.grant_id], key)
        if not grants:
            raise BlockRobotError("PROOF_INVALID", "A grant that was there is proven not to be.")
        (grant,) = grants
        now_ms = (await self._wallet.network.newest_header(key)).timestamp_ms
        is_open = grant.row.is_open(now_ms)
        had = {copy.record_id for copy in received.copies}
        trail = await audit_visit(_TrailReader(self._wallet, key), KnownVisit(grant.row.owner, b"", b"", 0, 0))
        notices = [
            ChangeNotice(
                record_id, kind, record_id in grant.row.noticed or _mark(record_id, kind) in received.confirmed
            )
            for record_id, kind in await self._find_notices(grant, key, trail, is_open=is_open)
            if kind != KIND_ENDED or record_id in had
        ]
        looked = any(entry.data.get("grant") == grant.grant_id for entry in trail if entry.kind == "access_requested")
        return IncomingShare(grant, received, is_open, tuple(notices), looked)

    async def _find_notices(
        self, grant: Grant, key: PrivateKey, trail: Sequence[AuditEntry], *, is_open: bool
    ) -> list[tuple[bytes, str]]:
        owner = grant.row.owner
        places = [RESTRICTION.key(owner), QUARANTINE.key(owner), CORRECTION_COUNT.key(owner)]
        values = await self._wallet.values([*places, *map(RECORD.key, grant.row.records)], key)
        corrected = await self._corrected(grant, CORRECTION_COUNT.among(values, owner) or 0, key)
        row, denied = RESTRICTION.among(values, owner), QUARANTINE.among(values, owner) is not None
        cut = cut_since(grant, trail)
        end = [] if is_open else [KIND_REVOKED if grant.row.status == "revoked" else KIND_ENDED]
        notices = []
        for record_id in grant.row.records:
            state = RECORD.among(values, record_id)
            kinds = []
            if state is None or state.status != "active":
                kinds.append(KIND_ERASED)
            elif record_id in cut:
                kinds.append(KIND_FRAMES_ERASED)
            if denied:
                kinds.append(KIND_DENIED)
            kinds += end
            if record_id in corrected:
                kinds.append(KIND_CORRECTED)
            if row is not None and row.covers(record_id):
                kinds.append(KIND_RESTRICTED)
            notices += [(record_id, kind) for kind in kinds]
        return notices

    async def _corrected(self, grant: Grant, count: int, key: PrivateKey) -> set[bytes]:
        values = await self._wallet.values(correction_keys(grant.row.owner, count), key)
        found: set[bytes] = set()
        for row in map(CORRECTION.convert, values.values()):
            if row.time >= grant.row.time:
                found |= set(grant.row.records).intersection(row.records or grant.row.records)
        return found

    async def request_access(self, share: IncomingShare, records: Sequence[bytes]) -> bytes:
        """By the grant's key; wait until final. Raises CALL_REFUSED."""
        grant, key = share.grant, grantee_key(share.received, self._wallet)
        arguments = [grant.grant_id, list(records), grant.row.purpose]
        return (await self._wallet.network.call(key, "access", "request_granted", arguments)).txid

    async def look(self, share: IncomingShare, record_id: bytes, access_id: bytes) -> SharedView:
        """From the fewest custodians. Raises GRANT_PARTS_MISSING, or the common refusal."""
        key = grantee_key(share.received, self._wallet)
        state = await proved_row(self._wallet.reading(key), RECORD, record_id)
        if state is None or state.owner != share.grant.row.owner:
            raise BlockRobotError("NOT_FOUND", "The chain has no such record of this visit.")
        if state.status != "active":
            raise BlockRobotError("CLIP_ERASED")
        sealing = self._wallet.eras[share.received.era].sealing
        gathered = _Gathered(state, record_id, share.grant.row.grantee, sealing)
        refused_with: BlockRobotError | None = None
        proven = await self._custodians(key)
        for node in self._wallet.network.custody.keepers_first(record_id):
            if node not in proven:
                continue
            ask = SharedRequest(
                record_id,
                access_id,
                self._wallet.store.content.handle,
                grantee_salt(share.received, self._wallet),
                not gathered.is_whole,
            )
            try:
                answer = await self._download(node, share.grant.grant_id, ask, key)
                gathered.add(node.name, proven[node], answer)
            except BlockRobotError as error:
                if refused_with is None or refused_with.code == "NODE_UNREACHABLE":
                    refused_with = error
                continue
            if gathered.is_done:
                break
        return gathered.view(refused_with)

    async def _custodians(self, key: PrivateKey) -> dict[NodeAddress | None, bytes]:
        """Raises GRANT_ENDED."""
        try:
            found = await read_custodians(self._wallet, key)
        except BlockRobotError as error:
            if error.code != "NOT_PERMITTED":
                raise
            raise BlockRobotError("GRANT_ENDED") from None
        return {node: custodian for custodian, node in found.items()}

    async def _download(
        self, node: NodeAddress, grant_id: bytes, ask: SharedRequest, key: PrivateKey
    ) -> SharedDownload:
        waited_ms = 0.0
        while True:
            try:
                return await self._wallet.network.custody.download_shared(node, grant_id, ask, key)
            except BlockRobotError as error:
                if error.code not in _NOT_YET or waited_ms >= self._follow_max_ms:
                    raise
            await self._sleep(_FOLLOW_PAUSE_S)
            waited_ms += _FOLLOW_PAUSE_S * 1000

    async def background(self, share: IncomingShare, rendition: Rendition) -> bytes | None:
        key = grantee_key(share.received, self._wallet)
        custody = self._wallet.network.custody
        return await custody.find_background(rendition.background_id, key, self.missing_rooms)

    def remember_copy(self, share: IncomingShare, record_id: bytes, folder: str) -> None:
        copy = SharedCopy(record_id, folder)
        if copy not in share.received.copies:
            share.received.copies.append(copy)
            self._wallet.store.save()

    async def confirm_deleted(self, share: IncomingShare, records: Sequence[bytes]) -> bytes:
        """On the chain; forget their folders and return the txid. Raises NOTHING_TO_CONFIRM, CALL_REFUSED."""
        received = share.received
        if not set(records) <= set(share.to_confirm):
            raise refusal("NOTHING_TO_CONFIRM", "confirm_once")
        arguments = [share.grant.grant_id, list(records)]
        key = grantee_key(received, self._wallet)
        txid = (await self._wallet.network.call(key, "access", "noticed", arguments)).txid
        received.copies = [copy for copy in received.copies if copy.record_id not in records]
        received.confirmed += [
            _mark(notice.record_id, notice.kind) for notice in share.notices if notice.record_id in records
        ]
        self._wallet.store.save()
        return txid


@dataclass(frozen=True, slots=True)
class _TrailReader:
    wallet: Wallet
    key: PrivateKey
    trails: None = None

    def owner_key(self, visit: KnownVisit) -> PrivateKey:  # noqa: ARG002
        return self.key

    async def values(self, keys: Sequence[bytes], session: PrivateKey) -> dict[bytes, Any]:
        return await self.wallet.values(keys, session)

    async def scan(self) -> list[KnownVisit]:
        return []


class _Gathered:
    """Custodians' answers for one record; a lying custodian spoils only its own.

    All keys are kept, as a custodian can seal its own; a frame counts once any opens the commitment.
    """

    def __init__(self, state: RecordRow, record_id: bytes, grantee: bytes, sealing: bytes) -> None:
        self._state = state
        self._record_id = record_id
        self._grantee = grantee
        self._sealing = sealing
        self._answers: dict[str, SharedDownload] = {}
        self._parts: dict[bytes, list[KeyPart]] = {}
        self._key_sets: list[dict[int, bytes]] = []
        self._failure = BlockRobotError("GRANT_PARTS_MISSING")
        self._frames: dict[int, FrameView] = {}
        self.is_whole = False

    @property
    def is_done(self) -> bool:
        return bool(self._frames) and all(frame.status != STATUS_CORRUPTED for frame in self._frames.values())

    def add(self, name: str, custodian: bytes, answer: SharedDownload) -> None:
        """Raises UPLOAD_INVALID, then none of it is used."""
        check_shared_parts(answer)
        self._answers[name] = answer
        self._parts[custodian] = answer.parts
        if answer.frames:
            self.is_whole = self.is_whole or self._damaged(answer) == set()
        candidates = join_parts(self._parts)
        for each in self._answers.values():
            try:
                keys = open_package(
                    candidates, self._sealing, each.package, grantee=self._grantee, record_id=self._record_id
                )
            except BlockRobotError as error:
                self._failure = error
            else:
                if keys not in self._key_sets:
                    self._key_sets.append(keys)
        if self._key_sets:
            self._open_all()

    def _damaged(self, answer: SharedDownload) -> set[int] | None:
        try:
            damaged = set(check_shared_download(answer, self._state.commitment_root, self._state.ciphertext_root))
        except BlockRobotError:
            return None
        return damaged | {frame.index for frame in answer.frames if frame.erased and not self._is_erased(frame.index)}

    def _is_erased(self, index: int) -> bool:
        """Trust the chain only: a custodian could claim erasure to withhold a frame."""
        return index in self._state.erased_frames

    def view(self, refused_with: BlockRobotError | None) -> SharedView:
        if not self._answers:
            raise refused_with or refusal("NOT_FOUND", "no_custodian")
        if not self._key_sets:
            if self._failure.code == "GRANT_PARTS_MISSING" and refused_with is not None:
                text = f"One custodian gave its part of the key, and another has to: {refused_with.detail}"
                raise BlockRobotError("GRANT_PARTS_MISSING", text)
            raise self._failure
        if not any(answer.frames for answer in self._answers.values()):
            raise refused_with or BlockRobotError("CLIP_NOT_CONFIRMED", "No custodian that answered keeps this clip.")
        if not self._frames:
            raise BlockRobotError("RENDITION_CORRUPTED", "What custodians sent leads to other roots than the chain's.")
        frames = tuple(self._frames[index] for index in sorted(self._frames))
        return SharedView(self._record_id, frames, tuple(self._answers))

    def _open_all(self) -> None:
        for answer in self._answers.values():
            damaged = self._damaged(answer) if answer.frames else None
            if damaged is None:
                continue
            for frame in answer.frames:
                if frame.index not in self._frames or self._frames[frame.index].status == STATUS_CORRUPTED:
                    self._frames[frame.index] = self._open(answer, frame, is_damaged=frame.index in damaged)

    def _open(self, answer: SharedDownload, frame: SharedFrame, *, is_damaged: bool) -> FrameView:
        if frame.erased and not is_damaged:
            return FrameView(frame.index, STATUS_ERASED, None)
        found = FrameView(frame.index, STATUS_CORRUPTED, None)
        leaf = answer.commitment_leaves[frame.index]
        for keys in () if is_damaged else self._key_sets:
            if frame.index in keys:
                found = judge_frame(keys[frame.index], self._record_id, frame.index, frame.ciphertext, leaf)
            if found.status != STATUS_CORRUPTED:
                break
        return found


def _mark(record_id: bytes, kind: str) -> str:
    return f"{record_id.hex()}:{kind}"
