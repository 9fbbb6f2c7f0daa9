"""`blockrobot wallet new|restore`: a wallet and its words. Must never take words as an argument, nor show them twice."""

from __future__ import annotations

import sys
from pathlib import Path

import click
from nacl import pwhash

from clients.sdk.terminal import console, json_option, plain_errors, print_json
from clients.wallet.keys import derive_keys, draw_words
from clients.wallet.keystore import Keystore, PassphraseCost
from clients.wallet.opening import read_passphrase
from clients.wallet.restoring import read_words, require_distinct, restore_wallet
from clients.wallet.rotating_commands import write_words


def _cost(fast: bool) -> PassphraseCost | None:
    return PassphraseCost(pwhash.argon2id.OPSLIMIT_MIN, pwhash.argon2id.MEMLIMIT_MIN) if fast else None


@click.command()
@click.option("--words-file", type=click.Path(path_type=Path, dir_okay=False), help="Write the words here, mode 0600.")
@click.option("--fast-passphrase", is_flag=True, help="A cheaper passphrase check, for tests and demonstrations.")
@json_option
@click.pass_context
@plain_errors
def new(ctx: click.Context, words_file: Path | None, fast_passphrase: bool, as_json: bool) -> None:
    """Make a new wallet and show its 24 words once. Write them down: they are the wallet.

    Example: blockrobot wallet new
    """
    path, _ = ctx.obj
    if words_file is None and not sys.stdin.isatty():
        raise click.UsageError("There is no terminal to show the words on: give --words-file.")
    words = draw_words()
    passphrase = read_passphrase(confirm=True)
    Keystore.create(path, words, passphrase, _cost(fast_passphrase))
    if words_file:
        write_words(words_file, words)
    else:
        console.print("Your 24 words. Write them down now; they are shown this once:\n")
        console.print(words, style="bold")
    member = derive_keys(words).identity.public_key.hex()
    if as_json:
        print_json({"ok": True, "wallet": str(path), "member": member})
    else:
        console.print(f"\nYour wallet is {path}. Next: blockrobot wallet register CODE (the code on your card).")


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
    if words_file:
        words = words_file.read_text(encoding="utf-8")
    elif sys.stdin.isatty():
        words = click.prompt("The 24 words", hide_input=True)
    else:
        raise click.UsageError("There is no terminal to ask for the words: give --words-file.")
    keys = derive_keys(words)
    replaced = [read_words(file.read_text(encoding="utf-8")) for file in former]
    require_distinct(read_words(words), replaced)
    passphrase = read_passphrase(confirm=True)
    known = restore_wallet(path, read_words(words), replaced, passphrase, _cost(fast_passphrase), genesis_path)
    if as_json:
        member = keys.identity.public_key.hex()
        print_json({"ok": True, "wallet": str(path), "member": member, "words_checked": known})
        return
    console.print(f"Your wallet is {path} again. Next: blockrobot wallet records.")
    if not former:
        console.print(
            "If you ever changed your words (wallet rotate), the old pictures need the former ones: --former."
        )
    elif not known:
        console.print(
            "Which of these words are in force the network could not be asked. If it is the others: swap them."
        )


COMMANDS = (new, restore)
