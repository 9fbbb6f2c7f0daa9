"""`blockrobot wallet restrict|lift|object|correct|wrong-person`."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import click

from clients.sdk.new_files import new_file, read_given_text
from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.terminal import EXISTING_FILE, FILE, can_ask, command_output, console, print_answer
from clients.wallet.answers.rights_answers import (
    CorrectAnswer,
    LiftAnswer,
    ObjectAnswer,
    RestrictAnswer,
    RestrictedVisit,
    VisitStatement,
    WrongPersonAnswer,
)
from clients.wallet.cli.group_options import for_option, visit_option
from clients.wallet.cli.wallet_context import confirm_or_print, require_new, run_with_wallet
from clients.wallet.consent.consent_by_mandate import RepresentedPerson, handle_of, resolve_represented
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.consent_text import spoken_for
from clients.wallet.presentation.translations import WrongUsage, purposes_text, text
from clients.wallet.records.rights_requests import RecordChoice, Rights, RightsStatement, choose, write_correction
from consensus.errors import BlockRobotError
from consensus.members.handles import encode_short
from consensus.rights.purposes import PURPOSES
from consensus.rights.right_codes import CORRECTIONS, GROUNDS, KEEPING_GROUNDS, Correction
from pages.time_format import format_time

Spoken = tuple[list[RightsStatement], BlockRobotError | None]


def _what(command: Any) -> Any:
    return click.argument("record_ids", nargs=-1)(visit_option(command))


def _now(command: Any) -> Any:
    return click.option(
        "--now", is_flag=True, help="Without pauses between visits: whoever watches can tell that they are one's."
    )(command)


def _require_named(record_ids: tuple[str, ...], visits: tuple[str, ...]) -> None:
    if not record_ids and not visits:
        raise WrongUsage("name_records")


async def _choose(opened: Wallet, record_ids: tuple[str, ...], visits: tuple[str, ...]) -> list[RecordChoice]:
    return choose(await opened.records(), record_ids, visits)


def _visit_statement(statement: RightsStatement) -> VisitStatement:
    return VisitStatement(
        visit=statement.visit.owner.hex(),
        records=[record_id.hex() for record_id in statement.record_ids],
        txid=statement.txid.hex(),
        height=statement.height,
        time_ms=statement.time_ms,
    )


def _name(statement: RightsStatement) -> str:
    name = statement.visit.owner.hex()[:12]
    return text("rights.some" if statement.record_ids else "rights.whole", count=len(statement.record_ids), name=name)


def _all_of(spoken: Spoken) -> list[RightsStatement]:
    """Report them before raising the refusal."""
    words, refusal = spoken
    if refusal is None:
        return words
    for statement in words:
        click.echo(text("rights.before_refusal", what=_name(statement)), err=True)
    raise refusal


@click.command()
@_what
@click.option("--ground", type=click.Choice(sorted(GROUNDS)), required=True, help="Why: see below.")
@_now
@click.pass_context
@command_output
def restrict(
    ctx: click.Context, record_ids: tuple[str, ...], visits: tuple[str, ...], ground: str, now: bool, as_json: bool
) -> None:
    """Keep records as they are, and let nobody but you see them, until you lift it.

    The ground says why: `accuracy` (it is not right, and being checked), `unlawful` (it should not have been recorded, but
    is to be kept), `legal-claim` (you need it for a claim), `objection` (you objected, and that is being checked). For
    `unlawful` and `legal-claim` it is also kept beyond its time, for a year; say it again to prolong that.

    Example: blockrobot wallet restrict --visit 02ab34cd --ground legal-claim
    """
    _require_named(record_ids, visits)

    async def action(opened: Wallet) -> Spoken:
        rights, chosen = Rights(opened), await _choose(opened, record_ids, visits)
        return await rights.say_each(
            chosen, lambda one: rights.restrict(one, ground), at_once=now, on_progress=_print_progress
        )

    words = _all_of(run_with_wallet(ctx, action))
    if as_json:
        rows = [
            extend(RestrictedVisit, _visit_statement(statement), kept_until_ms=statement.data["until_ms"] or None)
            for statement in words
        ]
        print_answer(RestrictAnswer(ground=ground, restricted=rows))
        return
    for statement in words:
        line = text("rights.restricted", what=_name(statement))
        if ground in KEEPING_GROUNDS:
            line += " " + text("rights.kept", moment=format_time(statement.data["until_ms"]))
        console.print(line)
    console.print("  " + text("rights.to_lift"))


@click.command()
@_what
@_now
@click.pass_context
@command_output
def lift(ctx: click.Context, record_ids: tuple[str, ...], visits: tuple[str, ...], now: bool, as_json: bool) -> None:
    """Lift a restriction. What has outlived its time under it is erased at once.

    Example: blockrobot wallet lift --visit 02ab34cd
    """
    _require_named(record_ids, visits)

    async def action(opened: Wallet) -> Spoken:
        rights, chosen = Rights(opened), await _choose(opened, record_ids, visits)
        return await rights.say_each(chosen, rights.lift, at_once=now, on_progress=_print_progress)

    words = _all_of(run_with_wallet(ctx, action))
    if as_json:
        print_answer(LiftAnswer(lifted=[_visit_statement(statement) for statement in words]))
    for statement in () if as_json else words:
        console.print(text("rights.lifted", what=_name(statement)))


def _print_progress(number: int, count: int) -> None:
    click.echo(text("rights.progress", number=number + 1, count=count), err=True)


@click.command("object")
@click.option("--purpose", "purposes", multiple=True, help="A purpose's code; may be repeated.")
@_now
@click.option(
    "--recording-only", is_flag=True, help="Object to new recordings only, and leave past visits as they are."
)
@for_option
@click.pass_context
@command_output
def object_to(
    ctx: click.Context, purposes: tuple[str, ...], now: bool, recording_only: bool, whom: str | None, as_json: bool
) -> None:
    """Object to a purpose: nothing more is recorded of you for it, and nothing that was is released for it.

    For somebody else, by a mandate, it is about new recordings only: past visits are told by the person's own wallet.

    Example: blockrobot wallet object --purpose research
    """
    if not purposes:
        raise WrongUsage("object_what", known=", ".join(PURPOSES))
    if now and not as_json:
        click.echo(text("rights.linked"), err=True)

    async def action(opened: Wallet) -> tuple[int, list[RightsStatement], RepresentedPerson | None]:
        rights, person = Rights(opened), await resolve_represented(opened, whom)
        height = await rights.object_to_recording(list(purposes), handle_of(person))
        if recording_only or person is not None:
            return height, [], person
        return height, await rights.object_to_release(list(purposes), at_once=now, on_progress=_print_progress), None

    height, words, person = run_with_wallet(ctx, action)
    if as_json:
        visits = [_visit_statement(statement) for statement in words]
        answer = extend(ObjectAnswer, spoken_for(person), purposes=list(purposes), from_height=height, visits=visits)
        print_answer(answer)
        return
    if person is not None:
        console.print(text("mandates.said_for", name=encode_short(person.handle)))
    console.print(text("rights.objected", purposes=purposes_text(purposes), height=height, count=len(words)))
    console.print("  " + text("rights.objected_next"))


def _read_text(text_file: Path | None) -> str:
    if text_file is not None:
        return read_given_text(text_file).strip()
    if not can_ask():
        raise WrongUsage("no_terminal_text")
    return str(click.prompt(text("rights.ask_correction"))).strip()


@click.command()
@_what
@click.option("--of", "kind", type=click.Choice(sorted(CORRECTIONS)), default="attribution", show_default=True)
@click.option("--text-file", type=EXISTING_FILE, help="What is right.")
@click.option("--out", type=FILE, help="Write it to this new file, to hand it on (mode 0600).")
@click.pass_context
@command_output
def correct(
    ctx: click.Context,
    record_ids: tuple[str, ...],
    visits: tuple[str, ...],
    kind: str,
    text_file: Path | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Say what is wrong with a visit or records. It stands beside them on the chain; nothing is changed.

    The text stays in your wallet, the chain holds a seal of it. To have the hospital act on it, hand it the file that
    --out writes: with it, everybody can check that you said it, and when.

    Example: blockrobot wallet correct --visit 02ab34cd --text-file what-is-right.txt --out correction.json
    """
    _require_named(record_ids, visits)
    require_new(out)
    right = _read_text(text_file)

    async def action(opened: Wallet) -> tuple[RightsStatement, Correction]:
        chosen = await _choose(opened, record_ids, visits)
        if len(chosen) != 1:
            raise WrongUsage("correct_one_visit")
        return await Rights(opened).correct(chosen[0], kind, right)

    with nullcontext() if out is None else new_file(out) as file:
        statement, correction = run_with_wallet(ctx, action)
        if file is not None:
            file.write(write_correction(correction))
    if as_json:
        place = None if out is None else str(out)
        print_answer(
            extend(CorrectAnswer, _visit_statement(statement), kind=kind, number=statement.data["number"], out=place)
        )
        return
    console.print(text("rights.corrected", number=statement.data["number"] + 1, what=_name(statement)))
    console.print("  " + (text("rights.hand_over", path=out) if out else text("rights.not_handed")))


@click.command("wrong-person")
@click.argument("visit")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def wrong_person(ctx: click.Context, visit: str, yes: bool, as_json: bool) -> None:
    """Say that a visit (the beginning of its name) shows somebody else. Nobody sees it from then on, you neither.

    Data protection officers find it among their breaches, and decide within days. You cannot take it back yourself: where
    the robot's organisation has no officer, it stays so until one is enrolled. Ask at its desk before.

    Example: blockrobot wallet wrong-person 02ab34cd
    """
    question = text("rights.ask_wrong_person", no_officer=text("rights.no_officer"))
    confirm_or_print(question, yes=yes, as_json=as_json)

    async def action(opened: Wallet) -> RightsStatement:
        (chosen,) = choose(await opened.records(), (), (visit,))
        return await Rights(opened).deny(chosen.visit)

    statement = run_with_wallet(ctx, action)
    breach_id, due_ms = statement.data["breach_id"].hex(), statement.data["due_ms"]
    if as_json:
        organisation = statement.data["org"]
        answer = extend(
            WrongPersonAnswer,
            _visit_statement(statement),
            breach_id=breach_id,
            organisation=organisation,
            due_ms=due_ms,
        )
        print_answer(answer)
        return
    console.print(text("rights.wrong_person", organisation=statement.data["org"], moment=format_time(due_ms)))
    console.print("  " + text("rights.no_officer"))
    console.print("  " + text("rights.breach", name=breach_id[:12]))


COMMANDS = (restrict, lift, object_to, correct, wrong_person)
