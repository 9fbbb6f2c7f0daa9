"""Persistent fault switch (links, clock, disk), set by `POST /faults` with `operator.token`."""

from __future__ import annotations

import errno
import os
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import msgspec

from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.errors import BlockRobotError
from node.consensus.journal_disk import Disk, DiskFile
from node.p2p.link_faults import LinkFault, LinkFaultShaper

TOKEN_FILE_NAME = "operator.token"  # noqa: S105 - a file's name
STATE_FILE_NAME = "faults.json"
CLOCK_OFFSET_MAX_MS = 10 * 365 * 24 * 3_600_000
LINKS_MAX_COUNT = 64
SEED_MAX = (1 << 32) - 1
DISKS = ("journal", "ledger", "custody")
_TOKEN_BYTES = 32


class AdjustableClock(Protocol):
    """A wall clock that can be set wrong."""

    offset_ms: int


class FaultRequest(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Body of `POST /faults`; unnamed faults stay, `clear` ends all first.

    `links` by peer (null: none); `clock_offset_ms` from true time; `disk`: which is full.
    """

    clear: bool = False
    seed: int | None = None
    links: dict[str, LinkFault | None] = {}
    clock_offset_ms: int | None = None
    disk: dict[str, bool] = {}


class _Kept(msgspec.Struct, frozen=True):
    seed: int
    links: dict[str, LinkFault]
    clock_offset_ms: int
    disk: list[str]


class FaultSwitch:
    """All faults of one node; disks may ask from any thread."""

    def __init__(self, own_name: str, folder: Path, clock: AdjustableClock) -> None:
        """Restore saved faults. Raises FAULT_INVALID if their file is damaged."""
        self._path = folder / STATE_FILE_NAME
        self._clock = clock
        self._full: frozenset[str] = frozenset()
        self.shaper = LinkFaultShaper(own_name)
        if self._path.exists():
            self._restore()

    def _restore(self) -> None:
        try:
            kept = read_json_as(self._path.read_bytes(), _Kept)
        except (OSError, TextInvalidError):
            raise BlockRobotError("FAULT_INVALID", f"{self._path.name} cannot be read; remove it to be rid.") from None
        links: dict[str, LinkFault | None] = dict(kept.links)
        disk = dict.fromkeys(kept.disk, True)
        self._apply(FaultRequest(seed=kept.seed, links=links, clock_offset_ms=kept.clock_offset_ms, disk=disk))

    def request(self, body: bytes) -> Mapping[str, Any]:
        """Atomic; return active faults. Raises FAULT_INVALID."""
        try:
            wanted = read_json_as(body, FaultRequest)
        except TextInvalidError as error:
            raise BlockRobotError("FAULT_INVALID", f"The request is not understood: {error}.") from None
        self._apply(wanted)
        state = self.describe()
        self._keep()
        return state

    def _apply(self, wanted: FaultRequest) -> None:
        self._check(wanted)
        if wanted.clear:
            self.shaper.clear()
            self._clock.offset_ms = 0
            self._full = frozenset()
        if wanted.seed is not None:
            self.shaper.reseed(wanted.seed)
        for peer, fault in wanted.links.items():
            self.shaper.set_link(peer, fault or LinkFault())
        if wanted.clock_offset_ms is not None:
            self._clock.offset_ms = wanted.clock_offset_ms
        full = {name for name, is_full in wanted.disk.items() if is_full}
        self._full = (self._full | full) - {name for name, is_full in wanted.disk.items() if not is_full}

    def _check(self, wanted: FaultRequest) -> None:
        unknown = sorted(set(wanted.disk) - set(DISKS))
        if unknown:
            raise BlockRobotError("FAULT_INVALID", f"There is no disk {unknown[0]!r}; there are {', '.join(DISKS)}.")
        if len(self.shaper.faults) + len(wanted.links) > LINKS_MAX_COUNT:
            raise BlockRobotError("FAULT_INVALID", f"At most {LINKS_MAX_COUNT} links can be sick at once.")
        for fault in wanted.links.values():
            if fault is not None:
                fault.check()
        if wanted.seed is not None and not 0 <= wanted.seed <= SEED_MAX:
            raise BlockRobotError("FAULT_INVALID", f"A seed is a whole number from 0 to {SEED_MAX}.")
        if wanted.clock_offset_ms is not None and abs(wanted.clock_offset_ms) > CLOCK_OFFSET_MAX_MS:
            raise BlockRobotError("FAULT_INVALID", "A clock is wrong by ten years at most.")

    def _keep(self) -> None:
        kept = _Kept(self.shaper.seed, dict(self.shaper.faults), self._clock.offset_ms, sorted(self._full))
        temporary = self._path.with_suffix(".tmp")
        temporary.write_bytes(msgspec.json.encode(kept))
        temporary.replace(self._path)

    def describe(self) -> dict[str, Any]:
        return {
            "links": {peer: msgspec.to_builtins(fault) for peer, fault in sorted(self.shaper.faults.items())},
            "clock_offset_ms": self._clock.offset_ms,
            "disk": sorted(self._full),
            "seed": self.shaper.seed,
            "frames_lost": self.shaper.lost_count,
        }

    # Disks

    def require_space(self, disk: str) -> None:
        """Raise OSError(ENOSPC) while this disk is full."""
        if disk in self._full:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


class FillableDisk:
    """A `Disk` that can be full: half of one more write fits, then nothing."""

    def __init__(self, disk: Disk, switch: FaultSwitch, name: str) -> None:
        self._disk = disk
        self._switch = switch
        self._name = name

    def exists(self, path: Path) -> bool:
        return self._disk.exists(path)

    def open(self, path: Path, *, create: bool) -> DiskFile:
        if create:
            self._switch.require_space(self._name)
        return _FillableFile(self._disk.open(path, create=create), self._switch, self._name)

    def replace(self, source: Path, target: Path) -> None:
        self._disk.replace(source, target)

    def remove(self, path: Path) -> None:
        self._disk.remove(path)

    def sync_directory(self, directory: Path) -> None:
        self._disk.sync_directory(directory)


class _FillableFile:
    def __init__(self, file: DiskFile, switch: FaultSwitch, name: str) -> None:
        self._file = file
        self._switch = switch
        self._name = name
        self._is_filled_up = False

    def read_all(self) -> bytes:
        return self._file.read_all()

    def append(self, data: bytes) -> None:
        try:
            self._switch.require_space(self._name)
        except OSError:
            if not self._is_filled_up:
                self._file.append(data[: len(data) // 2])
                self._is_filled_up = True
            raise
        self._file.append(data)
        self._is_filled_up = False

    def truncate(self, size_bytes: int) -> None:
        self._file.truncate(size_bytes)

    def sync(self) -> None:
        self._file.sync()

    def close(self) -> None:
        self._file.close()


def read_or_make_token(folder: Path, name: str = TOKEN_FILE_NAME) -> str:
    """Created (0600) if missing. Raises FILE_UNUSABLE."""
    path = folder / name
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    except FileExistsError:
        return _read_token(path)
    except OSError as error:
        raise BlockRobotError("FILE_UNUSABLE", f"{path.name} cannot be made: {error.strerror}.") from error
    token = secrets.token_hex(_TOKEN_BYTES)
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(token)
    return token


def _read_token(path: Path) -> str:
    try:
        token = path.read_text(encoding="ascii").strip()
        path.chmod(0o600)
    except (OSError, UnicodeDecodeError):
        raise BlockRobotError("FILE_UNUSABLE", f"{path.name} cannot be read.") from None
    if len(token) != 2 * _TOKEN_BYTES:
        raise BlockRobotError("FILE_UNUSABLE", f"{path.name} holds no token; remove it and start the node again.")
    return token
