"""`blockrobot wallet view|verify`: records fetched, checked and opened."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import aclosing
from pathlib import Path

import click

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import FOLDER, command_output, console, print_answer, status_line
from clients.wallet.answers.record_answers import FrameStatus, MissingRoom, VerifyAnswer, ViewAnswer, ViewedRecord
from clients.wallet.cli.group_options import complete_records, visit_option
from clients.wallet.cli.wallet_context import on_abort, read_only_wallet, run_with_wallet, warn_of_linked_visits
from clients.wallet.ledger.record_filter import choose_records
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.presentation.album import Album, find_earlier, find_earlier_of, print_earlier_files
from clients.wallet.presentation.translations import describe_error, text, withheld_text
from clients.wallet.records.picture_files import write_pictures
from clients.wallet.records.viewing import (
    STATUS_ERASED,
    STATUS_NOTICE,
    STATUS_OK,
    RecordView,
    RecordViewer,
    name_places,
)
from consensus.errors import BlockRobotError


async def _view_all(
    opened: Wallet,
    entries: list[RecordEntry],
    purpose: str,
    *,
    verdict: bool,
    album: Album | None = None,
    on_progress: Callable[[str], None] = lambda _: None,
) -> list[RecordView]:
    viewing = RecordViewer(opened)
    views: list[RecordView] = []
    on_progress(text("view.doing", number=1, count=len(entries)))
    async with aclosing(viewing.view_each(entries, purpose, verdict=verdict)) as each:
        async for view in each:
            if album is not None:
                album.written.update(await write_pictures(viewing, view, album.out, album.seen_by(view.entry)))
                album.missing_rooms.update(viewing.missing_rooms)
            views.append(view)
            on_progress(text("view.doing", number=min(len(views) + 1, len(entries)), count=len(entries)))
    return views


def _viewed_record(view: RecordView) -> ViewedRecord:
    return ViewedRecord(
        record_id=view.entry.record_id.hex(),
        verdict=view.verdict,
        frames_counted=view.frames_counted,
        frames_committed=len(view.frames),
        custodians=list(view.custodians),
        frames=[FrameStatus(number=frame.index + 1, status=frame.status) for frame in view.frames],
    )


def list_missing_rooms(missing: Mapping[bytes, BlockRobotError]) -> list[MissingRoom]:
    return [MissingRoom(sha256=digest.hex(), code=error.code) for digest, error in missing.items()]


def print_missing_rooms(missing: Mapping[bytes, BlockRobotError]) -> None:
    """Print each reason once."""
    for reason in dict.fromkeys(describe_error(error)[0] for error in missing.values()):
        console.print(escape(text("view.no_room", reason=reason)))


def _print_views(views: list[RecordView]) -> None:
    if not views:
        console.print(text("view.nothing"))
    for view in views:
        name = view.entry.record_id.hex()
        pictures = sum(frame.status != STATUS_NOTICE for frame in view.frames)
        if not pictures:
            withheld = withheld_text(view.entry.metadata.withheld)
            console.print(escape(text("view.no_pictures", name=name, withheld=withheld)))
            if view.miscounted:
                console.print(f"  [red]{_counts(view)}[/red].")
            continue
        whole = sum(frame.status == STATUS_OK for frame in view.frames)
        line = text("view.whole", name=name, whole=whole, count=pictures)
        erased = sum(frame.status == STATUS_ERASED for frame in view.frames)
        if erased:
            line += "; " + text("view.erased", count=erased)
        if view.corrupted:
            line += f"; [red]{text('view.changed', indexes=name_places(view.corrupted))}[/red]"
        if view.miscounted:
            line += f"; [red]{_counts(view)}[/red]"
        console.print(line + ".")


def _find_earlier(album: Album, views: list[RecordView], *, of_all: bool) -> list[Path]:
    """All in the folder if `of_all`, else these records'."""
    if of_all:
        return find_earlier(album.out, album.written)
    gone = [view.entry for view in views if any(frame.status == STATUS_ERASED for frame in view.frames)]
    records = [view.entry.record_id for view in views]
    return find_earlier_of(album.out, album.written, records, dict.fromkeys(entry.visit.owner for entry in gone))


def _counts(view: RecordView) -> str:
    return text("view.miscounted", counted=view.frames_counted, committed=len(view.frames))


@click.command()
@click.argument("record_ids", nargs=-1, shell_complete=complete_records)
@visit_option
@click.option("--out", type=FOLDER, default=Path("pictures"), show_default=True)
@click.option("--sheet/--no-sheet", default=True, help="Write contact sheets and animations too, or leave them.")
@click.option("--show/--no-show", default=True, help="Show some pictures in the terminal, where it can.")
@click.option("--purpose", default="own-access", show_default=True, help="Why you look: it stands in the audit trail.")
@click.pass_context
@command_output
@read_only_wallet
def view(
    ctx: click.Context,
    record_ids: tuple[str, ...],
    visits: tuple[str, ...],
    out: Path,
    sheet: bool,
    show: bool,
    purpose: str,
    as_json: bool,
) -> None:
    """Fetch, check and decrypt records (all if none is named) and write them as pictures, labels and sounds.

    A contact sheet (PNG) and an animation (GIF) of each record, and of each visit, show many at a glance.

    A file's name begins with the picture's number in its record, as `erase --frames` takes it.

    Example: blockrobot wallet view 3fa2c19b07de --out pictures
    """
    album, sheets = Album(out), list[Path]()

    async def action(opened: Wallet) -> list[RecordView]:
        entries = warn_of_linked_visits(await choose_records(opened, record_ids, visits), as_json=as_json)
        with status_line(text("view.asking"), as_json=as_json) as on_progress:
            views = await _view_all(opened, entries, purpose, verdict=False, album=album, on_progress=on_progress)
            if sheet:
                on_progress(text("view.drawing"))
                sheets.extend(path for entry in entries for path in album.write_record(entry))
                sheets.extend(album.write_visits())
        return views

    with on_abort(ctx, lambda: text("view.stopped", count=len(album.written), out=out)):
        views = run_with_wallet(ctx, action)
    earlier = _find_earlier(album, views, of_all=not record_ids and not visits)
    if as_json:
        answer = ViewAnswer(
            records=[_viewed_record(view) for view in views],
            out=str(out),
            sheets=[str(path) for path in sheets],
            earlier=[str(path) for path in earlier],
            missing_rooms=list_missing_rooms(album.missing_rooms),
        )
        print_answer(answer)
        return
    _print_views(views)
    if any(frame.status == STATUS_OK for view in views for frame in view.frames):
        console.print(text("view.written", out=out))
    print_missing_rooms(album.missing_rooms)
    for path in [path for path in sheets if path.parent == out] or sheets[:2]:
        console.print(f"  {path}")
    print_earlier_files(earlier)
    if show:
        album.show(console)


@click.command()
@click.argument("record_ids", nargs=-1, shell_complete=complete_records)
@visit_option
@click.option("--purpose", default="own-access", show_default=True, help="Why you look: it stands in the audit trail.")
@click.pass_context
@command_output
@read_only_wallet
def verify(
    ctx: click.Context, record_ids: tuple[str, ...], visits: tuple[str, ...], purpose: str, as_json: bool
) -> None:
    """Check records against the chain on this machine, trusting no node, and put the verdict on the chain.

    Example: blockrobot wallet verify
    """

    async def action(opened: Wallet) -> list[RecordView]:
        entries = warn_of_linked_visits(await choose_records(opened, record_ids, visits), as_json=as_json)
        with status_line(text("view.asking"), as_json=as_json) as on_progress:
            return await _view_all(opened, entries, purpose, verdict=True, on_progress=on_progress)

    views = run_with_wallet(ctx, action)
    if as_json:
        print_answer(VerifyAnswer(records=[_viewed_record(view) for view in views], out=None))
        return
    _print_views(views)
    if views:
        console.print(text("view.verdicts"))


COMMANDS = (view, verify)
