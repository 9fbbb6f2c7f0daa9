"""`blockrobot wallet records`: what was recorded, proven against the chain."""

from __future__ import annotations

import datetime
from typing import Any

import click

from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import command_output, console, print_answer, status_line
from clients.wallet.answers.record_answers import RecordRow, RecordsAnswer, VisitRow
from clients.wallet.cli.filter_options import read_filter
from clients.wallet.cli.wallet_context import read_only_wallet, run_with_wallet
from clients.wallet.commands.account.rotate_commands import print_words
from clients.wallet.consent.notice_reading import Notices
from clients.wallet.ledger.mandates import Mandates
from clients.wallet.ledger.record_filter import Filter, Page, Shown, select
from clients.wallet.ledger.robot_names import RobotNames, read_robot_names, robot_label
from clients.wallet.ledger.visit_status import VisitRights
from clients.wallet.ledger.wallet import RecordEntry, VisitReport, Wallet
from clients.wallet.presentation.former_text import former_visits, unreadable_words
from clients.wallet.presentation.translations import WrongUsage, code_text, text, withheld_text
from clients.wallet.presentation.visit_status_text import print_rights, rights_row
from clients.wallet.store.keystore import WalletContent
from consensus.records.metadata import NOTICE_SENSOR
from consensus.rights.notices import NoticeVersion
from pages.time_format import format_time

PAGE_RECORDS_COUNT = 50
NARROW_COLUMNS = 60
_THINGS = {"emotion": "records.estimates", "audio": "records.sounds"}


def _record_row(entry: RecordEntry, rights: VisitRights) -> RecordRow:
    meta = entry.metadata
    return RecordRow(
        record_id=entry.record_id.hex(),
        visit=entry.visit.owner.hex(),
        status=entry.state.status,
        sensor=meta.sensor,
        started_at_ms=meta.started_at_ms,
        ended_at_ms=meta.ended_at_ms,
        frames=entry.pictures_count,
        erased_numbers=[index + 1 for index in entry.state.erased_frames],
        index_in_visit=meta.index_in_visit,
        expires_at_ms=entry.state.expires_at_ms,
        withheld=dict(meta.withheld),
        restricted=rights.restricts(entry.record_id),
    )


def _visit_row(shown: Shown, names: RobotNames) -> VisitRow:
    report = shown.report
    named = names.get(report.visit.robot)
    return extend(
        VisitRow,
        rights_row(report.rights),
        visit=report.visit.owner.hex(),
        robot=report.visit.robot.hex(),
        robot_name="" if named is None else named.name,
        robot_place="" if named is None else named.place,
        closed=report.closed,
        missing_records=report.missing_count,
        erased_records=[record_id.hex() for record_id in report.erased_ids],
        unreadable_records=[record_id.hex() for record_id in report.unreadable_ids],
        needs_former_words=report.needs_former_words,
        records=[_record_row(entry, report.rights) for entry in shown.records],
    )


def _line(entry: RecordEntry) -> str:
    meta = entry.metadata
    name = entry.record_id.hex()[: 12 if console.is_terminal and console.width < NARROW_COLUMNS else None]
    things = text(_THINGS.get(meta.sensor, "records.pictures"), count=entry.pictures_count)
    held = text("records.by_sensor", things=things, sensor=code_text("sensor", meta.sensor))
    parts = [format_time(meta.started_at_ms), text("records.note") if meta.sensor == NOTICE_SENSOR else held]
    if meta.withheld:
        parts.append(escape(withheld_text(meta.withheld)))
    if entry.state.erased_frames:
        parts.append(text("records.erased_frames", count=len(entry.state.erased_frames)))
    return f"  {name}  {', '.join(parts)}"


def _print_visit(shown: Shown, names: RobotNames) -> None:
    report = shown.report
    console.print(
        text(
            "records.visit",
            number=shown.number,
            name=report.visit.owner.hex()[:12],
            robot=escape(robot_label(report.visit.robot, names)),
            state=text("records.ended" if report.closed else "records.open"),
            count=sum(entry.pictures_left_count for entry in report.records),
        )
    )
    print_rights(report.rights)
    for entry in shown.records:
        console.print(_line(entry))
    if report.erased_ids:
        console.print("  " + text("records.erased", count=len(report.erased_ids)))
    if report.unreadable_ids:
        console.print(f"  [red]{unreadable_words(report)}[/red]")
    if report.missing_count:
        console.print(f"  [red]{text('records.missing', count=report.missing_count)}[/red]")


def _print_page(page: Page, wanted: Filter, names: RobotNames) -> None:
    if not page.records_count and not page.visits:
        console.print(text("records.none"))
    elif wanted.narrows and not page.matching_count:
        console.print(text("records.no_match", count=page.records_count))
    for shown in page.visits:
        _print_visit(shown, names)
    if page.number < page.pages_count:
        console.print(text("records.page", page=page.number, pages=page.pages_count, next=page.number + 1))
    elif page.pages_count > 1:
        console.print(text("records.last_page", page=page.number, pages=page.pages_count))


def _filters(command: Any) -> Any:
    for option in (
        click.option("--sensor", "sensors", multiple=True, help="By this sensor: depth, rgb, audio, emotion."),
        click.option("--robot", "robots", multiple=True, help="By this robot: the beginning of its key."),
        click.option("--time", "time_of_day", help="At this time of day: morning, evening ... or 09:00-12:30."),
        click.option("--day", help="On this day: today, yesterday, 2027-01-31, or from..to."),
    ):
        command = option(command)
    return command


@click.command()
@_filters
@click.option("--page", "number", type=click.IntRange(1), default=1, show_default=True, help="Which page.")
@click.option(
    "--per-page", type=click.IntRange(0), help="Records a page, 0 for all (default: 50 at a terminal, otherwise all)."
)
@click.pass_context
@command_output
@read_only_wallet
def records(
    ctx: click.Context,
    day: str | None,
    time_of_day: str | None,
    robots: tuple[str, ...],
    sensors: tuple[str, ...],
    number: int,
    per_page: int | None,
    as_json: bool,
) -> None:
    """List what was recorded of you, proven against the chain: all, or what fits.

    Days and times are those of your time zone. A visit of which something is missing is always shown.

    Example: blockrobot wallet records --day yesterday --time morning --json
    """
    today = datetime.datetime.now().astimezone().date()
    wanted = read_filter(day, time_of_day, robots, sensors, today)
    if per_page is None:
        per_page = PAGE_RECORDS_COUNT if console.is_terminal and not as_json else 0

    async def action(
        opened: Wallet,
    ) -> tuple[list[VisitReport], NoticeVersion | None, bytes | None, WalletContent, RobotNames]:
        with status_line(text("records.reading"), as_json=as_json):
            reports, content = await opened.records(), opened.store.content
            is_member = not content.left and not opened.member_gone
            changed = await Notices(opened).changed_since_consent() if is_member else None
            mandate_id = await Mandates(opened).over_own() if is_member else None
            names = await read_robot_names(opened, (each.visit for each in reports))
            return reports, changed, mandate_id, content, names

    reports, changed, mandate_id, content, names = run_with_wallet(ctx, action)
    page = select(reports, wanted, number, per_page)
    if number > page.pages_count:
        raise WrongUsage("no_page", page=number, count=page.pages_count)
    if as_json:
        answer = extend(
            RecordsAnswer,
            former_visits(content),
            notice_changed_to=None if changed is None else changed.version,
            mandate_id=mandate_id.hex() if mandate_id else None,
            visits=[_visit_row(shown, names) for shown in page.visits],
            page=page.number,
            pages=page.pages_count,
            matching_records=page.matching_count,
            all_records=page.records_count,
        )
        print_answer(answer)
        return
    print_words(content)
    if changed is not None:
        console.print(text("records.notice_changed", organisation=escape(changed.organisation)))
    if mandate_id is not None:
        console.print(text("records.mandate"))
    _print_page(page, wanted, names)
