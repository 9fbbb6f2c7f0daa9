"""`blockrobot wallet export`: all a network holds of a person, in one file."""

from __future__ import annotations

import time
from pathlib import Path

import click

from clients.bundle.checks.bundle_check import Verdict
from clients.bundle.proving import Heard
from clients.bundle.writing import require_free, write_bundle
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import FILE, ask, can_ask, command_output, console, print_answer, show_progress
from clients.wallet.cli.times import read_time
from clients.wallet.cli.wallet_context import on_abort, run_with_wallet
from clients.wallet.export.export_building import ExportChoice, Exporter, Plan
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.export_text import bundle_warning, export_answer, problem_text
from clients.wallet.presentation.invocation import verify_command
from clients.wallet.presentation.translations import WrongUsage, language_in_use, section, text
from consensus.records.envelopes import RECORD_ID_BYTES
from consensus.rights.purposes import require_purpose


def _read_ids(written: tuple[str, ...]) -> tuple[bytes, ...]:
    ids = []
    for digits in (part.strip() for group in written for part in group.split(",")):
        try:
            record_id = bytes.fromhex(digits)
        except ValueError:
            record_id = b""
        if len(record_id) != RECORD_ID_BYTES:
            raise WrongUsage("no_record", given=digits)
        ids.append(record_id)
    return tuple(dict.fromkeys(ids))


def _confirm(plan: Plan, *, now: bool, yes: bool, as_json: bool) -> None:
    if yes and as_json:
        return
    for line in bundle_warning(plan, now=now):
        click.echo(line, err=as_json)
    if yes:
        return
    ask(text("export.ask"), err=as_json)


@click.command()
@click.argument("out", type=FILE)
@click.option("--records", multiple=True, help="Only these records; may be repeated, or several with commas.")
@click.option("--from", "begins", help="Only what was recorded from then on: -7d, 2027-01-31 or 2027-01-31T18:00.")
@click.option("--until", "ends", help="Only what was recorded before then, written as for --from.")
@click.option("--pictures/--no-pictures", default=True, show_default=True, help="Fetch the pictures, or leave them.")
@click.option("--identity/--no-identity", default=True, show_default=True, help="Say which member you are; consents.")
@click.option("--purpose", default="own-access", show_default=True, help="Why you look: it stands in the audit trail.")
@click.option("--now", is_flag=True, help="No pauses between visits: whoever reads the ledger can join them then.")
@click.option("--force", is_flag=True, help="Replace OUT if it is there.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def export(
    ctx: click.Context,
    out: Path,
    records: tuple[str, ...],
    begins: str | None,
    ends: str | None,
    pictures: bool,
    identity: bool,
    purpose: str,
    now: bool,
    force: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Take along what the network holds of you: a ZIP of pictures, JSON and proofs that anybody can check offline.

    Example: blockrobot wallet export my-data.zip --from -30d
    """
    if not yes and not can_ask():
        raise WrongUsage("no_terminal_yes")
    require_purpose(purpose)
    require_free(out, replace=force)
    now_ms = round(time.time() * 1000)
    from_ms, until_ms = read_time(begins, now_ms), read_time(ends, now_ms)
    if until_ms and until_ms <= from_ms:
        raise WrongUsage("until_order")
    wanted = ExportChoice(_read_ids(records), from_ms, until_ms, pictures, identity, purpose)
    hear = _say_progress(show_progress(quiet=as_json))

    begun = False

    async def action(opened: Wallet) -> Verdict:
        nonlocal begun
        exporting = Exporter(opened, hear, at_once=now)
        plan = await exporting.plan(wanted)
        _confirm(plan, now=now, yes=yes, as_json=as_json)
        begun = True
        return write_bundle(out, await exporting.collect(plan, now_ms), replace=force, heard=hear)

    with on_abort(ctx, lambda: text("export.stopped", out=out) if begun else ""):
        verdict = run_with_wallet(ctx, action)
    if as_json:
        print_answer(export_answer(out, verdict))
    else:
        _print(out, verdict)


def _say_progress(hear: Heard) -> Heard:
    steps = section("export.step", language_in_use())
    return lambda what, done, of: hear(str(steps.get(what.replace(" ", "_"), what)), done, of)


def _print(out: Path, verdict: Verdict) -> None:
    answer = export_answer(out, verdict)
    console.print(
        text(
            "export.done",
            out=out,
            visits=text("count.visits", count=answer.visits),
            records=text("count.records", count=answer.records),
            pictures=text("records.pictures", count=answer.pictures),
            events=text("count.events", count=answer.audit_entries),
            megabytes=f"{answer.bytes / 1e6:.1f}",
            height=answer.proved_until_height,
        )
    )
    for problem in verdict.manifest.problems:
        about = text("export.record", name=problem.record_id) if problem.record_id else text("export.all")
        sentence = problem_text(problem.code, problem.sentence)
        console.print(f"  [red]{text('export.missing')}[/red] ({about}): {sentence}")
    console.print(escape(text("export.next", check=verify_command(out))))
