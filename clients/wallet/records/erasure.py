"""Erasure of records or frames, with the custodians' receipts."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from clients.sdk.terminal.terminal import pluralize
from clients.wallet.ledger.visit_audit import AuditEntry, audit_visit
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.records.viewing import RecordViewer
from clients.wallet.store.kept_proofs import keep_erasure
from clients.wallet.store.keystore import KnownVisit
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from consensus.limits import CLIP_FRAMES_MAX_COUNT, RECORDS_A_CALL_MAX_COUNT
from consensus.records.metadata import NOTICE_SENSOR
from consensus.state.erasure import REQUEST, ErasureRow

WAIT_MAX_S = 60.0
"""How long a command and the page wait for receipts."""
_POLL_S = 0.1
_LOOK_PURPOSE = "own-access"


@dataclass(frozen=True, slots=True)
class ErasureReport:
    """One proven erasure request with its receipts so far."""

    erasure_id: bytes
    visit: KnownVisit
    state: ErasureRow

    @property
    def complete(self) -> bool:
        return self.state.status == "complete"


@dataclass(frozen=True, slots=True)
class ErasurePlan:
    """What a request would erase; `frames` are picture indexes of its one record, none of them: whole records.

    `gone`: erased or asked for already, `missing`: beyond the record's `count`.
    """

    entries: list[RecordEntry]
    frames: list[int]
    gone: list[int]
    missing: list[int]
    count: int

    @property
    def is_empty(self) -> bool:
        return not self.entries or bool(self.gone and not self.frames)


def plan_erasure(
    entries: Sequence[RecordEntry], frames: Sequence[int] = (), count: int = 0, trail: Sequence[AuditEntry] = ()
) -> ErasurePlan:
    """`count` and `trail`: of the one record whose `frames` are wanted. Raises REQUEST_INVALID."""
    if frames and len(entries) != 1:
        raise refusal("REQUEST_INVALID", "erase_frames")
    gone = {index for entry in entries for index in entry.state.erased_frames}
    for each in trail:
        if each.kind == "erasure_requested" and each.record_id == entries[0].record_id:
            gone.update(each.data.get("frames", ()))
    return ErasurePlan(
        entries=[entry for entry in entries if entry.state.status == "active"],
        frames=[index for index in frames if index not in gone],
        gone=[index for index in frames if index in gone],
        missing=[index for index in frames if index >= count],
        count=count,
    )


class ErasureClient:
    """Erasure of one person's records."""

    def __init__(self, wallet: Wallet) -> None:
        self._wallet = wallet

    async def _count_pictures(self, entry: RecordEntry, frames: Sequence[int]) -> int:
        """An index beyond the robot's count makes a logged access. Raises as `view`."""
        if entry.metadata.sensor == NOTICE_SENSOR:
            return 0
        count = entry.metadata.frame_count
        if count <= max(frames) < CLIP_FRAMES_MAX_COUNT:
            viewing = RecordViewer(self._wallet)
            view = await viewing.view(entry, await viewing.request_access([entry], _LOOK_PURPOSE))
            count = len(view.frames)
        return count

    async def plan(self, entries: Sequence[RecordEntry], frames: Sequence[int]) -> ErasurePlan:
        """Raises REQUEST_INVALID, as `view`."""
        if not frames or len(entries) != 1:
            return plan_erasure(entries, frames)
        (entry,) = entries
        if entry.state.status != "active":
            return plan_erasure(entries)
        trail = await audit_visit(self._wallet, entry.visit)
        return plan_erasure(entries, frames, await self._count_pictures(entry, frames), trail)

    async def request(self, visit: KnownVisit, records: list[bytes], frames: list[int]) -> list[bytes]:
        """In batches of 64 records; return the erasure ids."""
        if frames and len(records) != 1:
            raise refusal("REQUEST_INVALID", "erase_frames")
        ids = []
        for start in range(0, len(records), RECORDS_A_CALL_MAX_COUNT):
            part = records[start : start + RECORDS_A_CALL_MAX_COUNT]
            erasure_id = await self._wallet.sign_and_wait(visit, "erasure", "request", [part, frames])
            ids.append(erasure_id)
            self._wallet.store.content.asked_erasures.append(erasure_id)
        self._wallet.store.save()
        return ids

    async def request_each(
        self, entries: Sequence[RecordEntry], frames: list[int]
    ) -> list[tuple[KnownVisit, list[bytes]]]:
        asked = []
        for owner in dict.fromkeys(entry.visit.owner for entry in entries):
            part = [entry for entry in entries if entry.visit.owner == owner]
            ids = await self.request(part[0].visit, [entry.record_id for entry in part], frames)
            asked.append((part[0].visit, ids))
        return asked

    async def report(self, visit: KnownVisit, erasure_id: bytes) -> ErasureReport:
        """Proven against a finalized header; the proof is kept once complete."""
        proved = await self._wallet.network.state_values([REQUEST.key(erasure_id)], self._wallet.owner_key(visit))
        state = REQUEST.among(proved.values, erasure_id)
        if state is None:
            raise refusal("NOT_FOUND", "erase_unknown")
        if state.status == "complete":
            keep_erasure(self._wallet.store.content, erasure_id, proved)
        return ErasureReport(erasure_id, visit, state)

    async def wait_complete(
        self,
        requested: Sequence[tuple[KnownVisit, list[bytes]]],
        timeout_s: float = WAIT_MAX_S,
        on_progress: Callable[[Sequence[ErasureReport]], None] = lambda _: None,
        is_over: Callable[[], bool] = lambda: False,
    ) -> list[ErasureReport]:
        """Wait for all custodians' receipts, until `is_over`. Raises ERASURE_NOT_CONFIRMED."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout_s
        while True:
            reports = [await self.report(visit, erasure_id) for visit, ids in requested for erasure_id in ids]
            on_progress(reports)
            if all(report.complete for report in reports):
                return reports
            if loop.time() >= deadline or is_over():
                waiting = sum(len(report.state.custodians) - len(report.state.receipts) for report in reports)
                missing = pluralize(waiting, "receipt of a custodian is", "receipts of custodians are")
                raise BlockRobotError("ERASURE_NOT_CONFIRMED", f"{missing} still missing.")
            await asyncio.sleep(_POLL_S)
