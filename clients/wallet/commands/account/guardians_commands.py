"""`blockrobot wallet guardians list|split`: handing out shares of the wallet's mnemonic."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

import click

from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import (
    FOLDER,
    ask_for_enter,
    command_output,
    console,
    is_at_terminal,
    json_option,
    print_answer,
)
from clients.wallet.answers.guardian_answers import GuardiansAnswer, GuardianShares, GuardiansSplitAnswer
from clients.wallet.cli.mnemonic_handover import show_and_check, show_and_wipe
from clients.wallet.cli.wallet_context import confirm_or_print, read_passphrase
from clients.wallet.commands.account.guardians_recover_commands import check, recover
from clients.wallet.presentation.guardian_lines import guardian_lines
from clients.wallet.presentation.guardian_sheets import require_no_sheets, write_sheets
from clients.wallet.presentation.invocation import with_command_prefix
from clients.wallet.presentation.translations import WrongUsage, text
from clients.wallet.recovery.slip39_shares import (
    GUARDIANS_MAX_COUNT,
    GUARDIANS_MIN_COUNT,
    SHARE_WORDS_COUNT,
    THRESHOLD_MIN_COUNT,
    read_share,
    show_identifier,
    split_mnemonic,
)
from clients.wallet.store.keystore import GuardianSet, Keystore, WalletContent
from clients.wallet.store.wallet_lock import claim_wallet, lock_or_read_only, require_wallet
from consensus.errors import BlockRobotError
from pages.time_format import format_time

NAME_MAX_CHARS = 40


def _read(ctx: click.Context) -> WalletContent:
    path: Path = ctx.obj[0]
    require_wallet(path)
    passphrase = read_passphrase()
    with lock_or_read_only(path, name_command=with_command_prefix):
        return Keystore.open(path, passphrase).content


@contextlib.contextmanager
def _opened(ctx: click.Context) -> Iterator[Keystore]:
    """Open the wallet offline and without the keyring."""
    path: Path = ctx.obj[0]
    require_wallet(path)
    passphrase = read_passphrase(from_keyring=False)
    with claim_wallet(path, name_command=with_command_prefix):
        yield Keystore.open(path, passphrase)


def _shares_answer(one: GuardianSet, present_era: int) -> GuardianShares:
    return GuardianShares(
        identifier=one.identifier,
        made_at_ms=one.made_at_ms,
        threshold=one.threshold,
        guardians=one.guardians,
        handed_over=one.handed_count,
        words_in_force=one.era == present_era,
    )


@click.group(invoke_without_command=True)
@json_option
@click.pass_context
def guardians(ctx: click.Context, as_json: bool) -> None:
    """Let people you trust bring your wallet back together if you lose it. Without a command: who they are.

    Example: blockrobot wallet guardians split --guardian Ann --guardian Ben --guardian Cleo
    """
    if ctx.invoked_subcommand is None:
        ctx.invoke(list_, as_json=as_json)
    elif as_json:
        raise WrongUsage("json_behind")


@guardians.command("list")
@click.pass_context
@command_output
def list_(ctx: click.Context, as_json: bool) -> None:
    """Show who holds words of this wallet, how many of them are needed, and which sets still work.

    Example: blockrobot wallet guardians list
    """
    content = _read(ctx)
    era = len(content.former)
    if as_json:
        print_answer(GuardiansAnswer(sets=[_shares_answer(one, era) for one in content.guardian_sets]))
        return
    for sentence, at_ms in guardian_lines(content):
        console.print(escape(sentence if at_ms is None else f"{format_time(at_ms)}  {sentence}"))


def _require_sensible(names: tuple[str, ...], threshold: int | None) -> int:
    if not GUARDIANS_MIN_COUNT <= len(names) <= GUARDIANS_MAX_COUNT:
        raise WrongUsage("guardians_count", least=GUARDIANS_MIN_COUNT, most=GUARDIANS_MAX_COUNT)
    _require_names(names)
    needed = len(names) // 2 + 1 if threshold is None else threshold
    if needed < THRESHOLD_MIN_COUNT:
        raise WrongUsage("guardians_one")
    if needed > len(names):
        raise WrongUsage("guardians_needed", needed=needed, count=len(names))
    return needed


def _choose_words(content: WalletContent, former: int | None) -> tuple[str, int]:
    """Mnemonic to split and its index. Raises UsageError, WALLET_ROTATION_OPEN."""
    if former is not None:
        if former > len(content.former):
            raise WrongUsage("former_words", count=len(content.former), given=former)
        return content.former[former - 1], former - 1
    if content.next_words:
        raise BlockRobotError("WALLET_ROTATION_OPEN")
    return content.words, len(content.former)


def _print_before(content: WalletContent, one: GuardianSet) -> None:
    count = len(one.guardians)
    console.print(text("guardians.means", threshold=one.threshold, count=count))
    if one.threshold == count:
        console.print(text("guardians.all_needed", count=count))
    if content.former and one.era == len(content.former):
        console.print(text("guardians.former_left"))


@guardians.command()
@click.option("--guardian", "names", multiple=True, metavar="NAME", help="Who is to hold a share; two to sixteen.")
@click.option("--threshold", type=int, help="How many of them are needed (default: more than half).")
@click.option(
    "--out",
    type=FOLDER,
    help="Write a sheet for each guardian into this folder, mode 0600, instead of showing the words.",
)
@click.option("--former", type=click.IntRange(1), help="Split words that were replaced instead; 1 are the oldest.")
@click.option("--check/--no-check", "checked", default=True, help="Ask for some of the words back.")
@click.option("--yes", is_flag=True, help="Do not ask whether there is to be one more set.")
@click.pass_context
@command_output
def split(
    ctx: click.Context,
    names: tuple[str, ...],
    threshold: int | None,
    out: Path | None,
    former: int | None,
    checked: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Give each guardian words of their own; so many of them together bring this wallet back, fewer learn nothing.

    At a terminal it shows them one guardian at a time, wipes the screen and asks for some back; with --out it writes
    sheets to print, into a folder without other sheets. What was handed out cannot be taken back, only be made worthless
    by `wallet rotate`.

    Example: blockrobot wallet guardians split --guardian Ann --guardian Ben --guardian Cleo --threshold 2
    """
    needed = _require_sensible(names, threshold)
    if out is None and (as_json or not is_at_terminal()):
        raise WrongUsage("no_terminal_show_folder")
    if out is not None:
        require_no_sheets(out)
    with _opened(ctx) as store:
        content = store.content
        words, era = _choose_words(content, former)
        shares = split_mnemonic(words, needed, len(names))
        identifier = read_share(shares[0]).identifier
        one = GuardianSet(time.time_ns() // 1_000_000, needed, list(names), identifier, era)
        if not as_json:
            _print_before(content, one)
        earlier = sum(known.era == era for known in content.guardian_sets)
        if earlier:
            click.echo(text("guardians.again", count=earlier), err=True)
            confirm_or_print(text("guardians.ask_again"), yes=yes, as_json=as_json)
        content.guardian_sets.append(one)
        sheets = _write(store, one, shares, out) if out else _show(store, one, shares, checked=checked)
    if as_json:
        made = _shares_answer(one, len(content.former))
        print_answer(extend(GuardiansSplitAnswer, made, sheets=[str(path) for path in sheets]))
    elif out:
        console.print(text("guardians.sheets", count=len(sheets), folder=escape(str(out)), threshold=needed))
    else:
        console.print(text("guardians.done", count=len(names), threshold=needed))


def _write(store: Keystore, one: GuardianSet, shares: list[str], out: Path) -> list[Path]:
    """Write sheets, then note each owner; after a crash the set may be incomplete."""
    store.save()
    try:
        sheets = write_sheets(out, one, shares)
    except BaseException:
        store.content.guardian_sets.remove(one)
        store.save()
        raise
    one.handed_count = len(sheets)
    store.save()
    return sheets


def _show(store: Keystore, one: GuardianSet, shares: list[str], *, checked: bool) -> list[Path]:
    """One guardian at a time, each noted beforehand."""
    count, identifier = len(shares), show_identifier(one.identifier)
    was_shown = False
    try:
        for number, (name, share) in enumerate(zip(one.guardians, shares, strict=True), 1):
            ask_for_enter(text("guardians.turn", name=name, number=number, count=count))
            store.save()
            was_shown = True
            instructions = text(
                "guardians.words", name=name, words=SHARE_WORDS_COUNT, identifier=identifier, number=number
            )
            if checked:
                show_and_check(instructions, share, texts_of="guardians")
            else:
                show_and_wipe(instructions, share)
            one.handed_count = number
            store.save()
    except BaseException:
        if was_shown:
            click.echo(text("guardians.stopped", handed=one.handed_count, count=count), err=True)
        raise
    return []


guardians.add_command(recover)
guardians.add_command(check)


def _require_names(names: tuple[str, ...]) -> None:
    """Raise WrongUsage if unprintable or indistinguishable."""
    for name in names:
        if not name.strip() or len(name) > NAME_MAX_CHARS or not name.isprintable():
            raise WrongUsage("guardian_name", count=NAME_MAX_CHARS)
    folded = [" ".join(name.split()).casefold() for name in names]
    double = next((name for place, name in enumerate(names) if folded[place] in folded[:place]), None)
    if double is not None:
        raise WrongUsage("guardian_double", name=double)
