"""`blockrobot frames`: which empty-scene pictures a robot may publish."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import click

from clients.bundle.layout import BACKGROUND_MAX_BYTES
from clients.sdk.chain.empty_frames import PREVIEW_FILE, ROBOT_FILE, approve_frames, read_approved, withdraw_frames
from clients.sdk.chain.receipts import FinalReceipt
from clients.sdk.network_client import NetworkClient
from clients.sdk.new_files import read_given_file, read_given_text, write_new_file
from clients.sdk.pictures.rendition_picture import draw_preview
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import ask, can_ask, command_output, console, print_answer
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256
from network.cli.governance.governance_answers import ApprovedFrame, FramesDecisionAnswer, FramesListAnswer
from network.cli.governance.governance_signer import (
    AdminOptions,
    governing_options,
    plain_table,
    shown_id,
    with_client,
)
from pages.time_format import format_time

_KEY_BYTES = 33


@click.group()
def frames() -> None:
    """The empty frames of a robot: pictures that show nobody, on which everybody's own are shown.

    Example: blockrobot frames approve ~/.local/share/blockrobot/robots/robot/empty-frames --as hospital
    """


def _read_hex(text: str, size: int, what: str) -> bytes:
    try:
        found = bytes.fromhex(text.strip())
    except ValueError:
        found = b""
    if len(found) != size:
        raise click.UsageError(f"{what} has {2 * size} hexadecimal digits.")
    return found


def _read_folder(folder: Path, robot: str | None) -> tuple[bytes, list[bytes]]:
    """Raises BACKGROUND_NOT_FOUND."""
    pictures = [path for path in sorted(folder.glob("*.png")) if path.name != PREVIEW_FILE]
    if not pictures:
        raise BlockRobotError("BACKGROUND_NOT_FOUND", f"There are no empty frames in {folder}.")
    known = folder / ROBOT_FILE
    if robot is None and not known.exists():
        raise click.UsageError(f"Say whose they are, since {known} is not there: --robot MEMBER_KEY.")
    contents = [read_given_file(path, BACKGROUND_MAX_BYTES) for path in pictures]
    member = _read_hex(robot or read_given_text(known, encoding="latin-1"), _KEY_BYTES, "A member key")
    return member, contents


def _look_at(place: Path, preview: bytes) -> None:
    """Drawn from the frames as read, so nobody can exchange it; without a terminal saved beside them. Raises Abort for a
    no.
    """
    if not can_ask():
        file = place / PREVIEW_FILE
        if file.is_symlink() or not _is_shown(file, preview):
            write_new_file(file, preview, replace=(place / ROBOT_FILE).is_file())  # a robot leaves both
        raise click.UsageError(
            f"There is no terminal to ask: look at {file}, which was drawn just now, and give --yes."
        )
    with TemporaryDirectory(prefix="blockrobot-frames-") as own:
        file = Path(own) / PREVIEW_FILE
        write_new_file(file, preview)
        ask(f"Have you looked at {file}, and is nobody in it?", err=True)


def _is_shown(file: Path, preview: bytes) -> bool:
    try:
        return read_given_file(file, len(preview)) == preview
    except (OSError, BlockRobotError):
        return False


def _report(receipt: FinalReceipt | None, what: str, digests: list[bytes], *, as_json: bool) -> None:
    if as_json:
        height = None if receipt is None else receipt.height
        print_answer(FramesDecisionAnswer(height=height, frames=[digest.hex() for digest in digests]))
    elif receipt is None:
        console.print("They are approved already: nothing was left to do.")
    else:
        console.print(f"{what}, final at height {receipt.height}.")


@frames.command()
@click.argument("place", metavar="FOLDER", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.option("--robot", metavar="MEMBER_KEY", help="Whose frames they are, if no robot.txt is beside them.")
@click.option("--yes", is_flag=True, help="Do not ask: you have looked at the preview.png beside the frames.")
@governing_options
@command_output
def approve(place: Path, robot: str | None, yes: bool, *, admin: AdminOptions, as_json: bool) -> None:
    """Let a robot publish the frames in FOLDER: you have looked at them, and nobody is in them.

    A robot whose frames are not approved writes them there and says so. For an admin of its organisation. The preview to
    look at is drawn of the very frames that are approved; with --yes the one beside them has to be the same.

    Example: blockrobot frames approve robots/robot/empty-frames --as hospital
    """
    member, contents = _read_folder(place, robot)
    preview, digests = draw_preview(contents), [sha256(content) for content in contents]
    if yes and not _is_shown(place / PREVIEW_FILE, preview):
        raise BlockRobotError("BACKGROUND_PREVIEW_DIFFERS")
    if not yes:
        _look_at(place, preview)
    signer = admin.signer()
    receipt = with_client(signer, lambda client: approve_frames(client, signer.key, member, digests))
    _report(receipt, f"Approved: {len(digests)} empty frames of robot {shown_id(member)}", digests, as_json=as_json)


@frames.command("list")
@click.argument("robot", metavar="MEMBER_KEY")
@governing_options
@command_output
def list_frames(robot: str, admin: AdminOptions, as_json: bool) -> None:
    """Show which frames a robot may publish, who approved them and when, as the chain proves it.

    Example: blockrobot frames list 02ab... --json
    """
    member = _read_hex(robot, _KEY_BYTES, "A member key")

    rows = admin.read(lambda client, key: read_approved(client, member, key))
    if as_json:
        approved = [
            ApprovedFrame(sha256=row.digest.hex(), approver=row.approver.hex(), approved_ms=row.time) for row in rows
        ]
        print_answer(FramesListAnswer(frames=approved))
        return
    if not rows:
        console.print("None is approved. The robot names those that it needs when it starts.")
        return
    table = plain_table(f"Empty frames of robot {shown_id(member)}", ["sha256", "approved by", "at"])
    for row in rows:
        table.add_row(row.digest.hex(), escape(shown_id(row.approver)), format_time(row.time))
    console.print(table)


@frames.command()
@click.argument("robot", metavar="MEMBER_KEY")
@click.argument("digests", metavar="[SHA256]...", nargs=-1)
@click.option("--all", "takes_all", is_flag=True, help="Withdraw all that are approved for the robot.")
@governing_options
@command_output
def withdraw(robot: str, digests: tuple[str, ...], takes_all: bool, *, admin: AdminOptions, as_json: bool) -> None:
    """Take frames back: every custodian deletes them, and what stood on them is shown without a room.

    Example: blockrobot frames withdraw 02ab... 5f3c... --as hospital
    """
    member = _read_hex(robot, _KEY_BYTES, "A member key")
    if takes_all == bool(digests):
        raise click.UsageError("Name the frames by their SHA256, or give --all.")
    named = [_read_hex(text, HASH_SIZE_BYTES, "A SHA256") for text in digests]
    signer = admin.signer()

    async def work(client: NetworkClient) -> FinalReceipt | None:
        if takes_all:
            named.extend(row.digest for row in await read_approved(client, member, signer.key))
        return await withdraw_frames(client, signer.key, member, named)

    receipt = with_client(signer, work)
    if receipt is None and not as_json:
        console.print("None is approved: nothing was left to do.")
        return
    _report(receipt, f"Withdrawn: {len(named)} empty frames; custodians delete them", named, as_json=as_json)
