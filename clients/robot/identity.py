"""A robot's own keys, in one file readable by its user only. Must never be copied to another robot.

A robot starts unattended, so no passphrase guards the file: whoever steals the robot has its keys and its roster of the
day, and no more (see the threat model); revoking the robot ends both.
"""

from __future__ import annotations

import os
import secrets
from dataclasses import dataclass
from pathlib import Path

import msgspec
from nacl.public import PrivateKey as SealingPrivateKey

from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey

_FILE = "robot.keys"
_KEY_BYTES = 32


class _KeyFile(msgspec.Struct):
    version: int
    identity: bytes
    spend: bytes
    view: bytes
    sealing: bytes
    spool: bytes

    def __repr__(self) -> str:
        return "_KeyFile()"


@dataclass(frozen=True, slots=True, repr=False)
class RobotIdentity:
    """The robot's member key M, the S, V and X that every member has, and the key of its spool."""

    identity: PrivateKey
    spend: PrivateKey
    view: PrivateKey
    sealing: bytes
    spool: bytes

    def __repr__(self) -> str:
        return f"RobotIdentity({self.identity.public_key.hex()})"

    @property
    def sealing_public(self) -> bytes:
        """The X25519 public key that rosters are sealed to, 32 bytes."""
        return bytes(SealingPrivateKey(self.sealing).public_key)


def create_identity(folder: Path) -> RobotIdentity:
    """Draw a robot's keys and write them, mode 0600. Raises ROBOT_EXISTS rather than overwrite."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    keys = _KeyFile(1, *(secrets.token_bytes(_KEY_BYTES) for _ in range(5)))
    try:
        descriptor = os.open(folder / _FILE, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise BlockRobotError("ROBOT_EXISTS", f"There is a robot in {folder} already.") from None
    with os.fdopen(descriptor, "wb") as file:
        file.write(msgspec.msgpack.encode(keys))
        file.flush()
        os.fsync(file.fileno())
    return _identity(keys)


def load_identity(folder: Path) -> RobotIdentity:
    """Read a robot's keys. Raises ROBOT_NOT_FOUND, or DATA_DIRECTORY_INVALID for a damaged file."""
    try:
        return _identity(msgspec.msgpack.decode((folder / _FILE).read_bytes(), type=_KeyFile))
    except FileNotFoundError:
        raise BlockRobotError("ROBOT_NOT_FOUND", f"There is no robot in {folder}.") from None
    except (msgspec.MsgspecError, BlockRobotError):
        raise BlockRobotError("DATA_DIRECTORY_INVALID", f"The key file in {folder} is damaged.") from None


def _identity(keys: _KeyFile) -> RobotIdentity:
    if len(keys.sealing) != _KEY_BYTES or len(keys.spool) != _KEY_BYTES:
        raise BlockRobotError("KEY_INVALID")
    return RobotIdentity(
        identity=PrivateKey(keys.identity),
        spend=PrivateKey(keys.spend),
        view=PrivateKey(keys.view),
        sealing=keys.sealing,
        spool=keys.spool,
    )
