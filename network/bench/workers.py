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
    """Give processes to share work with, each a fresh interpreter.

    Whatever ends the block early (an error, Ctrl-C, SIGTERM) ends the workers in the middle of their work: nobody wants
    their results any more. SIGTERM exits with 143, as if there were no workers.
    """
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
