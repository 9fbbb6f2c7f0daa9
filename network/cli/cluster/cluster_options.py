"""The network option of commands, its text in next steps, and options that belong together."""

from __future__ import annotations

import functools
import inspect
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from clients.sdk.terminal.terminal import FOLDER, home_folder


def genesis_steps(network: Path, data_dir: Path) -> list[str]:
    """How commands on a member's host come to know its network, if they do not yet."""
    if (network / "genesis.json").is_file():
        return []
    source, target = (shlex.quote(str(place / "genesis.json")) for place in (data_dir, network))
    return [f"mkdir -p {shlex.quote(str(network))} && cp {source} {target}"]


def network_folder(folder: Path | None) -> Path:
    return folder or home_folder() / "network"


def dir_words(place: Path) -> str:
    """The option, leading blank included, in a suggested command."""
    return "" if place.absolute() == network_folder(None).absolute() else f" --dir {shlex.quote(str(place.absolute()))}"


folder_option = click.option("--dir", "folder", type=FOLDER, help="The network's folder.")


def as_one(name: str, make: Callable[..., Any], *options: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Add options, and pass `make(**their_values)` as one argument."""
    taken = tuple(inspect.signature(make).parameters)

    def decorate(command: Any) -> Any:
        @functools.wraps(command)
        def wrapped(*args: Any, **values: Any) -> Any:
            made = make(**{each: values.pop(each) for each in taken})
            return command(*args, **values, **{name: made})

        for option in reversed(options):
            option(wrapped)
        return wrapped

    return decorate
