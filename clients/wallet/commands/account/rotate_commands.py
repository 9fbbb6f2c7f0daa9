"""`blockrobot wallet rotate|transfer|leave`: key rotation, visit transfer and leaving."""

from __future__ import annotations

import asyncio
import contextlib
from pathlib import Path
from typing import Any

import click

from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.terminal import FILE, command_output, console, is_at_terminal, print_answer
from clients.wallet.answers.wallet_answers import LeaveAnswer, RotateAnswer, TransferAnswer
from clients.wallet.cli.mnemonic_handover import show_and_check, write_words
from clients.wallet.cli.wallet_context import confirm_or_print, on_abort, print_linked_moves, run_with_wallet
from clients.wallet.consent.receipt_fetching import ConsentReceipts
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.former_text import exposed, stuck_lines, taken_lines, words_lines
from clients.wallet.presentation.translations import WrongUsage, text
from clients.wallet.recovery.key_rotation import KeyRotation, Transferred
from clients.wallet.store.keystore import WalletContent
from consensus.errors import BlockRobotError

CHECKED_COUNT = 1
SPREAD_DEFAULT_MINUTES = 10
SPREAD_MAX_MINUTES = 7 * 24 * 60
RECEIPTS_WAIT_S = 5.0


def _spread(command: Any) -> Any:
    over = click.option(
        "--over-minutes",
        type=click.IntRange(0, SPREAD_MAX_MINUTES),
        default=SPREAD_DEFAULT_MINUTES,
        show_default=True,
        help="Move the visits within this time, at moments that chance decides.",
    )
    now = click.option(
        "--now",
        is_flag=True,
        help="All at once, without pauses: whoever reads the ledger can tell that they are one's.",
    )
    keep = click.option("--keep-shares", is_flag=True, help="End no share, whoever made it.")
    return over(now(keep(command)))


def _hand_over(words: str, words_file: Path | None) -> None:
    if words_file is not None:
        write_words(words_file, words)
    else:
        show_and_check(text("rotate.words"), words, CHECKED_COUNT, texts_of="rotate")


def _print_progress(number: int, count: int, pause_s: float) -> None:
    click.echo(text("rotate.progress", number=number + 1, count=count, seconds=f"{pause_s:.0f}"), err=True)


async def _transfer(
    rotating: KeyRotation, over_minutes: int, *, now: bool, keep_shares: bool, with_member: bool, as_json: bool
) -> Transferred:
    count = len(await rotating.exposed_visits())
    if now and not as_json:
        print_linked_moves(count, with_member=with_member)
    over_s = 0.0 if now else over_minutes * 60.0
    return await rotating.transfer_all(over_s, _print_progress, keep_shares=keep_shares)


def _transfer_answer(done: Transferred) -> TransferAnswer:
    return TransferAnswer(
        transferred=[visit.owner.hex() for visit in done.done],
        taken_visits=[visit.owner.hex() for visit in done.taken],
        stuck_visits=[visit.owner.hex() for visit in done.stuck],
        ended_shares=[grant_id.hex() for grant_id in done.ended],
    )


def _print_transferred(done: Transferred) -> None:
    console.print(text("rotate.moved", count=len(done.done)))
    if done.ended:
        console.print(text("rotate.shares_ended", count=len(done.ended)))
    print_taken(len(done.taken))
    print_stuck(len(done.stuck))
    if done.refusal is not None:
        console.print(f"[red]{text('rotate.ended_early')}[/red]")
        raise done.refusal


def print_taken(count: int) -> None:
    """Somebody else's key controls them."""
    for line in taken_lines(count):
        console.print(f"[red]{line}[/red]")


def print_stuck(count: int) -> None:
    """Say of how many visits the key cannot be replaced any more."""
    for line in stuck_lines(count):
        console.print(f"[red]{line}[/red]")


def print_words(content: WalletContent) -> None:
    for line in words_lines(content):
        console.print(f"[red]{line}[/red]")


class _Before:
    """Wallet state before a rotation."""

    def __init__(self) -> None:
        self._content: WalletContent | None = None
        self._former_count = 0
        self._was_moving = False

    def note(self, content: WalletContent) -> None:
        self._content = content
        self._former_count, self._was_moving = len(content.former), content.transfers_due

    def say_how_far(self) -> str:
        content = self._content
        if content is None:  # a change that was cut off before may be in force already, and nobody has looked
            return text("rotate.stopped_unopened")
        if content.next_words:
            return text("rotate.stopped_sending" if content.next_words_shown else "rotate.stopped_words")
        if len(content.former) == self._former_count and not self._was_moving:
            return text("rotate.stopped")
        if content.transfers_due:
            return text("rotate.stopped_moving", count=len(exposed(content)))
        return text("rotate.stopped_done")


async def _fetch_receipts(opened: Wallet) -> int:
    """Briefly; return how many are missing. Not waiting longer protects visits after theft."""
    content = opened.store.content
    try:
        async with asyncio.timeout(RECEIPTS_WAIT_S):
            for txid in list(content.receipts_due):
                with contextlib.suppress(BlockRobotError):
                    await ConsentReceipts(opened).obtain(txid)
    except TimeoutError:
        pass
    return len(content.receipts_due)


@click.command()
@click.option("--words-file", type=FILE, help="Write the words here, mode 0600.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@_spread
@click.pass_context
@command_output
def rotate(
    ctx: click.Context,
    words_file: Path | None,
    yes: bool,
    over_minutes: int,
    now: bool,
    keep_shares: bool,
    as_json: bool,
) -> None:
    """Get new words after a theft: whoever has the old ones sees, decides and erases nothing any more.

    Your membership gets its new key at once, then each visit, one by one; shares that this wallet did not make end with
    that. Cut off anywhere, run it again: it goes on.

    Example: blockrobot wallet rotate
    """

    found = _Before()

    async def action(opened: Wallet) -> Transferred:
        rotating, content = KeyRotation(opened), opened.store.content
        found.note(content)
        if not content.next_words and not content.transfers_due:
            if words_file is None and not is_at_terminal():
                raise WrongUsage("no_terminal_show")
            await opened.scan()
            if opened.member_gone:
                raise BlockRobotError("MEMBERSHIP_ENDED")
            confirm_or_print(text("rotate.ask"), yes=yes, as_json=as_json)
            rotating.prepare()
        if rotating.must_show:
            if words_file is None and not is_at_terminal():
                raise WrongUsage("no_terminal_show")
            _hand_over(rotating.prepare(), words_file)
            rotating.confirm_shown()
        due_count = await _fetch_receipts(opened) if content.next_words else 0
        if await rotating.rotate() and due_count:
            click.echo(text("rotate.receipts_lost", count=due_count), err=True)
        return await _transfer(
            rotating, over_minutes, now=now, keep_shares=keep_shares, with_member=True, as_json=as_json
        )

    with on_abort(ctx, found.say_how_far):
        done = run_with_wallet(ctx, action)
    if as_json:
        if done.refusal is not None:
            raise done.refusal
        file = str(words_file) if words_file else None
        print_answer(extend(RotateAnswer, _transfer_answer(done), words_file=file))
        return
    _print_transferred(done)
    console.print(text("rotate.done"))


@click.command()
@_spread
@click.pass_context
@command_output
def transfer(ctx: click.Context, over_minutes: int, now: bool, keep_shares: bool, as_json: bool) -> None:
    """Give visits that came late, under former words, a key of the present ones.

    Shares of them that this wallet did not make end with that.

    Example: blockrobot wallet transfer
    """

    async def action(opened: Wallet) -> Transferred:
        rotating = KeyRotation(opened)
        return await _transfer(
            rotating, over_minutes, now=now, keep_shares=keep_shares, with_member=False, as_json=as_json
        )

    done = run_with_wallet(ctx, action)
    if as_json:
        if done.refusal is not None:
            raise done.refusal
        print_answer(_transfer_answer(done))
        return
    _print_transferred(done)


@click.command()
@click.option("--yes", is_flag=True, help="Do not ask.")
@click.pass_context
@command_output
def leave(ctx: click.Context, yes: bool, as_json: bool) -> None:
    """End your membership. Says what stays and what goes, and asks.

    Example: blockrobot wallet leave
    """
    if not as_json:
        console.print(text("leave.means"))
    confirm_or_print(text("leave.ask"), yes=yes, as_json=as_json)
    height = run_with_wallet(ctx, lambda opened: KeyRotation(opened).leave())
    if as_json:
        print_answer(LeaveAnswer(height=height or None))
    elif height:
        console.print(text("leave.done", height=height))
    else:
        console.print(text("leave.before"))


COMMANDS = (rotate, transfer, leave)
