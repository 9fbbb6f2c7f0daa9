"""`blockrobot wallet consent`: consent to recording."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import click
import msgspec

from clients.bundle.checks.consent_receipts import CheckedReceipt, encode_file
from clients.sdk.new_files import write_new_file
from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import FILE, command_output, console, print_answer
from clients.wallet.answers.consent_answers import (
    ConsentGiveAnswer,
    ConsentListAnswer,
    ConsentReceiptsAnswer,
    ConsentWordAnswer,
    ReceiptNotHad,
)
from clients.wallet.cli.group_options import for_option
from clients.wallet.cli.times import read_time
from clients.wallet.cli.wallet_context import read_only_wallet, require_new, run_with_wallet
from clients.wallet.commands.notice_commands import confirm_with_notice, require_said
from clients.wallet.consent.consent_by_mandate import RepresentedPerson, handle_of, resolve_represented
from clients.wallet.consent.consent_choices import DEPTH, Choice, Choices, ConsentClient, ConsentDecision, round_period
from clients.wallet.consent.notice_reading import Notices
from clients.wallet.consent.receipt_fetching import ConsentReceipts, ReceiptOutcome, Receipts, try_fetch_receipt
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.consent_text import (
    choice_answer,
    fetched_receipt,
    notice_answer,
    receipt_line,
    spoken_for,
)
from clients.wallet.presentation.invocation import verify_command
from clients.wallet.presentation.translations import WrongUsage, code_text, describe_error, purposes_text, text
from consensus.bounded_text import read_json_text
from consensus.members.handles import encode_short
from consensus.rights.purposes import PURPOSES
from consensus.rights.sensors import SENSORS
from consensus.state.consent import GIVEN
from pages.time_format import format_time

_SAID_COLUMNS = 4
"""By this sensor a robot tells people apart: without a yes to it, it keeps nothing of any other."""


def _codes(command: Any) -> Any:
    for option in (
        click.option("--purpose", "purposes", multiple=True, help="A purpose's code; may be repeated."),
        click.option("--sensor", "sensors", multiple=True, help="A sensor's code; may be repeated."),
    ):
        command = option(command)
    return command


@click.group()
def consent() -> None:
    """Give, refuse and withdraw consent to being recorded; see what you said.

    Example: blockrobot wallet consent withdraw
    """


async def _tell(
    opened: Wallet,
    word: ConsentDecision,
    line: str,
    next_step: str,
    *,
    person: RepresentedPerson | None,
    as_json: bool,
    answer: ConsentWordAnswer,
) -> None:
    """Before fetching the receipt; statements for a represented person have none."""
    if not as_json:
        if person is not None:
            console.print(text("mandates.said_for", name=encode_short(person.handle)))
        console.print(f"{line}\n  {text('consent.holds_from', height=word.from_height)} {next_step}")
    receipted = ReceiptOutcome(None, None) if person is not None else await try_fetch_receipt(opened, word.txid)
    if as_json:
        receipt, error_code = fetched_receipt(receipted), receipted.error_code
        print_answer(msgspec.structs.replace(answer, receipt=receipt, receipt_error=error_code))
    elif person is not None:
        console.print("  " + text("mandates.in_trail"))
    else:
        console.print(f"  {escape(receipt_line(receipted))}")


def _word_answer(
    word: ConsentDecision,
    status: str,
    purposes: Collection[str],
    sensors: Collection[str],
    person: RepresentedPerson | None,
) -> ConsentWordAnswer:
    """Without the receipt, which is fetched last."""
    return extend(
        ConsentWordAnswer,
        spoken_for(person),
        txid=word.txid.hex(),
        height=word.height,
        from_height=word.from_height,
        count=word.count,
        status=status,
        purposes=list(purposes),
        sensors=list(sensors),
        receipt=None,
        receipt_error=None,
    )


def _named(codes: tuple[str, ...], kind: str, known: Mapping[str, str], none: str) -> str:
    return ", ".join(f"{code} ({text(f'{kind}.{code}')})" if code in known else code for code in codes) or none


@consent.command()
@_codes
@click.option("--from", "begins", help="Not before: +12h, 2027-01-31 or 2027-01-31T18:00.")
@click.option("--until", "ends", help="Until when, written as for --from; until you take it back otherwise.")
@click.option("--height", type=click.IntRange(min=0), default=0, help="From this block on (default: the next one).")
@click.option("--yes", is_flag=True, help="Do not ask, if there is a notice that was not shown yet.")
@for_option
@click.pass_context
@command_output
def give(
    ctx: click.Context,
    purposes: tuple[str, ...],
    sensors: tuple[str, ...],
    begins: str | None,
    ends: str | None,
    height: int,
    yes: bool,
    whom: str | None,
    as_json: bool,
) -> None:
    """Consent to purposes, by the depth camera unless you name other sensors.

    If your organisation tells you something that this wallet never showed, it shows that first, and asks. What its
    notice does not name is refused: a purpose, a sensor for it, or consent where it rests on another ground. The
    receipt, signed by your organisation and by you, lands in the wallet.

    For somebody else, by a mandate, it shows what that person's organisation tells, asks each time, and lasts until the
    mandate ends unless you name an earlier end.

    Example: blockrobot wallet consent give --purpose care --sensor depth --until +30d
    """
    if not purposes:
        raise WrongUsage("consent_what", known=", ".join(PURPOSES))
    chosen = sensors or (DEPTH,)
    now_ms = round(time.time() * 1000)
    from_ms, until_ms = round_period(*(read_time(written, now_ms) for written in (begins, ends)))
    if ends is not None and until_ms <= max(from_ms, now_ms):
        raise WrongUsage("until_over")

    async def action(opened: Wallet) -> None:
        notices, person = Notices(opened), await resolve_represented(opened, whom)
        notice_view = await (notices.current() if person is None else notices.of_organisation(person.organisation))
        notice = notice_answer(notice_view) if person is not None or notices.is_new(notice_view) else None
        notice_view.require_named(purposes, chosen)
        if notice is not None:
            require_said(yes=yes)
            question = text("consent.ask", purposes=", ".join(purposes), sensors=", ".join(chosen))
            confirm_with_notice(notices if person is None else None, notice_view, question, yes=yes, as_json=as_json)
        last_ms = until_ms if person is None else until_ms or person.until_ms
        word = await ConsentClient(opened, handle_of(person)).give(
            list(purposes),
            list(chosen),
            from_ms=from_ms,
            until_ms=last_ms,
            height=height,
            seen_height=notice_view.height,
        )
        answer = extend(
            ConsentGiveAnswer,
            _word_answer(word, GIVEN, purposes, chosen, person),
            period_from_ms=from_ms or None,
            period_until_ms=last_ms or None,
            notice=notice,
        )
        line = _given(purposes, chosen, from_ms, last_ms)
        next_step = text("consent.take_back") if person is None else ""
        await _tell(opened, word, line, next_step, person=person, as_json=as_json, answer=answer)
        if person is None:
            notices.note_consented(notice_view)

    run_with_wallet(ctx, action)


def _given(purposes: tuple[str, ...], sensors: tuple[str, ...], from_ms: int, until_ms: int) -> str:
    period = " " + text("consent.from", moment=format_time(from_ms)) if from_ms else ""
    period += " " + text("consent.until", moment=format_time(until_ms)) if until_ms else text("consent.open_end")
    named = {
        "purposes": _named(purposes, "purpose", PURPOSES, ""),
        "sensors": _named(sensors, "sensor", SENSORS, ""),
    }
    line = text("consent.given", **named) + period
    if DEPTH not in sensors:
        line += "\n  " + text("consent.needs_depth", purpose=" --purpose ".join(purposes))
    return line


def _say_no(
    ctx: click.Context,
    act: Callable[[ConsentClient], Callable[[list[str], list[str]], Any]],
    status: str,
    key: str,
    purposes: tuple[str, ...],
    sensors: tuple[str, ...],
    *,
    whom: str | None,
    as_json: bool,
) -> None:

    named = _named(purposes, "purpose", PURPOSES, text("consent.everything"))
    what = text(key, purposes=named, sensors=_named(sensors, "sensor", SENSORS, text("consent.every_sensor")))

    async def action(opened: Wallet) -> None:
        person = await resolve_represented(opened, whom)
        word: ConsentDecision = await act(ConsentClient(opened, handle_of(person)))(list(purposes), list(sensors))
        line = what if word.count else text("consent.nothing_given")
        next_step = text("consent.after_no") if person is None else ""
        answer = _word_answer(word, status, purposes, sensors, person)
        await _tell(opened, word, line, next_step, person=person, as_json=as_json, answer=answer)

    run_with_wallet(ctx, action)


@consent.command()
@_codes
@for_option
@click.pass_context
@command_output
def refuse(
    ctx: click.Context, purposes: tuple[str, ...], sensors: tuple[str, ...], whom: str | None, as_json: bool
) -> None:
    """Say no to purposes, by every sensor unless you name some, whatever you said before.

    Example: blockrobot wallet consent refuse --purpose research
    """
    if not purposes:
        raise WrongUsage("refuse_what", known=", ".join(PURPOSES))
    _say_no(ctx, lambda say: say.refuse, "refused", "consent.refused", purposes, sensors, whom=whom, as_json=as_json)


@consent.command()
@_codes
@for_option
@click.pass_context
@command_output
def withdraw(
    ctx: click.Context, purposes: tuple[str, ...], sensors: tuple[str, ...], whom: str | None, as_json: bool
) -> None:
    """Take back what you gave: everything, unless you name purposes or sensors.

    Example: blockrobot wallet consent withdraw
    """
    key = "consent.withdrawn"
    _say_no(ctx, lambda say: say.withdraw, "withdrawn", key, purposes, sensors, whom=whom, as_json=as_json)


@consent.command("list")
@_codes
@for_option
@click.pass_context
@command_output
@read_only_wallet
def list_choices(
    ctx: click.Context, purposes: tuple[str, ...], sensors: tuple[str, ...], whom: str | None, as_json: bool
) -> None:
    """Show what you said about being recorded, proven against the chain.

    Example: blockrobot wallet consent list --json
    """

    async def action(opened: Wallet) -> Choices:
        person = await resolve_represented(opened, whom)
        consenting = ConsentClient(opened, handle_of(person))
        consenting.require_known(list(purposes), list(sensors))
        return await consenting.choices()

    found = run_with_wallet(ctx, action)
    rows = [
        row
        for row in found.rows
        if (not purposes or row.purpose in purposes) and (not sensors or row.sensor in sensors)
    ]
    if as_json:
        print_answer(ConsentListAnswer(height=found.height, choices=[choice_answer(row) for row in rows]))
        return
    if not rows:
        console.print(text("consent.none"))
    for row in rows:
        console.print(_line(row, found.height))
    for line in _without_depth(found, {row.purpose for row in rows}):
        console.print(line)


def _without_depth(found: Choices, purposes: Collection[str]) -> list[str]:
    """Per purpose, sensors without effect because depth is not consented."""
    lines = []
    for purpose in sorted(purposes):
        lacking = sorted(row.sensor for row in found.lacking_depth if row.purpose == purpose)
        if lacking:
            lines.append(text("consent.without_depth", purpose=purpose, sensors=", ".join(lacking)))
    return lines


def _line(row: Choice, height: int) -> str:
    last = row.last
    answer_word = f"{text('consent.yes' if row.holds else 'consent.no'):<{_SAID_COLUMNS}}"
    mark = f"[green]{answer_word}[/green]" if row.holds else answer_word
    since = format_time(last.since_ms)
    purpose, sensor = code_text("purpose", row.purpose), code_text("sensor", row.sensor)
    line = text("consent.row", purpose=purpose, sensor=sensor, status=code_text("said", last.status), moment=since)
    if last.height > height:
        line += ", " + text("consent.from_block", height=last.height)
    if last.from_ms:
        line += ", " + text("consent.from", moment=format_time(last.from_ms))
    if last.until_ms:
        line += ", " + text("consent.until", moment=format_time(last.until_ms))
    if last.mandate:
        line += ", " + text("mandates.by", name=last.mandate.hex()[:12])
    return f"{mark} {line}"


@consent.command()
@click.option("--out", type=FILE, help="Write them here, for anybody to check.")
@click.option("--search", is_flag=True, help="Look through the chain for words that this wallet does not know.")
@click.pass_context
@command_output
def receipts(ctx: click.Context, out: Path | None, search: bool, as_json: bool) -> None:
    """Show your consent receipts, signed by your organisation and by you, each checked anew; fetch those that are due.

    A file that --out writes can be checked by anybody, offline: blockrobot verify FILE.

    Example: blockrobot wallet consent receipts --out receipts.json
    """
    require_new(out)

    async def action(opened: Wallet) -> tuple[Receipts, bytes]:
        kept = ConsentReceipts(opened)
        found = await kept.all(search=search)
        return found, encode_file(opened.genesis, kept.epochs(), found.entries)

    found, content = run_with_wallet(ctx, action)
    if out is not None and not found.entries:
        out = None  # a file without receipts proves nothing, and is refused
    if out is not None:
        write_new_file(out, content)
    if as_json:
        rows = [read_json_text(entry.document) for entry in found.entries]
        missing = [ReceiptNotHad(txid=txid.hex(), code=error.code) for txid, error in found.missing]
        file = None if out is None else str(out)
        print_answer(ConsentReceiptsAnswer(receipts=rows, missing=missing, file=file))
        return
    if not found.checked:
        console.print(text("receipts.none"))
    for receipt in found.checked:
        console.print(escape(_receipt_line(receipt)))
    for txid, error in found.missing:
        detail, next_step = describe_error(error)
        line = text("receipts.missing", name=txid.hex()[:12], detail=detail, next_step=next_step)
        console.print(escape(line))
    if out is not None:
        console.print(escape(text("receipts.written", path=out, check=verify_command(out))))


def _receipt_line(receipt: CheckedReceipt) -> str:
    statement = receipt.statement
    published = receipt.published
    return text(
        "receipts.line",
        moment=format_time(statement.time_ms),
        status=code_text("said", statement.status),
        purposes=purposes_text(statement.purposes) or text("receipts.everything"),
        sensors=", ".join(code_text("sensor", code) for code in statement.sensors) or text("receipts.every_sensor"),
        height=statement.height,
        node=receipt.node,
        organisation=receipt.organisation,
        notice=text("receipts.notice", version=published.row.version) if published else text("receipts.no_notice"),
    )
