"""Views records: access on the chain first, then fetch, decrypt and verify each frame locally."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator, Sequence
from dataclasses import dataclass, field

from clients.sdk.connections import NodeAddress
from clients.wallet.ledger.visit_audit import Finding
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.store.keystore import KnownVisit
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from consensus.limits import RECORDS_A_CALL_MAX_COUNT
from consensus.primitives.hashing import sha256
from consensus.records.clips import ClipDownload, check_clip_download
from consensus.records.commitments import commitment_leaf, derive_salt
from consensus.records.envelopes import open_frame
from consensus.records.renditions import Rendition, decode_rendition
from consensus.rights.purposes import require_published

STATUS_OK = "ok"
STATUS_CORRUPTED = "corrupted"
STATUS_ERASED = "erased"
STATUS_NOTICE = "notice"
"""A frame without a picture: it only carries the count of what was withheld."""

CHECK_RELEASED = "released"
CHECK_CIPHERTEXT = "ciphertext"
CHECK_DECRYPTED = "decrypted"
CHECK_COMMITMENT = "commitment"
CHECK_RENDITION = "rendition"
CHECKS = (CHECK_RELEASED, CHECK_CIPHERTEXT, CHECK_DECRYPTED, CHECK_COMMITMENT, CHECK_RENDITION)
"""The checks of a frame, in their order: it was handed out, its bytes are what the chain names, it opens with the owner's
key, it is what the robot committed to, and that can be read. One that fails ends them: what the next would find is not
known."""

CUSTODY_CHECKS = frozenset({CHECK_RELEASED, CHECK_CIPHERTEXT})
"""Checks that fail by custodians alone: what the later ones look at, the sealed key too, the chain names by its hash."""

FOLLOW_MAX_MS = 15_000
VERDICT_WHEN_CANCELLED_MAX_S = 3.0
_FOLLOW_PAUSE_S = 0.25
_NOT_YET = frozenset({"ACCESS_NOT_GRANTED", "CLIP_NOT_CONFIRMED"})

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FrameView:
    """One frame; `rendition` is set only if every check passed.

    `failed` is of `CHECKS`, empty if unknown. `salt` opens only the commitment, `data_key` the frame.
    """

    index: int
    status: str
    rendition: Rendition | None
    salt: bytes = b""
    data_key: bytes = field(default=b"", repr=False)
    failed: str = ""


@dataclass(frozen=True, slots=True)
class RecordView:
    """A record with its frames, custodians used, commitment leaves and `refused` custodians with error codes."""

    entry: RecordEntry
    frames: tuple[FrameView, ...]
    custodians: tuple[str, ...]
    commitment_leaves: tuple[bytes, ...] = ()
    refused: tuple[tuple[str, str], ...] = ()

    @property
    def corrupted(self) -> list[int]:
        return [frame.index for frame in self.frames if frame.status == STATUS_CORRUPTED]

    @property
    def damaged(self) -> list[int]:
        """Those frames of `corrupted` that custodians changed or withheld."""
        return [frame.index for frame in self.frames if frame.failed in CUSTODY_CHECKS]

    @property
    def frames_counted(self) -> int:
        return self.entry.metadata.frame_count

    @property
    def miscounted(self) -> bool:
        """The robot's count differs from its commitment; erasure cannot cause this."""
        return self.frames_counted != len(self.frames)

    @property
    def verdict(self) -> str:
        """`verified` (every check passed) or `corrupted`."""
        return "corrupted" if self.corrupted or self.miscounted else "verified"


def judge_frame(data_key: bytes, record_id: bytes, index: int, ciphertext: bytes, leaf: bytes) -> FrameView:
    try:
        plaintext = open_frame(data_key, record_id, index, ciphertext)
    except BlockRobotError:
        return corrupted_frame(index, CHECK_DECRYPTED)
    salt = derive_salt(data_key)
    if commitment_leaf(salt, index, sha256(plaintext)) != leaf:
        return corrupted_frame(index, CHECK_COMMITMENT)
    try:
        rendition = decode_rendition(plaintext)
    except BlockRobotError:
        return corrupted_frame(index, CHECK_RENDITION)
    return FrameView(index, STATUS_OK if rendition.pixels else STATUS_NOTICE, rendition, salt, data_key)


def corrupted_frame(index: int, failed: str) -> FrameView:
    return FrameView(index, STATUS_CORRUPTED, None, failed=failed)


def better_frame(known: FrameView | None, found: FrameView) -> FrameView:
    """The whole copy, or the one that passed more checks."""
    if known is None or (known.status == STATUS_CORRUPTED and found.status != STATUS_CORRUPTED):
        return found
    if known.status != STATUS_CORRUPTED:
        return known
    return max(known, found, key=lambda frame: CHECKS.index(frame.failed))


def finding_of(view: RecordView) -> Finding:
    """None if only the robot's count is wrong."""
    return view.entry.record_id, view.verdict, view.corrupted


def name_places(indexes: Sequence[int]) -> str:
    return ", ".join(str(index + 1) for index in indexes)


class RecordViewer:
    """Access to one visit's records under one access transaction."""

    def __init__(self, wallet: Wallet, *, follow_max_ms: int = FOLLOW_MAX_MS) -> None:
        """`follow_max_ms` bounds a custodian's lag behind the proven final height."""
        self._wallet = wallet
        self._follow_max_ms = follow_max_ms
        self.missing_rooms: dict[bytes, BlockRobotError] = {}
        """Empty frames that were asked for in vain, by their hash, and why."""

    async def request_access(self, entries: Sequence[RecordEntry], purpose: str) -> bytes:
        """Wait until it is final; return its id."""
        require_published([purpose], self._wallet.genesis.purposes)
        ids = [entry.record_id for entry in entries] if len(entries) <= RECORDS_A_CALL_MAX_COUNT else []
        return await self._wallet.sign_and_wait(entries[0].visit, "access", "request", [ids, purpose])

    async def split_requests(self, entries: Sequence[RecordEntry]) -> list[list[RecordEntry]]:
        """The fewest requests: whole visits, or 64 records each."""
        requests = []
        for owner in dict.fromkeys(entry.visit.owner for entry in entries):
            part = [entry for entry in entries if entry.visit.owner == owner]
            if len(part) <= RECORDS_A_CALL_MAX_COUNT or await self._is_whole_visit(part):
                requests.append(part)
                continue
            starts = range(0, len(part), RECORDS_A_CALL_MAX_COUNT)
            requests += [part[start : start + RECORDS_A_CALL_MAX_COUNT] for start in starts]
        return requests

    async def _is_whole_visit(self, entries: Sequence[RecordEntry]) -> bool:
        report = await self._wallet.visit_report(entries[0].visit)
        there = {entry.record_id for entry in report.records if entry.state.status == "active"}
        return there <= {entry.record_id for entry in entries}

    async def view_each(
        self, entries: Sequence[RecordEntry], purpose: str, *, verdict: bool = False
    ) -> AsyncGenerator[RecordView, None]:
        """Request, fetch and check records visit by visit.

        With `verdict` findings go on the chain even after errors: close the generator (`contextlib.aclosing`). Raises
        the first error; cancellation waits VERDICT_WHEN_CANCELLED_MAX_S at most.
        """
        for part in await self.split_requests(entries):
            access_id = await self.request_access(part, purpose)
            findings: list[Finding] = []
            try:
                for entry in part:
                    view = await self.view(entry, access_id)
                    findings.append(finding_of(view))
                    yield view
            except BaseException as error:
                if verdict:
                    await self._put_after(error, part[0].visit, findings)
                raise
            if verdict:
                await self.put_verdicts(part[0].visit, findings)

    async def _put_after(self, first: BaseException, visit: KnownVisit, findings: list[Finding]) -> None:
        is_cancelled = isinstance(first, asyncio.CancelledError)
        try:
            async with asyncio.timeout(VERDICT_WHEN_CANCELLED_MAX_S if is_cancelled else None):
                await self.put_verdicts(visit, findings)
        except (BlockRobotError, TimeoutError) as error:
            code = error.code if isinstance(error, BlockRobotError) else "TIMEOUT"
            _log.warning("The verdict on %d records is not on the chain: %s.", len(findings), code)

    async def view(self, entry: RecordEntry, access_id: bytes) -> RecordView:
        """Fetch, verify, open. Raises when all custodians refuse."""
        frames: dict[int, FrameView] = {}
        used: list[str] = []
        leaves: list[bytes] = []
        refused: list[tuple[str, str]] = []
        failure: BlockRobotError | None = None
        for custodian in self._wallet.network.custody.keepers_first(entry.record_id):
            try:
                found, leaves = await self._view_at(custodian, entry, access_id)
            except BlockRobotError as error:
                failure = error
                refused.append((custodian.name, error.code))
                continue
            used.append(custodian.name)
            for frame in found:
                frames[frame.index] = better_frame(frames.get(frame.index), frame)
            if all(frame.status != STATUS_CORRUPTED for frame in frames.values()):
                break
        if not frames:
            raise failure or refusal("NOT_FOUND", "no_custodian")
        ordered = tuple(frames[index] for index in sorted(frames))
        return RecordView(entry, ordered, tuple(used), tuple(leaves), tuple(refused))

    async def _view_at(
        self, custodian: NodeAddress, entry: RecordEntry, access_id: bytes
    ) -> tuple[list[FrameView], list[bytes]]:
        clip = await self._download(custodian, entry, access_id)
        state = entry.state
        damaged = set(check_clip_download(clip, state.commitment_root, state.ciphertext_root))
        frames = [self._open(entry, clip, index, damaged=index in damaged) for index in range(len(clip.frames))]
        return frames, clip.commitment_leaves

    async def _download(self, custodian: NodeAddress, entry: RecordEntry, access_id: bytes) -> ClipDownload:
        key = self._wallet.owner_key(entry.visit)
        loop = asyncio.get_running_loop()
        deadline = loop.time() + self._follow_max_ms / 1000
        while True:
            try:
                return await self._wallet.network.custody.download_clip(custodian, entry.record_id, access_id, key)
            except BlockRobotError as error:
                if error.code not in _NOT_YET or loop.time() >= deadline:
                    raise
            await asyncio.sleep(_FOLLOW_PAUSE_S)

    def _open(self, entry: RecordEntry, clip: ClipDownload, index: int, *, damaged: bool) -> FrameView:
        frame = clip.frames[index]
        if frame.erased:
            # A custodian's word is not enough: it would be an easy way to keep a picture back.
            known = index in entry.state.erased_frames or entry.state.status != "active"
            return FrameView(index, STATUS_ERASED, None) if known else corrupted_frame(index, CHECK_RELEASED)
        if damaged:
            return corrupted_frame(index, CHECK_CIPHERTEXT)
        try:
            data_key = self._wallet.open_data_key(frame.sealed_key)
        except BlockRobotError:
            return corrupted_frame(index, CHECK_DECRYPTED)
        return judge_frame(data_key, entry.record_id, index, frame.ciphertext, clip.commitment_leaves[index])

    async def put_verdicts(self, visit: KnownVisit, findings: Sequence[Finding]) -> None:
        """Signed by the owner key, 64 records per transaction."""
        for start in range(0, len(findings), RECORDS_A_CALL_MAX_COUNT):
            batch = [list(finding) for finding in findings[start : start + RECORDS_A_CALL_MAX_COUNT]]
            await self._wallet.sign_and_wait(visit, "access", "verdict", [batch])

    async def background(self, rendition: Rendition, entry: RecordEntry) -> bytes | None:
        key = self._wallet.owner_key(entry.visit)
        custody = self._wallet.network.custody
        return await custody.find_background(rendition.background_id, key, self.missing_rooms)
