"""`blockrobot wallet records`: what was recorded, proven against the chain. Must never leave out what is missing."""

from __future__ import annotations

from typing import Any

import click
from rich.markup import escape

from clients.sdk.terminal import console, json_option, plain_errors, print_json
from clients.wallet.keystore import WalletContent
from clients.wallet.notices import Notices
from clients.wallet.opening import run_opened, show_moment
from clients.wallet.rotating_commands import print_words, unreadable_words, words_json
from clients.wallet.standing_words import print_standing, standing_json
from clients.wallet.wallet import RecordEntry, VisitReport, Wallet
from consensus.records.metadata import NOTICE_SENSOR
from consensus.records.notices import NoticeRow

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


@click.command()
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
