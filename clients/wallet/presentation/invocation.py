"""How this wallet is called, so that suggested commands keep its profile, folder and network options."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from clients.sdk.terminal.own_command import called_with, name_in_full
from clients.sdk.terminal.terminal import home_folder

WALLET_COMMAND = "blockrobot wallet"
OFFICER_COMMAND = "blockrobot officer"
"""How texts name the wallet."""
DEFAULT_PROFILE = "default"
_PLACES = {"--wallet-dir": "wallet_dir", "--genesis": "genesis"}


def _group() -> click.Context | None:
    context = click.get_current_context(silent=True)
    while context is not None and "profile" not in context.params:
        context = context.parent
    return context


def genesis_place(named: Path | None) -> Path:
    """The user's default if none is named."""
    return named or home_folder() / "network" / "genesis.json"


def verify_command(file: Path | str) -> str:
    context = _group()
    trusted = genesis_place(None if context is None else context.params.get("genesis")).absolute()
    return f"blockrobot verify {shlex.quote(str(file))} --genesis {shlex.quote(str(trusted))}"


def called(command: str = WALLET_COMMAND) -> str:
    """With profile, folder and genesis options, if given."""
    context = _group()
    if context is None:
        return command
    profile = context.params["profile"]
    places = [(option, context.params.get(name)) for option, name in _PLACES.items()]
    return called_with(command, [("--profile", None if profile == DEFAULT_PROFILE else profile), *places])


def with_command_prefix(words: str, *, has_fields: bool = False) -> str:
    """Expand wallet commands in a catalogue text; idempotent. Not for texts with filled-in names. `has_fields`:
    `str.format` follows.
    """
    if WALLET_COMMAND not in words:
        return words
    command = called()
    if has_fields:
        command = command.replace("{", "{{").replace("}", "}}")
    return name_in_full(words, WALLET_COMMAND, command)
