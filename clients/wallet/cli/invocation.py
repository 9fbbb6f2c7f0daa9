"""How this very wallet is called, so that every next step that is told can be typed as it stands.

Texts and errors say `blockrobot wallet records`; whoever named a profile, a folder or the network's file for the command
that runs is shown these too. What somebody else is to type at a
wallet of their own is written without `blockrobot`: `wallet handle`.
"""

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
    """Return the context that holds the options of the wallet for which a command runs, None outside of any."""
    context = click.get_current_context(silent=True)
    while context is not None and "profile" not in context.params:
        context = context.parent
    return context


def genesis_place(named: Path | None) -> Path:
    """Return the file of the network that is trusted: the one that was named, else this user's own."""
    return named or home_folder() / "network" / "genesis.json"


def verify_command(file: Path | str) -> str:
    """Return what checks a file that this wallet wrote against the network that this wallet trusts."""
    context = _group()
    trusted = genesis_place(None if context is None else context.params.get("genesis")).absolute()
    return f"blockrobot verify {shlex.quote(str(file))} --genesis {shlex.quote(str(trusted))}"


def called(command: str = WALLET_COMMAND) -> str:
    """Return how the wallet of the command that runs was called: with its profile, folder and genesis file, if named."""
    context = _group()
    if context is None:
        return command
    profile = context.params["profile"]
    told = [command] if profile == DEFAULT_PROFILE else [f"{command} --profile {profile}"]
    for option, name in _PLACES.items():
        place = context.params.get(name)
        if place is not None:
            told.append(f"{option} {shlex.quote(str(place.absolute()))}")
    return " ".join(told)


def as_called(told: str, *, has_fields: bool = False) -> str:
    """Return a text in which every command of the wallet is called as this very wallet is. Twice is as good as once.

    Only for what a catalogue says: a path or a name that was put into a sentence could look like a command.
    `has_fields`: the text is one that `str.format` fills afterwards.
    """
    if WALLET_COMMAND not in told:
        return told
    command = called()
    if has_fields:
        command = command.replace("{", "{{").replace("}", "}}")
    # What is called so already is stepped over whole: the paths in it may have the command's words too.
    return re.sub(f"{re.escape(command)}|{_CALL}", lambda _: command, told)
