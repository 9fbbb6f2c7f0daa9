"""Status of every requested erasure and its custodians, proven from the chain."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass

from clients.wallet.ledger.visit_audit import AuditEntry, audit_visit
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.record_answers import CustodianAnswer, ErasureRow
from clients.wallet.presentation.translations import DEFAULT_LANGUAGE, text
from clients.wallet.records.erasure import ErasureClient, ErasureReport
from clients.wallet.store.keystore import KnownVisit
from consensus.limits import ERASURE_OVERDUE_AFTER_MS
from pages.time_format import format_time

REMAINS_NOTHING = "nothing"
_REMAINS = {"commitment-leaves": "erasures.leaves"}
"""What custodians say of what remains, as the ledger has it, and the text for it."""


@dataclass(frozen=True, slots=True)
class CustodianStatus:
    """One custodian's status; `confirmed_at_ms` is None until it confirms."""

    key: bytes
    name: str
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
    names = custodian_names(wallet)
    return [describe_erasure(report, asked, names, now_ms) for report, asked in await read_erasures(wallet, visit)]


def custodian_names(wallet: Wallet, language: str = DEFAULT_LANGUAGE) -> dict[bytes, str]:
    say = functools.partial(text, "custodian.named", language=language)
    return {
        node.custodian_key: say(name=node.name, organisation=node.organisation) for node in wallet.genesis.custodians
    }


async def read_erasures(wallet: Wallet, visit: KnownVisit) -> list[tuple[ErasureReport, AuditEntry]]:
    erasing = ErasureClient(wallet)
    return [
        (await erasing.report(visit, entry.data["erasure_id"]), entry)
        for entry in await audit_visit(wallet, visit)
        if entry.kind == "erasure_requested"
    ]


def describe_erasure(report: ErasureReport, asked: AuditEntry, names: dict[bytes, str], now_ms: int) -> ErasureProgress:
    is_late = now_ms - asked.time_ms > ERASURE_OVERDUE_AFTER_MS
    words = []
    for key in report.state.custodians:
        receipt = report.state.receipts.get(key)
        words.append(
            CustodianStatus(
                key=key,
                name=names.get(key) or text("custodian.unnamed", language=DEFAULT_LANGUAGE, key=key.hex()[:12]),
                confirmed_at_ms=None if receipt is None else receipt.time,
                destroyed_frames=0 if receipt is None else receipt.destroyed_frames,
                remains="" if receipt is None else receipt.remains,
                remains_until_ms=0 if receipt is None else receipt.remains_until_ms,
                overdue=receipt is None and is_late,
            )
        )
    records = asked.data.get("records", 0)
    return ErasureProgress(report, asked.time_ms, records, tuple(asked.data.get("frames", ())), tuple(words))


def erasure_row(erasure: ErasureProgress) -> ErasureRow:
    return ErasureRow(
        erasure_id=erasure.report.erasure_id.hex(),
        visit=erasure.report.visit.owner.hex(),
        asked_at_ms=erasure.asked_at_ms,
        records=erasure.records_count,
        frames=list(erasure.frames),
        status=erasure.report.state.status,
        custodians=[
            CustodianAnswer(
                name=word.name,
                confirmed_at_ms=word.confirmed_at_ms,
                destroyed_frames=word.destroyed_frames,
                remains=word.remains,
                remains_until_ms=word.remains_until_ms,
                overdue=word.overdue,
            )
            for word in erasure.custodians
        ],
    )


def erasure_lines(
    erasure: ErasureProgress, names: Mapping[bytes, str] | None = None, language: str | None = None
) -> list[str]:
    say = functools.partial(text, language=language)
    what = say("count.records", count=erasure.records_count)
    if erasure.frames:
        what = say("erasures.pictures", count=len(erasure.frames))
    state = say("erasures.complete" if erasure.report.complete else "erasures.waiting")
    lines = [say("erasures.line", moment=format_time(erasure.asked_at_ms), what=what, state=state)]
    for word in erasure.custodians:
        name = word.name if names is None else names.get(word.key) or say("custodian.unnamed", key=word.key.hex()[:12])
        if word.confirmed_at_ms is not None:
            moment = format_time(word.confirmed_at_ms)
            confirmed = functools.partial(say, name=name, moment=moment, count=word.destroyed_frames)
            if word.remains and word.remains != REMAINS_NOTHING:
                remains = say(_REMAINS[word.remains]) if word.remains in _REMAINS else word.remains
                line = confirmed("erasures.confirmed_but", remains=remains, until=format_time(word.remains_until_ms))
            else:
                line = confirmed("erasures.confirmed")
        else:
            line = say("erasures.overdue" if word.overdue else "erasures.not_yet", name=name)
        lines.append(f"  {line}")
    return lines
