"""Processes of a measurement: what starts nodes stops them however it ends, and workers share the work.

SIGTERM and SIGHUP cancel a measurement once, like Ctrl-C.
"""

from __future__ import annotations

import asyncio
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Coroutine, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from types import FrameType
from typing import Any, TypeVar

from network.bench.cluster import cluster_pool

SIGNALS = (signal.SIGTERM, signal.SIGHUP)
_EXIT_BY_SIGNAL = 128

T = TypeVar("T")


def run_to_end(work: Coroutine[Any, Any, T]) -> T:
    """Exits with 128 plus signal number if one ended it."""
    heard: list[signal.Signals] = []

    async def cancellable() -> T:
        loop, task = asyncio.get_running_loop(), asyncio.current_task()
        assert task is not None

        def end(number: signal.Signals) -> None:
            if not heard:
                task.cancel()
            heard.append(number)

        for number in SIGNALS:
            if signal.getsignal(number) is not signal.SIG_IGN:  # as under `nohup`
                loop.add_signal_handler(number, end, number)
        return await work

    try:
        return asyncio.run(cancellable())
    except asyncio.CancelledError:
        if not heard:
            raise
        sys.exit(_EXIT_BY_SIGNAL + heard[0])


@contextmanager
def worker_pool(processes: int, on: str = "") -> Iterator[Executor]:
    """Fresh interpreters with one thread each, killed on early exit, or a cluster's; SIGTERM exits with 143."""
    if on:
        with leave_by_exit(), cluster_pool(on) as cluster:
            yield cluster
        return
    pool = ProcessPoolExecutor(processes, mp_context=multiprocessing.get_context("spawn"), initializer=_one_thread)
    with leave_by_exit():
        try:
            yield pool
        except BaseException:
            for child in multiprocessing.active_children():
                child.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def leave_by_exit() -> Iterator[None]:
    """SIGTERM unwinds the stack, so that what was begun is ended."""
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, _leave) if in_main else None
    try:
        yield
    finally:
        if in_main:
            signal.signal(signal.SIGTERM, before)


def _one_thread() -> None:
    """Processes are the parallelism."""
    import cv2  # noqa: PLC0415 - benches without workers need none of it

    os.environ["OMP_NUM_THREADS"] = "1"
    cv2.setNumThreads(1)


def _leave(number: int, _frame: FrameType | None) -> None:
    sys.exit(_EXIT_BY_SIGNAL + number)
