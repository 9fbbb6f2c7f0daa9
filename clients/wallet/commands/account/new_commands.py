"""`blockrobot wallet new|restore`: a wallet and its mnemonic."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import click
from nacl import pwhash

from clients.sdk.new_files import read_given_text
from clients.sdk.passphrase import PassphraseCost
from clients.sdk.terminal.terminal import (
    EXISTING_FILE,
    FILE,
    can_ask,
    command_output,
    console,
    is_at_terminal,
    print_answer,
)
from clients.wallet.answers.wallet_answers import NewWalletAnswer, RestoreAnswer
from clients.wallet.cli.mnemonic_handover import print_words, show_and_check, write_words
from clients.wallet.cli.wallet_context import on_abort, read_new_passphrase
from clients.wallet.commands.account.wallet_restore import read_words, require_distinct, restore_wallet
from clients.wallet.presentation.invocation import with_command_prefix
from clients.wallet.presentation.translations import WrongUsage, error_text, text
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import derive_keys, draw_words
from clients.wallet.store.wallet_lock import claim_place
from consensus.errors import BlockRobotError

WORDS_TRIES_MAX_COUNT = 5


@contextlib.contextmanager
def _place(ctx: click.Context, path: Path, words_file: Path | None = None) -> Iterator[None]:
    """Reserve the new wallet's place; on failure `words_file` is removed."""
    was_there = words_file is not None and words_file.exists()

    def say() -> str:
        if not path.exists():
            return text("new.stopped")
        if words_file is not None:
            return text("new.stopped_words", path=path, words_file=words_file)
        return text("new.stopped_made", path=path)

    with claim_place(path, name_command=with_command_prefix):
        try:
            with on_abort(ctx, say):
                yield
        finally:
            if words_file is not None and not was_there and not path.exists():
                words_file.unlink(missing_ok=True)


def guess_cost(fast: bool) -> PassphraseCost | None:
    """Default (None), or minimal for tests."""
    return PassphraseCost(pwhash.argon2id.OPSLIMIT_MIN, pwhash.argon2id.MEMLIMIT_MIN) if fast else None


def _hand_over(words: str, words_file: Path | None, *, check: bool) -> None:
    if words_file is not None:
        write_words(words_file, words)
    elif check:
        show_and_check(text("new.words"), words)
    else:
        print_words(text("new.words"), words)


@click.command()
@click.option("--words-file", type=FILE, help="Write the words here, mode 0600.")
@click.option("--check/--no-check", default=True, help="Ask for some of the words, once they are written down.")
@click.option("--fast-passphrase", is_flag=True, help="A cheaper passphrase check, for tests and demonstrations.")
@click.pass_context
@command_output
def new(ctx: click.Context, words_file: Path | None, check: bool, fast_passphrase: bool, as_json: bool) -> None:
    """Make a new wallet and show its 24 words, this once. Write them down: they are the wallet.

    It wipes the screen and asks for some of them before the wallet is made, to see that they were written down right.
    Words that go to a file are not asked for, and with --no-check they stay on the screen.

    Example: blockrobot wallet new
    """
    path, _ = ctx.obj
    if words_file is None and not is_at_terminal():
        raise WrongUsage("no_terminal_show")
    if words_file is None and as_json:
        raise WrongUsage("json_words")
    words = draw_words()
    with _place(ctx, path, words_file):
        if not as_json:
            click.echo(text("new.lost"), err=True)
        passphrase = read_new_passphrase()
        _hand_over(words, words_file, check=check)
        Keystore.create(path, words, passphrase, guess_cost(fast_passphrase))
    member = derive_keys(words).identity.public_key.hex()
    if as_json:
        print_answer(NewWalletAnswer(wallet=str(path), member=member))
        return
    if words_file is not None:
        console.print(text("new.words_file", path=words_file))
    console.print("\n" + text("new.done", path=path))


@click.command()
@click.option("--words-file", type=EXISTING_FILE, help="Read the words here.")
@click.option(
    "--former",
    type=EXISTING_FILE,
    multiple=True,
    help="Words that were replaced, in a file; oldest first if there are several.",
)
@click.option("--fast-passphrase", is_flag=True, help="A cheaper passphrase check, for tests and demonstrations.")
@click.pass_context
@command_output
def restore(
    ctx: click.Context, words_file: Path | None, former: tuple[Path, ...], fast_passphrase: bool, as_json: bool
) -> None:
    """Make the wallet again from its 24 words. Your visits are found again on the chain.

    If you ever changed them (wallet rotate), former words are needed to open what was recorded before.

    Example: blockrobot wallet restore --words-file words.txt
    """
    path, genesis_path = ctx.obj
    if words_file is None and not can_ask():
        raise WrongUsage("no_terminal_words")
    with _place(ctx, path):
        words = read_given_text(words_file) if words_file else _ask_for_words()
        keys = derive_keys(words)
        replaced = [read_words(read_given_text(file)) for file in former]
        require_distinct(read_words(words), replaced)
        passphrase = read_new_passphrase()
        known = restore_wallet(path, read_words(words), replaced, passphrase, guess_cost(fast_passphrase), genesis_path)
    if as_json:
        member = keys.identity.public_key.hex()
        print_answer(RestoreAnswer(wallet=str(path), member=member, words_checked=known))
        return
    console.print(text("restore.done", path=path))
    if not former:
        console.print(text("restore.former"))
    elif not known:
        console.print(text("restore.unchecked"))


def _ask_for_words() -> str:
    """Raises WORDS_INVALID."""
    for left in reversed(range(WORDS_TRIES_MAX_COUNT)):
        words: str = click.prompt(text("restore.words"), hide_input=True)
        try:
            return read_words(words)
        except BlockRobotError as error:
            if not left:
                raise
            console.print(error_text(error), markup=False)
    raise AssertionError("the last try returns or raises")


COMMANDS = (new, restore)
