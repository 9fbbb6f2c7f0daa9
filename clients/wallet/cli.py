"""`blockrobot wallet`: the wallet on the command line, in plain words. Must never print a key or take one as an argument.

How a wallet is opened: `clients.wallet.opening`; the commands about consent: `clients.wallet.consent_commands`.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import click
from rich.markup import escape

from clients.sdk.terminal import ask, console, json_option, plain_errors, print_json, problem_json
from clients.wallet.auditing import AuditEntry, audit_all
from clients.wallet.choosing import choose_records, tell_visits_linked
from clients.wallet.completing import complete_records
from clients.wallet.consent_commands import consent
from clients.wallet.erasing import Erasing, ErasureReport
from clients.wallet.erasure_status import custodian_names, erasures
from clients.wallet.export_command import export
from clients.wallet.guardians_commands import guardians
from clients.wallet.inbox_commands import COMMANDS as INBOX_COMMANDS
from clients.wallet.keyring_command import keyring
from clients.wallet.language import DEFAULT_LANGUAGE, WrongUsage, language_in_use, text
from clients.wallet.making_commands import COMMANDS as MAKING_COMMANDS
from clients.wallet.notice_commands import notice, register
from clients.wallet.opening import place_wallet, reads_only, run_opened, show_moment, wallet_options
from clients.wallet.page.story import event_sentence
from clients.wallet.records_command import picture_count, records
from clients.wallet.rights import describe_event
from clients.wallet.rights_commands import COMMANDS as RIGHTS_COMMANDS
from clients.wallet.rotating_commands import COMMANDS as ROTATING_COMMANDS
from clients.wallet.serve_command import serve
from clients.wallet.sharing import Share, Sharing
from clients.wallet.sharing_commands import COMMANDS as SHARING_COMMANDS
from clients.wallet.sharing_commands import share_json, tell_recipients
from clients.wallet.spoken_help import SpokenGroup
from clients.wallet.viewing_commands import COMMANDS as VIEWING_COMMANDS
from clients.wallet.wallet import RecordEntry, Wallet
from consensus.errors import BlockRobotError
from consensus.exit_codes import exit_code_of
from consensus.primitives.keys import PrivateKey

ERASE_WAIT_S = 60.0


@click.group(cls=SpokenGroup)
@wallet_options
@click.pass_context
def wallet(ctx: click.Context, profile: str, wallet_dir: Path | None, genesis: Path | None) -> None:
    """See, check, follow and erase what robots recorded of you.

    Example: blockrobot wallet new; blockrobot wallet register BR1-...; blockrobot wallet records
    """
    ctx.obj = place_wallet(profile, wallet_dir, genesis)


for command in (
    *MAKING_COMMANDS,
    register,
    records,
    *VIEWING_COMMANDS,
    consent,
    notice,
    *RIGHTS_COMMANDS,
    *SHARING_COMMANDS,
    *INBOX_COMMANDS,
    *ROTATING_COMMANDS,
    export,
    erasures,
    guardians,
    keyring,
    serve,
):
    wallet.add_command(command)


@wallet.command()
@json_option
@click.pass_context
@plain_errors
@reads_only
def audit(ctx: click.Context, as_json: bool) -> None:
    """Show everything that happened to your records, in order.

    Example: blockrobot wallet audit
    """

    async def action(opened: Wallet) -> tuple[list[AuditEntry], dict[bytes, str]]:
        return await audit_all(opened), custodian_names(opened, language_in_use())

    entries, names = run_opened(ctx, action)
    if as_json:
        rows = [
            {
                "visit": entry.owner.hex(),
                "index": entry.index,
                "record_id": entry.record_id.hex(),
                "kind": entry.kind,
                "time_ms": entry.time_ms,
                "height": entry.height,
                "detail": describe_event(entry.kind, entry.data, DEFAULT_LANGUAGE),
            }
            for entry in entries
        ]
        print_json({"ok": True, "entries": rows})
        return
    if not entries:
        console.print(text("audit.nothing"))
    for entry in entries:
        if entry.record_id:
            subject = text("audit.record", name=entry.record_id.hex())
        else:
            subject = text("audit.visit", name=entry.owner.hex()[:12])
        block = text("audit.block", height=f"{entry.height:>5}")
        detail = describe_event(entry.kind, entry.data)
        about = f"{subject}; {detail}" if detail else subject
        sentence = event_sentence(entry, names, language_in_use())
        console.print(escape(f"{show_moment(entry.time_ms)}  {block}  {sentence} ({about})"))


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


@wallet.command()
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


@wallet.command(hidden=True)
@click.argument("record_id")
@json_option
@click.pass_context
@plain_errors
def probe(ctx: click.Context, record_id: str, as_json: bool) -> None:
    """Ask every custodian for a record that is not this wallet's, and say how each refuses (for demonstrations).

    Example: blockrobot wallet probe 3fa2c19b07de5a41b6f0c2d4e8a19377
    """

    async def action(opened: Wallet) -> dict[str, str]:
        refusals = {}
        for custodian in opened.network.custody.custodians:
            for name, key in (("member", opened.keys.identity), *_own_owner(opened)):
                try:
                    await opened.network.custody.download_clip(custodian, bytes.fromhex(record_id), bytes(32), key)
                except BlockRobotError as error:
                    refusals[f"{custodian.name} as {name}"] = error.code
                else:
                    refusals[f"{custodian.name} as {name}"] = "RELEASED"
        return refusals

    refusals = run_opened(ctx, action)
    if as_json:
        print_json({"ok": True, "refusals": refusals})
    else:
        for name, code in refusals.items():
            console.print(f"{name}: {code}")


def _own_owner(opened: Wallet) -> list[tuple[str, PrivateKey]]:
    """Return the owner key of this wallet's first visit, if it has one."""
    visits = opened.store.content.visits
    return [("owner of another visit", opened.owner_key(visits[0]))] if visits else []
