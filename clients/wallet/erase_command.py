"""`blockrobot wallet erase`: what will be gone and what remains is said, asked, done. Must never erase what was not named.

What erasing is: `clients.wallet.erasing`; what became of it: `clients.wallet.erasure_status`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence

import click

from clients.sdk.terminal import ask, console, json_option, plain_errors, print_json, problem_json
from clients.wallet.choosing import choose_records, tell_visits_linked
from clients.wallet.completing import complete_records
from clients.wallet.erasing import Erasing, ErasureReport
from clients.wallet.language import WrongUsage, text
from clients.wallet.opening import run_opened
from clients.wallet.records_command import picture_count
from clients.wallet.sharing import Share, Sharing
from clients.wallet.sharing_commands import share_json, tell_recipients
from clients.wallet.wallet import RecordEntry, Wallet
from consensus.errors import BlockRobotError
from consensus.exit_codes import exit_code_of

ERASE_WAIT_S = 60.0


def _read_frames(written: str | None) -> list[int]:
    """Return the indexes of the pictures that were named by numbers from 1, in order; none if the option was not given.

    Raises WrongUsage for anything else: an option that names no picture must not stand for the whole record.
    """
    if written is None:
        return []
    try:
        numbers = sorted({int(part) for part in written.split(",") if part.strip()})
    except ValueError:
        raise WrongUsage("frames") from None
    if not numbers or numbers[0] < 1:
        raise WrongUsage("frames")
    return [number - 1 for number in numbers]


def _ask_to_erase(entries: list[RecordEntry], frames: list[int]) -> None:
    """Say what will be gone and what remains, and ask. Raises Abort for no."""
    if frames:
        console.print(text("erase.frames", count=len(frames), name=entries[0].record_id.hex()[:12]))
    else:
        pictures = text("records.pictures", count=sum(picture_count(entry) for entry in entries))
        of = text("count.visits", count=len({entry.visit.owner for entry in entries}))
        console.print(text("erase.records", count=len(entries), visits=of, pictures=pictures))
    console.print(text("erase.remains"))
    ask(text("erase.ask"))


def _ignore(_: Sequence[ErasureReport]) -> None:
    """Tell nobody."""


def _tell_receipts() -> Callable[[Sequence[ErasureReport]], None]:
    """Return what says on standard error how many receipts have come in, whenever that has changed."""
    told: list[int] = []

    def tell(reports: Sequence[ErasureReport]) -> None:
        here = sum(len(report.receipts) for report in reports)
        if here and told[-1:] != [here]:
            told.append(here)
            of_all = sum(len(report.custodians) for report in reports)
            click.echo(text("erase.receipts", here=here, count=of_all), err=True)

    return tell


@click.command()
@click.argument("record_ids", nargs=-1, shell_complete=complete_records)
@click.option("--all", "everything", is_flag=True, help="Erase all records of all visits.")
@click.option("--frames", help="Only these pictures of one record, counted from 1: 1,4,5. Files in exports: from 0.")
@click.option("--wait", is_flag=True, help="Wait until every custodian has confirmed.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@json_option
@click.pass_context
@plain_errors
def erase(
    ctx: click.Context,
    record_ids: tuple[str, ...],
    everything: bool,
    frames: str | None,
    wait: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Erase records, or single pictures of one. Keys are destroyed first; this cannot be undone.

    Example: blockrobot wallet erase 3fa2c19b07de --frames 1,4 --wait
    """
    if not record_ids and not everything:
        raise WrongUsage("erase_what")
    frame_indexes = _read_frames(frames)
    if frame_indexes and (everything or len(record_ids) != 1):
        raise WrongUsage("frames_of_one")
    if not yes and not sys.stdin.isatty():
        raise WrongUsage("no_terminal_yes")
    late: list[BlockRobotError] = []

    async def action(opened: Wallet) -> tuple[list[ErasureReport], list[Share]]:
        chosen = await choose_records(opened, () if everything else record_ids)
        active = [entry for entry in chosen if entry.state["status"] == "active"]
        entries = tell_visits_linked(active, as_json=as_json)
        erasing = Erasing(opened)
        await erasing.require_pictures(entries, frame_indexes)
        if entries and not yes:
            _ask_to_erase(entries, frame_indexes)
        recipients = await Sharing(opened).recipients(active)
        reports: list[ErasureReport] = []
        for visit, ids in await erasing.request_each(entries, frame_indexes):
            try:
                if wait and not late:
                    await erasing.wait_complete(visit, ids, ERASE_WAIT_S, _ignore if as_json else _tell_receipts())
            except BlockRobotError as error:
                if error.code != "ERASURE_NOT_CONFIRMED":
                    raise
                late.append(error)  # who had received it is told all the same
            reports.extend([await erasing.report(visit, erasure_id) for erasure_id in ids])
        return reports, recipients

    reports, recipients = run_opened(ctx, action)
    if as_json:
        rows = [
            {
                "erasure_id": report.erasure_id.hex(),
                "status": report.status,
                "custodians": [custodian.hex() for custodian in report.custodians],
                "confirmed": list(report.receipts),
            }
            for report in reports
        ]
        now_ms = time.time_ns() // 1_000_000
        told = {"erasures": rows, "recipients": [share_json(each, now_ms) for each in recipients]}
        if late:
            print_json({"ok": False, "error": problem_json(late[0]), **told})
            ctx.exit(exit_code_of(late[0].entry))
        print_json({"ok": True, **told})
        return
    if not reports:
        console.print(text("erase.nothing"))
    for report in reports:
        name, status = report.erasure_id.hex()[:16], text("erase.complete" if report.complete else "erase.requested")
        confirmed, count = len(report.receipts), len(report.custodians)
        console.print(text("erase.report", name=name, status=status, confirmed=confirmed, count=count))
    tell_recipients(recipients)
    if late:
        raise late[0]
