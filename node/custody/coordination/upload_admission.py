"""Admits a robot's upload before its body is read.

New content counts in quotas and reserve until stored or refused; known content needs no room.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, asynccontextmanager, contextmanager, nullcontext
from functools import partial

from consensus.errors import BlockRobotError
from consensus.state.identity import handle_of, organisation_of
from consensus.state.keys import Reader
from consensus.state.records import RECORD, VISIT, is_frame_approved
from consensus.state.settings import read_quotas
from node.custody.coordination.upload_report import RefusedUploads
from node.custody.custodian import Custodian
from node.custody.uploads.upload_usage import UploadTerms, Use
from node.ledger.ledger_writer import FinalityFeed
from node.storage.ledger_store import LedgerSnapshot, LedgerStore

CATCH_UP_MAX_MS = 3_000
"""How long a custodian may lag behind what a robot has seen final."""

UPLOADS_OF_ROBOT_MAX_COUNT = 16
"""So many uploads of one robot are on their way at once, new ones and repeated ones together."""
UPLOADS_OF_CONTENT_MAX_COUNT = 2
"""Of the same clip or empty frame by one robot: it may come again before it is noticed that a connection is dead."""

HoldRoom = Callable[[bytes, int], AbstractContextManager[None]]
"""Keeps so many bytes of the disk free for an upload of this robot. Raises DISK_RESERVE_REACHED."""


def may_upload(state: Reader, record_id: bytes, owner: bytes, robot: bytes) -> bool:
    visit = VISIT.at(state, owner)
    if visit is not None and visit.robot == robot and visit.status == "open":
        return True
    record = RECORD.at(state, record_id)
    return record is not None and record.robot == robot


class UploadAdmission:
    """Admits uploads; `in_flight` is each robot's use under way."""

    def __init__(
        self,
        ledger: LedgerStore,
        feed: FinalityFeed,
        custodian: Custodian,
        hold_room: HoldRoom | None = None,
        has_followed: Callable[[], bool] = lambda: True,
        is_custodian: Callable[[Reader], bool] = lambda _state: True,
    ) -> None:
        """`has_followed`: the custodian knows the chain; `is_custodian`: the chain knows the custodian."""
        self._ledger = ledger
        self._feed = feed
        self._custodian = custodian
        self._is_custodian = is_custodian
        self._hold_room = hold_room or (lambda _robot, _size_bytes: nullcontext())
        self.in_flight: dict[bytes, Use] = {}
        self._open: Counter[tuple[str, bytes]] = Counter()
        self.refused = RefusedUploads(has_followed=has_followed)

    def organisation_of(self, robot: bytes) -> str:
        with self._ledger.snapshot() as snapshot:
            return organisation_of(snapshot, robot)

    def handle_of(self, robot: bytes) -> bytes:
        with self._ledger.snapshot() as snapshot:
            return handle_of(snapshot, robot)

    def read_terms(self, robot: bytes) -> UploadTerms:
        with self._ledger.snapshot() as snapshot:
            quotas = read_quotas(snapshot.get)
        return UploadTerms(robot, quotas, self.organisation_of, self.handle_of)

    def require_room(self) -> None:
        """Raises DISK_RESERVE_REACHED."""
        with self._hold_room(b"", 0):
            return

    @asynccontextmanager
    async def clip(self, record_id: bytes, owner: bytes, size_bytes: int, robot: bytes) -> AsyncIterator[bool]:
        """Whether it is new; room is kept for those that are. Raises VISIT_NOT_OPEN and as `background`."""
        content = ("clip", robot + record_id)
        wait = partial(self.wait_for_visit, record_id, owner, robot)
        async with self._let_in(robot, content, size_bytes, wait, partial(self._custodian.holds, record_id)) as is_new:
            yield is_new

    @asynccontextmanager
    async def background(self, digest: bytes, size_bytes: int, robot: bytes) -> AsyncIterator[None]:
        """Raises EMPTY_FRAME_NOT_APPROVED, UPLOAD_QUOTA_EXCEEDED, DISK_RESERVE_REACHED, RATE_LIMITED."""
        content = ("empty frame", robot + digest)
        wait = partial(self.wait_until_approved, digest, robot)
        async with self._let_in(robot, content, size_bytes, wait, partial(self._custodian.holds_background, digest)):
            yield

    @asynccontextmanager
    async def _let_in(
        self,
        robot: bytes,
        content: tuple[str, bytes],
        size_bytes: int,
        wait: Callable[[], Awaitable[None]],
        is_known: Callable[[], Awaitable[bool]],
    ) -> AsyncIterator[bool]:
        whose = self.handle_of(robot) or robot
        with ExitStack() as held:
            held.enter_context(self._place(("robot", whose), UPLOADS_OF_ROBOT_MAX_COUNT))
            held.enter_context(self._place(content, UPLOADS_OF_CONTENT_MAX_COUNT))
            with self.refused.noted(robot):
                await wait()
                is_new = not await is_known()
                if is_new:
                    await self._custodian.require_quota(size_bytes, self.read_terms(robot), self.in_flight)
                    # Nothing is awaited from the judgement on: what is let in next sees this.
                    held.enter_context(self._hold_room(whose, size_bytes))
                    held.enter_context(self._on_its_way(robot, Use(1, size_bytes)))
            yield is_new

    @contextmanager
    def _place(self, what: tuple[str, bytes], most: int) -> Iterator[None]:
        """Raises RATE_LIMITED."""
        if self._open[what] >= most:
            raise BlockRobotError(
                "RATE_LIMITED", f"{most} uploads of this {what[0]} are on their way already.", retry_after_s=1
            )
        self._open[what] += 1
        try:
            yield
        finally:
            self._open[what] -= 1
            if not self._open[what]:
                del self._open[what]

    @contextmanager
    def _on_its_way(self, robot: bytes, use: Use) -> Iterator[None]:
        self.in_flight[robot] = self.in_flight.get(robot, Use()) + use
        try:
            yield
        finally:
            left = self.in_flight.pop(robot)
            left = Use(left.count - use.count, left.size_bytes - use.size_bytes)
            if left.count:
                self.in_flight[robot] = left

    async def wait_for_visit(self, record_id: bytes, owner: bytes, robot: bytes) -> None:
        """Raises VISIT_NOT_OPEN, CUSTODY_ELSEWHERE."""

        def judge(state: LedgerSnapshot) -> bool | None:
            is_known = VISIT.has(state, owner)
            return may_upload(state, record_id, owner, robot) or (False if is_known else None)

        await self._wait_until(judge, "VISIT_NOT_OPEN")

    async def wait_until_approved(self, digest: bytes, robot: bytes) -> None:
        """Raises EMPTY_FRAME_NOT_APPROVED."""
        await self._wait_until(
            lambda state: is_frame_approved(state, robot, digest) or None, "EMPTY_FRAME_NOT_APPROVED"
        )

    def require_approved(self, digest: bytes, robot: bytes) -> None:
        """Raises EMPTY_FRAME_NOT_APPROVED."""
        with self._ledger.snapshot() as snapshot:
            if not is_frame_approved(snapshot, robot, digest):
                raise BlockRobotError("EMPTY_FRAME_NOT_APPROVED")

    async def _wait_until(self, judge: Callable[[LedgerSnapshot], bool | None], refusal: str) -> None:
        """Raises the refusal, and CUSTODY_ELSEWHERE for what the chain counts as no copy: this custodian was removed."""
        deadline_s = asyncio.get_running_loop().time() + CATCH_UP_MAX_MS / 1000
        while True:
            with self._ledger.snapshot() as snapshot:
                is_custodian = self._is_custodian(snapshot)
                verdict = judge(snapshot) if is_custodian else None
                height = -1 if snapshot.position is None else snapshot.position.height
            left_s = deadline_s - asyncio.get_running_loop().time()
            if verdict:
                return
            if verdict is False or left_s <= 0:
                raise BlockRobotError(refusal if is_custodian else "CUSTODY_ELSEWHERE")
            await self._feed.wait_above(height, int(1000 * left_s) + 1)
