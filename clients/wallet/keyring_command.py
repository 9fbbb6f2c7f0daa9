"""`blockrobot wallet keyring`: a passphrase in the system's keyring, for who wants that. Must never be used unasked.

Whoever can use the person's session on this machine can then open the wallet: that is why nothing goes there by itself.
"""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import click

from clients.sdk.terminal import console, json_option, plain_errors, print_json
from clients.wallet.calling import called
from clients.wallet.claiming import require_wallet
from clients.wallet.keystore import Keystore
from clients.wallet.language import text
from clients.wallet.opening import read_passphrase
from clients.wallet.passphrase_sources import SERVICE, load_keyring
from consensus.errors import BlockRobotError


def _errors() -> Any:
    return importlib.import_module("keyring.errors").KeyringError


@click.group()
def keyring() -> None:
    """Keep this wallet's passphrase in the system's keyring, or take it out again.

    Commands take it from there only with `blockrobot wallet --keyring COMMAND`, or if BLOCKROBOT_KEYRING is set.

    Example: blockrobot wallet keyring store
    """


@keyring.command()
@json_option
@click.pass_context
@plain_errors
def store(ctx: click.Context, as_json: bool) -> None:
    """Ask for the passphrase, see that it opens the wallet, and keep it in the keyring.

    Example: blockrobot wallet keyring store
    """
    path: Path = ctx.obj[0]
    require_wallet(path)
    backend = load_keyring()
    passphrase = read_passphrase()
    Keystore.open(path, passphrase)
    try:
        backend.set_password(SERVICE, str(path.resolve()), passphrase)
    except _errors() as error:
        raise BlockRobotError("KEYRING_UNUSABLE", f"The keyring took nothing: {type(error).__name__}.") from None
    if as_json:
        print_json({"ok": True, "wallet": str(path)})
    else:
        console.print(text("keyring.stored", command=called()))


@keyring.command()
@json_option
@click.pass_context
@plain_errors
def forget(ctx: click.Context, as_json: bool) -> None:
    """Take the passphrase out of the keyring.

    Example: blockrobot wallet keyring forget
    """
    path: Path = ctx.obj[0]
    backend = load_keyring()
    name = str(path.resolve())
    try:
        if backend.get_password(SERVICE, name) is None:
            raise BlockRobotError("KEYRING_EMPTY")
        backend.delete_password(SERVICE, name)
    except _errors() as error:
        raise BlockRobotError("KEYRING_UNUSABLE", f"The keyring may still have it: {type(error).__name__}.") from None
    if as_json:
        print_json({"ok": True, "wallet": str(path)})
    else:
        console.print(text("keyring.forgotten"))
