"""Selects a command's robot and its key file's passphrase source."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import click

from clients.robot.identity.robot_keys import RobotIdentity, is_sealed, load_identity
from clients.sdk.new_files import SMALL_FILE_MAX_BYTES, read_given_file
from clients.sdk.terminal.own_command import name_in_full
from clients.sdk.terminal.terminal import can_ask
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.visible_text import one_entry

ROBOT_COMMAND = "blockrobot robot"
PASSPHRASE_MAX_BYTES = 4_096
CREDENTIAL = "blockrobot-robot-passphrase"
"""How a passphrase is called among the credentials that systemd hands to a unit (`LoadCredential=`)."""


@dataclass(frozen=True, slots=True)
class RobotPlace:
    """A robot's folder, genesis file, and passphrase file if named."""

    folder: Path
    genesis: Path
    passphrase_file: Path | None = None
    command: str = ROBOT_COMMAND
    """How the robot is called again."""

    def find_passphrase(self) -> str | None:
        """Take it from a file, systemd or the terminal. Raises ROBOT_NOT_FOUND, REQUEST_INVALID."""
        if not is_sealed(self.folder):
            return None
        handed = os.environ.get("CREDENTIALS_DIRECTORY")
        file = self.passphrase_file or (Path(handed) / CREDENTIAL if handed else None)
        if file is not None and (self.passphrase_file or file.is_file()):
            return read_passphrase(file)
        return str(click.prompt("Passphrase of the robot", hide_input=True, err=True)) if can_ask() else None

    def get_approver(self, organisation: str | None) -> PrivateKey | None:
        """Return the organisation's admin key. Raises ORGANISATION_KEY_NOT_FOUND."""
        if organisation is None:
            return None
        file = self.genesis.parent / "organisations" / organisation / "admin.key"
        try:
            return PrivateKey(read_given_file(file, SMALL_FILE_MAX_BYTES))
        except FileNotFoundError:
            detail = (
                f"There is no key file {file}. Where it is, an admin approves without the robot: "
                f"blockrobot frames approve FOLDER --as {organisation}."
            )
            raise BlockRobotError("ORGANISATION_KEY_NOT_FOUND", detail) from None

    def load(self) -> RobotIdentity:
        """Raises as `load_identity`."""
        return load_identity(self.folder, self.find_passphrase())


def name_robot(words: str) -> str:
    """Let the commands in these words be of the robot that this command was called for."""
    context = click.get_current_context(silent=True)
    place = None if context is None else context.find_object(RobotPlace)
    return words if place is None else name_in_full(words, ROBOT_COMMAND, place.command)


def describe_refusal(error: BlockRobotError) -> str:
    return f"{name_robot(one_entry(error.detail))}\n  {error.code}. Next step: {name_robot(error.next_step)}"


def read_passphrase(file: Path) -> str:
    """Return the first line. Raises REQUEST_INVALID."""
    try:
        with file.open("rb") as opened:
            data = opened.read(PASSPHRASE_MAX_BYTES + 1)
        text = data.decode("utf-8")
    except (OSError, UnicodeDecodeError):
        raise BlockRobotError("REQUEST_INVALID", f"The passphrase cannot be read from {file}.") from None
    line = text.split("\n", 1)[0].removesuffix("\r")
    if not line or len(data) > PASSPHRASE_MAX_BYTES:
        raise BlockRobotError("REQUEST_INVALID", f"The first line of {file} is empty, or the file is too large.")
    return line
