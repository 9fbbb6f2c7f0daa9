"""Sequential background jobs of a page, followed by rising revisions."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import secrets
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field

import msgspec

from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError

WAIT_MAX_MS = 25_000
KEPT_MS = 30 * 60_000
OPEN_MAX_COUNT = 16
DECISIONS = frozenset({"register", "consent", "share", "revoke", "erase"})
"""Kinds of jobs that write what the owner decided: a page that ends finishes them first."""
TOLD = DECISIONS | {"export"}
"""Kinds of jobs of which the owner is to know that they came to nothing, though the page that would say so is gone."""
_log = logging.getLogger("wallet.page")
Result = Mapping[str, object]
"""What a job came to, ready to be encoded; Structs may be anywhere in it."""
Work = Callable[["Job"], Awaitable[Result]]


@dataclass
class Job:
    """One requested job; `receipts` are custodians', as received."""

    name: str
    kind: str
    is_stoppable: bool
    state: str = "waiting"
    revision: int = 0
    step: str = ""
    done: int = 0
    of: int = 0
    receipts: Sequence[msgspec.Struct] | None = None
    result: Result | None = None
    error: BlockRobotError | None = None
    ended_ms: int = 0
    changed: asyncio.Event = field(default_factory=asyncio.Event, repr=False)
    task: asyncio.Task[None] | None = field(default=None, repr=False)

    @property
    def is_over(self) -> bool:
        return self.state in {"done", "failed", "cancelled"}

    def tell(self, step: str, done: int = 0, of: int = 0) -> None:
        """Note a step; 0 of 0 means that the total is unknown."""
        self.step, self.done, self.of = step, done, of
        self.note()

    def note(self) -> None:
        self.revision += 1
        self.changed.set()
        self.changed = asyncio.Event()


async def _read_no_more() -> None:
    """Once nobody looks at the page: the network may be away, and nobody waits."""


class Jobs:
    """One page's jobs. `lock` is held during a job and its `after`."""

    def __init__(self, lock: asyncio.Lock, now_ms: Callable[[], int], after: Callable[[], Awaitable[None]]) -> None:
        self._lock = lock
        self._now_ms = now_ms
        self._after = after
        self._jobs: dict[str, Job] = {}
        self._last: list[Job] | None = None

    @property
    def are_open(self) -> bool:
        return any(not job.is_over for job in self._jobs.values())

    @property
    def are_decisions_open(self) -> bool:
        return any(not job.is_over and job.kind in DECISIONS for job in self._jobs.values())

    @property
    def unfinished(self) -> list[Job]:
        """Jobs of TOLD failed or undecided since closing began, without those only rereading."""
        return [job for job in self._last or [] if job.kind in TOLD and job.result is None]

    def begin_to_end(self) -> None:
        """From now on the page cannot report."""
        if self._last is None:
            self._last = [job for job in self._jobs.values() if not job.is_over]

    def start(self, kind: str, work: Work, *, stoppable: bool = False) -> Job:
        """Raises RATE_LIMITED."""
        now = self._now_ms()
        for name in [name for name, job in self._jobs.items() if job.is_over and now - job.ended_ms > KEPT_MS]:
            del self._jobs[name]
        if sum(not job.is_over for job in self._jobs.values()) >= OPEN_MAX_COUNT:
            raise refusal("RATE_LIMITED", "page_too_much")
        job = Job(secrets.token_hex(8), kind, stoppable)
        self._jobs[job.name] = job
        if self._last is not None:
            self._last.append(job)
        job.task = asyncio.create_task(self._run(job, work))
        return job

    async def _run(self, job: Job, work: Work) -> None:
        try:
            async with self._lock:
                job.state = "running"
                job.note()
                try:
                    job.result = await work(job)
                    job.is_stoppable = False  # it is done: its result is kept and shown
                finally:
                    await self._after()
            job.state = "done"
        except asyncio.CancelledError:
            job.state = "cancelled"
        except BlockRobotError as error:
            job.state, job.error = "failed", error
        except OSError as error:
            reason = error.strerror or type(error).__name__
            job.state, job.error = "failed", BlockRobotError("FILE_UNUSABLE", f"{reason}.")
        except Exception as error:  # noqa: BLE001 - whatever fails, the page gets words and the log gets the rest
            _log.error("unexpected fault in a job of kind %s: %s", job.kind, type(error).__name__)
            job.state, job.error = "failed", refusal("INTERNAL", "page_fault")
        job.ended_ms = self._now_ms()
        job.note()

    def find(self, name: str) -> Job:
        """Raises NOT_FOUND if forgotten."""
        job = self._jobs.get(name)
        if job is None:
            raise refusal("NOT_FOUND", "page_no_task")
        return job

    async def wait(self, name: str, after: int, wait_ms: int) -> Job:
        """Wait until the revision exceeds `after`, the job's end, or timeout. Raises NOT_FOUND."""
        job = self.find(name)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(min(max(wait_ms, 0), WAIT_MAX_MS) / 1000):
                while job.revision <= after and not job.is_over:
                    await job.changed.wait()
        return job

    def cancel(self, name: str) -> Job:
        """Cancel a waiting or read-only job. Raises NOT_FOUND, JOB_NOT_STOPPABLE."""
        job = self.find(name)
        if job.is_over:
            return job
        if job.task is None or (job.state == "running" and not job.is_stoppable):
            raise BlockRobotError("JOB_NOT_STOPPABLE")
        job.task.cancel()
        return job

    async def close(self) -> None:
        """Cancel reading jobs; wait for decisions."""
        self._after = _read_no_more
        self.begin_to_end()
        open_jobs = [job for job in self._jobs.values() if job.task is not None and not job.is_over]
        for job in open_jobs:
            if job.task is not None and job.kind not in DECISIONS:
                job.task.cancel()
        await asyncio.gather(*(job.task for job in open_jobs if job.task is not None), return_exceptions=True)
        self._jobs.clear()
