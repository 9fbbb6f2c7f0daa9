"""`blockrobot wallet rotate|transfer|leave`: after a theft, and when one goes. Must never take words as an argument."""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import sys
from pathlib import Path
from typing import Any

import click

from clients.sdk.terminal import ask, ask_for, console, json_option, plain_errors, print_json
from clients.wallet.consent_receipts import ConsentReceipts
from clients.wallet.counting import counted
from clients.wallet.keys import WORDS_COUNT
from clients.wallet.keystore import WalletContent
from clients.wallet.linking import tell_linked_moves
from clients.wallet.opening import STOLEN_PAGE, run_opened
from clients.wallet.rotating import Rotating, Transferred
from clients.wallet.wallet import VisitReport, Wallet
from consensus.errors import BlockRobotError

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
    return over(now(command))


def write_words(path: Path, words: str) -> None:
    """Write words to a new file that only its owner reads; one that holds them already will do. Raises UsageError."""
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        if path.read_text(encoding="utf-8").strip() == words:
            return
        raise click.UsageError(f"{path} exists already: name a new file.") from None
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(words + "\n")
        file.flush()
        os.fsync(file.fileno())


def _show_words(words: str, words_file: Path | None) -> None:
    """Hand the words over, and go on only once they are in a file or were written down."""
    if words_file is not None:
        write_words(words_file, words)
        return
    console.print("Your 24 new words. Write them down now, and keep the old ones too; they are shown this once:\n")
    console.print(words, style="bold")
    wanted = secrets.randbelow(WORDS_COUNT)
    while ask_for(f"\nFrom what you wrote down: word number {wanted + 1}").strip().lower() != words.split()[wanted]:
        console.print("That is not this word. Look again; nothing is changed yet.")


def _ask_or_say(question: str, *, yes: bool) -> None:
    if not yes:
        if not sys.stdin.isatty():
            raise click.UsageError("There is no terminal to ask for confirmation: give --yes.")
        ask(question)


def _tell_progress(number: int, count: int, pause_s: float) -> None:
    click.echo(f"Visit {number + 1} of {count} gets its new key in {pause_s:.0f} s ...", err=True)


async def _transfer(
    rotating: Rotating, over_minutes: int, *, now: bool, with_member: bool, as_json: bool
) -> Transferred:
    count = len(await rotating.exposed_visits())
    if now and not as_json:
        tell_linked_moves(count, with_member=with_member)
    return await rotating.transfer_all(0.0 if now else over_minutes * 60.0, _tell_progress)


def _transferred_json(done: Transferred) -> dict[str, Any]:
    return {
        "transferred": [visit.owner.hex() for visit in done.done],
        "taken_visits": [visit.owner.hex() for visit in done.taken],
        "stuck_visits": [visit.owner.hex() for visit in done.stuck],
    }


def _tell_transferred(done: Transferred) -> None:
    console.print(f"{counted(len(done.done), 'visit has', 'visits have')} a key of your present words.")
    print_taken(len(done.taken))
    print_stuck(len(done.stuck))
    if done.refusal is not None:
        console.print("[red]It was ended early; run the same command again to go on.[/red]")
        raise done.refusal


def print_taken(count: int) -> None:
    """Say, if so, that visits obey somebody else's key."""
    for line in _taken_lines(count):
        console.print(f"[red]{line}[/red]")


def _taken_lines(count: int) -> list[str]:
    return [
        (
            f"{counted(count, 'visit was', 'visits were')} given a key that is not of your words, by somebody who had"
            " the key before: out of this wallet's reach. Tell the hospital's data protection officer; see"
            f" {STOLEN_PAGE}."
        )
    ][:count]


def print_stuck(count: int) -> None:
    """Say, if so, that visits can be given no other key any more."""
    for line in _stuck_lines(count):
        console.print(f"[red]{line}[/red]")


def _stuck_lines(count: int) -> list[str]:
    visits = counted(count, "visit still obeys", "visits still obey")
    return [
        (
            f"{visits} your former words, and can be given no other key any more: moved too often. Whoever has those words"
            f" sees them. You can have them erased: blockrobot wallet erase; see {STOLEN_PAGE}."
        )
    ][:count]


def unreadable_words(report: VisitReport) -> str:
    """Say what to do about records of a visit that do not open."""
    count = len(report.unreadable_ids)
    what = counted(count, "record")
    if not report.needs_former_words:
        return f"{what} cannot be opened with your keys. Ask the hospital why."
    return (
        f"{what} of before you changed your words cannot be opened without the former ones. Make the wallet again under"
        " another name, with all words that you had: blockrobot wallet --profile NAME restore --words-file NEW --former OLD"
    )


def words_json(content: WalletContent) -> dict[str, Any]:
    """Return what is to be known of visits that the present words do not decide of, for a program."""
    return {
        "taken_visits": [visit.owner.hex() for visit in content.visits if visit.taken],
        "exposed_visits": [visit.owner.hex() for visit in exposed(content)],
        "stuck_visits": [visit.owner.hex() for visit in content.visits if visit.stuck and not visit.taken],
    }


def exposed(content: WalletContent) -> list[Any]:
    """Return the visits of which a key from former words still decides, and can be replaced, as far as is known."""
    present = len(content.former)
    return [visit for visit in content.visits if visit.era != present and not visit.taken and not visit.stuck]


def print_words(content: WalletContent) -> None:
    """Say what is to be known of visits that the present words do not decide of."""
    for line in words_lines(content):
        console.print(f"[red]{line}[/red]")


def words_lines(content: WalletContent) -> list[str]:
    """Return the same in sentences."""
    count = len(exposed(content))
    visits = counted(count, "visit still obeys", "visits still obey")
    told = [f"{visits} your former words. Run: blockrobot wallet transfer"] if count else []
    told += _taken_lines(sum(visit.taken for visit in content.visits))
    return told + _stuck_lines(sum(visit.stuck and not visit.taken for visit in content.visits))


async def _fetch_receipts(opened: Wallet) -> int:
    """Fetch the receipts of consent that are still due, for some seconds; return how many are not to be had.

    Theft is no time to wait: custodians that do not answer cost the receipts, not the visits.
    """
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
@click.option("--words-file", type=click.Path(path_type=Path, dir_okay=False), help="Write the words here, mode 0600.")
@click.option("--yes", is_flag=True, help="Do not ask.")
@_spread
@json_option
@click.pass_context
@plain_errors
def rotate(ctx: click.Context, words_file: Path | None, yes: bool, over_minutes: int, now: bool, as_json: bool) -> None:
    """Get new words after a theft: whoever has the old ones sees, decides and erases nothing any more.

    Your membership gets its new key at once, then each visit, one by one. Cut off anywhere, run it again: it goes on.

    Example: blockrobot wallet rotate
    """

    async def action(opened: Wallet) -> Transferred:
        rotating, content = Rotating(opened), opened.store.content
        if not content.next_words and not content.transfers_due:
            if words_file is None and not sys.stdin.isatty():
                raise click.UsageError("There is no terminal to show the words on: give --words-file.")
            await opened.scan()
            if opened.member_gone:
                raise BlockRobotError("MEMBER_NO_MORE")
            _ask_or_say("You get 24 new words, and the old ones decide of nothing any more. Go on?", yes=yes)
            rotating.prepare()
        if rotating.must_show:
            if words_file is None and not sys.stdin.isatty():
                raise click.UsageError("There is no terminal to show the words on: give --words-file.")
            _show_words(rotating.prepare(), words_file)
            rotating.confirm_shown()
        due_count = await _fetch_receipts(opened) if content.next_words else 0
        if await rotating.rotate() and due_count:
            click.echo(f"{counted(due_count, 'receipt')} of consent, still due, cannot be had any more.", err=True)
        return await _transfer(rotating, over_minutes, now=now, with_member=True, as_json=as_json)

    done = run_opened(ctx, action)
    if as_json:
        if done.refusal is not None:
            raise done.refusal
        print_json({"ok": True, "words_file": str(words_file) if words_file else None, **_transferred_json(done)})
        return
    _tell_transferred(done)
    console.print(
        "The new words are in force. Keep the old ones too: only together they restore this wallet with its old pictures\n"
        "(blockrobot wallet restore --former FILE). Where a robot was cut off, visits may come late under the old words:\n"
        "blockrobot wallet records says so."
    )


@click.command()
@_spread
@json_option
@click.pass_context
@plain_errors
def transfer(ctx: click.Context, over_minutes: int, now: bool, as_json: bool) -> None:
    """Give visits that came late, under former words, a key of the present ones.

    Example: blockrobot wallet transfer
    """

    async def action(opened: Wallet) -> Transferred:
        return await _transfer(Rotating(opened), over_minutes, now=now, with_member=False, as_json=as_json)

    done = run_opened(ctx, action)
    if as_json:
        if done.refusal is not None:
            raise done.refusal
        print_json({"ok": True, **_transferred_json(done)})
        return
    _tell_transferred(done)


_LEAVING = """\
If you leave:
  - No robot records you any more, from the next block on; all you consented to ends.
  - Your keys are taken out of the registry. Your handle stays there, marked as left; a new card makes you a new member.
  - What was recorded stays until it expires, and stays yours: this wallet shows and erases it as before.
    To have it erased first: blockrobot wallet erase --all
  - What a robot that was cut off brings later is not found by this wallet any more."""


@click.command()
@click.option("--yes", is_flag=True, help="Do not ask.")
@json_option
@click.pass_context
@plain_errors
def leave(ctx: click.Context, yes: bool, as_json: bool) -> None:
    """End your membership. Says what stays and what goes, and asks.

    Example: blockrobot wallet leave
    """
    if not as_json:
        console.print(_LEAVING)
    _ask_or_say("Leave?", yes=yes)
    height = run_opened(ctx, lambda opened: Rotating(opened).leave())
    if as_json:
        print_json({"ok": True, "height": height or None})
    elif height:
        console.print(f"You have left, as of block {height}. Your records: blockrobot wallet records")
    else:
        console.print("You had left already. Your records: blockrobot wallet records")


COMMANDS = (rotate, transfer, leave)
