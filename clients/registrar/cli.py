"""`blockrobot card` and `roster`: the registrar's commands."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import click

from clients.registrar.card_sheet import SUFFIXES, describe_card, qr_text
from clients.registrar.registrar import KEY_FILE, Registrar
from clients.registrar.registrar_answers import (
    CardForgetAnswer,
    CardIssueAnswer,
    CardNameAnswer,
    CardRevokeAnswer,
    RosterMakeAnswer,
)
from clients.sdk.new_files import new_file, read_given_text, require_seen, write_new_file
from clients.sdk.terminal.qr_codes import qr_columns, qr_lines
from clients.sdk.terminal.terminal import (
    EXISTING_FILE,
    FILE,
    FOLDER,
    can_ask,
    command_output,
    console,
    home_folder,
    load_genesis,
    print_answer,
)
from consensus.errors import BlockRobotError
from consensus.members.vouchers import ROLES, decode_card_code

LAST_LATIN = "\u024f"
"""The last sign that the contract of identities takes in a robot's name."""


def _registrar_options(command: Any) -> Any:
    for option in (
        click.option("--registrar-dir", type=FOLDER, help="The folder with the registrar's key and list of cards."),
        click.option("--genesis", type=FILE, help="The network's genesis file."),
    ):
        command = option(command)
    return command


def _open(registrar_dir: Path | None, genesis: Path | None) -> Registrar:
    """Of several organisations whose registrar's key is here, the network's first.

    Raises ORGANISATION_KEY_NOT_FOUND, and as `Registrar`.
    """
    place = home_folder() / "network"
    opened = load_genesis(genesis or place / "genesis.json")
    if registrar_dir is None:
        here = {path.parent.name: path.parent for path in sorted((place / "organisations").glob(f"*/{KEY_FILE}"))}
        names = [*(entry.name for entry in opened.organisations if entry.name in here), *here]
        if not names:
            require_seen(place / "organisations", KEY_FILE)
            detail = f"There is no {KEY_FILE} in {place / 'organisations'}: name its folder with --registrar-dir."
            raise BlockRobotError("ORGANISATION_KEY_NOT_FOUND", detail)
        registrar_dir = here[names[0]]
    return Registrar(registrar_dir, opened)


@click.group()
def card() -> None:
    """Issue enrolment cards (registrars).

    Example: blockrobot card issue --role subject
    """


@card.command()
@_registrar_options
@click.option("--role", type=click.Choice(ROLES), default="subject", show_default=True)
@click.option("--uid-file", type=EXISTING_FILE, help="A file with the tag's UID (asked for at a terminal otherwise).")
@click.option(
    "--out",
    type=FILE,
    help="Write the card: FILE.html to print, FILE.svg with the QR code alone, FILE.txt with the code.",
)
@command_output
def issue(
    registrar_dir: Path | None, genesis: Path | None, role: str, uid_file: Path | None, out: Path | None, as_json: bool
) -> None:
    """Issue a card for a tag and print its enrolment code once: as a QR code on a terminal, and in letters.

    With --out the code is in the file alone.

    Example: blockrobot card issue --role subject --uid-file tag.uid --out card.html
    """
    if out is not None and (out.suffix not in SUFFIXES or out.exists() or out.is_symlink()):
        raise click.UsageError(f"--out takes a new file that ends with {', '.join(SUFFIXES)}.")
    if uid_file:
        uid = read_given_text(uid_file)
    elif can_ask():
        uid = click.prompt("Hold the tag to the reader (or type its UID)", hide_input=True)
    else:
        raise click.UsageError("There is no terminal to ask for the tag: give --uid-file.")
    opened = _open(registrar_dir, genesis)
    organisation = asyncio.run(opened.find_organisation())
    replaced = opened.has_card(uid)
    if out is None:
        code = opened.issue(uid, role)
    else:
        with new_file(out) as file:  # first: a code is shown once, and the tag's former card ends with it
            code = opened.issue(uid, role)
            until_ms = decode_card_code(code).not_after_ms
            card = describe_card(out.suffix, code, role=role, organisation=organisation, until_ms=until_ms)
            file.write(card.encode())
    if as_json:
        shown, file_name = ("", str(out)) if out else (code, "")
        print_answer(CardIssueAnswer(role=role, code=shown, out=file_name, replaced=replaced))
    elif out is not None:
        console.print(
            f"The card is {out}: it registers one member ({role}), once. Destroy the file afterwards.", markup=False
        )
    else:
        console.print(f"Hand this code over with the card; it registers one member ({role}), once:\n\n{code}")
        if console.is_terminal and console.width >= qr_columns(qr_text(code)):
            console.print(qr_lines(qr_text(code)))
    if replaced and not as_json:
        click.echo(
            "This tag had a card before: destroy that card, for its code registers until it expires. "
            "Whoever registered with that one is on no roster from now on, and is not recorded until they register with "
            "the new code. `blockrobot roster make` names them.",
            err=True,
        )


@card.command()
@_registrar_options
@click.option("--member", metavar="KEY", help="The member key, in hexadecimal.")
@click.option(
    "--uid-file",
    type=EXISTING_FILE,
    help="Instead of --member: a file with the UID of the tag, or of the robot, that the card was issued for.",
)
@click.option("--yes", is_flag=True, help="Do not ask.")
@command_output
def revoke(
    registrar_dir: Path | None,
    genesis: Path | None,
    member: str | None,
    uid_file: Path | None,
    yes: bool,
    as_json: bool,
) -> None:
    """End a membership of this organisation: a robot that was stolen, somebody's lost key.

    Robots stop at the block that says so, and its consents end. What was recorded stays its owners'. It cannot be undone:
    whoever comes back gets a new card.

    Example: blockrobot card revoke --member 02ab...
    """
    if (member is None) == (uid_file is None):
        raise click.UsageError("Give --member KEY or --uid-file FILE.")
    opened = _open(registrar_dir, genesis)
    key = asyncio.run(opened.get_member(read_given_text(uid_file))) if uid_file else _member_key(member, "--member")
    if not yes:
        role = asyncio.run(opened.get_role(key))
        if as_json or not can_ask():
            raise click.UsageError("Nobody can be asked here: add --yes.")
        click.confirm(f"End the membership of this {role} for good?", abort=True)
    done = asyncio.run(opened.revoke(key))
    if as_json:
        print_answer(CardRevokeAnswer(txid=done.txid.hex(), role=done.role))
    else:
        console.print(f"The {done.role}'s membership is over, and the card is off the list.")


@card.command("name")
@_registrar_options
@click.argument("name")
@click.option("--place", default="", help="Where it is: a ward, a room, a floor.")
@click.option("--robot", metavar="KEY", help="The robot's member key, in hexadecimal.")
@click.option("--uid-file", type=EXISTING_FILE, help="Instead of --robot: the file that its card was issued with.")
@command_output
def name_robot(
    registrar_dir: Path | None,
    genesis: Path | None,
    name: str,
    place: str,
    robot: str | None,
    uid_file: Path | None,
    as_json: bool,
) -> None:
    """Give a robot of this organisation a name and a place: patients read them instead of its key.

    Both are public and stay on the chain: they are of Latin letters, digits and signs, a name of 32 characters at most, a
    place of 48. Say no person's name. Said again, they take the place of what was said before.

    Example: blockrobot card name "Robbie" --place "Ward 4" --robot 02ab...
    """
    if (robot is None) == (uid_file is None):
        raise click.UsageError("Give --robot KEY or --uid-file FILE.")
    strange = next((sign for sign in name + place if not " " <= sign <= LAST_LATIN), None)
    if strange is not None:
        raise click.UsageError(
            f"A name and a place are of Latin letters, digits and signs, up to U+{ord(LAST_LATIN):04X}: "
            f"{strange!r} (U+{ord(strange):04X}) cannot stand there."
        )
    opened = _open(registrar_dir, genesis)
    key = asyncio.run(opened.get_member(read_given_text(uid_file))) if uid_file else _member_key(robot, "--robot")
    txid = asyncio.run(opened.name_robot(key, name, place))
    if as_json:
        print_answer(CardNameAnswer(txid=txid.hex(), robot=key.hex(), name=name, place=place))
    else:
        console.print(f"Everybody can read it now: {name}{', ' if place else ''}{place}.", markup=False)


@card.command()
@_registrar_options
@click.option("--uid-file", type=EXISTING_FILE, help="Forget this tag alone, whoever has it.")
@command_output
def forget(registrar_dir: Path | None, genesis: Path | None, uid_file: Path | None, as_json: bool) -> None:
    """Take tags off the registrar's list: of those who left or were revoked, and of codes that expired unused.

    Making a roster does the same. Rosters that robots have keep a tag until they expire, within a day.

    Example: blockrobot card forget
    """
    opened = _open(registrar_dir, genesis)
    count = opened.forget(read_given_text(uid_file)) if uid_file else asyncio.run(opened.forget_former())
    if as_json:
        print_answer(CardForgetAnswer(forgotten=count))
    else:
        console.print(f"{count} {'card is' if count == 1 else 'cards are'} off the list.")


def _member_key(text: str | None, option: str) -> bytes:
    try:
        return bytes.fromhex(text or "")
    except ValueError:
        raise click.UsageError(f"{option} takes hexadecimal digits.") from None


@click.group()
def roster() -> None:
    """Make robots' rosters (registrars).

    Example: blockrobot roster make --robot 02ab... --out roster.sealed
    """


@roster.command()
@_registrar_options
@click.option("--robot", required=True, help="The robot's member key, in hexadecimal.")
@click.option("--out", required=True, type=FILE, help="Where to write it, in place of an older roster.")
@command_output
def make(registrar_dir: Path | None, genesis: Path | None, robot: str, out: Path, as_json: bool) -> None:
    """Seal today's roster to one robot. It is good for a day.

    Example: blockrobot roster make --robot 02ab... --out roster.sealed
    """
    member = _member_key(robot, "--robot")
    made = asyncio.run(_open(registrar_dir, genesis).make_roster(member))
    write_new_file(out, made.sealed, replace=True)
    superseded = [key.hex() for key in made.superseded]
    if as_json:
        print_answer(RosterMakeAnswer(rows=made.rows, out=str(out), superseded=superseded))
    else:
        people = "1 person" if made.rows == 1 else f"{made.rows} people"
        console.print(f"{people}; only this robot can open {out}.")
        for key in superseded:
            click.echo(
                f"Member {key} registered with a card that another one of the same tag has replaced: they are not on the "
                "roster, and are not recorded. Tell them. End that membership with "
                f"`blockrobot card revoke --member {key}`; they register in a new wallet with the new card's code.",
                err=True,
            )
