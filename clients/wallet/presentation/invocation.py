"""How this wallet is called, so that suggested commands keep its profile, folder and network options."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click

from clients.sdk.terminal.terminal import home_folder

WALLET_COMMAND = "blockrobot wallet"
OFFICER_COMMAND = "blockrobot officer"
"""How texts name the wallet. One that is followed by an option says itself which wallet it means."""
DEFAULT_PROFILE = "default"
# A folder's or a file's name that has these words in it is no command.
_CALL = rf"(?<![\w./\\-]){WALLET_COMMAND}(?! --)(?=[.,;:!?)\]`]*(?:\s|$))"
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
    words = [command] if profile == DEFAULT_PROFILE else [f"{command} --profile {profile}"]
    for option, name in _PLACES.items():
        place = context.params.get(name)
        if place is not None:
            words.append(f"{option} {shlex.quote(str(place.absolute()))}")
    return " ".join(words)


def with_command_prefix(words: str, *, has_fields: bool = False) -> str:
    """Expand wallet commands in a catalogue text; idempotent. Not for texts with filled-in names. `has_fields`:
    `str.format` follows.
    """
    if WALLET_COMMAND not in words:
        return words
    command = called()
    if has_fields:
        command = command.replace("{", "{{").replace("}", "}}")
    # What is called so already is stepped over whole: the paths in it may have the command's words too.
    return re.sub(f"{re.escape(command)}|{_CALL}", lambda _: command, words)
