"""`blockrobot wallet new|restore`: a wallet and its words. Must never take words as an argument, nor show them twice."""

from __future__ import annotations

import contextlib
import secrets
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import click
from nacl import pwhash

from clients.sdk.terminal import EXIT_FAILED, ask_for, console, is_at_terminal, json_option, plain_errors, print_json
from clients.wallet.claiming import claim_place
from clients.wallet.keys import derive_keys, draw_words
from clients.wallet.keystore import Keystore, PassphraseCost
from clients.wallet.language import text
from clients.wallet.opening import read_new_passphrase
from clients.wallet.restoring import read_words, require_distinct, restore_wallet
from clients.wallet.rotating_commands import CHECK_TRIES_MAX_COUNT, write_words
from consensus.errors import BlockRobotError

CHECKED_COUNT = 3


@contextlib.contextmanager
def _place(ctx: click.Context, path: Path, words_file: Path | None = None) -> Iterator[None]:
    """Hold the place of a wallet that is made inside. A Ctrl-C ends the command with a word on what it left behind.

    `words_file` is one that is written inside: without the wallet it goes again, since its words are nobody's.
    """
    was_there = words_file is not None and words_file.exists()
    with claim_place(path):
        try:
            yield
        except (click.Abort, KeyboardInterrupt):
            if not path.exists():
                told = text("new.stopped")
            elif words_file is not None:
                told = text("new.stopped_words", path=path, words_file=words_file)
            else:
                told = text("new.stopped_made", path=path)
            click.echo("\n" + told, err=True)
            ctx.exit(EXIT_FAILED)
        finally:
            if words_file is not None and not was_there and not path.exists():
                words_file.unlink(missing_ok=True)


def guess_cost(fast: bool) -> PassphraseCost | None:
    """Return what a guess of the passphrase is to cost: the usual (None), or as little as possible for tests."""
    return PassphraseCost(pwhash.argon2id.OPSLIMIT_MIN, pwhash.argon2id.MEMLIMIT_MIN) if fast else None


def word_lines(words: str, width: int) -> list[str]:
    """Return the words with their numbers, in as many columns as a terminal of that width has room for."""
    columns = 4 if width >= 56 else 2 if width >= 28 else 1
    told = [f"{number:>2} {word:<9}" for number, word in enumerate(words.split(), 1)]
    return ["  ".join(told[start : start + columns]).rstrip() for start in range(0, len(told), columns)]


def check_back(
    words: str, count: int = CHECKED_COUNT, *, said: str = "new", show_again: Callable[[], None] | None = None
) -> None:
    """Ask for some of the words, drawn by chance, until each is right or so many were wrong.

    `said` is where the catalogue has what it is about. `show_again` is what a ? does, if it may do anything. Raises
    WORDS_NOT_CHECKED, and Abort at the first Ctrl-C.
    """
    console.print("\n" + text(f"{said}.check"))
    wanted = sorted(secrets.SystemRandom().sample(range(len(words.split())), count))
    left = CHECK_TRIES_MAX_COUNT
    for place in wanted:
        question = text("new.check_word", number=place + 1)
        while (answer := ask_for(question).strip().lower()) != words.split()[place]:
            if answer == "?" and show_again is not None:
                show_again()
                continue
            left -= 1
            if not left:
                console.print(text(f"{said}.check_failed"))
                raise BlockRobotError("WORDS_NOT_CHECKED")
            console.print(text("new.check_wrong", number=place + 1, count=left))


def hand_over(words: str, words_file: Path | None, *, check: bool) -> None:
    """Let the 24 words be written down: in a file, or from the terminal. Raises what `check_back` raises."""
    if words_file is not None:
        write_words(words_file, words)
        return
    console.print(text("new.words") + "\n")
    for line in word_lines(words, console.width):
        console.print(line, style="bold")
    if check:
        check_back(words)


@click.command()
@click.option("--words-file", type=click.Path(path_type=Path, dir_okay=False), help="Write the words here, mode 0600.")
@click.option("--check/--no-check", default=True, help="Ask for some of the words, once they are written down.")
@click.option("--fast-passphrase", is_flag=True, help="A cheaper passphrase check, for tests and demonstrations.")
@json_option
@click.pass_context
@plain_errors
def new(ctx: click.Context, words_file: Path | None, check: bool, fast_passphrase: bool, as_json: bool) -> None:
    """Make a new wallet and show its 24 words once. Write them down: they are the wallet.

    It asks for some of them before the wallet is made, to see that they were written down right. Words that go to a
    file are not asked for.

    Example: blockrobot wallet new
    """
    path, _ = ctx.obj
    if words_file is None and not is_at_terminal():
        raise click.UsageError("There is no terminal to show the words on: give --words-file.")
    if words_file is None and as_json:
        raise click.UsageError("With --json the words go to a file: give --words-file.")
    words = draw_words()
    with _place(ctx, path, words_file):
        if not as_json:
            click.echo(text("new.lost"), err=True)
        passphrase = read_new_passphrase()
        hand_over(words, words_file, check=check)
        Keystore.create(path, words, passphrase, guess_cost(fast_passphrase))
    member = derive_keys(words).identity.public_key.hex()
    if as_json:
        print_json({"ok": True, "wallet": str(path), "member": member})
        return
    if words_file is not None:
        console.print(text("new.words_file", path=words_file))
    console.print("\n" + text("new.done", path=path))


@click.command()
@click.option("--words-file", type=click.Path(path_type=Path, exists=True, dir_okay=False), help="Read the words here.")
@click.option(
    "--former",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    multiple=True,
    help="Words that were replaced, in a file; oldest first if there are several.",
)
@click.option("--fast-passphrase", is_flag=True, help="A cheaper passphrase check, for tests and demonstrations.")
@json_option
@click.pass_context
@plain_errors
def restore(
    ctx: click.Context, words_file: Path | None, former: tuple[Path, ...], fast_passphrase: bool, as_json: bool
) -> None:
    """Make the wallet again from its 24 words. Your visits are found again on the chain.

    If you ever changed them (wallet rotate), former words are needed to open what was recorded before.

    Example: blockrobot wallet restore --words-file words.txt
    """
    path, genesis_path = ctx.obj
    if words_file is None and not sys.stdin.isatty():
        raise click.UsageError("There is no terminal to ask for the words: give --words-file.")
    with _place(ctx, path):
        if words_file:
            words = words_file.read_text(encoding="utf-8")
        else:
            words = click.prompt(text("restore.words"), hide_input=True)
        keys = derive_keys(words)
        replaced = [read_words(file.read_text(encoding="utf-8")) for file in former]
        require_distinct(read_words(words), replaced)
        passphrase = read_new_passphrase()
        known = restore_wallet(path, read_words(words), replaced, passphrase, guess_cost(fast_passphrase), genesis_path)
    if as_json:
        member = keys.identity.public_key.hex()
        print_json({"ok": True, "wallet": str(path), "member": member, "words_checked": known})
        return
    console.print(text("restore.done", path=path))
    if not former:
        console.print(text("restore.former"))
    elif not known:
        console.print(text("restore.unchecked"))


COMMANDS = (new, restore)
