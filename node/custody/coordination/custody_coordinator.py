"""Ties the custodian to the chain: feeds blocks, submits transactions, exchanges clips.

Continues from the custodian's checkpoint; a crash repeats at most one block.
"""

from __future__ import annotations

import asyncio
import secrets
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

import structlog

from consensus.chain.block import Block, Receipt, Receipts
from consensus.chain.genesis import Genesis
from consensus.chain.transaction import SALT_SIZE_BYTES, Transaction, sign_transaction
from consensus.errors import BlockRobotError
from consensus.limits import CLIP_SIZE_MAX_BYTES, DAY_MS
from consensus.primitives.encoding import decode, decode_value, encode
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipDownload, ClipUpload
from consensus.records.placement import Placement
from consensus.records.png import check_depth_png
from consensus.records.sharing import GrantUpload, SharedDownload, SharedRequest
from consensus.state.identity import CUSTODIAN, ROOM, RoomRow
from consensus.state.records import EMPTY_FRAME
from consensus.state.settings import read_quotas
from node.custody.block_effects import only_records
from node.custody.chain_facts import ChainFacts, read_placement, require_grantee, require_open_grant
from node.custody.clip_fetching import FETCHES_IN_FLIGHT_COUNT
from node.custody.coordination.custody_answers import UploadReport
from node.custody.coordination.upload_admission import CATCH_UP_MAX_MS, HoldRoom, UploadAdmission
from node.custody.coordination.upload_report import describe_uploads
from node.custody.coordination.work_failures import WorkFailures
from node.custody.custodian import Custodian
from node.custody.erase_keys import ErasableKeys
from node.custody.finalized_events import CUSTODIANS_REMOVED, FinalizedEvents, collect_events
from node.custody.stores.custody_store import Checkpoint, CustodyStore, OutboxRow
from node.custody.uploads.upload_usage import UploadAccount
from node.ledger.ledger_writer import FinalityFeed
from node.limits.disk_reserve import DiskReserve
from node.mempool.transaction_pool import TransactionPool
from node.p2p.wire import ClipPart, ClipRequest, RequestKind
from node.storage.ledger_store import LedgerStore, TransactionLocation

OUTBOX_BATCH_COUNT = 64
SUBMISSIONS_KEPT_MAX_COUNT = 4_096
OUTBOX_INTERVAL_MS = 1_000
OUTBOX_LIFETIME_MS = 60_000
FETCH_INTERVAL_MS = 2_000
BLOCKS_AT_ONCE_COUNT = 16
"""How many blocks a custodian that is behind follows by one write."""
REFUSALS_MAX_COUNT = 3
VAIN_CODES = frozenset({"RECEIPT_EXISTS", "RELEASE_EXISTS", "REFUSAL_EXISTS", "NOT_A_CUSTODIAN"})
"""After which nothing is said again: the chain knows it already, or asked others, before this custodian came."""
CLIP_ABSENT_CODES = frozenset({"NOT_FOUND", "CLIP_NOT_CONFIRMED", "CLIP_ERASED"})
CLIP_PART_BYTES = 1024 * 1024
CLIP_WIRE_MAX_BYTES = CLIP_SIZE_MAX_BYTES + 1024 * 1024
CLIP_MAX_MS = 30_000
"""For all parts of one: some 0.6 MiB a second for the largest."""
CLIPS_SERVED_KEPT_COUNT = FETCHES_IN_FLIGHT_COUNT
"""Of clips in parts; fewer, and each part of what one custodian fetches would read its clip again."""
RETRY_MS = 500
SERVING_POLL_MS = 50
_WAIT_MS = 60_000

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class _Submission:
    row: OutboxRow
    txid: bytes
    valid_until_ms: int
    refusals: int = 0


class PeerRequests(Protocol):
    """Asks peers."""

    @property
    def connected(self) -> list[str]: ...

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Raises PEER_UNAVAILABLE."""
        ...


class PeerLink:
    """A `PeerCustodian` over a node's connections; a clip is limited to its announced size."""

    def __init__(self, name: str, peers: PeerRequests, member: bytes = b"") -> None:
        self.name, self.member = name, member
        self._peers = peers

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        """Return a confirmed clip, or None. Raises PEER_*, ENCODING_*."""
        try:
            async with asyncio.timeout(CLIP_MAX_MS / 1000):
                return await self._fetch(record_id)
        except TimeoutError:
            raise BlockRobotError("PEER_UNAVAILABLE", "The peer takes too long for a clip.") from None

    async def _fetch(self, record_id: bytes) -> ClipDownload | None:
        data = bytearray()
        while True:
            request = ClipRequest(record_id=record_id, offset=len(data))
            part = decode(await self._peers.request(self.name, RequestKind.CLIP, encode(request)), ClipPart)
            if part.total > CLIP_WIRE_MAX_BYTES or len(part.data) < min(CLIP_PART_BYTES, part.total - len(data)):
                raise BlockRobotError("PEER_MESSAGE_INVALID", "The peer's clip is not what it announced.")
            data += part.data
            if len(data) >= part.total:
                return decode(bytes(data), ClipDownload) if data else None


class CustodyCoordinator:
    """The custodian's work on this node: follow, submit and fetch tasks."""

    def __init__(
        self,
        *,
        genesis: Genesis,
        name: str,
        custodian: Custodian,
        key: PrivateKey,
        ledger: LedgerStore,
        feed: FinalityFeed,
        pool: TransactionPool,
        peers: PeerRequests,
        clock: Callable[[], int],
        randomness: Callable[[int], bytes] = secrets.token_bytes,
        custodians: Callable[[], Mapping[str, bytes]] | None = None,
        is_in_touch: Callable[[], bool] = lambda: True,
        final_height: Callable[[], int] = lambda: -1,
        hold_room: HoldRoom | None = None,
        room_gib: int = 0,
    ) -> None:
        """`is_in_touch`: the node is as far as a quorum; nothing is served before.

        `final_height` includes final blocks not yet stored; `hold_room` reserves disk room; `room_gib` is declared on the
        chain.
        """
        self.admission = UploadAdmission(
            ledger,
            feed,
            custodian,
            hold_room,
            lambda: self.is_serving,
            lambda state: CUSTODIAN.has(state, key.public_key),
        )
        self._genesis = genesis
        self.custodian = self._custodian = custodian
        self._key = key
        self._ledger = ledger
        self._feed = feed
        self._pool = pool
        self._peers = peers
        self._clock = clock
        self.failing = WorkFailures(clock)
        self._randomness = randomness
        self._name = name
        self._custodians = custodians or (lambda: {node.name: node.custodian_key for node in genesis.custodians})
        self._is_in_touch = is_in_touch
        self._final_height = final_height
        self._room_gib, self._room_pending_until_ms = room_gib, 0
        self._serves_from: int | None = None
        self._submitted: dict[tuple[str, bytes, int], _Submission] = {}
        self._served: OrderedDict[bytes, bytes] = OrderedDict()
        self._wake_outbox = asyncio.Event()
        self._followed = asyncio.Condition()
        self._tasks: list[asyncio.Task[None]] = []
        self.checkpoint_height: int | None = None

    @property
    def _others(self) -> Mapping[str, bytes]:
        return {name: key for name, key in self._custodians().items() if name != self._name}

    @property
    def is_serving(self) -> bool:
        """Return whether clips may leave: the chain has been followed fully since start.

        Until then an old backup could serve clips erased since.
        """
        if self._serves_from is None and self._is_in_touch():
            self._serves_from = max(self._feed.height, self._final_height())
        return self._serves_from is not None and self._has_followed(self._serves_from)

    def _has_followed(self, height: int) -> bool:
        return (-1 if self.checkpoint_height is None else self.checkpoint_height) >= height

    async def _wait_current(self, txid: bytes | None = None) -> None:
        """Wait briefly until all final blocks here, and `txid`, are applied.

        Before that, erased or denied clips could be served. Raises CUSTODY_CATCHING_UP.
        """
        if txid is not None and self._locate(txid) is None:
            await self._feed.wait_final(txid, CATCH_UP_MAX_MS)
        needed = self._feed.height
        for _ in range(CATCH_UP_MAX_MS // SERVING_POLL_MS):
            if self.is_serving:
                break
            await asyncio.sleep(SERVING_POLL_MS / 1000)
        try:
            async with asyncio.timeout(CATCH_UP_MAX_MS / 1000), self._followed:
                await self._followed.wait_for(lambda: self._has_followed(needed))
        except TimeoutError:
            log.warning("custody_behind", height=self.checkpoint_height, needed=needed)
            raise BlockRobotError("CUSTODY_CATCHING_UP") from None
        if not self.is_serving:
            raise BlockRobotError("CUSTODY_CATCHING_UP")

    def find_peers(self) -> list[PeerLink]:
        others = self._others
        return [PeerLink(name, self._peers, others[name]) for name in self._peers.connected if name in others]

    async def start(self) -> None:
        """Finish interrupted work and begin. Raises STORE_UNAVAILABLE, ERASE_KEYS_DAMAGED."""
        await self._custodian.start()
        checkpoint = await self._custodian.checkpoint()
        self.checkpoint_height = None if checkpoint is None else checkpoint.height
        loop = asyncio.get_running_loop()
        for work in (self._follow, self._submit, self._fetch):
            self._tasks.append(loop.create_task(work(), name=f"custody{work.__name__}"))

    async def stop(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # What clients ask (`CustodyService`)

    async def stage(self, upload: ClipUpload, robot: bytes, *, is_new: bool = True) -> None:
        """Raises CLIP_ERASED, STORE_UNAVAILABLE, VISIT_NOT_OPEN, and UPLOAD_* as the custodian."""
        with self.admission.refused.noted(robot), self.failing.noted("uploads"):
            await self.admission.wait_for_visit(upload.record_id, upload.owner, robot)
            await self._custodian.stage(upload, self.admission.read_terms(robot), is_new=is_new)
        self._wake_outbox.set()

    async def describe_uploads(
        self, account: UploadAccount, timestamp_ms: int, reserve: DiskReserve | None, *, counts_held: bool
    ) -> UploadReport:
        with self._ledger.snapshot() as snapshot:
            quotas = read_quotas(snapshot.get)
        refused = self.admission.refused
        return await describe_uploads(
            account, timestamp_ms, quotas, self.admission.organisation_of, refused, reserve, counts_held=counts_held
        )

    async def download(self, record_id: bytes, access_id: bytes, owner: bytes) -> ClipDownload:
        """Raises as the custodian, and CUSTODY_CATCHING_UP."""
        await self._wait_current(access_id)
        return await self._custodian.download(record_id, access_id, owner)

    async def stage_part(self, upload: GrantUpload, owner: bytes) -> str:
        def require_open() -> None:
            with self._ledger.snapshot() as snapshot:
                require_open_grant(snapshot, upload.grant_txid, self._clock())

        self.admission.require_room()
        status = await self._custodian.stage_part(upload, owner, require_open)
        self._wake_outbox.set()
        return status

    async def download_shared(self, request: SharedRequest, grant_id: bytes, grantee: bytes) -> SharedDownload:
        """Return a shared clip to a grantee who is still staff or officer.

        The newest final state and the custodian's store have to agree. Raises as `download`.
        """
        await self._wait_current(request.access_id)
        with self._ledger.snapshot() as snapshot:
            require_grantee(snapshot, request, grant_id, grantee, self._clock())
        return await self._custodian.download_shared(request, grant_id)

    async def put_background(self, digest: bytes, content: bytes, robot: bytes) -> None:
        """Raises BACKGROUND_NOT_A_PICTURE, EMPTY_FRAME_NOT_APPROVED, UPLOAD_QUOTA_EXCEEDED."""
        with self.admission.refused.noted(robot):
            await asyncio.to_thread(check_depth_png, content)
            terms, require_approved = self.admission.read_terms(robot), self.admission.require_approved
            await self._custodian.put_background(digest, content, terms, partial(require_approved, digest, robot))

    async def get_background(self, digest: bytes) -> bytes | None:
        """None if it is not approved. Raises CUSTODY_CATCHING_UP."""
        await self._wait_current()
        return await self._custodian.get_background(digest)

    def _locate(self, txid: bytes) -> TransactionLocation | None:
        with self._ledger.snapshot() as snapshot:
            return snapshot.locate(txid)

    # Following the chain

    async def _follow(self) -> None:
        while True:
            height = -1 if self.checkpoint_height is None else self.checkpoint_height
            if height >= self._feed.height:
                await self._feed.wait_above(height, _WAIT_MS)
                continue
            try:
                with self.failing.noted("following"):
                    if not await self._reconcile_if_due(height):
                        await self._apply_blocks(height + 1)
            except BlockRobotError as error:
                log.warning("custody_behind", height=height, code=error.code, detail=error.detail)
                await asyncio.sleep(RETRY_MS / 1000)
            except Exception:
                log.exception("custody_fault", height=height)
                await asyncio.sleep(RETRY_MS / 1000)

    async def _reconcile_if_due(self, height: int) -> bool:
        with self._ledger.snapshot() as snapshot:
            position = snapshot.position
            if position is None or height + 1 >= snapshot.earliest_height:
                return False
            log.info("custody_reconciles", followed=height, earliest_height=snapshot.earliest_height)
            point = Checkpoint(position.height, position.block_id, position.timestamp_ms)
            try:
                await self._custodian.reconcile(ChainFacts(snapshot, point))
            finally:
                self._served.clear()
        log.info("custody_reconciled", height=point.height)
        await self._note_followed(point.height)
        self._wake_outbox.set()
        return True

    async def _note_followed(self, height: int) -> None:
        self.checkpoint_height = height
        async with self._followed:
            self._followed.notify_all()

    async def _apply_blocks(self, first: int) -> None:
        """Several that only record, where the custodian is behind; any other alone."""
        taken: list[tuple[FinalizedEvents, Sequence[Receipt]]] = []
        last = max(first, min(self._feed.height, first + BLOCKS_AT_ONCE_COUNT - 1))
        for height in range(first, last + 1):
            events, receipts = self._read_block(height)
            removes = any(event.kind == CUSTODIANS_REMOVED for event in events.events)
            is_alone = removes or not only_records(self._key.public_key, events)
            if is_alone and taken:
                break
            if removes:
                await self._report_expired()  # before the block counts as followed: after a crash it is done again
            taken.append((events, receipts))
            if is_alone:
                break
        try:
            await self._custodian.on_finalized_blocks([events for events, _ in taken])
        finally:
            self._served.clear()  # of what was erased nothing may be left, not even in memory
        await self._note_followed(taken[-1][0].height)
        for _, receipts in taken:
            await self._note_refusals(receipts)
        if any(events.events for events, _ in taken):
            self._wake_outbox.set()

    def _read_block(self, height: int) -> tuple[FinalizedEvents, Sequence[Receipt]]:
        with self._ledger.snapshot() as snapshot:
            block_bytes, receipts_bytes = snapshot.block(height), snapshot.receipts(height)
        if block_bytes is None or receipts_bytes is None:
            raise BlockRobotError("STORAGE_DAMAGED", f"The ledger does not hold block {height}.")
        block, receipts = decode(block_bytes, Block), decode(receipts_bytes, Receipts).receipts
        return collect_events(height, block.block_id, block.header.timestamp_ms, receipts), receipts

    async def _report_expired(self) -> None:
        with self._ledger.snapshot() as snapshot:
            position = snapshot.position
            if position is not None:
                point = Checkpoint(position.height, position.block_id, position.timestamp_ms)
                await self._custodian.report_expired(ChainFacts(snapshot, point))

    async def _note_refusals(self, receipts: Sequence[Receipt]) -> None:
        if not self._submitted:
            return
        refused = {receipt.txid: receipt.code for receipt in receipts if not receipt.ok}
        for key, submission in list(self._submitted.items()):
            code = refused.get(submission.txid)
            if code is None:
                continue
            submission.refusals += 1
            submission.valid_until_ms = 0
            log.warning("outbox_call_failed", kind=submission.row.kind, code=code, count=submission.refusals)
            if code in VAIN_CODES or submission.refusals >= REFUSALS_MAX_COUNT:
                await self._custodian.dismiss(submission.row)
                self._submitted.pop(key, None)  # the next submissions may have let go of it meanwhile

    # Submitting what is owed

    async def _submit(self) -> None:
        while True:
            try:
                await self._submit_due()
            except BlockRobotError as error:
                log.warning("outbox_pending", code=error.code, detail=error.detail)
            except Exception:
                log.exception("outbox_fault")
            try:
                async with asyncio.timeout(OUTBOX_INTERVAL_MS / 1000):
                    await self._wake_outbox.wait()
            except TimeoutError:
                continue
            finally:
                self._wake_outbox.clear()

    async def _submit_due(self) -> None:
        """Nothing while the chain knows no such custodian: this node's own pool would refuse it, again and again."""
        with self._ledger.snapshot() as snapshot:
            room, is_custodian = ROOM.at(snapshot, self._key.public_key), CUSTODIAN.has(snapshot, self._key.public_key)
        if not is_custodian:
            return
        now_ms = self._clock()
        await self._declare_room(room, now_ms)
        rows = {row.key: row for row in await self._custodian.ready_outbox(OUTBOX_BATCH_COUNT)}
        self._forget_submissions(rows, now_ms)
        due = [row for row in rows.values() if self._is_due(row, now_ms)]
        if not due:
            return
        until_ms = now_ms + OUTBOX_LIFETIME_MS
        transactions = [self._sign(row.contract, row.entry, decode_value(row.arguments), until_ms) for row in due]
        results = await self._pool.submit([transaction.wire for transaction in transactions])
        for row, transaction, result in zip(due, transactions, results, strict=True):
            if result.error is not None:
                log.warning("outbox_refused", kind=row.kind, code=result.error.code)
                continue
            previous = self._submitted.get(row.key)
            refusals = 0 if previous is None else previous.refusals
            self._submitted[row.key] = _Submission(row, transaction.txid, transaction.body.valid_until_ms, refusals)

    def _forget_submissions(self, owed: Mapping[tuple[str, bytes, int], OutboxRow], now_ms: int) -> None:
        """Also those of an earlier row with the key of one that is owed: a request's releases and reports of what expired
        come again.
        """
        self._submitted = {
            key: submission
            for key, submission in self._submitted.items()
            if (key in owed or submission.refusals or submission.valid_until_ms > now_ms)
            and owed.get(key, submission.row).is_same_call(submission.row)
        }
        others = [key for key in self._submitted if key not in owed]
        for key in others[: max(0, len(self._submitted) - SUBMISSIONS_KEPT_MAX_COUNT)]:
            del self._submitted[key]

    def _is_due(self, row: OutboxRow, now_ms: int) -> bool:
        submission = self._submitted.get(row.key)
        if submission is None or submission.valid_until_ms <= now_ms:
            return True
        return (
            submission.valid_until_ms > now_ms + OUTBOX_LIFETIME_MS
        )  # signed while this clock was ahead of the others

    async def _declare_room(self, row: RoomRow | None, now_ms: int) -> None:
        """Where the chain says otherwise; the contract takes it once a day."""
        declared_gib, due_ms = (0, 0) if row is None else (row.gib, row.time + DAY_MS)
        if declared_gib == self._room_gib or now_ms < max(due_ms, self._room_pending_until_ms):
            return
        transaction = self._sign("identity", "declare_room", [self._room_gib], now_ms + OUTBOX_LIFETIME_MS)
        [result] = await self._pool.submit([transaction.wire])
        self._room_pending_until_ms = transaction.body.valid_until_ms
        if result.error is not None:
            log.warning("room_not_declared", code=result.error.code)

    def _sign(self, contract: str, entry: str, arguments: list[Any], valid_until_ms: int) -> Transaction:
        return sign_transaction(
            self._key,
            chain_id=self._genesis.chain_id,
            contract=contract,
            entry=entry,
            arguments=arguments,
            valid_until_ms=valid_until_ms,
            salt=self._randomness(SALT_SIZE_BYTES),
        )

    # Clips between custodians

    async def serve_peer(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Part of a clip. Raises PEER_REFUSED, NOT_FOUND, CUSTODY_CATCHING_UP."""
        if peer not in self._others:
            raise BlockRobotError("PEER_REFUSED", f"{peer} is no custodian of this network.")
        if kind is not RequestKind.CLIP:
            raise BlockRobotError("NOT_FOUND")
        await self._wait_current()
        request = decode(body, ClipRequest)
        data = await self._read_clip(request.record_id, is_first=request.offset == 0)
        part = data[request.offset : request.offset + CLIP_PART_BYTES] if request.offset >= 0 else b""
        if request.offset + len(part) >= len(data):
            self._served.pop(request.record_id, None)
        return encode(ClipPart(total=len(data), data=part))

    async def _read_clip(self, record_id: bytes, *, is_first: bool) -> bytes:
        try:
            kept = None if is_first else self._served.get(record_id)
            if kept is not None:
                await self._custodian.require_exportable(record_id)
                return kept
            followed = self.checkpoint_height
            data = encode(await self._custodian.export(record_id))
        except BlockRobotError as error:
            self._served.pop(record_id, None)
            if error.code in CLIP_ABSENT_CODES:
                return b""
            raise
        if followed == self.checkpoint_height:  # else a block may have erased some of it while it was read
            self._served[record_id] = data
            while len(self._served) > CLIPS_SERVED_KEPT_COUNT:
                self._served.popitem(last=False)
        return data

    async def _fetch(self) -> None:
        count = 0
        while True:
            await asyncio.sleep(0 if count else FETCH_INTERVAL_MS / 1000)
            count = 0
            try:
                with self.failing.noted("fetching"):
                    if moved := await self._custodian.follow_placement():
                        log.info("clips_placed_anew", count=moved)
                    if links := self.find_peers():
                        count = await self._custodian.fetch_missing(links)
            except BlockRobotError as error:
                log.warning("clips_not_fetched", code=error.code, detail=error.detail)
            except Exception:
                log.exception("clip_fetch_fault")
            else:
                if count:
                    log.info("clips_fetched", count=count)
                    self._wake_outbox.set()


@dataclass(frozen=True, slots=True)
class CustodyPlace:
    """A custodian's key, open store and open erase keys; closed by their owner."""

    key: PrivateKey
    store: CustodyStore
    erase_keys: ErasableKeys
    reserve: DiskReserve | None = None
    room_gib: int = 0

    def make_custodian(self, ledger: LedgerStore, clock_ms: Callable[[], int]) -> Custodian:
        def is_frame_approved(digest: bytes) -> bool:
            with ledger.snapshot() as snapshot:
                return EMPTY_FRAME.has(snapshot, digest)

        def find_placement() -> Placement:
            with ledger.snapshot() as snapshot:
                return read_placement(snapshot)

        return Custodian(
            self.store,
            self.erase_keys,
            member=self.key.public_key,
            clock_ms=clock_ms,
            has_room=None if self.reserve is None else self.reserve.has_room,
            is_frame_approved=is_frame_approved,
            find_placement=find_placement,
        )
