"""`blockrobot wallet notice | register`, and showing notices before consent."""

from __future__ import annotations

import click
from msgspec import UNSET

from clients.sdk.terminal.qr_codes import read_given
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import ask, can_ask, command_output, console, print_answer
from clients.wallet.answers.consent_answers import RegisterAnswer
from clients.wallet.cli.wallet_context import run_with_wallet
from clients.wallet.consent.notice_reading import Notices, NoticeView
from clients.wallet.consent.receipt_fetching import ReceiptOutcome, try_fetch_receipt
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.consent_text import fetched_receipt, notice_answer, notice_text, receipt_line
from clients.wallet.presentation.translations import WrongUsage, text
from consensus.rights.consent_receipts import FIRST_SENSORS
from pages.time_format import format_time


def show_notice(notice_view: NoticeView, *, err: bool = False) -> None:
    """Verbatim, without control characters or colours from the chain."""
    for line in notice_text(notice_view):
        if err:
            click.echo(line, err=True)
        else:
            console.print(escape(line))


def require_said(*, yes: bool) -> None:
    """Raise UsageError without terminal, unless `yes`: consent needs a person."""
    if not yes and not can_ask():
        raise WrongUsage("no_terminal_read")


def confirm_with_notice(
    notices: Notices | None, notice_view: NoticeView, question: str, *, yes: bool, as_json: bool
) -> None:
    """Show a notice before signing, and ask unless `yes`. `notices` None: another person's, not remembered."""
    if as_json and (yes or not can_ask()):
        return
    show_notice(notice_view, err=as_json)
    if not yes and can_ask():
        ask(question, err=as_json)
    if notices is not None:
        notices.note_shown(notice_view)


@click.command()
@click.pass_context
@command_output
def notice(ctx: click.Context, as_json: bool) -> None:
    """Show what your organisation tells you about your data, and what changed since you consented.

    Example: blockrobot wallet notice
    """

    async def action(opened: Wallet) -> None:
        notices = Notices(opened)
        notice_view = await notices.current()
        if as_json:
            print_answer(notice_answer(notice_view))
        else:
            _show_with_changes(notice_view)
        notices.note_shown(notice_view)

    run_with_wallet(ctx, action)


def _show_with_changes(notice_view: NoticeView) -> None:
    show_notice(notice_view)
    if notice_view.before is None or notice_view.published is None:
        return
    came = format_time(notice_view.published.row.time_ms)
    console.print(
        "\n" + text("notice.changed", before=notice_view.before.version, version=notice_view.version, moment=came)
    )
    for line in notice_view.changes:
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
        notice_view, shown = await notices.for_card(code), -1
        while notice_view.version > shown:  # a newer one may come while they read
            notice_view.require_named(purposes, FIRST_SENSORS)
            confirm_with_notice(notices, notice_view, _ask_of(purposes), yes=yes, as_json=as_json)
            shown, notice_view = notice_view.version, await notices.for_card(code)
        done = await opened.register(code, list(purposes))
        if not as_json:
            console.print(_registered_line(purposes))
        receipted = await try_fetch_receipt(opened, done.txid) if purposes and done.txid else None
        if as_json:
            answer = RegisterAnswer(
                notice=notice_answer(notice_view),
                receipt=UNSET if receipted is None else fetched_receipt(receipted),
                receipt_error=UNSET if receipted is None else receipted.error_code,
                txid=done.txid.hex(),
                member=done.member.hex(),
                purposes=list(purposes),
            )
            print_answer(answer)
        elif receipted is not None:
            console.print(f"  {escape(receipt_line(receipted))}{_unseen(receipted, notice_view)}")
        if receipted is None:
            notices.note_shown(notice_view)
        else:
            notices.note_consented(notice_view)

    run_with_wallet(ctx, action)


def _registered_line(purposes: tuple[str, ...]) -> str:
    if purposes:
        return text("register.done", purposes=", ".join(purposes))
    return text("register.done_nothing")


def _unseen(receipted: ReceiptOutcome, notice_view: NoticeView) -> str:
    """A version published during registration, to which the chain binds."""
    published = None if receipted.receipt is None else receipted.receipt.published
    if published is None or published.row.version <= notice_view.version:
        return ""
    return " " + text("register.unseen")
