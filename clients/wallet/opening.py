"""How every command opens a wallet: passphrase, genesis file, one run. Must never take a passphrase as an argument.

The passphrase is asked for at a terminal, or read from the file that BLOCKROBOT_PASSPHRASE_FILE names.
"""

from __future__ import annotations

import asyncio
import datetime
import os
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from clients.sdk.terminal import home_folder, load_genesis
from clients.wallet.claiming import claim_wallet
from clients.wallet.keystore import Keystore
from clients.wallet.wallet import Wallet
from consensus.genesis import Genesis

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

STOLEN_PAGE = "docs/how-to/when-your-wallet-is-stolen.md"
_PASSPHRASE_FILE = "BLOCKROBOT_PASSPHRASE_FILE"  # noqa: S105 - the name of a variable, not a passphrase


def wallet_options(command: F) -> F:
    """Add the options that name a wallet and its network, to a group."""
    place = click.Path(path_type=Path, file_okay=False)
    file = click.Path(path_type=Path, dir_okay=False)
    for option in (
        click.option("--genesis", type=file, help="The network's genesis file: all that is trusted."),
        click.option("--wallet-dir", type=place, help="The folder of wallets (default: your own)."),
        click.option("--profile", default="default", show_default=True, help="Which wallet, if there are several."),
    ):
        command = option(command)
    return command


def place_wallet(profile: str, wallet_dir: Path | None, genesis: Path | None) -> tuple[Path, Path]:
    """Return the files of a wallet and of its network's genesis, as a group's context holds them."""
    if not profile.replace("-", "").replace("_", "").isalnum():
        raise click.UsageError("A profile's name has letters, digits, - and _ only.")
    return (
        (wallet_dir or home_folder() / "wallets") / f"{profile}.wallet",
        genesis or home_folder() / "network" / "genesis.json",
    )


def read_passphrase(*, confirm: bool = False) -> str:
    """Return the passphrase from the file that is named for it, or ask at the terminal (twice, to `confirm`)."""
    path = os.environ.get(_PASSPHRASE_FILE)
    if path:
        return Path(path).read_text(encoding="utf-8").rstrip("\n")
    if not sys.stdin.isatty():
        raise click.UsageError(f"There is no terminal to ask for the passphrase: set {_PASSPHRASE_FILE}.")
    text: str = click.prompt("Passphrase", hide_input=True, confirmation_prompt=confirm)
    return text


def run_opened(ctx: click.Context, action: Callable[[Wallet], Awaitable[T]]) -> T:
    """Open the wallet that the group's options name and do something with it. Raises what that raises.

    Says on standard error, loudly, if the wallet's words turned out to make nobody a member any more.
    """
    path, genesis_path = ctx.obj
    genesis = load_genesis(genesis_path)
    passphrase = read_passphrase()
    with claim_wallet(path):
        return _run(Keystore.open(path, passphrase), genesis, action)


def run_made(store: Keystore, genesis_path: Path, action: Callable[[Wallet], Awaitable[T]]) -> T:
    """Do something with a wallet that was made just now. Raises what that raises, and GENESIS_INVALID."""
    return _run(store, load_genesis(genesis_path), action)


def _run(store: Keystore, genesis: Genesis, action: Callable[[Wallet], Awaitable[T]]) -> T:
    async def main() -> T:
        async with Wallet(store, genesis) as opened:
            try:
                return await action(opened)
            finally:
                tell_member_gone(opened)

    return asyncio.run(main())


def tell_member_gone(opened: Wallet) -> None:
    """Say, if so, that somebody else may be the member now, what this wallet still can do, and what to do next."""
    if not opened.member_gone:
        return
    if opened.store.content.next_words:
        next_step = "Your new words may be in force already: run `blockrobot wallet rotate` again"
    else:
        next_step = "If you did not change your words yourself, go to the registrar's desk at once"
    lost = len(opened.out_of_reach)
    click.secho(
        "WARNING: this wallet's words make nobody a member any more. Visits that it knew and that still obey it, it goes on"
        " to show and to erase; nothing new is found."
        + (f" {lost} of your visits obey it no more." if lost else "")
        + f" {next_step}. See {STOLEN_PAGE}.",
        fg="red",
        bold=True,
        err=True,
    )


def show_moment(time_ms: int) -> str:
    """Return a time for people, in their own time zone."""
    return datetime.datetime.fromtimestamp(time_ms / 1000).astimezone().strftime("%Y-%m-%d %H:%M:%S")
