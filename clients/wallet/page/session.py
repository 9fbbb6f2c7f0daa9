"""A page's session with an open wallet. Keys stay in this process; the chain is polled every few seconds while a page
listens.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import time
from collections.abc import AsyncIterator, Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from clients.sdk.new_files import require_own_folder
from clients.sdk.node_answers import FAULTY
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.page.jobs import Jobs
from clients.wallet.page.open_clips import Clips
from clients.wallet.page.passphrase_check import PassphraseGate
from clients.wallet.page.wallet_snapshot import Snapshot, read_snapshot
from clients.wallet.records.viewing import RecordViewer
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError

LOOKS_MAX_COUNT = 32
LOOK_NAME_MAX_CHARS = 64
READ_EVERY_S = 2.0
READ_IDLE_EVERY_S = 60.0
READ_SHARE = 8
"""Reading takes at most one part in so many of the time."""
LISTENING_MS = 60_000
HOLD_MAX_S = 20.0
NEWS_KEPT_COUNT = 1_000
AWAY_TOLD_MS = 5 * 60_000
UNKNOWN_YET = "SESSION_REFUSED"
"""What a node says that has not followed the chain to the owner's registration."""
_PRIVATE_FOLDER = 0o700
_OWN_FILE = re.compile(r"\.?export-[0-9a-f]+\.zip(?:\.[0-9a-f]{8})?|open-[0-9a-f]+\.html")
_DESCRIPTORS = Path("/proc/self/fd")
_log = logging.getLogger("wallet.page")


class AccessRequests:
    """One on chain per look and purpose; least recently used evicted."""

    def __init__(self) -> None:
        self._requests: dict[tuple[str, str], dict[bytes, bytes]] = {}

    async def request(
        self, viewing: RecordViewer, look: str, purpose: str, entries: Sequence[RecordEntry]
    ) -> dict[bytes, bytes]:
        """Return access ids by record; what is missing is requested on chain."""
        known = self._requests.pop((look, purpose), {})
        if look:
            self._requests[look, purpose] = known
            while len(self._requests) > LOOKS_MAX_COUNT:
                del self._requests[next(iter(self._requests))]
        missing = [entry for entry in entries if entry.record_id not in known]
        for part in await viewing.split_requests(missing):
            access_id = await viewing.request_access(part, purpose)
            known |= {entry.record_id: access_id for entry in part}
        return known

    def forget(self, look: str) -> None:
        for key in [key for key in self._requests if key[0] == look]:
            del self._requests[key]

    def forget_all(self) -> None:
        self._requests.clear()


def wall_clock_ms() -> int:
    return time.time_ns() // 1_000_000


@dataclass
class KeptFile:
    """An open file for the page, its readable path, whether fetched."""

    file: BinaryIO
    path: Path
    was_fetched: bool = False


class PageSession:
    """A page's state; `folder` holds temporary downloads."""

    def __init__(
        self,
        wallet: Wallet,
        profile: str,
        folder: Path,
        *,
        now_ms: Callable[[], int] = wall_clock_ms,
        read_every_s: float = READ_EVERY_S,
        command: str = "blockrobot wallet serve",
    ) -> None:
        self.wallet = wallet
        self.profile = profile
        self.command = command
        """What is typed to open this very wallet's page again."""
        self.folder = folder
        self.now_ms = now_ms
        self.lock = asyncio.Lock()
        self.ended = asyncio.Event()
        self.jobs = Jobs(self.lock, now_ms, self.read)
        self.gate = PassphraseGate(wallet.store, now_ms, self._give_up)
        self.was_given_up = False
        """Whether it ended because the passphrase was wrong too often."""
        self.was_not_begun = False
        """Whether something was asked for when the page ended that did not begin: its passphrase was not taken in time."""
        self.clips = Clips()
        self.looks = AccessRequests()
        self.exports: dict[str, KeptFile] = {}
        self.lost_export_count = 0
        """How many files to take along were there when the page ended, and nobody had fetched them."""
        self.snapshot = Snapshot()
        self.state = "reading"
        self.problem: BlockRobotError | None = None
        self.news = 0
        self.used_at_ms = now_ms()
        self._heard_at_ms = now_ms()
        self._troubles: dict[str, tuple[BlockRobotError, int]] = {}
        self._troubles_told: dict[str, str] = {}
        self._new_records: list[tuple[int, bytes]] = []
        self._changed = asyncio.Event()
        self._wake = asyncio.Event()
        self._read_every_s = read_every_s
        self._watching: asyncio.Task[None] | None = None
        wallet.trails = {}

    async def __aenter__(self) -> PageSession:
        self._clear_folder()
        self._watching = asyncio.create_task(self._watch())
        return self

    async def __aexit__(self, *exception: object) -> None:
        try:
            if self._watching is not None:
                self._watching.cancel()
                await asyncio.gather(self._watching, return_exceptions=True)
            await self.jobs.close()
        finally:
            self.lost_export_count = sum(not kept.was_fetched for kept in self.exports.values())
            self.clips.forget_all()
            self.looks.forget_all()
            self._clear_folder()

    @property
    def unfinished(self) -> list[tuple[str, BlockRobotError | None]]:
        """Failures since closing began, with errors (None: aborted), including unfetched exports."""
        return [(job.kind, job.error) for job in self.jobs.unfinished] + [("export", None)] * self.lost_export_count

    def _clear_folder(self) -> None:
        for name in list(self.exports):
            self.forget_export(name)
        require_own_folder(self.folder)
        self.folder.chmod(_PRIVATE_FOLDER)
        for path in self.folder.iterdir():
            if _OWN_FILE.fullmatch(path.name):
                path.unlink()

    # Use

    def _give_up(self) -> None:
        self.was_given_up = True
        self.ended.set()

    def note_use(self, ago_ms: int = 0) -> None:
        self.used_at_ms = max(self.used_at_ms, self.now_ms() - ago_ms)

    def is_idle(self, minutes: int) -> bool:
        """Whether nothing was asked for a while and no job is open."""
        return not self.jobs.are_open and self.now_ms() - self.used_at_ms > minutes * 60_000

    def node_troubles(self) -> dict[str, BlockRobotError]:
        """Troubles by node; an unreachable node is forgotten after a while."""
        now, troubles = self.now_ms(), self.wallet.network.troubles
        for name, error in troubles.items():
            if name not in self._troubles or self._troubles[name][0] is not error:
                self._troubles[name] = (error, now)
        return {
            name: error
            for name, error in troubles.items()
            if error.code in FAULTY or now - self._troubles[name][1] < AWAY_TOLD_MS
        }

    def keep_export(self, name: str, path: Path) -> None:
        """Unnamed where supported, so it vanishes on exit. Raises OSError."""
        file = path.open("rb")
        if _DESCRIPTORS.exists():
            path.unlink()
            path = _DESCRIPTORS / str(file.fileno())
        self.exports[name] = KeptFile(file, path)

    def forget_export(self, name: str) -> None:
        kept = self.exports.pop(name, None)
        if kept is not None:
            kept.file.close()
            if kept.path.parent != _DESCRIPTORS:
                kept.path.unlink(missing_ok=True)

    @contextlib.asynccontextmanager
    async def hold(self) -> AsyncIterator[Wallet]:
        """Raises WALLET_BUSY on timeout."""
        try:
            async with asyncio.timeout(HOLD_MAX_S):
                await self.lock.acquire()
        except TimeoutError:
            raise refusal("WALLET_BUSY", "page_busy") from None
        try:
            yield self.wallet
        finally:
            self.lock.release()

    # News

    def look_again(self) -> None:
        self._wake.set()

    async def wait_news(self, after: int, wait_ms: int) -> list[bytes]:
        """After number `after`; return new records."""
        self._heard_at_ms = self.now_ms()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(wait_ms / 1000):
                while self.news <= after and not self.ended.is_set():
                    await self._changed.wait()
        self._heard_at_ms = self.now_ms()
        return [record_id for number, record_id in self._new_records if number > after]

    def _tell_news(self) -> None:
        self.news += 1
        self._changed.set()
        self._changed = asyncio.Event()

    async def _watch(self) -> None:
        while True:
            self._wake.clear()
            started = time.monotonic()
            async with self.lock:
                await self.read()
            took_s = time.monotonic() - started
            is_heard = self.now_ms() - self._heard_at_ms < LISTENING_MS
            pause_s = max(self._read_every_s if is_heard else READ_IDLE_EVERY_S, READ_SHARE * took_s)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(pause_s):
                    await self._wake.wait()

    async def read(self, *, fresh: bool = False) -> None:
        """Keeps errors; the caller holds the lock."""
        before, was = self.snapshot, (self.state, self.problem and self.problem.code)
        try:
            snapshot = await read_snapshot(self.wallet, before, self.now_ms(), fresh=fresh)
        except BlockRobotError as error:
            unread = {"NOT_REGISTERED": "not_registered", "NODE_UNREACHABLE": "unreachable"}
            self.state, self.problem = unread.get(error.code, "failed"), error
        except Exception as error:  # noqa: BLE001 - the page stays, and says that something is wrong
            _log.error("unexpected fault while the chain was read: %s", type(error).__name__)
            self.state, self.problem = "failed", refusal("INTERNAL", "page_fault")
        else:
            self.snapshot, self.state, self.problem = snapshot, "ready", None
            self._note_new(before, snapshot)
            self.clips.keep_only(
                {entry.record_id for entry in snapshot.entries.values() if entry.state.status == "active"}
            )
        is_new = self.state == "ready" and not self.snapshot.same_as(before)
        if was[0] == "not_registered" and self.state == "ready":
            self._forget_refusals()
        troubles = {name: error.code for name, error in self.node_troubles().items()}
        if is_new or was != (self.state, self.problem and self.problem.code) or troubles != self._troubles_told:
            self._troubles_told = troubles
            self._tell_news()

    def _forget_refusals(self) -> None:
        troubles = self.wallet.network.troubles
        for name in [name for name, error in troubles.items() if error.code == UNKNOWN_YET]:
            del troubles[name]

    def _note_new(self, before: Snapshot, snapshot: Snapshot) -> None:
        if not before.read_at_ms:
            return
        new = [record_id for record_id in snapshot.entries if record_id not in before.entries]
        self._new_records += [(self.news + 1, record_id) for record_id in new]
        del self._new_records[:-NEWS_KEPT_COUNT]
