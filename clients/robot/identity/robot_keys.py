"""A robot's own keys, in one file readable by its user only.

Sealed under a passphrase if given; otherwise a thief of the robot has keys and the day's roster until revocation
(see the threat model).
"""

from __future__ import annotations

import os
import secrets
from dataclasses import dataclass
from pathlib import Path

import msgspec
from nacl.public import PrivateKey as SealingPrivateKey

from clients.robot.identity.sealed_file import write_durably
from clients.sdk.chain.enrolment import NewMember, Registration, register_member
from clients.sdk.network_client import open_pinned_client
from clients.sdk.passphrase import (
    PassphraseCost,
    PassphraseError,
    SealedFileError,
    SealFormat,
    new_sealing_key,
    open_sealed,
)
from clients.sdk.trust_pin import PIN_FILE
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.members.vouchers import decode_card_code
from consensus.primitives.keys import PrivateKey

_FILE = "robot.keys"
_KEY_BYTES = 32
_FORMAT = SealFormat(b"BRROBOT1", "blockrobot/robot-keys")


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
    """The robot's member key M, member keys S, V, X, and spool key."""

    identity: PrivateKey
    spend: PrivateKey
    view: PrivateKey
    sealing: bytes
    spool: bytes

    def __repr__(self) -> str:
        return f"RobotIdentity({self.identity.public_key.hex()})"

    @property
    def sealing_public(self) -> bytes:
        """The 32-byte X25519 public key for sealing rosters."""
        return bytes(SealingPrivateKey(self.sealing).public_key)


def create_identity(folder: Path, passphrase: str | None = None, cost: PassphraseCost | None = None) -> RobotIdentity:
    """Write keys, mode 0600. Raises ROBOT_EXISTS."""
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    keys = _KeyFile(1, *(secrets.token_bytes(_KEY_BYTES) for _ in range(5)))
    content = _to_bytes(keys, passphrase, cost)  # before there is a file: sealing takes memory, a second, and may fail
    try:
        descriptor = os.open(folder / _FILE, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except FileExistsError:
        raise BlockRobotError("ROBOT_EXISTS", f"There is a robot in {folder} already.") from None
    with os.fdopen(descriptor, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    return _identity(keys)


def load_identity(folder: Path, passphrase: str | None = None) -> RobotIdentity:
    """Raises ROBOT_NOT_FOUND, ROBOT_PASSPHRASE_MISSING, ROBOT_PASSPHRASE_WRONG, DATA_DIRECTORY_INVALID."""
    return _identity(_read(folder, passphrase))


def is_sealed(folder: Path) -> bool:
    """Raises ROBOT_NOT_FOUND."""
    return _FORMAT.magic in _read_bytes(folder)[:64]


def change_passphrase(
    folder: Path, passphrase: str | None, new: str | None, cost: PassphraseCost | None = None
) -> None:
    """None unseals. Raises as `load_identity`, SPOOL_FULL."""
    write_durably(folder / _FILE, _to_bytes(_read(folder, passphrase), new, cost))


def _to_bytes(keys: _KeyFile, passphrase: str | None, cost: PassphraseCost | None) -> bytes:
    content = msgspec.msgpack.encode(keys)
    return content if passphrase is None else new_sealing_key(passphrase, _FORMAT, cost).seal(content)


def _read_bytes(folder: Path) -> bytes:
    try:
        return (folder / _FILE).read_bytes()
    except FileNotFoundError:
        raise BlockRobotError("ROBOT_NOT_FOUND", f"There is no robot in {folder}.") from None


def _read(folder: Path, passphrase: str | None) -> _KeyFile:
    data = _read_bytes(folder)
    try:
        if is_sealed(folder):
            if passphrase is None:
                raise BlockRobotError("ROBOT_PASSPHRASE_MISSING", f"The key file in {folder} is sealed.")
            data, _ = open_sealed(data, passphrase, _FORMAT)
        return msgspec.msgpack.decode(data, type=_KeyFile)
    except PassphraseError:
        raise BlockRobotError("ROBOT_PASSPHRASE_WRONG") from None
    except (msgspec.MsgspecError, SealedFileError):
        raise BlockRobotError("DATA_DIRECTORY_INVALID", f"The key file in {folder} is damaged.") from None


def _identity(keys: _KeyFile) -> RobotIdentity:
    if len(keys.sealing) != _KEY_BYTES or len(keys.spool) != _KEY_BYTES:
        raise BlockRobotError("DATA_DIRECTORY_INVALID", "The robot's key file is damaged.")
    try:
        return _from_file(keys)
    except BlockRobotError:
        raise BlockRobotError("DATA_DIRECTORY_INVALID", "The robot's key file is damaged.") from None


def _from_file(keys: _KeyFile) -> RobotIdentity:
    return RobotIdentity(
        identity=PrivateKey(keys.identity),
        spend=PrivateKey(keys.spend),
        view=PrivateKey(keys.view),
        sealing=keys.sealing,
        spool=keys.spool,
    )


async def register_robot(folder: Path, identity: RobotIdentity, code: str, genesis: Genesis) -> Registration:
    """Raises VOUCHER_INVALID, CALL_REFUSED."""
    card = decode_card_code(code)
    member = NewMember(
        identity=identity.identity,
        spend=identity.spend.public_key,
        view=identity.view.public_key,
        sealing=identity.sealing_public,
    )
    async with open_pinned_client(genesis, folder / PIN_FILE) as client:
        return await register_member(client, card, member, [])
