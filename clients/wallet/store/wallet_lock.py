"""Advisory lock next to the wallet file: one program at a time; the kernel releases it."""

from __future__ import annotations

import contextlib
import fcntl
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import msgspec

from clients.wallet.text_catalogue import refusal
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.errors import BlockRobotError
from pages.time_format import format_time

WAIT_MAX_S = 5.0
"""A command that runs at the same time is over soon; a page stays."""
READING_WAIT_MAX_S = 0.5
"""Who only reads does not wait for a command that waits for receipts: the file is whole at any moment."""
NOTE_MAX_BYTES = 1024
SINCE_MAX_MS = 1 << 45
_PAUSE_S = 0.05
_PRIVATE_FOLDER = 0o700
NameCommand = Callable[[str], str]


@contextlib.contextmanager
def claim_wallet(
    path: Path,
    *,
    name_command: NameCommand = str,
    wait_s: float = WAIT_MAX_S,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[None]:
    """`name_command`: how the holder's command is shown to the user. Raises WALLET_BUSY, WALLET_NOT_FOUND."""
    require_wallet(path)
    with _hold(path, name_command, wait_s, sleep):
        yield


@contextlib.contextmanager
def lock_or_read_only(
    path: Path,
    *,
    name_command: NameCommand = str,
    wait_s: float = READING_WAIT_MAX_S,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[BlockRobotError | None]:
    """Yield WALLET_BUSY for read-only use. Raises WALLET_NOT_FOUND."""
    require_wallet(path)
    try:
        descriptor = _lock(path, name_command, wait_s, sleep)
    except BlockRobotError as busy:
        yield busy
        return
    try:
        yield None
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def claim_place(path: Path, *, name_command: NameCommand = str) -> Iterator[None]:
    """Of a new wallet. Raises WALLET_BUSY, WALLET_EXISTS."""
    path.parent.mkdir(parents=True, exist_ok=True, mode=_PRIVATE_FOLDER)
    with _hold(path, name_command, 0.0, time.sleep):
        if path.exists():
            raise refusal("WALLET_EXISTS", "wallet_exists", path=str(path))
        try:
            yield
        finally:
            if not path.exists():
                _lock_of(path).unlink(missing_ok=True)


def _lock_of(path: Path) -> Path:
    return path.with_name(f".{path.name}.lock")


def require_wallet(path: Path) -> None:
    """Raise WALLET_NOT_FOUND if missing, before a passphrase is requested."""
    if not path.exists():
        raise refusal("WALLET_NOT_FOUND", "wallet_not_found", path=str(path))


@contextlib.contextmanager
def _hold(path: Path, name_command: NameCommand, wait_s: float, sleep: Callable[[float], None]) -> Iterator[None]:
    descriptor = _lock(path, name_command, wait_s, sleep)
    try:
        yield
    finally:
        os.close(descriptor)


def _lock(path: Path, name_command: NameCommand, wait_s: float, sleep: Callable[[float], None]) -> int:
    """Raises WALLET_BUSY."""
    for _ in range(max(1, round(wait_s / _PAUSE_S))):
        descriptor = os.open(_lock_of(path), os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # Where no wallet came to be the file goes again; a lock on one that is gone keeps nobody out.
            if _is_there(descriptor, path):
                _write_holder(descriptor)
                return descriptor
            os.close(descriptor)
        except BlockingIOError:
            os.close(descriptor)
            sleep(_PAUSE_S)
    holder = _read_holder(path)
    if holder is None:
        raise refusal("WALLET_BUSY", "wallet_busy", path=str(path))
    # It has the very wallet that is wanted here, so it is called as this one is.
    who = name_command(holder.command[:1].upper() + holder.command[1:])
    moment = format_time(holder.since_ms)
    raise refusal("WALLET_BUSY", "wallet_busy_with", who=who, process=holder.process, path=str(path), since=moment)


def _is_there(descriptor: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(descriptor), _lock_of(path).stat())
    except FileNotFoundError:
        return False


class _Holder(msgspec.Struct):
    """A lock holder: command without arguments, process, start in ms."""

    command: str
    process: int
    since_ms: int


def _write_holder(descriptor: int) -> None:
    context = click.get_current_context(silent=True)
    command = "another program" if context is None else f"`{context.command_path}`"
    note = msgspec.json.encode(_Holder(command, os.getpid(), time.time_ns() // 1_000_000))
    with contextlib.suppress(OSError):
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, note, 0)


def _read_holder(path: Path) -> _Holder | None:
    try:
        with _lock_of(path).open("rb") as file:
            holder = read_json_as(file.read(NOTE_MAX_BYTES), _Holder)
    except (OSError, TextInvalidError):
        return None
    return holder if 0 <= holder.since_ms < SINCE_MAX_MS else None
