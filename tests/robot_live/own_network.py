"""Runs a test in a network of its own, which has nothing but a loopback interface: middleware may bind what it likes there.

A thread leaves the machine's network, and what it starts is where it is. Must never fall back to the machine's.
Shared memory is its own too: Fast DDS numbers its queues in /dev/shm by ports, which two networks both have. The test's
files may lie there: their folder stays.
"""

from __future__ import annotations

import asyncio
import ctypes
import fcntl
import os
import socket
import struct
import threading
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

WAY_OUT = "make test ROS2=none"
_CLONE_NEWNS, _CLONE_NEWNET = 0x2_0000, 0x4000_0000
_MS_BIND, _MS_REC_PRIVATE = 0x1000, 0x4000 | 0x4_0000
_SHARED_MEMORY = Path("/dev/shm")
_SIOCSIFFLAGS = 0x8914
_UP_LOOPBACK_RUNNING_MULTICAST = 0x1 | 0x8 | 0x40 | 0x1000


class NoOwnNetworkError(Exception):
    """The system does not let this process have a network of its own; the text says what to do."""


def run_in_own_network(test: Callable[[], Coroutine[Any, Any, None]], folder: Path) -> None:
    """Run a coroutine in an event loop in a network of its own, and keep the folder of its files.

    Raises NoOwnNetworkError, and whatever the coroutine raises.
    """
    failures: list[BaseException] = []

    def run() -> None:
        try:
            _leave_the_network(folder)
            asyncio.run(test())
        except BaseException as error:  # noqa: BLE001 - raised again where the test waits
            failures.append(error)

    thread = threading.Thread(target=run, name="own-network")
    thread.start()
    thread.join()
    if failures:
        raise failures[0]


def _leave_the_network(folder: Path) -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if (
        library.unshare(_CLONE_NEWNET | _CLONE_NEWNS) != 0
        or library.mount(None, b"/", None, _MS_REC_PRIVATE, None) != 0
        or not _has_own_shared_memory(library, folder)
    ):
        why = os.strerror(ctypes.get_errno())
        raise NoOwnNetworkError(
            f"Tests of ROS 2 need a network and a /dev/shm of their own, and the system says: {why}.\n"
            "Next step: run them as root, or where users may have namespaces as\n"
            "  unshare --map-root-user make test\n"
            f"or leave them out (they are counted at the end):\n  {WAY_OUT}"
        )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        request = struct.pack("16sH14x", b"lo", _UP_LOOPBACK_RUNNING_MULTICAST)
        fcntl.ioctl(any_socket, _SIOCSIFFLAGS, request)


def _has_own_shared_memory(library: ctypes.CDLL, folder: Path) -> bool:
    """Cover /dev/shm, and bring the folder back if it was below."""
    kept = os.open(folder, os.O_PATH | os.O_DIRECTORY)
    try:
        if library.mount(b"tmpfs", bytes(_SHARED_MEMORY), b"tmpfs", 0, None) != 0:
            return False
        if not folder.is_relative_to(_SHARED_MEMORY):
            return True
        folder.mkdir(parents=True)
        return library.mount(f"/proc/self/fd/{kept}".encode(), bytes(folder), None, _MS_BIND, None) == 0
    finally:
        os.close(kept)


async def nothing() -> None:
    """Do nothing: to find out whether there can be a network of our own."""
