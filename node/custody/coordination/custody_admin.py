"""An operator's view of a custodian; never opens clips."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import fields, replace
from typing import Any, TypeVar

import msgspec
import structlog
from prometheus_client import CollectorRegistry, Gauge, generate_latest

from consensus.api_documents import describe
from consensus.errors import BlockRobotError
from consensus.limits import ERASURE_OVERDUE_AFTER_MS
from consensus.state.identity import CUSTODIAN
from node.custody.chain_facts import ChainFacts, ErasureFacts
from node.custody.clip_fetching import PeerCustodian
from node.custody.coordination.custody_answers import (
    CustodyStatus,
    FrameName,
    MissingReceipts,
    OverdueErasure,
    PartName,
    RebuildAnswer,
    ScrubAnswer,
    UploadReport,
)
from node.custody.coordination.upload_report import render_uploads
from node.custody.coordination.work_failures import WorkFailures
from node.custody.custodian import Custodian
from node.custody.erase_keys import ErasableKeys
from node.custody.repair.rebuild import Rebuild, RebuildReport
from node.custody.repair.scrub import ScrubReport, Tell, ignore_progress, scrub
from node.custody.stores.custody_store import Checkpoint, CustodyStore
from node.storage.ledger_store import LedgerStore

FETCH_PAUSE_S = 1.0
ERASURES_READ_AGAIN_MS = 60_000
"""How old the metrics' count of unconfirmed erasures may be: each count reads all erasures that ever were."""
_LISTED_MAX_COUNT = 1_000
R = TypeVar("R", ScrubReport, RebuildReport)

log = structlog.get_logger(__name__)


class CustodyAdmin:
    """Operator's view of one custodian; `find_peers` returns custodians reachable now."""

    def __init__(
        self,
        *,
        name: str,
        member: bytes,
        custodian: Custodian,
        store: CustodyStore,
        keys: ErasableKeys,
        ledger: LedgerStore,
        clock: Callable[[], int],
        find_peers: Callable[[], Sequence[PeerCustodian]],
        is_serving: Callable[[], bool],
        failing: WorkFailures,
        describe_uploads: Callable[..., Awaitable[UploadReport]],
    ) -> None:
        """`describe_uploads` reports uploads at a block's time (ms)."""
        self._describe_uploads = describe_uploads
        self._name = name
        self._member = member
        self._custodian = custodian
        self._store = store
        self._keys = keys
        self._ledger = ledger
        self._clock = clock
        self._find_peers = find_peers
        self._is_serving = is_serving
        self._failing = failing
        self._one_at_a_time = asyncio.Lock()
        self._erasures_read_ms = 0
        self._erasures_waiting: dict[str, MissingReceipts] = {}

    @contextmanager
    def open_facts(self) -> Iterator[ChainFacts]:
        with self._ledger.snapshot() as snapshot:
            position = snapshot.position
            assert position is not None, "a node's ledger begins with the genesis block"
            yield ChainFacts(snapshot, Checkpoint(position.height, position.block_id, position.timestamp_ms))

    async def status(self) -> CustodyStatus:
        """Raises STORE_UNAVAILABLE."""
        point, counts = await self._custodian.checkpoint(), await self._store.counts()
        height, waiting = await asyncio.to_thread(self._look_at_erasures)
        followed = -1 if point is None else point.height
        uploads = await self._describe_uploads(0 if point is None else point.timestamp_ms, counts_held=True)
        return CustodyStatus(
            name=self._name,
            member=self._member.hex(),
            checkpoint_height=None if point is None else followed,
            finalized_height=height,
            behind_blocks=max(0, height - followed),
            custodian=self._is_custodian(),
            failing=self._failing.describe(),
            serving=self._is_serving(),
            busy=self._one_at_a_time.locked(),
            clips_held=counts.confirmed,
            clips_staged=counts.staged,
            clips_missing=counts.missing,
            clips_erased=counts.erased,
            frames=counts.frames,
            shares=counts.shares,
            key_parts=counts.parts,
            outbox_ready=counts.outbox_ready,
            outbox_erasing=counts.outbox_erasing,
            slots_used=self._keys.held_count,
            slots_total=self._keys.capacity_count,
            store_bytes=counts.size_bytes,
            waiting_for=waiting,
            **msgspec.structs.asdict(uploads),
        )

    def _is_custodian(self) -> bool:
        with self._ledger.snapshot() as snapshot:
            return CUSTODIAN.has(snapshot, self._member)

    async def metrics(self) -> bytes:
        try:
            point = await self._custodian.checkpoint()
            at_ms = 0 if point is None else point.timestamp_ms
            uploads = render_uploads(await self._describe_uploads(at_ms, counts_held=False))
        except BlockRobotError as error:
            log.warning("upload_metrics_left_out", code=error.code)
            uploads = b""
        if abs(self._clock() - self._erasures_read_ms) >= ERASURES_READ_AGAIN_MS:
            try:
                _, self._erasures_waiting = await asyncio.to_thread(self._look_at_erasures)
            except BlockRobotError as error:
                log.warning("erasure_metrics_left_out", code=error.code)
                return uploads
            self._erasures_read_ms = self._clock()
        return uploads + _render_erasures(self._erasures_waiting, self._member.hex())

    def _look_at_erasures(self) -> tuple[int, dict[str, MissingReceipts]]:
        with self.open_facts() as facts:
            return facts.point.height, self._waiting(facts)

    def _waiting(self, facts: ChainFacts) -> dict[str, MissingReceipts]:
        ages_ms: dict[str, list[tuple[ErasureFacts, int]]] = {}
        now_ms = self._clock()
        for erasure in facts.open_erasures():
            for custodian in sorted(set(erasure.custodians) - erasure.receipts):
                ages_ms.setdefault(custodian.hex(), []).append((erasure, now_ms - erasure.asked_at_ms))
        return {
            custodian: MissingReceipts(
                receipts=len(missing),
                overdue=[
                    OverdueErasure(
                        erasure_id=erasure.erasure_id.hex(), age_s=age_ms // 1000, records=len(erasure.records)
                    )
                    for erasure, age_ms in missing
                    if age_ms > ERASURE_OVERDUE_AFTER_MS
                ],
            )
            for custodian, missing in ages_ms.items()
        }

    @asynccontextmanager
    async def _work(self) -> AsyncIterator[None]:
        """One at a time. Raises why the chain is not followed in place of CUSTODY_CATCHING_UP, which says to try again."""
        async with self._one_at_a_time:
            try:
                yield
            except BlockRobotError as error:
                if error.code == "CUSTODY_CATCHING_UP":
                    self._failing.require_following()
                raise

    async def scrub(self, tell: Tell = ignore_progress, after: bytes = b"") -> ScrubAnswer:
        """Raises CUSTODY_CATCHING_UP, STORE_UNAVAILABLE, ERASE_KEYS_DAMAGED."""
        async with self._work():
            report = await scrub(self._custodian, self._store, self._keys, self.open_facts, tell, after)
        log.info("custody_scrubbed", clean=report.is_clean, nothing_erased_is_left=report.nothing_erased_is_left)
        return describe_scrub(report)

    async def rebuild(self, tell: Tell = ignore_progress) -> RebuildAnswer:
        """Raises as `scrub`."""

        async def pause() -> None:
            await asyncio.sleep(FETCH_PAUSE_S)

        parts = (self._custodian, self._store, self._keys, self.open_facts, self._find_peers)
        async with self._work():
            report = await Rebuild(*parts, pause=pause, tell=tell).run()
        log.info("custody_rebuilt", whole=report.is_whole, fetched=report.fetched_count)
        return describe_rebuild(report)


def _frames(frames: Sequence[tuple[bytes, int]]) -> list[FrameName]:
    return [FrameName(record=record_id.hex(), frame=index) for record_id, index in frames]


def _render_erasures(waiting: dict[str, MissingReceipts], own: str) -> bytes:
    """`own`: this custodian's key, which has its lines in any case."""
    registry = CollectorRegistry()
    texts = {
        "unconfirmed": "Erasures that a custodian (its key) has yet to confirm; up to a minute old.",
        "overdue": f"Those of them that are older than {ERASURE_OVERDUE_AFTER_MS // 1000} seconds.",
    }
    unconfirmed, overdue = (
        Gauge(f"blockrobot_erasures_{name}", text, ("custodian",), registry=registry) for name, text in texts.items()
    )
    for custodian, missing in ({own: MissingReceipts(0, [])} | waiting).items():
        unconfirmed.labels(custodian).set(missing.receipts)
        overdue.labels(custodian).set(len(missing.overdue))
    return generate_latest(registry)


def describe_scrub(report: ScrubReport) -> ScrubAnswer:
    counts, report = _count_and_cut(report)
    parts = report.parts_held_though_ended
    return describe(
        ScrubAnswer,
        report,
        ok=report.is_clean,
        frames_held_though_erased=_frames(report.frames_held_though_erased),
        corrupted=_frames(report.corrupted),
        parts_held_though_ended=[PartName(grant=grant.hex(), record=record.hex()) for grant, record in parts],
        log_bytes=report.leftovers.log_bytes,
        dirty_bytes=report.leftovers.dirty_bytes,
        counts=counts,
    )


def describe_rebuild(report: RebuildReport) -> RebuildAnswer:
    counts, report = _count_and_cut(report)
    return describe(RebuildAnswer, report, ok=report.is_whole, counts=counts)


def _count_and_cut(report: R) -> tuple[dict[str, int], R]:
    """Return how long each list is, and the report with no more of it than is told."""
    lists = {each.name: found for each in fields(report) if isinstance(found := getattr(report, each.name), list)}
    cut: dict[str, Any] = {name: found[:_LISTED_MAX_COUNT] for name, found in lists.items()}
    return {name: len(found) for name, found in lists.items()}, replace(report, **cut)
