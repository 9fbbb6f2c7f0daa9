"""A child process that is killed in the middle of a removal."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from typing import Any


def is_killed_after(removals: int, work: Callable[[], object]) -> bool:
    """Whether `work` came so far: it dies once it has removed so many files and folders."""
    child = os.fork()
    if not child:
        left = iter(range(removals - 1, -1, -1))

        def then_die(remove: Callable[..., None]) -> Callable[..., None]:
            def removed(*arguments: Any, **options: Any) -> None:
                remove(*arguments, **options)
                if next(left) == 0:
                    os.kill(os.getpid(), signal.SIGKILL)

            return removed

        os.unlink, os.rmdir = then_die(os.unlink), then_die(os.rmdir)  # type: ignore[misc]
        try:
            work()
        finally:
            os._exit(0)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
