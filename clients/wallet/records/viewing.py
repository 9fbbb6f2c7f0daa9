"""Sees a record: access on the chain first, then fetch, decrypt, verify on this machine.

Every frame is judged by itself. A frame whose bytes are not those that the robot committed to is named as corrupted; the
others still open. If one custodian's copy is damaged, the next custodian is asked before a frame is called corrupted.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import AsyncGenerator, Sequence
from dataclasses import dataclass, field

from clients.sdk.connections import NodeAddress
from clients.wallet.ledger.visit_audit import Finding
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.present.translations import refusal
from clients.wallet.store.keystore import KnownVisit
from consensus.errors import BlockRobotError
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

RECORDS_A_REQUEST_MAX_COUNT = 64
FOLLOW_MAX_MS = 15_000
VERDICT_WHEN_CANCELLED_MAX_S = 3.0
_FOLLOW_PAUSE_S = 0.25
_NOT_YET = frozenset({"ACCESS_NOT_GRANTED", "CLIP_NOT_CONFIRMED"})

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class FrameView:
    """One frame of a record as it was found: `rendition` is there only if every check passed.

    `failed` is the check of `CHECKS` that a corrupted frame did not pass, empty if that is not
    known. `salt` opens the frame's commitment, and nothing else; `data_key` opens the frame, wherever it is kept.
    """

    index: int
    status: str
    rendition: Rendition | None
    salt: bytes = b""
    data_key: bytes = field(default=b"", repr=False)
    failed: str = ""


@dataclass(frozen=True, slots=True)
class RecordView:
    """A record with all its frames, the custodians whose copies were used, and the leaves under its commitment.

    `refused` are custodians that were asked in vain before one answered, with the code of why.
    """

    entry: RecordEntry
    frames: tuple[FrameView, ...]
    custodians: tuple[str, ...]
    commitment_leaves: tuple[bytes, ...] = ()
    refused: tuple[tuple[str, str], ...] = ()

    @property
    def corrupted(self) -> list[int]:
        """The indexes of frames that no custodian has whole."""
        return [frame.index for frame in self.frames if frame.status == STATUS_CORRUPTED]

    @property
    def damaged(self) -> list[int]:
        """Those of `corrupted` that custodians changed or kept back; of the others the robot made something else."""
        return [frame.index for frame in self.frames if frame.failed in CUSTODY_CHECKS]

    @property
    def frames_counted(self) -> int:
        """How many frames the record has by the metadata that the robot sealed to its owner."""
        return self.entry.metadata.frame_count

    @property
    def miscounted(self) -> bool:
        """Whether the robot contradicts itself: it counted another number of frames than it committed to.

        An erased frame keeps its leaf, and the number of leaves is hashed into the root: no erasure makes this so, and no
        custodian can.
        """
        return self.frames_counted != len(self.frames)

    @property
    def verdict(self) -> str:
        """`verified` or `corrupted`, as the verdict on the chain says it: verified is only what passed every check."""
        return "corrupted" if self.corrupted or self.miscounted else "verified"


def judge_frame(data_key: bytes, record_id: bytes, index: int, ciphertext: bytes, leaf: bytes) -> FrameView:
    """Open one frame and hold it against the leaf that the robot committed to; what does not fit is corrupted."""
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
    """Return a frame that is not shown, with the check of `CHECKS` that it did not pass."""
    return FrameView(index, STATUS_CORRUPTED, None, failed=failed)


def better_frame(known: FrameView | None, found: FrameView) -> FrameView:
    """Return the frame that is to be told of, of two copies: a whole one, else the one that passed more checks.

    What only the bytes that the chain names can show is true of the record, whoever else sent other bytes.
    """
    if known is None or (known.status == STATUS_CORRUPTED and found.status != STATUS_CORRUPTED):
        return found
    if known.status != STATUS_CORRUPTED:
        return known
    return max(known, found, key=lambda frame: CHECKS.index(frame.failed))


def finding_of(view: RecordView) -> Finding:
    """Return what a verdict says of a record. It names the frames that are there and corrupted.

    None, if only the robot's count is wrong.
    """
    return view.entry.record_id, view.verdict, view.corrupted


def name_places(indexes: Sequence[int]) -> str:
    """Name frames by their indexes as people count them, from 1."""
    return ", ".join(str(index + 1) for index in indexes)


class Viewing:
    """Access to the records of one visit, under one access transaction."""

    def __init__(self, wallet: Wallet, *, follow_max_ms: int = FOLLOW_MAX_MS) -> None:
        """`follow_max_ms` is how long a custodian may lag behind what the wallet has proven final."""
        self._wallet = wallet
        self._follow_max_ms = follow_max_ms
        self.missing_rooms: dict[bytes, BlockRobotError] = {}
        """Empty frames that were asked for in vain, by their hash, and why."""

    async def request_access(self, entries: Sequence[RecordEntry], purpose: str) -> bytes:
        """Put one access request of the owner key on the chain and wait until it is final. Returns the access id.

        The records are of one visit; more than 64 are asked for as the whole visit (see `split_requests`).
        """
        require_published([purpose], self._wallet.genesis.purposes)
        ids = [entry.record_id for entry in entries] if len(entries) <= RECORDS_A_REQUEST_MAX_COUNT else []
        return await self._wallet.sign_and_wait(entries[0].visit, "access", "request", [ids, purpose])

    async def split_requests(self, entries: Sequence[RecordEntry]) -> list[list[RecordEntry]]:
        """Return the records by access request, as few as the chain takes: one for each visit of which all are wanted.

        Of a larger part of a visit with more than 64 records, each 64 are a request.
        """
        requests = []
        for owner in dict.fromkeys(entry.visit.owner for entry in entries):
            part = [entry for entry in entries if entry.visit.owner == owner]
            if len(part) <= RECORDS_A_REQUEST_MAX_COUNT or await self._is_whole_visit(part):
                requests.append(part)
                continue
            starts = range(0, len(part), RECORDS_A_REQUEST_MAX_COUNT)
            requests += [part[start : start + RECORDS_A_REQUEST_MAX_COUNT] for start in starts]
        return requests

    async def _is_whole_visit(self, entries: Sequence[RecordEntry]) -> bool:
        report = await self._wallet.visit_report(entries[0].visit)
        there = {entry.record_id for entry in report.records if entry.state.status == "active"}
        return there <= {entry.record_id for entry in entries}

    async def view_each(
        self, entries: Sequence[RecordEntry], purpose: str, *, verdict: bool = False
    ) -> AsyncGenerator[RecordView, None]:
        """Ask for records visit by visit (see `split_requests`), fetch and check them one after the other.

        With `verdict` what was found of a visit is put on the chain, also if one of its records could not be had or the
        caller stops: close the generator then (`contextlib.aclosing`). Raises as `request_access`, `view`, `put_verdicts`;
        of two errors the first, and who is cancelled waits for the verdict VERDICT_WHEN_CANCELLED_MAX_S at most.
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
        """Put what was found on the chain after something else ended the look; what fails of it hides nothing."""
        is_cancelled = isinstance(first, asyncio.CancelledError)
        try:
            async with asyncio.timeout(VERDICT_WHEN_CANCELLED_MAX_S if is_cancelled else None):
                await self.put_verdicts(visit, findings)
        except (BlockRobotError, TimeoutError) as error:
            code = error.code if isinstance(error, BlockRobotError) else "TIMEOUT"
            _log.warning("The verdict on %d records is not on the chain: %s.", len(findings), code)

    async def view(self, entry: RecordEntry, access_id: bytes) -> RecordView:
        """Fetch a record's clip, verify and open it. Raises what every custodian refused, if all did."""
        frames: dict[int, FrameView] = {}
        used: list[str] = []
        leaves: list[bytes] = []
        refused: list[tuple[str, str]] = []
        failure: BlockRobotError | None = None
        for custodian in self._wallet.network.custody.custodians:
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
        """Return the frames as this custodian has them, and the leaves, which are the same whoever sends them."""
        clip = await self._download(custodian, entry, access_id)
        state = entry.state
        damaged = set(check_clip_download(clip, state.commitment_root, state.ciphertext_root))
        frames = [self._open(entry, clip, index, damaged=index in damaged) for index in range(len(clip.frames))]
        return frames, clip.commitment_leaves

    async def _download(self, custodian: NodeAddress, entry: RecordEntry, access_id: bytes) -> ClipDownload:
        """Fetch a clip from one custodian, giving one that follows the chain late some time to see the final request."""
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
        """Put what was found of a visit's records on the chain, signed by the owner key, 64 records to a transaction."""
        for start in range(0, len(findings), RECORDS_A_REQUEST_MAX_COUNT):
            said = [list(finding) for finding in findings[start : start + RECORDS_A_REQUEST_MAX_COUNT]]
            await self._wallet.sign_and_wait(visit, "access", "verdict", [said])

    async def background(self, rendition: Rendition, entry: RecordEntry) -> bytes | None:
        """Return the PNG of the empty frame behind a rendition, checked against its hash, or None (`missing_rooms`)."""
        key = self._wallet.owner_key(entry.visit)
        custody = self._wallet.network.custody
        return await custody.find_background(rendition.background_id, key, self.missing_rooms)
