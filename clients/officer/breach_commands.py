"""`blockrobot officer`: breach commands of data protection officers."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar

import click
import msgspec

from clients.officer.breaches import Breach, Breaches, breach_answer
from clients.officer.lost_keys_commands import lost_keys
from clients.officer.officer_answers import BreachCloseAnswer, BreachesAnswer, CorrectionAnswer, CorrectionFile
from clients.officer.officer_mandates_commands import mandates
from clients.sdk.new_files import read_given_file
from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.terminal import EXISTING_FILE, command_output, console, pluralize, print_answer
from clients.wallet.cli.group_options import place_wallet, wallet_options
from clients.wallet.cli.wallet_context import confirm_or_print, read_only_wallet, run_with_wallet
from clients.wallet.records.rights_requests import read_correction, write_correction
from consensus.bounded_text import JSON_MAX_BYTES, read_json_text
from consensus.rights.right_codes import DELAY_REASONS, OUTCOMES, REASONS, RECIPIENTS, RISKS
from consensus.visible_text import one_entry
from pages.time_format import format_time

T = TypeVar("T")
_HOUR_MS = 3_600_000


@click.group()
@wallet_options
@click.pass_context
def officer(ctx: click.Context, profile: str, wallet_dir: Path | None, genesis: Path | None) -> None:
    """Handle visits that were denied, lost keys and mandates (data protection officers, with a wallet of their own).

    Register it once: blockrobot card issue --role officer, then blockrobot wallet --profile officer register CODE.

    Example: blockrobot officer --profile officer breaches
    """
    ctx.obj = place_wallet(profile, wallet_dir, genesis)


officer.add_command(lost_keys)
officer.add_command(mandates)


def _reasons(codes: tuple[str, ...] | None = None) -> Any:
    return click.Choice(sorted(codes or REASONS))


def _run(ctx: click.Context, start: str, action: Callable[[Breaches, Breach], Awaitable[T]]) -> tuple[T, Breach]:
    async def main(breaches: Breaches) -> tuple[T, Breach]:
        breach = await breaches.find(start)
        return await action(breaches, breach), await breaches.find(breach.breach_id.hex())

    return run_with_wallet(ctx, lambda opened: main(Breaches(opened)))


def _clock(breach: Breach) -> str:
    hours = abs(breach.left_ms) / _HOUR_MS
    if not breach.is_open or "authority" in breach.state.notified or breach.state.risk == "none":
        return ""
    if breach.left_ms < 0:
        return f"[red]{hours:.1f} hours over the 72[/red]"
    return f"{hours:.1f} hours left to tell the authority"


def _profile(ctx: click.Context) -> str:
    return str(ctx.parent.params["profile"]) if ctx.parent is not None else "default"


def _next_step(breach: Breach, profile: str) -> str:
    name, called = breach.breach_id.hex()[:12], "blockrobot officer"
    if profile != "default":
        called += f" --profile {profile}"
    state = breach.state
    if state.status == "closed":
        return ""
    if state.assessed is None:
        return f"{called} assess {name} --risk RISK --reason CODE"
    needed = {"none": (), "risk": ("authority",), "high": ("authority", "subjects")}[state.risk]
    for recipient in needed:
        if recipient not in state.notified:
            return f"{called} notify {name} --whom {recipient}"
    return f"{called} close {name} --outcome OUTCOME --reason CODE"


def _show(breach: Breach, profile: str) -> None:
    state = breach.state
    risk = f", risk: {state.risk}" if state.risk else ""
    clock = _clock(breach)
    console.print(
        f"{breach.breach_id.hex()[:12]}  {state.status}{risk}  denied {format_time(state.opened_ms)} at "
        f"{state.org}, robot {state.robot.hex()[:10]}" + (f"  {clock}" if clock else "")
    )
    step = _next_step(breach, profile)
    if step:
        console.print(f"  Next: {step}")


@officer.command()
@click.option("--all", "everything", is_flag=True, help="Those that are closed, too.")
@click.pass_context
@command_output
@read_only_wallet
def breaches(ctx: click.Context, everything: bool, as_json: bool) -> None:
    """List denied visits with what is left of the 72 hours, by the chain's clock.

    Example: blockrobot officer breaches --json
    """
    found: list[Breach] = run_with_wallet(ctx, lambda opened: Breaches(opened).read_all())
    shown = [breach for breach in found if everything or breach.is_open]
    if as_json:
        print_answer(BreachesAnswer(breaches=[breach_answer(breach) for breach in shown]))
        return
    if not shown:
        console.print("There is no open breach.")
    for breach in shown:
        _show(breach, _profile(ctx))


@officer.command()
@click.argument("breach")
@click.option("--risk", type=click.Choice(sorted(RISKS)), required=True, help="none, risk or high, to people.")
@click.option("--reason", type=_reasons(), required=True, help="Why you think so.")
@click.pass_context
@command_output
def assess(ctx: click.Context, breach: str, risk: str, reason: str, as_json: bool) -> None:
    """Say how much risk a breach is to people; say it anew if it turns out to be more. It cannot be lowered again.

    Example: blockrobot officer assess 3fa2c19b07de --risk risk --reason released-before
    """
    _, after = _run(ctx, breach, lambda handled, found: handled.assess(found, risk, reason))
    _tell(ctx, after, RISKS[risk], as_json=as_json)


@officer.command()
@click.argument("breach")
@click.option("--whom", type=click.Choice(sorted(RECIPIENTS)), required=True, help="Who was told.")
@click.option("--reason", type=_reasons(), help=f"After 72 hours, why so late: {', '.join(DELAY_REASONS)}.")
@click.pass_context
@command_output
def notify(ctx: click.Context, breach: str, whom: str, reason: str | None, as_json: bool) -> None:
    """Note that the authority (Art. 33) or the subjects (Art. 34) were told. You tell them yourself.

    Example: blockrobot officer notify 3fa2c19b07de --whom authority
    """
    _, after = _run(ctx, breach, lambda handled, found: handled.notify(found, whom, reason or ""))
    _tell(ctx, after, f"Told: {RECIPIENTS[whom]}", as_json=as_json)


@officer.command()
@click.argument("breach")
@click.option("--outcome", type=click.Choice(sorted(OUTCOMES)), required=True, help="erased or released.")
@click.option("--reason", type=_reasons(), required=True, help="Why.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def close(ctx: click.Context, breach: str, outcome: str, reason: str, yes: bool, as_json: bool) -> None:
    """End a breach: have the visit erased, or end its quarantine. It cannot be opened again.

    If more comes to a visit after you had it erased, say so again, and that is erased too.

    Example: blockrobot officer close 3fa2c19b07de --outcome erased --reason matched-wrongly
    """
    confirm_or_print(
        "Every record of the visit will be gone for everyone, for ever, also what was to be kept for a claim. Erase?",
        yes=yes or outcome != "erased",
        as_json=as_json,
    )

    def on_progress(number: int, count: int) -> None:
        click.echo(f"erasing records: {number} of {count} are asked for", err=True)

    count, after = _run(ctx, breach, lambda handled, found: handled.close(found, outcome, reason, on_progress))
    going = f" {pluralize(count, 'record is', 'records are')} being erased." if outcome == "erased" else ""
    line = OUTCOMES[outcome] + going
    _tell(ctx, after, line, as_json=as_json, erasing=count)


@officer.command("correction")
@click.argument("file", type=EXISTING_FILE)
@click.pass_context
@command_output
def check_correction(ctx: click.Context, file: Path, as_json: bool) -> None:
    """Check a correction that a person handed over: that it was they who said it, of what, and when.

    Example: blockrobot officer correction correction.json
    """
    correction = read_correction(read_given_file(file, JSON_MAX_BYTES))
    number, row = run_with_wallet(ctx, lambda opened: Breaches(opened).get_correction(correction))
    if as_json:
        held = msgspec.convert(read_json_text(write_correction(correction)), CorrectionFile)
        where = CorrectionAnswer(
            number=number, txid=row.txid.hex(), height=row.height, time_ms=row.time, correction=held
        )
        print_answer(where)
        return
    of = pluralize(len(correction.record_ids), "record") if correction.record_ids else "all"
    console.print(
        f"Said by the owner of visit {correction.visit[:12]} on {format_time(row.time)} (block {row.height}), "
        f"of {of} of it, about its {correction.kind}:\n"
    )
    console.print(one_entry(correction.text), markup=False)


def _tell(ctx: click.Context, breach: Breach, line: str, *, as_json: bool, erasing: int | None = None) -> None:
    if as_json:
        answer = breach_answer(breach)
        print_answer(answer if erasing is None else extend(BreachCloseAnswer, answer, erasing=erasing))
        return
    console.print(line)
    _show(breach, _profile(ctx))
