"""The network option of commands, and its text in next steps."""

from __future__ import annotations

import shlex
from pathlib import Path

import click

from clients.sdk.terminal.terminal import home_folder


def network_folder(folder: Path | None) -> Path:
    return folder or home_folder() / "network"


def dir_words(place: Path) -> str:
    """Return the option (leading blank included) that selects `place` in a suggested command."""
    return "" if place.absolute() == network_folder(None).absolute() else f" --dir {shlex.quote(str(place.absolute()))}"


folder_option = click.option(
    "--dir", "folder", type=click.Path(path_type=Path, file_okay=False), help="The network's folder."
)
