"""`blockrobot wallet`: the wallet on the command line, in plain words. Must never print a key or take one as an argument.

How a wallet is opened: `clients.wallet.opening`; the commands about consent: `clients.wallet.consent_commands`.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import click
from rich.markup import escape

from clients.sdk.terminal import console, json_option, plain_errors, print_json
from clients.wallet.auditing import audit_all
from clients.wallet.consent_commands import consent
from clients.wallet.erasing import Erasing, ErasureReport
from clients.wallet.erasure_status import erasures
from clients.wallet.export_command import export
from clients.wallet.inbox_commands import COMMANDS as INBOX_COMMANDS
from clients.wallet.keys import derive_keys, draw_words
from clients.wallet.keystore import Keystore, PassphraseCost, WalletContent
from clients.wallet.linking import tell_linked
from clients.wallet.notice_commands import notice, register
from clients.wallet.notices import Notices
from clients.wallet.opening import place_wallet, read_passphrase, run_opened, show_moment, wallet_options
from clients.wallet.pictures import write_pictures
from clients.wallet.restoring import read_words, require_distinct, restore_wallet
from clients.wallet.rights import describe_event
from clients.wallet.rights_commands import COMMANDS as RIGHTS_COMMANDS
from clients.wallet.rotating_commands import COMMANDS as ROTATING_COMMANDS
from clients.wallet.rotating_commands import print_words, unreadable_words, words_json, write_words
from clients.wallet.sharing import Share, Sharing
from clients.wallet.sharing_commands import COMMANDS as SHARING_COMMANDS
from clients.wallet.sharing_commands import share_json, tell_recipients
from clients.wallet.standing_words import print_standing, standing_json
from clients.wallet.viewing import RecordView, Viewing
from clients.wallet.visits import find_record
from clients.wallet.wallet import RecordEntry, VisitReport, Wallet
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.metadata import NOTICE_SENSOR
from consensus.records.notices import NoticeRow

ERASE_WAIT_S = 60.0


@click.group()
@wallet_options
@click.pass_context
def wallet(ctx: click.Context, profile: str, wallet_dir: Path | None, genesis: Path | None) -> None:
    """See, check, follow and erase what robots recorded of you.

    Example: blockrobot wallet new; blockrobot wallet register BR1-...; blockrobot wallet records
    """
    ctx.obj = place_wallet(profile, wallet_dir, genesis)


@wallet.command()
@click.option("--words-file", type=click.Path(path_type=Path, dir_okay=False), help="Write the words here, mode 0600.")
@click.option("--fast-passphrase", is_flag=True, help="A cheaper passphrase check, for tests and demonstrations.")
@json_option
@click.pass_context
@plain_errors
def new(ctx: click.Context, words_file: Path | None, fast_passphrase: bool, as_json: bool) -> None:
    """Make a new wallet and show its 24 words once. Write them down: they are the wallet.

    Example: blockrobot wallet new
    """
    path, _ = ctx.obj
    if words_file is None and not sys.stdin.isatty():
        raise click.UsageError("There is no terminal to show the words on: give --words-file.")
    words = draw_words()
    passphrase = read_passphrase(confirm=True)
    Keystore.create(path, words, passphrase, _cost(fast_passphrase))
    if words_file:
        write_words(words_file, words)
    else:
        console.print("Your 24 words. Write them down now; they are shown this once:\n")
        console.print(words, style="bold")
    member = derive_keys(words).identity.public_key.hex()
    if as_json:
        print_json({"ok": True, "wallet": str(path), "member": member})
    else:
        console.print(f"\nYour wallet is {path}. Next: blockrobot wallet register CODE (the code on your card).")


wallet.add_command(consent)
wallet.add_command(register)
wallet.add_command(notice)
for right in (*RIGHTS_COMMANDS, *SHARING_COMMANDS, *INBOX_COMMANDS):
    wallet.add_command(right)
for command in ROTATING_COMMANDS:
    wallet.add_command(command)
wallet.add_command(export)
wallet.add_command(erasures)


def _cost(fast: bool) -> PassphraseCost | None:
    from nacl import pwhash  # noqa: PLC0415 - only for this constant

    return PassphraseCost(pwhash.argon2id.OPSLIMIT_MIN, pwhash.argon2id.MEMLIMIT_MIN) if fast else None


@wallet.command()
@click.option("--words-file", type=click.Path(path_type=Path, exists=True, dir_okay=False), help="Read the words here.")
@click.option(
    "--former",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    multiple=True,
    help="Words that were replaced, in a file; oldest first if there are several.",
)
@click.option("--fast-passphrase", is_flag=True, help="A cheaper passphrase check, for tests and demonstrations.")
@json_option
@click.pass_context
@plain_errors
def restore(
    ctx: click.Context, words_file: Path | None, former: tuple[Path, ...], fast_passphrase: bool, as_json: bool
) -> None:
    """Make the wallet again from its 24 words. Your visits are found again on the chain.

    If you ever changed them (wallet rotate), former words are needed to open what was recorded before.

    Example: blockrobot wallet restore --words-file words.txt
    """
    path, genesis_path = ctx.obj
    if words_file:
        words = words_file.read_text(encoding="utf-8")
    elif sys.stdin.isatty():
        words = click.prompt("The 24 words", hide_input=True)
    else:
        raise click.UsageError("There is no terminal to ask for the words: give --words-file.")
    keys = derive_keys(words)
    replaced = [read_words(file.read_text(encoding="utf-8")) for file in former]
    require_distinct(read_words(words), replaced)
    passphrase = read_passphrase(confirm=True)
    known = restore_wallet(path, read_words(words), replaced, passphrase, _cost(fast_passphrase), genesis_path)
    if as_json:
        member = keys.identity.public_key.hex()
        print_json({"ok": True, "wallet": str(path), "member": member, "words_checked": known})
        return
    console.print(f"Your wallet is {path} again. Next: blockrobot wallet records.")
    if not former:
        console.print("If you ever changed your words (wallet rotate), the old pictures need the former ones: --former.")
    elif not known:
        console.print("Which of these words are in force the network could not be asked. If it is the others: swap them.")


_THINGS = {"emotion": "estimates", "audio": "sounds"}


def _picture_count(entry: RecordEntry) -> int:
    """Return how many pictures a record has: a notice of withheld frames alone has none."""
    return 0 if entry.metadata.sensor == NOTICE_SENSOR else entry.metadata.frame_count


def _entry_json(entry: RecordEntry) -> dict[str, Any]:
    meta = entry.metadata
    return {
        "record_id": entry.record_id.hex(),
        "visit": entry.visit.owner.hex(),
        "status": entry.state["status"],
        "sensor": meta.sensor,
        "started_at_ms": meta.started_at_ms,
        "ended_at_ms": meta.ended_at_ms,
        "frames": _picture_count(entry),
        "erased_frames": list(entry.state["erased_frames"]),
        "index_in_visit": meta.index_in_visit,
        "expires_at_ms": entry.state["expires_at_ms"],
        "withheld": dict(meta.withheld),
    }


def _report_json(report: VisitReport) -> dict[str, Any]:
    return {
        "visit": report.visit.owner.hex(),
        "robot": report.visit.robot.hex(),
        "closed": report.closed,
        "missing_records": report.missing_count,
        "erased_records": [record_id.hex() for record_id in report.erased_ids],
        "unreadable_records": [record_id.hex() for record_id in report.unreadable_ids],
        "needs_former_words": report.needs_former_words,
        "records": [
            _entry_json(entry) | {"restricted": report.standing.restricts(entry.record_id)} for entry in report.records
        ],
        **standing_json(report.standing),
    }


@wallet.command()
@json_option
@click.pass_context
@plain_errors
def records(ctx: click.Context, as_json: bool) -> None:
    """List what was recorded of you, proven against the chain.

    Example: blockrobot wallet records --json
    """

    async def action(opened: Wallet) -> tuple[list[VisitReport], NoticeRow | None, WalletContent]:
        reports, content = await opened.records(), opened.store.content
        is_member = not content.left and not opened.member_gone
        return reports, await Notices(opened).changed_since_consent() if is_member else None, content

    reports, changed, content = run_opened(ctx, action)
    if as_json:
        version = None if changed is None else changed.version
        visits = [_report_json(report) for report in reports]
        print_json({"ok": True, "notice_changed_to": version, "visits": visits, **words_json(content)})
        return
    print_words(content)
    if changed is not None:
        console.print(
            f"What {escape(changed.organisation)} tells you changed since you consented: blockrobot wallet notice"
        )
    if not reports:
        console.print("Nothing was recorded of you.")
    for number, report in enumerate(reports, 1):
        frames = sum(_picture_count(entry) for entry in report.records)
        state = "ended" if report.closed else "still open"
        name = report.visit.owner.hex()[:12]
        console.print(f"Visit {number} ({name}) at robot {report.visit.robot.hex()[:10]}, {state}: {frames} pictures")
        print_standing(report.standing)
        for entry in report.records:
            meta = entry.metadata
            what = _THINGS.get(meta.sensor, "pictures")
            span = f"{show_moment(meta.started_at_ms)}, {_picture_count(entry)} {what} ({meta.sensor})"
            withheld = sum(count for _, count in meta.withheld)
            span += f", {withheld} withheld before" if withheld else ""
            erased = f", {len(entry.state['erased_frames'])} of them erased" if entry.state["erased_frames"] else ""
            console.print(f"  {entry.record_id.hex()}  {span}{erased}")
        if report.erased_ids:
            console.print(f"  {len(report.erased_ids)} records of this visit are erased.")
        if report.unreadable_ids:
            console.print(f"  [red]{unreadable_words(report)}[/red]")
        if report.missing_count:
            console.print(f"  [red]{report.missing_count} records are missing. Ask the hospital why.[/red]")


async def _chosen(opened: Wallet, record_ids: tuple[str, ...]) -> list[RecordEntry]:
    """Return the named records; if none is named all, but for visits that she denied.

    Raises NOT_FOUND for one that is not this person's.
    """
    reports = await opened.records()
    reports = [report for report in reports if record_ids or not report.standing.breach_id]
    entries = {entry.record_id.hex(): entry for report in reports for entry in report.records}
    if not record_ids:
        return list(entries.values())
    return [entries[find_record(list(entries), record_id)] for record_id in record_ids]


def _tell_linked(entries: list[RecordEntry], *, as_json: bool) -> list[RecordEntry]:
    if not as_json:
        tell_linked(len({entry.visit.owner for entry in entries}))
    return entries


async def _view_all(
    opened: Wallet, entries: list[RecordEntry], purpose: str, *, verdict: bool, out: Path | None
) -> list[RecordView]:
    viewing = Viewing(opened)
    views: list[RecordView] = []
    for start in range(0, len(entries), 64):
        for owner in {entry.visit.owner for entry in entries[start : start + 64]}:
            part = [entry for entry in entries[start : start + 64] if entry.visit.owner == owner]
            access_id = await viewing.request_access(part, purpose)
            for entry in part:
                view = await viewing.view(entry, access_id)
                if verdict:
                    await viewing.put_verdict(view)
                if out:
                    await write_pictures(viewing, view, out)
                views.append(view)
    return views


def _view_json(view: RecordView) -> dict[str, Any]:
    return {
        "record_id": view.entry.record_id.hex(),
        "verdict": view.verdict,
        "custodians": list(view.custodians),
        "frames": [{"index": frame.index, "status": frame.status} for frame in view.frames],
    }


def _print_views(views: list[RecordView], *, as_json: bool, out: Path | None) -> None:
    if as_json:
        print_json({"ok": True, "records": [_view_json(view) for view in views], "out": str(out) if out else None})
        return
    if not views:
        console.print("There is nothing to show.")
        return
    for view in views:
        pictures = sum(frame.status != "notice" for frame in view.frames)
        whole = sum(frame.status == "ok" for frame in view.frames)
        line = f"{view.entry.record_id.hex()}: {whole} of {pictures} pictures are as the robot took them"
        if view.corrupted:
            line += f"; [red]changed since: {', '.join(map(str, view.corrupted))}[/red]"
        console.print(line + ".")
    if out:
        console.print(f"The pictures are in {out}.")


@wallet.command()
@click.argument("record_ids", nargs=-1)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("pictures"), show_default=True)
@click.option("--purpose", default="own-access", show_default=True, help="Why you look: it stands in the audit trail.")
@json_option
@click.pass_context
@plain_errors
def view(ctx: click.Context, record_ids: tuple[str, ...], out: Path, purpose: str, as_json: bool) -> None:
    """Fetch, check and decrypt records (all if none is named) and write them as pictures, labels and sounds.

    Example: blockrobot wallet view 3fa2c19b07de --out pictures
    """

    async def action(opened: Wallet) -> list[RecordView]:
        entries = _tell_linked(await _chosen(opened, record_ids), as_json=as_json)
        return await _view_all(opened, entries, purpose, verdict=False, out=out)

    _print_views(run_opened(ctx, action), as_json=as_json, out=out)


@wallet.command()
@click.argument("record_ids", nargs=-1)
@click.option("--purpose", default="own-access", show_default=True, help="Why you look: it stands in the audit trail.")
@json_option
@click.pass_context
@plain_errors
def verify(ctx: click.Context, record_ids: tuple[str, ...], purpose: str, as_json: bool) -> None:
    """Check records against the chain on this machine, trusting no node, and put the verdict on the chain.

    Example: blockrobot wallet verify
    """

    async def action(opened: Wallet) -> list[RecordView]:
        entries = _tell_linked(await _chosen(opened, record_ids), as_json=as_json)
        return await _view_all(opened, entries, purpose, verdict=True, out=None)

    _print_views(run_opened(ctx, action), as_json=as_json, out=None)


@wallet.command()
@json_option
@click.pass_context
@plain_errors
def audit(ctx: click.Context, as_json: bool) -> None:
    """Show everything that happened to your records, in order.

    Example: blockrobot wallet audit
    """
    entries = run_opened(ctx, audit_all)
    if as_json:
        rows = [
            {
                "visit": entry.owner.hex(),
                "index": entry.index,
                "record_id": entry.record_id.hex(),
                "kind": entry.kind,
                "time_ms": entry.time_ms,
                "height": entry.height,
                "detail": describe_event(entry.kind, entry.data),
            }
            for entry in entries
        ]
        print_json({"ok": True, "entries": rows})
        return
    if not entries:
        console.print("Nothing has happened yet.")
    for entry in entries:
        subject = f"record {entry.record_id.hex()}" if entry.record_id else f"visit {entry.owner.hex()[:12]}"
        detail = describe_event(entry.kind, entry.data)
        line = f"{show_moment(entry.time_ms)}  block {entry.height:>5}  {entry.kind:<20} {subject}"
        console.print(line + (f"  {detail}" if detail else ""))


@wallet.command()
@click.argument("record_ids", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="Erase all records of all visits.")
@click.option("--frames", default="", help="Only these pictures of one record, as 0,3,4.")
@click.option("--wait", is_flag=True, help="Wait until every custodian has confirmed.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@json_option
@click.pass_context
@plain_errors
def erase(
    ctx: click.Context, record_ids: tuple[str, ...], everything: bool, frames: str, wait: bool, yes: bool, as_json: bool
) -> None:
    """Erase records, or single pictures of one. Keys are destroyed first; this cannot be undone.

    Example: blockrobot wallet erase 3fa2c19b07de --frames 0,3 --wait
    """
    if not record_ids and not everything:
        raise click.UsageError("Name the records to erase, or say --all.")
    try:
        frame_indexes = sorted({int(part) for part in frames.split(",") if part})
    except ValueError:
        raise click.UsageError("--frames takes numbers, as 0,3,4.") from None
    if not yes:
        if not sys.stdin.isatty():
            raise click.UsageError("There is no terminal to ask for confirmation: give --yes.")
        click.confirm(
            "The pictures will be gone for everyone, for ever. The trail of what happened stays. Erase?", abort=True
        )

    async def action(opened: Wallet) -> tuple[list[ErasureReport], list[Share]]:
        chosen = await _chosen(opened, () if everything else record_ids)
        active = [entry for entry in chosen if entry.state["status"] == "active"]
        entries = _tell_linked(active, as_json=as_json)
        erasing, recipients = Erasing(opened), await Sharing(opened).recipients(active)
        reports: list[ErasureReport] = []
        for owner in dict.fromkeys(entry.visit.owner for entry in entries):
            part = [entry for entry in entries if entry.visit.owner == owner]
            ids = await erasing.request(part[0].visit, [entry.record_id for entry in part], frame_indexes)
            if wait:
                reports.extend(await erasing.wait_complete(part[0].visit, ids, ERASE_WAIT_S))
            else:
                reports.extend([await erasing.report(part[0].visit, erasure_id) for erasure_id in ids])
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
        print_json({"ok": True, "erasures": rows, "recipients": [share_json(each, now_ms) for each in recipients]})
        return
    if not reports:
        console.print("There is nothing left to erase.")
    for report in reports:
        console.print(
            f"Erasure {report.erasure_id.hex()[:16]}: {report.status}, "
            f"confirmed by {len(report.receipts)} of {len(report.custodians)} custodians."
        )
    tell_recipients(recipients)


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
