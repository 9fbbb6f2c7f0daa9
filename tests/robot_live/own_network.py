"""Runs a test in a network of its own, which has nothing but a loopback interface: middleware may bind what it likes there.

A thread leaves the machine's network, and what it starts is where it is. Must never fall back to the machine's.
Shared memory is its own too: Fast DDS numbers its queues in /dev/shm by ports, which two networks both have.
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
from typing import Any

WAY_OUT = "make test ROS2=none"
_CLONE_NEWNS, _CLONE_NEWNET = 0x2_0000, 0x4000_0000
_MS_REC_PRIVATE = 0x4000 | 0x4_0000
_SHARED_MEMORY = b"/dev/shm"
_SIOCSIFFLAGS = 0x8914
_UP_LOOPBACK_RUNNING_MULTICAST = 0x1 | 0x8 | 0x40 | 0x1000


class NoOwnNetworkError(Exception):
    """The system does not let this process have a network of its own; the text says what to do."""


def run_in_own_network(test: Callable[[], Coroutine[Any, Any, None]]) -> None:
    """Run a coroutine in an event loop in a network of its own. Raises NoOwnNetworkError, and whatever it raises."""
    failures: list[BaseException] = []

    def run() -> None:
        try:
            _leave_the_network()
            asyncio.run(test())
        except BaseException as error:  # noqa: BLE001 - raised again where the test waits
            failures.append(error)

    thread = threading.Thread(target=run, name="own-network")
    thread.start()
    thread.join()
    if failures:
        raise failures[0]


def _leave_the_network() -> None:
    library = ctypes.CDLL(None, use_errno=True)
    if (
        library.unshare(_CLONE_NEWNET | _CLONE_NEWNS) != 0
        or library.mount(None, b"/", None, _MS_REC_PRIVATE, None) != 0
        or library.mount(b"tmpfs", _SHARED_MEMORY, b"tmpfs", 0, None) != 0
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


async def nothing() -> None:
    """Do nothing: to find out whether there can be a network of our own."""
