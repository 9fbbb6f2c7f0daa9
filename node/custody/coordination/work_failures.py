"""What of a custodian's work fails, since when and why, so that an operator need not read logs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

from consensus.errors import BlockRobotError
from node.custody.coordination.custody_answers import WorkFailure

SHOWN_MAX_MS = 120_000
"""For so long after it last failed: nobody may try again."""
STORE_CODES = frozenset({"STORE_UNAVAILABLE", "STORAGE_DAMAGED", "ERASE_KEYS_DAMAGED"})
"""Of a custodian's own store and keys; other refusals of an upload are of its robot."""

Work = Literal["following", "uploads", "fetching"]


@dataclass(slots=True)
class _Failure:
    since_ms: int
    last_ms: int
    error: BlockRobotError


class WorkFailures:
    """Failures of work that is tried again, until it succeeds."""

    def __init__(self, clock_ms: Callable[[], int]) -> None:
        self._clock_ms = clock_ms
        self._failures: dict[Work, _Failure] = {}

    @contextmanager
    def noted(self, work: Work) -> Iterator[None]:
        try:
            yield
        except BlockRobotError as error:
            if error.code in STORE_CODES:
                now_ms = self._clock_ms()
                since_ms = next((each.since_ms for each in self._shown(now_ms, work)), now_ms)
                self._failures[work] = _Failure(since_ms, now_ms, error)
            raise
        self._failures.pop(work, None)

    def _shown(self, now_ms: int, *works: Work) -> list[_Failure]:
        found = [self._failures[work] for work in works if work in self._failures]
        return [each for each in found if now_ms - each.last_ms <= SHOWN_MAX_MS]

    def describe(self) -> list[WorkFailure]:
        now_ms = self._clock_ms()
        return [
            WorkFailure(
                work=work, code=each.error.code, detail=each.error.detail, failing_s=(now_ms - each.since_ms) // 1000
            )
            for work in sorted(self._failures)
            for each in self._shown(now_ms, work)
        ]

    @property
    def code(self) -> str | None:
        """Of the first; details are for the operator alone."""
        return next((each.code for each in self.describe()), None)

    def require_following(self) -> None:
        """Raises why the chain is not followed: who waits for that would wait in vain."""
        for failure in self._shown(self._clock_ms(), "following"):
            raise BlockRobotError(failure.error.code, failure.error.detail)
