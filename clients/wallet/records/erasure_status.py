"""Status of every requested erasure and its custodians, proven from the chain."""

from __future__ import annotations

from dataclasses import dataclass

from clients.wallet.ledger.visit_audit import audit_visit
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.records.erasure import ErasureClient, ErasureReport
from clients.wallet.store.keystore import KnownVisit
from consensus.limits import ERASURE_OVERDUE_AFTER_MS


@dataclass(frozen=True, slots=True)
class CustodianStatus:
    """One custodian's status; `confirmed_at_ms` is None until it confirms."""

    key: bytes
    confirmed_at_ms: int | None
    destroyed_frames: int
    remains: str
    remains_until_ms: int
    overdue: bool


@dataclass(frozen=True, slots=True)
class ErasureProgress:
    """One erasure request and each custodian's status."""

    report: ErasureReport
    asked_at_ms: int
    records_count: int
    frames: tuple[int, ...]
    custodians: tuple[CustodianStatus, ...]


async def find_erasures(wallet: Wallet, now_ms: int) -> list[ErasureProgress]:
    reports = [report for visit in await wallet.scan() for report in await read_erasures(wallet, visit)]
    return sorted((describe_erasure(report, now_ms) for report in reports), key=lambda each: each.asked_at_ms)


async def read_erasures(wallet: Wallet, visit: KnownVisit) -> list[ErasureReport]:
    erasing = ErasureClient(wallet)
    return [
        await erasing.report(visit, entry.data["erasure_id"])
        for entry in await audit_visit(wallet, visit)
        if entry.kind == "erasure_requested"
    ]


def describe_erasure(report: ErasureReport, now_ms: int) -> ErasureProgress:
    state = report.state
    is_late = now_ms - state.time > ERASURE_OVERDUE_AFTER_MS
    words = []
    for key in state.custodians:
        receipt = state.receipts.get(key)
        words.append(
            CustodianStatus(
                key=key,
                confirmed_at_ms=None if receipt is None else receipt.time,
                destroyed_frames=0 if receipt is None else receipt.destroyed_frames,
                remains="" if receipt is None else receipt.remains,
                remains_until_ms=0 if receipt is None else receipt.remains_until_ms,
                overdue=receipt is None and is_late,
            )
        )
    return ErasureProgress(report, state.time, len(state.records), tuple(state.frames), tuple(words))
