"""`blockrobot card` and `roster`: the registrar's desk on the command line. Must never take a UID as an argument."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path
from typing import Any

import click

from clients.registrar.desk import Desk
from clients.sdk.terminal import console, home_folder, json_option, load_genesis, plain_errors, print_json
from consensus.records.vouchers import ROLES


def _desk_options(command: Any) -> Any:
    for option in (
        click.option(
            "--desk", type=click.Path(path_type=Path, file_okay=False), help="The organisation's folder with its key."
        ),
        click.option("--genesis", type=click.Path(path_type=Path, dir_okay=False), help="The network's genesis file."),
    ):
        command = option(command)
    return command


def _open(desk: Path | None, genesis: Path | None) -> Desk:
    place = home_folder() / "network"
    opened = load_genesis(genesis or place / "genesis.json")
    return Desk(desk or place / "organisations" / opened.organisations[0].name, opened)


@click.group()
def card() -> None:
    """Issue enrolment cards (registrars).

    Example: blockrobot card issue --role subject
    """


@card.command()
@_desk_options
@click.option("--role", type=click.Choice(ROLES), default="subject", show_default=True)
@click.option(
    "--uid-file",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="A file with the tag's UID (asked for at a terminal otherwise).",
)
@json_option
@plain_errors
def issue(desk: Path | None, genesis: Path | None, role: str, uid_file: Path | None, as_json: bool) -> None:
    """Issue a card for a tag and print its enrolment code once.

    Example: blockrobot card issue --role subject --uid-file tag.uid
    """
    if uid_file:
        uid = uid_file.read_text(encoding="utf-8")
    elif sys.stdin.isatty():
        uid = click.prompt("Hold the tag to the reader (or type its UID)", hide_input=True)
    else:
        raise click.UsageError("There is no terminal to ask for the tag: give --uid-file.")
    code = _open(desk, genesis).issue(uid, role)
    if as_json:
        print_json({"ok": True, "role": role, "code": code})
    else:
        console.print(f"Hand this code over with the card; it registers one {role}, once:\n\n{code}")


@click.group()
def roster() -> None:
    """Make robots' rosters (registrars).

    Example: blockrobot roster make --robot 02ab... --out roster.sealed
    """


@roster.command()
@_desk_options
@click.option("--robot", required=True, help="The robot's member key, in hexadecimal.")
@click.option("--out", required=True, type=click.Path(path_type=Path, dir_okay=False), help="Where to write it.")
@json_option
@plain_errors
def make(desk: Path | None, genesis: Path | None, robot: str, out: Path, as_json: bool) -> None:
    """Seal today's roster to one robot. It is good for a day.

    Example: blockrobot roster make --robot 02ab... --out roster.sealed
    """
    try:
        member = bytes.fromhex(robot)
    except ValueError:
        raise click.UsageError("--robot takes hexadecimal digits.") from None
    sealed, rows = asyncio.run(_open(desk, genesis).make_roster(member))
    out.write_bytes(sealed)
    if as_json:
        print_json({"ok": True, "rows": rows, "out": str(out)})
    else:
        people = "1 person" if rows == 1 else f"{rows} people"
        console.print(f"{people}; only this robot can open {out}.")
