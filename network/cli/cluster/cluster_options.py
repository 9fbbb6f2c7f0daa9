"""Which network a command means: the option, and how it is told in a next step."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from clients.sdk.terminal.terminal import home_folder


def network_folder(folder: Path | None) -> Path:
    """Return the folder that a command means: the one given, or the user's own network."""
    return folder or home_folder() / "network"


def dir_words(place: Path) -> str:
    """Return what a command that is told as a next step needs to mean the network in `place`, a blank before it."""
    return "" if place.absolute() == network_folder(None).absolute() else f" --dir {shlex.quote(str(place.absolute()))}"


folder_option = click.option(
    "--dir", "folder", type=click.Path(path_type=Path, file_okay=False), help="The network's folder."
)
