"""Processes that share the work of a measurement."""

from __future__ import annotations

import multiprocessing
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from types import FrameType

_EXIT_BY_SIGNAL = 128


@contextmanager
def worker_pool(processes: int, initializer: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of fresh interpreters, killed on early exit; SIGTERM exits with 143."""
    pool = ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn"), initializer=initializer)
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, _leave) if in_main else None
    try:
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        if in_main:
            signal.signal(signal.SIGTERM, before)


def _leave(number: int, _frame: FrameType | None) -> None:
    sys.exit(_EXIT_BY_SIGNAL + number)
