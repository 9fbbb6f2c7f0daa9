"""`blockrobot wallet inbox|look|confirm-deleted`: records shared with this user, with later changes (Art. 19) and
problems of their own visits.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import click

from clients.sdk.terminal.terminal import FOLDER, command_output, console, print_answer, status_line
from clients.wallet.answers.record_answers import FetchedRecord, FrameStatus
from clients.wallet.answers.sharing_answers import (
    ConfirmDeletedAnswer,
    InboxAnswer,
    LookAnswer,
    LookAtOwn,
)
from clients.wallet.cli.wallet_context import confirm_or_print, read_only_wallet, run_with_wallet
from clients.wallet.commands.view_commands import list_missing_rooms, print_missing_rooms
from clients.wallet.ledger.visit_audit import AuditEntry, Finding
from clients.wallet.ledger.visit_scan import resolve_record
from clients.wallet.ledger.wallet import VisitReport, Wallet
from clients.wallet.presentation.album import find_earlier_of, print_earlier_files
from clients.wallet.presentation.former_text import unreadable_words
from clients.wallet.presentation.share_text import (
    incoming_share_lines,
    received_share,
    unread_line,
    unread_share,
    visit_alarm,
)
from clients.wallet.presentation.translations import code_text, text
from clients.wallet.records.picture_files import delete_frames, write_frames
from clients.wallet.records.viewing import STATUS_ERASED, STATUS_NOTICE, STATUS_OK, name_places
from clients.wallet.sharing.chain_grants import resolve_grant
from clients.wallet.sharing.inbox import Inbox, copies_left, read_inbox
from clients.wallet.sharing.incoming_shares import (
    KIND_ERASED,
    KIND_FRAMES_ERASED,
    KIND_RESTRICTED,
    IncomingShare,
    IncomingShares,
    SharedView,
)
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from pages.time_format import format_time

LOOKS_SHOWN = 20
_GONE = frozenset({KIND_ERASED, KIND_FRAMES_ERASED})


def _print_alarms(alarms: Sequence[VisitReport]) -> None:
    for report in alarms:
        name = report.visit.owner.hex()[:12]
        if report.missing_count:
            console.print(f"[red]{text('inbox.missing', name=name, count=report.missing_count)}[/red]")
        if report.unreadable_ids:
            console.print(f"[red]{text('inbox.unreadable', name=name, what=unreadable_words(report))}[/red]")


def _inbox_answer(found: Inbox) -> InboxAnswer:
    return InboxAnswer(
        received=[received_share(each) for each in found.shares],
        unread=[unread_share(each) for each in found.unread],
        alarms=[visit_alarm(report) for report in found.alarms],
        reads_new=found.reads_new,
        looks=[_look_at_own(entry) for entry in found.looks],
        changed_records=[record_id.hex() for _, (record_id, _, _) in found.changed],
    )


@click.command()
@click.pass_context
@command_output
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
    elif not found.shares and not found.alarms and not found.changed and not found.unread:
        console.print(text("inbox.nothing"))
    for share in found.shares:
        for line in incoming_share_lines(share):
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
    name, moment = record_id.hex(), format_time(entry.time_ms)
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
        explanation = {"moment": format_time(entry.time_ms), "count": entry.data["records"], "purpose": purpose}
        names = {"name": entry.owner.hex()[:12], "grant": entry.data["grant"].hex()[:12]}
        console.print(text("inbox.look", **explanation, **names))


async def _find(opened: Wallet, start: str) -> tuple[IncomingShares, IncomingShare]:
    receiving = IncomingShares(opened)
    found = await receiving.inbox()
    unread = {each.received.grant_id: each.error for each in receiving.unread}
    grant_id = resolve_grant([*(each.grant.grant_id for each in found), *unread], start)
    if grant_id in unread:
        raise unread[grant_id]
    (share,) = [each for each in found if each.grant.grant_id == grant_id]
    return receiving, share


def _choose(share: IncomingShare, record_ids: Sequence[str], otherwise: Sequence[bytes]) -> list[bytes]:
    known = [record_id.hex() for record_id in share.grant.row.records]
    return [bytes.fromhex(resolve_record(known, start)) for start in record_ids] or list(otherwise)


def _require_shown(share: IncomingShare, wanted: Sequence[bytes]) -> None:
    """Raise GRANT_ENDED if anything was erased: the access would be logged in vain."""
    kinds = {notice.kind for notice in share.notices if notice.record_id in wanted and notice.kind in _GONE}
    if KIND_FRAMES_ERASED in kinds:
        raise refusal("GRANT_ENDED", "look_cut")
    if kinds:
        raise refusal("GRANT_ENDED", "look_erased")


async def look_at(
    opened: Wallet, start: str, record_ids: Sequence[str], out: Path
) -> tuple[list[SharedView], list[bytes], list[Path], dict[bytes, BlockRobotError]]:
    """Request, fetch, verify and write a grant's records below `out` (absolute).

    Returns views, restricted records left out, leftover files, and missing empty frames with reasons. Restricted records
    fail only if named. Raises GRANT_ENDED, CALL_REFUSED.
    """
    receiving, share = await _find(opened, start)
    if not share.is_open:
        raise BlockRobotError("GRANT_ENDED")
    gone = {notice.record_id for notice in share.notices if notice.kind in _GONE}
    left = [record_id for record_id in share.grant.row.records if record_id not in gone]
    barred = {notice.record_id for notice in share.notices if notice.kind == KIND_RESTRICTED}
    chosen = _choose(share, record_ids, [each for each in left if each not in barred] or left)
    _require_shown(share, chosen or share.grant.row.records)
    left_out = [] if record_ids else [each for each in left if each not in chosen]
    access_id = await receiving.request_access(share, chosen)
    views, written = [], set[Path]()
    for record_id in chosen:
        view = await receiving.look(share, record_id, access_id)
        receiving.remember_copy(share, record_id, str(out))
        fetch = functools.partial(receiving.background, share)
        written.update(await write_frames(fetch, record_id, view.frames, out))
        views.append(view)
    earlier = find_earlier_of(out, written, chosen if record_ids else share.grant.row.records)
    return views, left_out, earlier, receiving.missing_rooms


@click.command()
@click.argument("grant")
@click.argument("record_ids", nargs=-1)
@click.option("--out", type=FOLDER, default=Path("shared"), show_default=True)
@click.pass_context
@command_output
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
    print_missing_rooms(missing)
    print_earlier_files(earlier)


def _fetched_record(view: SharedView) -> FetchedRecord:
    return FetchedRecord(
        record_id=view.record_id.hex(),
        custodians=list(view.custodians),
        frames=[FrameStatus(number=frame.index + 1, status=frame.status) for frame in view.frames],
    )


def _ask_whether_deleted(places: Sequence[Path], records_count: int, *, yes: bool) -> None:
    records = text("count.records", count=records_count)
    if places:
        explanation = text("confirm_deleted.delete", folders=text("count.folders", count=len(places)), records=records)
    else:
        explanation = text("confirm_deleted.say", records=records)
    confirm_or_print(text("confirm_deleted.ask"), yes=yes, explanation=explanation)


@click.command("confirm-deleted")
@click.argument("grant")
@click.argument("record_ids", nargs=-1)
@click.option("--delete", is_flag=True, help="Delete what `look` wrote on this machine, first.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def confirm_deleted(
    ctx: click.Context, grant: str, record_ids: tuple[str, ...], delete: bool, yes: bool, as_json: bool
) -> None:
    """Tell the owner that you have deleted your copies of what was erased, ended or denied since it was shared.

    It stands on the ledger, under the grant's key. Without records: all that the inbox asks you to delete.

    Example: blockrobot wallet confirm-deleted 3fa2c19b07de --delete
    """

    async def action(opened: Wallet) -> tuple[list[bytes], list[Path], list[Path]]:
        receiving, share = await _find(opened, grant)
        chosen = _choose(share, record_ids, share.to_confirm)
        if not share.looked:
            raise refusal("NOTHING_TO_CONFIRM", "confirm_never")
        if not chosen:
            raise refusal("NOTHING_TO_CONFIRM", "confirm_nothing")
        places = copies_left(share, chosen)
        if places and not delete:
            raise refusal("COPIES_REMAIN", "confirm_copy", place=str(places[0]))
        _ask_whether_deleted(places, len(chosen), yes=yes)
        kept = [path for place in places for path in delete_frames(place)]
        await receiving.confirm_deleted(share, chosen)
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
