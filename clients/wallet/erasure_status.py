"""What became of every erasure that a person asked for: who confirmed it, who has not, who is late.

Must never call erased what a custodian has not confirmed. All of it is proved from the chain, so it is the same on every
device that holds the words.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import click

from clients.sdk.terminal import console, json_option, plain_errors, print_json
from clients.wallet.auditing import AuditEntry, audit_visit
from clients.wallet.counting import counted
from clients.wallet.erasing import Erasing, ErasureReport
from clients.wallet.keystore import KnownVisit
from clients.wallet.opening import run_opened, show_moment
from clients.wallet.wallet import Wallet
from consensus.limits import ERASURE_OVERDUE_AFTER_MS


@dataclass(frozen=True, slots=True)
class CustodianWord:
    """One custodian about one erasure: `confirmed_at_ms` is None as long as it has said nothing."""

    name: str
    confirmed_at_ms: int | None
    destroyed_frames: int
    remains: str
    remains_until_ms: int
    overdue: bool


@dataclass(frozen=True, slots=True)
class AskedErasure:
    """One request: how many records (or which pictures of one), when, and what each custodian said."""

    report: ErasureReport
    asked_at_ms: int
    records_count: int
    frames: tuple[int, ...]
    custodians: tuple[CustodianWord, ...]


async def find_erasures(wallet: Wallet, now_ms: int) -> list[AskedErasure]:
    """Return every erasure that was asked for in this person's name, the oldest first."""
    found = [each for visit in await wallet.scan() for each in await find_erasures_of(wallet, visit, now_ms)]
    return sorted(found, key=lambda each: each.asked_at_ms)


async def find_erasures_of(wallet: Wallet, visit: KnownVisit, now_ms: int) -> list[AskedErasure]:
    """Return every erasure that was asked for of one visit, the oldest first."""
    names = custodian_names(wallet)
    return [describe_erasure(report, asked, names, now_ms) for report, asked in await read_erasures(wallet, visit)]


def custodian_names(wallet: Wallet) -> dict[bytes, str]:
    """Return what custodians are called, by their keys."""
    return {node.custodian_key: f"{node.name} of {node.organisation}" for node in wallet.genesis.custodians}


async def read_erasures(wallet: Wallet, visit: KnownVisit) -> list[tuple[ErasureReport, AuditEntry]]:
    """Return the erasures that were asked for of one visit, proven, with the entry of its audit that asks."""
    erasing = Erasing(wallet)
    return [
        (await erasing.report(visit, entry.data["erasure_id"]), entry)
        for entry in await audit_visit(wallet, visit)
        if entry.kind == "erasure_requested"
    ]


def describe_erasure(report: ErasureReport, asked: AuditEntry, names: dict[bytes, str], now_ms: int) -> AskedErasure:
    """Put a request and its receipts together. `names` are those of custodians, by key."""
    is_late = now_ms - asked.time_ms > ERASURE_OVERDUE_AFTER_MS
    words = []
    for key in report.custodians:
        told: dict[str, Any] | None = report.receipts.get(key.hex())
        words.append(
            CustodianWord(
                name=names.get(key, f"custodian {key.hex()[:12]}"),
                confirmed_at_ms=None if told is None else told.get("time", 0),
                destroyed_frames=0 if told is None else told.get("destroyed_frames", 0),
                remains="" if told is None else told.get("remains", ""),
                remains_until_ms=0 if told is None else told.get("remains_until_ms", 0),
                overdue=told is None and is_late,
            )
        )
    records = asked.data.get("records", 0)
    return AskedErasure(report, asked.time_ms, records, tuple(asked.data.get("frames", ())), tuple(words))


def erasure_json(erasure: AskedErasure) -> dict[str, Any]:
    """Return one erasure by names, for a program."""
    return {
        "erasure_id": erasure.report.erasure_id.hex(),
        "visit": erasure.report.visit.owner.hex(),
        "asked_at_ms": erasure.asked_at_ms,
        "records": erasure.records_count,
        "frames": list(erasure.frames),
        "status": erasure.report.status,
        "custodians": [
            {
                "name": word.name,
                "confirmed_at_ms": word.confirmed_at_ms,
                "destroyed_frames": word.destroyed_frames,
                "remains": word.remains,
                "remains_until_ms": word.remains_until_ms,
                "overdue": word.overdue,
            }
            for word in erasure.custodians
        ],
    }


def erasure_lines(erasure: AskedErasure) -> list[str]:
    """Say one erasure in plain sentences."""
    what = counted(erasure.records_count, "record")
    if erasure.frames:
        what = counted(len(erasure.frames), "picture") + " of a record"
    done = "erased everywhere" if erasure.report.complete else "not erased everywhere yet"
    lines = [f"{show_moment(erasure.asked_at_ms)}  {what}: {done}."]
    for word in erasure.custodians:
        if word.confirmed_at_ms is not None:
            left = ""
            if word.remains and word.remains != "nothing":
                left = f"; what remains is {word.remains}, until {show_moment(word.remains_until_ms)}"
            moment = show_moment(word.confirmed_at_ms)
            lines.append(
                f"  {word.name} confirmed {moment}: {counted(word.destroyed_frames, 'picture')} destroyed{left}."
            )
        elif word.overdue:
            lines.append(f"  {word.name} is OVERDUE. Ask its organisation. It hands nothing out before it has erased.")
        else:
            lines.append(f"  {word.name} has not confirmed yet.")
    return lines


@click.command()
@json_option
@click.pass_context
@plain_errors
def erasures(ctx: click.Context, as_json: bool) -> None:
    """Show what you asked to erase, which custodians have confirmed it, and which are overdue.

    Example: blockrobot wallet erasures
    """

    async def action(opened: Wallet) -> list[AskedErasure]:
        return await find_erasures(opened, time.time_ns() // 1_000_000)

    found = run_opened(ctx, action)
    if as_json:
        print_json({"ok": True, "erasures": [erasure_json(each) for each in found]})
        return
    if not found:
        console.print("You have not asked to erase anything.")
    for each in found:
        for line in erasure_lines(each):
            console.print(line)
