"""`blockrobot wallet notice | register`, and showing notices before consent."""

from __future__ import annotations

import click
from msgspec import UNSET

from clients.sdk.terminal.qr_codes import read_given
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import ask, can_ask, command_output, console, print_answer
from clients.wallet.cli.wallet_context import run_with_wallet
from clients.wallet.consent.notice_reading import Notices, NoticeView
from clients.wallet.consent.receipt_fetching import Receipted, take_receipt
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.present.consent_answers import RegisterAnswer
from clients.wallet.present.translations import WrongUsage, text
from consensus.rights.consent_receipts import FIRST_SENSORS
from pages.moments import show_moment


def show_notice(told: NoticeView, *, err: bool = False) -> None:
    """Print a notice verbatim, without control characters or colours from the chain."""
    for line in told.lines():
        if err:
            click.echo(line, err=True)
        else:
            console.print(escape(line))


def require_said(*, yes: bool) -> None:
    """Raise UsageError without terminal, unless `yes`: consent needs a person."""
    if not yes and not can_ask():
        raise WrongUsage("no_terminal_read")


def tell_first(notices: Notices | None, told: NoticeView, question: str, *, yes: bool, as_json: bool) -> None:
    """Show a notice before signing, and ask unless `yes`. `notices` None: another person's, not remembered. With `yes`
    it is marked as shown once printed.
    """
    if as_json and (yes or not can_ask()):
        return
    show_notice(told, err=as_json)
    if not yes and can_ask():
        ask(question, err=as_json)
    if notices is not None:
        notices.note_shown(told)


@click.command()
@click.pass_context
@command_output
def notice(ctx: click.Context, as_json: bool) -> None:
    """Show what your organisation tells you about your data, and what changed since you consented.

    Example: blockrobot wallet notice
    """

    async def action(opened: Wallet) -> None:
        notices = Notices(opened)
        told = await notices.current()
        if as_json:
            print_answer(told.answer())
        else:
            _show_with_changes(told)
        notices.note_shown(told)

    run_with_wallet(ctx, action)


def _show_with_changes(told: NoticeView) -> None:
    show_notice(told)
    if told.before is None or told.published is None:
        return
    came = show_moment(told.published.row.time_ms)
    console.print("\n" + text("notice.changed", before=told.before.version, version=told.version, moment=came))
    for line in told.changes:
        console.print(escape(line))
    console.print(text("notice.holds"))


def _ask_of(purposes: tuple[str, ...]) -> str:
    if not purposes:
        return text("register.ask_nothing")
    return text("register.ask", purposes=", ".join(purposes))


@click.command()
@click.argument("code")
@click.option("--purpose", "purposes", multiple=True, help="What you consent to. [default: nothing]")
@click.option("--yes", is_flag=True, help="Do not ask: who registers has read the notice, and consents.")
@click.pass_context
@command_output
def register(ctx: click.Context, code: str, purposes: tuple[str, ...], yes: bool, as_json: bool) -> None:
    """Register with the CODE on your card, and consent to the purposes named, by the depth camera.

    First it shows what the organisation that issued the card tells you about your data, and asks. Without a purpose you
    consent to nothing, and no robot records you. A purpose that the notice does not name, or not
    by that camera, or that rests on another ground, is refused.

    Instead of the letters: @FILE, a photograph of the card or a file with its code.

    Example: blockrobot wallet register BR1-... --purpose demo
    """
    code = read_given(code)

    if purposes:
        require_said(yes=yes)

    async def action(opened: Wallet) -> None:
        notices = Notices(opened)
        told, shown = await notices.for_card(code), -1
        while told.version > shown:  # a newer one may come while they read
            told.require_named(purposes, FIRST_SENSORS)
            tell_first(notices, told, _ask_of(purposes), yes=yes, as_json=as_json)
            shown, told = told.version, await notices.for_card(code)
        done = await opened.register(code, list(purposes))
        if not as_json:
            console.print(_registered_line(purposes))
        receipted = await take_receipt(opened, done.txid) if purposes and done.txid else None
        if as_json:
            answer = RegisterAnswer(
                notice=told.answer(),
                receipt=UNSET if receipted is None else receipted.fetched,
                receipt_error=UNSET if receipted is None else receipted.error_code,
                txid=done.txid.hex(),
                member=done.member.hex(),
                purposes=list(purposes),
            )
            print_answer(answer)
        elif receipted is not None:
            console.print(f"  {escape(receipted.line())}{_unseen(receipted, told)}")
        if receipted is None:
            notices.note_shown(told)
        else:
            notices.note_consented(told)

    run_with_wallet(ctx, action)


def _registered_line(purposes: tuple[str, ...]) -> str:
    if purposes:
        return text("register.done", purposes=", ".join(purposes))
    return text("register.done_nothing")


def _unseen(receipted: Receipted, told: NoticeView) -> str:
    """Describe a notice version published during registration, to which the chain binds."""
    published = None if receipted.receipt is None else receipted.receipt.published
    if published is None or published.row.version <= told.version:
        return ""
    return " " + text("register.unseen")
