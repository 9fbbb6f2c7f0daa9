"""`blockrobot wallet keyring`: passphrase in the system's keyring, opt-in, since any program of the session can then
open the wallet.
"""

from __future__ import annotations

from pathlib import Path

import click

from clients.sdk.terminal.terminal import command_output, console, print_answer
from clients.wallet.answers.wallet_answers import KeyringForgetAnswer, KeyringStoreAnswer
from clients.wallet.cli.wallet_context import read_passphrase
from clients.wallet.presentation.invocation import called
from clients.wallet.presentation.translations import text
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.system_keyring import forget_in_keyring, load_keyring, store_in_keyring
from clients.wallet.store.wallet_lock import require_wallet


@click.group()
def keyring() -> None:
    """Keep this wallet's passphrase in the system's keyring, or take it out again.

    Commands take it from there only with `blockrobot wallet --keyring COMMAND`, or if BLOCKROBOT_KEYRING is set.

    Example: blockrobot wallet keyring store
    """


@keyring.command()
@click.pass_context
@command_output
def store(ctx: click.Context, as_json: bool) -> None:
    """Ask for the passphrase, see that it opens the wallet, and keep it in the keyring.

    Example: blockrobot wallet keyring store
    """
    path: Path = ctx.obj[0]
    require_wallet(path)
    load_keyring()
    passphrase = read_passphrase()
    Keystore.open(path, passphrase)
    weak = store_in_keyring(path, passphrase)
    if as_json:
        print_answer(KeyringStoreAnswer(wallet=str(path), weak_keyring=weak))
        return
    console.print(text("keyring.stored", command=called()))
    if weak is not None:
        console.print(f"  [yellow]{text('keyring.protects_little', name=weak)}[/yellow]")


@keyring.command()
@click.pass_context
@command_output
def forget(ctx: click.Context, as_json: bool) -> None:
    """Take the passphrase out of the keyring.

    Example: blockrobot wallet keyring forget
    """
    path: Path = ctx.obj[0]
    forget_in_keyring(path)
    if as_json:
        print_answer(KeyringForgetAnswer(wallet=str(path)))
    else:
        console.print(text("keyring.forgotten"))
