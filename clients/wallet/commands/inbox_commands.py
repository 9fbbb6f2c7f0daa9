"""`blockrobot wallet inbox|look|confirm-deleted`: records shared with this user, with later changes (Art. 19) and
problems of their own visits.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click

from clients.sdk.terminal.terminal import console, handle_errors, json_option, print_answer, status_line
from clients.wallet.cli.prompts import ask_or_say
from clients.wallet.cli.wallet_context import read_only_wallet, run_with_wallet
from clients.wallet.commands.account.rotate_commands import unreadable_words
from clients.wallet.commands.view_commands import list_missing_rooms, tell_missing_rooms
from clients.wallet.ledger.visit_audit import AuditEntry, Finding, audit_visit, findings_of
from clients.wallet.ledger.visit_scan import find_record
from clients.wallet.ledger.wallet import VisitReport, Wallet
from clients.wallet.present.record_answers import FetchedRecord, FrameStatus
from clients.wallet.present.sharing_answers import (
    ConfirmDeletedAnswer,
    InboxAnswer,
    LookAnswer,
    LookAtOwn,
    ReceivedShare,
    ShareNotice,
    UnreadShare,
    VisitAlarm,
)
from clients.wallet.present.translations import code_text, describe_error, refusal, text
from clients.wallet.records.leftover_files import find_earlier_of, tell_earlier
from clients.wallet.records.picture_files import delete_frames, write_frames
from clients.wallet.records.viewing import STATUS_ERASED, STATUS_NOTICE, STATUS_OK, name_places
from clients.wallet.sharing.chain_grants import find_by_prefix
from clients.wallet.sharing.incoming_shares import (
    KIND_ERASED,
    KIND_FRAMES_ERASED,
    KIND_RESTRICTED,
    IncomingShares,
    Receipt,
    SharedView,
    UnreadableGrant,
)
from clients.wallet.store.sharing_memory import ReceivedGrant
from consensus.errors import BlockRobotError
from consensus.rights.purposes import PURPOSES
from pages.moments import show_moment

LOOKS_SHOWN = 20
_GONE = frozenset({KIND_ERASED, KIND_FRAMES_ERASED})


@dataclass(frozen=True, slots=True)
class Inbox:
    """Grants received, and problems of own visits. `looks` (others' access) and `changed` (records found altered) are
    oldest first; `unread` grants have errors.
    """

    receipts: tuple[Receipt, ...]
    alarms: tuple[VisitReport, ...]
    reads_new: bool
    faded: tuple[ReceivedGrant, ...] = ()
    looks: tuple[AuditEntry, ...] = ()
    changed: tuple[tuple[AuditEntry, Finding], ...] = ()
    unread: tuple[UnreadableGrant, ...] = ()


async def read_inbox(opened: Wallet) -> Inbox:
    """Read grants and own visits. Raises NOT_REGISTERED; former members still see known grants."""
    receiving = IncomingShares(opened)
    receipts = await receiving.inbox()
    try:
        reports = await opened.records()
    except BlockRobotError as error:
        if error.code != "MEMBER_NO_MORE":
            raise
        reports = []
    alarms = tuple(each for each in reports if each.missing_count or each.unreadable_ids)
    events = [entry for report in reports for entry in await audit_visit(opened, report.visit)]
    events.sort(key=lambda entry: (entry.height, entry.index))
    return Inbox(
        tuple(receipts),
        alarms,
        receiving.reads_new,
        tuple(receiving.faded),
        tuple(entry for entry in events if entry.kind == "access_requested" and "grant" in entry.data),
        tuple((entry, finding) for entry in events for finding in findings_of(entry) if finding[1] == "corrupted"),
        tuple(receiving.unread),
    )


def copies_left(receipt: Receipt, records: Sequence[bytes]) -> list[Path]:
    """Return local folders still holding pictures of these records."""
    places = [Path(copy.folder) / copy.record_id.hex() for copy in receipt.received.copies if copy.record_id in records]
    return [place for place in places if place.exists()]


def received_share(receipt: Receipt) -> ReceivedShare:
    grant = receipt.grant
    return ReceivedShare(
        grant_id=grant.grant_id.hex(),
        visit=grant.row.owner.hex(),
        records=[record_id.hex() for record_id in grant.row.records],
        purpose=grant.row.purpose,
        shared_at_ms=grant.row.time,
        until_ms=grant.row.until_ms,
        open=receipt.is_open,
        looked=receipt.looked,
        to_look=[record_id.hex() for record_id in receipt.to_look],
        notices=[
            ShareNotice(record_id=notice.record_id.hex(), kind=notice.kind, confirmed=notice.confirmed)
            for notice in receipt.notices
        ],
        to_confirm=[record_id.hex() for record_id in receipt.to_confirm],
        copies=[str(place) for place in copies_left(receipt, grant.row.records)],
    )


def receipt_lines(receipt: Receipt, language: str | None = None) -> list[str]:
    say = functools.partial(text, language=language)
    grant, name = receipt.grant, receipt.grant.grant_id.hex()[:12]
    records = say("count.records", count=len(grant.row.records))
    end = say("received.open", until=show_moment(grant.row.until_ms)) if receipt.is_open else say("received.over")
    meaning = say(f"purpose.{grant.row.purpose}") if grant.row.purpose in PURPOSES else grant.row.purpose
    visit = grant.row.owner.hex()[:12]
    lines = [say("received.line", grant=name, records=records, visit=visit, end=end, purpose=meaning)]
    news = [notice for notice in receipt.notices if not notice.confirmed]
    # Who never looked has no copy.
    words = "received.had" if receipt.looked else "received.never_had"
    for kind in dict.fromkeys(notice.kind for notice in news):
        told = [notice for notice in news if notice.kind == kind]
        what = say(f"{words}.{kind}", count=len(told))
        lines.append("  " + say("received.news", number=len(told), records=records, what=what))
        if len(told) < len(grant.row.records):
            lines += [f"    {notice.record_id.hex()}" for notice in told]
    lines += ["  " + say("received.copy", place=place) for place in copies_left(receipt, receipt.to_confirm)]
    if receipt.to_confirm and not receipt.looked:
        lines.append("  " + say("received.never"))
    elif receipt.to_confirm:
        lines.append("  " + say("received.confirm", grant=name))
    elif len(news) < len(receipt.notices):
        lines.append("  " + say("received.confirmed"))
    if receipt.to_look:
        lines.append("  " + say("received.look", grant=name))
    return lines


def unread_share(unread: UnreadableGrant) -> UnreadShare:
    error = unread.error
    return UnreadShare(grant_id=unread.received.grant_id.hex(), code=error.code, detail=error.detail)


def unread_line(unread: UnreadableGrant, language: str | None = None) -> str:
    why, _ = describe_error(unread.error, language)
    return text("received.unread", language=language, grant=unread.received.grant_id.hex()[:12], why=why)


def _print_alarms(alarms: Sequence[VisitReport]) -> None:
    for report in alarms:
        name = report.visit.owner.hex()[:12]
        if report.missing_count:
            console.print(f"[red]{text('inbox.missing', name=name, count=report.missing_count)}[/red]")
        if report.unreadable_ids:
            console.print(f"[red]{text('inbox.unreadable', name=name, what=unreadable_words(report))}[/red]")


def _inbox_answer(found: Inbox) -> InboxAnswer:
    return InboxAnswer(
        received=[received_share(each) for each in found.receipts],
        unread=[unread_share(each) for each in found.unread],
        alarms=[visit_alarm(report) for report in found.alarms],
        reads_new=found.reads_new,
        looks=[_look_at_own(entry) for entry in found.looks],
        changed_records=[record_id.hex() for _, (record_id, _, _) in found.changed],
    )


def visit_alarm(report: VisitReport) -> VisitAlarm:
    return VisitAlarm(
        visit=report.visit.owner.hex(),
        missing_records=report.missing_count,
        unreadable_records=[record_id.hex() for record_id in report.unreadable_ids],
    )


@click.command()
@json_option
@click.pass_context
@handle_errors
@read_only_wallet
def inbox(ctx: click.Context, as_json: bool) -> None:
    """Show what was shared with you and what became of it since, and what is wrong with your own visits.

    Example: blockrobot wallet inbox
    """
    found = run_with_wallet(ctx, read_inbox)
    if as_json:
        print_answer(_inbox_answer(found))
        return
    if not found.reads_new:
        console.print(text("inbox.no_member"))
    elif not found.receipts and not found.alarms and not found.changed and not found.unread:
        console.print(text("inbox.nothing"))
    for receipt in found.receipts:
        for line in receipt_lines(receipt):
            console.print(line)
    for each in found.unread:
        console.print(unread_line(each), markup=False)
    if found.faded:
        console.print(text("inbox.faded", count=len(found.faded)))
    for path in [Path(copy.folder) / copy.record_id.hex() for each in found.faded for copy in each.copies]:
        console.print("  " + text("inbox.faded_copy", place=path))
    _print_alarms(found.alarms)
    for entry, finding in found.changed:
        console.print(f"[red]{_changed_line(entry, finding)}[/red]")
    _print_looks(found.looks)


def _changed_line(entry: AuditEntry, finding: Finding) -> str:
    record_id, _, frames = finding
    name, moment = record_id.hex(), show_moment(entry.time_ms)
    if not frames:
        return text("inbox.failed", name=name, moment=moment)
    return text("inbox.changed", name=name, count=len(frames), frames=name_places(frames), moment=moment)


def _look_at_own(entry: AuditEntry) -> LookAtOwn:
    return LookAtOwn(
        visit=entry.owner.hex(),
        grant_id=entry.data["grant"].hex(),
        records=entry.data["records"],
        purpose=entry.data["purpose"],
        time_ms=entry.time_ms,
        height=entry.height,
    )


def _print_looks(looks: Sequence[AuditEntry]) -> None:
    if len(looks) > LOOKS_SHOWN:
        console.print(text("inbox.more_looks", count=len(looks) - LOOKS_SHOWN))
    for entry in looks[-LOOKS_SHOWN:]:
        purpose = code_text("purpose", entry.data["purpose"])
        told = {"moment": show_moment(entry.time_ms), "count": entry.data["records"], "purpose": purpose}
        names = {"name": entry.owner.hex()[:12], "grant": entry.data["grant"].hex()[:12]}
        console.print(text("inbox.look", **told, **names))


async def _find(opened: Wallet, start: str) -> tuple[IncomingShares, Receipt]:
    receiving = IncomingShares(opened)
    found = await receiving.inbox()
    unread = {each.received.grant_id: each.error for each in receiving.unread}
    grant_id = find_by_prefix([*(each.grant.grant_id for each in found), *unread], start)
    if grant_id in unread:
        raise unread[grant_id]
    (receipt,) = [each for each in found if each.grant.grant_id == grant_id]
    return receiving, receipt


def _choose(receipt: Receipt, record_ids: Sequence[str], otherwise: Sequence[bytes]) -> list[bytes]:
    known = [record_id.hex() for record_id in receipt.grant.row.records]
    return [bytes.fromhex(find_record(known, start)) for start in record_ids] or list(otherwise)


def _require_shown(receipt: Receipt, wanted: Sequence[bytes]) -> None:
    """Raise GRANT_ENDED if anything was erased: the access would be logged in vain."""
    kinds = {notice.kind for notice in receipt.notices if notice.record_id in wanted and notice.kind in _GONE}
    if KIND_FRAMES_ERASED in kinds:
        raise refusal("GRANT_ENDED", "look_cut")
    if kinds:
        raise refusal("GRANT_ENDED", "look_erased")


async def look_at(
    opened: Wallet, start: str, record_ids: Sequence[str], out: Path
) -> tuple[list[SharedView], list[bytes], list[Path], dict[bytes, BlockRobotError]]:
    """Request, fetch, verify and write a grant's records below `out` (absolute).

    Returns views, restricted records left out, leftover files, and missing empty frames with reasons. Restricted
    records fail only if named. Raises GRANT_ENDED, CALL_REFUSED.
    """
    receiving, receipt = await _find(opened, start)
    if not receipt.is_open:
        raise BlockRobotError("GRANT_ENDED")
    gone = {notice.record_id for notice in receipt.notices if notice.kind in _GONE}
    left = [record_id for record_id in receipt.grant.row.records if record_id not in gone]
    barred = {notice.record_id for notice in receipt.notices if notice.kind == KIND_RESTRICTED}
    chosen = _choose(receipt, record_ids, [each for each in left if each not in barred] or left)
    _require_shown(receipt, chosen or receipt.grant.row.records)
    left_out = [] if record_ids else [each for each in left if each not in chosen]
    access_id = await receiving.request_access(receipt, chosen)
    views, written = [], set[Path]()
    for record_id in chosen:
        view = await receiving.look(receipt, record_id, access_id)
        receiving.remember_copy(receipt, record_id, str(out))
        fetch = functools.partial(receiving.background, receipt)
        written.update(await write_frames(fetch, record_id, view.frames, out))
        views.append(view)
    earlier = find_earlier_of(out, written, chosen if record_ids else receipt.grant.row.records)
    return views, left_out, earlier, receiving.missing_rooms


@click.command()
@click.argument("grant")
@click.argument("record_ids", nargs=-1)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("shared"), show_default=True)
@json_option
@click.pass_context
@handle_errors
def look(ctx: click.Context, grant: str, record_ids: tuple[str, ...], out: Path, as_json: bool) -> None:
    """Look at what was shared with you (GRANT, by `blockrobot wallet inbox`): all of it, or these records.

    Its owner sees that you did, and when. The pictures are checked against the chain on this machine.

    Example: blockrobot wallet look 3fa2c19b07de --out shared
    """
    folder = out.absolute()

    async def action(opened: Wallet) -> tuple[list[SharedView], list[bytes], list[Path], dict[bytes, BlockRobotError]]:
        with status_line(text("look.asking"), as_json=as_json):
            return await look_at(opened, grant, record_ids, folder)

    views, left_out, earlier, missing = run_with_wallet(ctx, action)
    if as_json:
        answer = LookAnswer(
            records=[_fetched_record(view) for view in views],
            restricted=[record_id.hex() for record_id in left_out],
            out=str(out),
            earlier=[str(path) for path in earlier],
            missing_rooms=list_missing_rooms(missing),
        )
        print_answer(answer)
        return
    for view in views:
        shown = [frame for frame in view.frames if frame.status not in {STATUS_NOTICE, STATUS_ERASED}]
        whole = sum(frame.status == STATUS_OK for frame in shown)
        line = text("look.whole", name=view.record_id.hex(), whole=whole, count=len(shown))
        if view.corrupted:
            line += f"; [red]{text('look.changed', indexes=name_places(view.corrupted))}[/red]"
        console.print(line + ".")
    for record_id in left_out:
        console.print(text("look.left_out", name=record_id.hex()))
    console.print(text("look.written", out=out))
    tell_missing_rooms(missing)
    tell_earlier(earlier)


def _fetched_record(view: SharedView) -> FetchedRecord:
    return FetchedRecord(
        record_id=view.record_id.hex(),
        custodians=list(view.custodians),
        frames=[FrameStatus(number=frame.index + 1, status=frame.status) for frame in view.frames],
    )


def _ask_whether_deleted(places: Sequence[Path], records_count: int, *, yes: bool) -> None:
    records = text("count.records", count=records_count)
    if places:
        told = text("confirm_deleted.delete", folders=text("count.folders", count=len(places)), records=records)
    else:
        told = text("confirm_deleted.say", records=records)
    ask_or_say(text("confirm_deleted.ask"), yes=yes, told=told)


@click.command("confirm-deleted")
@click.argument("grant")
@click.argument("record_ids", nargs=-1)
@click.option("--delete", is_flag=True, help="Delete what `look` wrote on this machine, first.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@json_option
@click.pass_context
@handle_errors
def confirm_deleted(
    ctx: click.Context, grant: str, record_ids: tuple[str, ...], delete: bool, yes: bool, as_json: bool
) -> None:
    """Tell the owner that you have deleted your copies of what was erased, ended or denied since it was shared.

    It stands on the ledger, under the grant's key. Without records: all that the inbox asks you to delete.

    Example: blockrobot wallet confirm-deleted 3fa2c19b07de --delete
    """

    async def action(opened: Wallet) -> tuple[list[bytes], list[Path], list[Path]]:
        receiving, receipt = await _find(opened, grant)
        chosen = _choose(receipt, record_ids, receipt.to_confirm)
        if not receipt.looked:
            raise refusal("NOTHING_TO_CONFIRM", "confirm_never")
        if not chosen:
            raise refusal("NOTHING_TO_CONFIRM", "confirm_nothing")
        places = copies_left(receipt, chosen)
        if places and not delete:
            raise refusal("COPIES_REMAIN", "confirm_copy", place=str(places[0]))
        _ask_whether_deleted(places, len(chosen), yes=yes)
        kept = [path for place in places for path in delete_frames(place)]
        await receiving.confirm_deleted(receipt, chosen)
        return chosen, places, kept

    chosen, places, kept = run_with_wallet(ctx, action)
    if as_json:
        deleted = [str(place) for place in places if not place.exists()]
        records = [record_id.hex() for record_id in chosen]
        print_answer(ConfirmDeletedAnswer(records=records, deleted=deleted, kept=[str(path) for path in kept]))
        return
    for folder in dict.fromkeys(path.parent for path in kept):
        names = ", ".join(path.name for path in kept if path.parent == folder)
        console.print(text("confirm_deleted.stays", folder=folder, names=names))
    console.print(text("confirm_deleted.done", count=len(chosen)))


COMMANDS = (inbox, look, confirm_deleted)
