"""`blockrobot wallet export`: all a network holds of a person, in one file. Must never write before it has warned."""

from __future__ import annotations

import datetime
import re
import sys
import time
from pathlib import Path
from typing import Any

import click

from clients.bundle.checking import Verdict, unproved
from clients.bundle.frames import count_pictures
from clients.bundle.progress import show_progress
from clients.bundle.writing import require_free, write_bundle
from clients.sdk.terminal import ask, console, json_option, plain_errors, print_json
from clients.wallet.counting import counted
from clients.wallet.exporting import Exporting, Plan, Wanted
from clients.wallet.opening import run_opened
from clients.wallet.wallet import Wallet
from consensus.records.envelopes import RECORD_ID_BYTES
from consensus.records.purposes import require_purpose

_AGO = re.compile(r"-(\d{1,6})([hd])", re.ASCII)
_AGO_MS = {"h": 3_600_000, "d": 24 * 3_600_000}


def read_past(text: str | None, now_ms: int) -> int:
    """Return a time in ms: `-7d`, `-12h` (ago), a date or a date with a time of this machine's zone; 0 for none."""
    if text is None:
        return 0
    ago = _AGO.fullmatch(text.strip())
    try:
        if ago:
            return max(1, now_ms - int(ago[1]) * _AGO_MS[ago[2]])
        return max(1, round(datetime.datetime.fromisoformat(text.strip()).astimezone().timestamp() * 1000))
    except (ValueError, OverflowError, OSError):
        raise click.UsageError(f"{text!r} is no time: write -7d, -12h, 2027-01-31 or 2027-01-31T18:00.") from None


def _read_ids(texts: tuple[str, ...]) -> tuple[bytes, ...]:
    ids = []
    for text in (part.strip() for group in texts for part in group.split(",")):
        try:
            record_id = bytes.fromhex(text)
        except ValueError:
            record_id = b""
        if len(record_id) != RECORD_ID_BYTES:
            raise click.UsageError(f"{text!r} is no record: `blockrobot wallet records` shows them.")
        ids.append(record_id)
    return tuple(dict.fromkeys(ids))


def bundle_warning(plan: Plan, *, now: bool) -> list[str]:
    """Return what the bundle would give away, in plain sentences."""
    wanted = plan.wanted
    what = f"{counted(len(plan.visits), 'visit')} with {counted(plan.record_count, 'record')}"
    lines = [f"The bundle will hold {what}. Whoever has it learns:"]
    if plan.visits:
        lines.append("  - that these visits were of one person (on the ledger nobody can tell), where and when;")
    if wanted.pictures and plan.record_count:
        lines.append("  - what the pictures show, and that they are genuine; every custodian notes that you looked;")
    if wanted.identity:
        lines.append("  - which member of the network you are, and all your consents (--no-identity leaves that out);")
    lines.append("  - nothing that opens anything else, and nothing to act in your name. It holds no key of yours.")
    if wanted.pictures and len(plan.visits) > 1:
        how = "at once (--now), which joins" if now else "one by one, after pauses that chance decides, which may join"
        lines.append(
            f"The ledger is asked for your visits {how} them for whoever reads it; --no-pictures asks nothing."
        )
    lines.append("It is not encrypted, and a later erasure does not reach it. Keep it as you would keep the pictures.")
    return lines


def _confirm(plan: Plan, *, now: bool, yes: bool, as_json: bool) -> None:
    if yes and as_json:
        return
    for line in bundle_warning(plan, now=now):
        click.echo(line, err=as_json)
    if yes:
        return
    ask("Write it?", err=as_json)


@click.command()
@click.argument("out", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--records", multiple=True, help="Only these records; may be repeated, or several with commas.")
@click.option("--from", "begins", help="Only what was recorded from then on: -7d, 2027-01-31 or 2027-01-31T18:00.")
@click.option("--until", "ends", help="Only what was recorded before then, written as for --from.")
@click.option("--pictures/--no-pictures", default=True, show_default=True, help="Fetch the pictures, or leave them.")
@click.option("--identity/--no-identity", default=True, show_default=True, help="Say which member you are; consents.")
@click.option("--purpose", default="own-access", show_default=True, help="Why you look: it stands in the audit trail.")
@click.option("--now", is_flag=True, help="No pauses between visits: whoever reads the ledger can join them then.")
@click.option("--force", is_flag=True, help="Replace OUT if it is there.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@json_option
@click.pass_context
@plain_errors
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
    if not yes and not sys.stdin.isatty():
        raise click.UsageError("There is no terminal to ask for confirmation: give --yes.")
    require_purpose(purpose)
    require_free(out, replace=force)
    now_ms = round(time.time() * 1000)
    from_ms, until_ms = read_past(begins, now_ms), read_past(ends, now_ms)
    if until_ms and until_ms <= from_ms:
        raise click.UsageError("The time that --until names is not after --from.")
    wanted = Wanted(_read_ids(records), from_ms, until_ms, pictures, identity, purpose)
    hear = show_progress(quiet=as_json)

    async def action(opened: Wallet) -> Verdict:
        exporting = Exporting(opened, hear, at_once=now)
        plan = await exporting.plan(wanted)
        _confirm(plan, now=now, yes=yes, as_json=as_json)
        return write_bundle(out, await exporting.collect(plan, now_ms), replace=force, heard=hear)

    verdict = run_opened(ctx, action)
    if as_json:
        print_json(bundle_json(out, verdict))
    else:
        _print(out, verdict)


def bundle_json(out: Path, verdict: Verdict) -> dict[str, Any]:
    """Return what a bundle holds, and what it lacks, for a program."""
    problems = verdict.manifest.problems
    return {
        "ok": True,
        "file": str(out),
        "bytes": out.stat().st_size,
        "is_complete": not problems,
        "visits": len(verdict.visits),
        "records": len(verdict.records),
        "pictures": count_pictures(verdict.frames),
        "audit_entries": verdict.events,
        "accesses": verdict.accesses,
        "erasures": verdict.erasures,
        "consent_receipts": len(verdict.consents.history),
        "proved_until_height": verdict.as_of_height,
        "genesis_id": verdict.manifest.genesis_id,
        "problems": [{"record_id": each.record_id, "code": each.code, "sentence": each.sentence} for each in problems],
        "not_proved": unproved(verdict),
    }


def _print(out: Path, verdict: Verdict) -> None:
    told = bundle_json(out, verdict)
    console.print(
        f"{out}: {counted(told['visits'], 'visit')}, {counted(told['records'], 'record')}, "
        f"{counted(told['pictures'], 'picture')}, "
        f"{told['audit_entries']} events, {told['bytes'] / 1e6:.1f} MB, proved up to block {told['proved_until_height']}."
    )
    for problem in verdict.manifest.problems:
        about = f"record {problem.record_id}" if problem.record_id else "all"
        console.print(f"  [red]missing[/red] ({about}): {problem.sentence}")
    console.print(
        "Unpack it and open play.html to look at it. Anybody can check it, offline:\n"
        f"  blockrobot verify {out} --genesis GENESIS_FILE"
    )
