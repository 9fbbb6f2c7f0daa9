"""Status of every requested erasure and its custodians, proven from the chain."""

from __future__ import annotations

from dataclasses import dataclass

from clients.wallet.ledger.visit_audit import AuditEntry, audit_visit
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
    found = [each for visit in await wallet.scan() for each in await find_erasures_of(wallet, visit, now_ms)]
    return sorted(found, key=lambda each: each.asked_at_ms)


async def find_erasures_of(wallet: Wallet, visit: KnownVisit, now_ms: int) -> list[ErasureProgress]:
    return [describe_erasure(report, asked, now_ms) for report, asked in await read_erasures(wallet, visit)]


async def read_erasures(wallet: Wallet, visit: KnownVisit) -> list[tuple[ErasureReport, AuditEntry]]:
    erasing = ErasureClient(wallet)
    return [
        (await erasing.report(visit, entry.data["erasure_id"]), entry)
        for entry in await audit_visit(wallet, visit)
        if entry.kind == "erasure_requested"
    ]


def describe_erasure(report: ErasureReport, asked: AuditEntry, now_ms: int) -> ErasureProgress:
    is_late = now_ms - asked.time_ms > ERASURE_OVERDUE_AFTER_MS
    words = []
    for key in report.state.custodians:
        receipt = report.state.receipts.get(key)
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
    records = asked.data.get("records", 0)
    return ErasureProgress(report, asked.time_ms, records, tuple(asked.data.get("frames", ())), tuple(words))
