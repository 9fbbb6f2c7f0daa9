"""The contract worker's sandbox, closed irrevocably from inside before any contract runs.

Parts are independent and missing ones reported. Order matters: the last forbids what earlier ones need.
"""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys
from collections.abc import Callable
from pathlib import Path

from contracts.worker.system_calls import allow_only_listed
from contracts.worker.wire import SandboxFeature

PARTS = (
    "environment",
    "descriptors",
    "memory",
    "limits",
    "network",
    "capabilities",
    "undumpable",
    "no_new_privileges",
    "system_calls",
)
"""All parts, in the order in which they are closed."""
REQUIRED_PARTS = frozenset(PARTS) - {"network"}
"""What a node that requires the sandbox must have. Without a network namespace the filter of system calls still stands."""

_PR_SET_DUMPABLE = 4
_PR_SET_NO_NEW_PRIVS = 38
_CLONE_NEWUSER = 0x10000000
_CLONE_NEWNET = 0x40000000
_CAPABILITY_VERSION_3 = 0x20080522
_PROC = Path("/proc/self")
_PAGE_BYTES = resource.getpagesize()


def enter_sandbox(kept_files: tuple[Path, ...], memory_max_bytes: int) -> tuple[SandboxFeature, ...]:
    """Close the sandbox; return its parts. Descriptors on `kept_files` and the standard ones stay open.

    `memory_max_bytes` limits additional memory; 0 sets no limit.
    """
    libc = ctypes.CDLL(None, use_errno=True) if sys.platform == "linux" else None
    steps: tuple[Callable[[], str], ...] = (
        _empty_environment,
        lambda: _close_descriptors(kept_files),
        lambda: _limit_memory(memory_max_bytes),
        _limit_resources,
        lambda: _leave_network(libc),
        lambda: _drop_capabilities(libc),
        lambda: _control(libc, _PR_SET_DUMPABLE, 0),
        lambda: _control(libc, _PR_SET_NO_NEW_PRIVS, 1),
        lambda: _filter_calls(libc),
    )
    return tuple(_close(name, step) for name, step in zip(PARTS, steps, strict=True))


def _close(name: str, step: Callable[[], str]) -> SandboxFeature:
    try:
        trouble = step()
    except (OSError, ValueError) as error:
        trouble = f"{type(error).__name__}: {error}"
    return SandboxFeature(name, not trouble, trouble)


def _empty_environment() -> str:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the node is told to stop, and closes the pipe
    os.environ.clear()
    return "" if not os.environ else "the environment cannot be emptied"


def _close_descriptors(kept_files: tuple[Path, ...]) -> str:
    folder = _PROC / "fd"
    if not folder.is_dir():
        return "the system does not say which descriptors are open"
    kept = {str(path.resolve()) for path in kept_files}
    for name in os.listdir(folder):  # noqa: PTH208 - a live folder
        number = int(name)
        try:
            target = str((folder / name).readlink())
        except FileNotFoundError:  # the folder's own, closed by now
            continue
        if number > 2 and target not in kept:
            os.close(number)
    return ""


def _limit_resources() -> str:
    for limit in (resource.RLIMIT_NOFILE, resource.RLIMIT_FSIZE, resource.RLIMIT_CORE, resource.RLIMIT_NPROC):
        resource.setrlimit(limit, (0, 0))
    if sys.platform == "linux":
        for limit in (resource.RLIMIT_MEMLOCK, resource.RLIMIT_MSGQUEUE, resource.RLIMIT_SIGPENDING):
            resource.setrlimit(limit, (0, 0))
    return ""


def _limit_memory(memory_max_bytes: int) -> str:
    """Private memory has its own limit: address space includes the ledger map."""
    if not memory_max_bytes:
        return ""
    path = _PROC / "statm"
    if not path.is_file():
        return "the system does not say how much memory is taken"
    fields = path.read_text(encoding="ascii").split()
    for limit, pages in ((resource.RLIMIT_DATA, fields[5]), (resource.RLIMIT_AS, fields[0])):
        size_bytes = int(pages) * _PAGE_BYTES + memory_max_bytes
        _, hard = resource.getrlimit(limit)
        if hard != resource.RLIM_INFINITY:
            size_bytes = min(size_bytes, hard)
        resource.setrlimit(limit, (size_bytes, size_bytes))
    return ""


def _leave_network(libc: ctypes.CDLL | None) -> str:
    if libc is None:
        return "only Linux has network namespaces"
    if libc.unshare(_CLONE_NEWNET) and libc.unshare(_CLONE_NEWUSER | _CLONE_NEWNET):
        return f"the system permits no network namespace (errno {ctypes.get_errno()})"
    return ""


def _drop_capabilities(libc: ctypes.CDLL | None) -> str:
    if libc is None:
        return "only Linux has capabilities"
    header = (ctypes.c_uint32 * 2)(_CAPABILITY_VERSION_3, 0)
    if libc.capset(header, (ctypes.c_uint32 * 6)()):
        return f"the kernel refused (errno {ctypes.get_errno()})"
    return ""


def _control(libc: ctypes.CDLL | None, option: int, value: int) -> str:
    if libc is None:
        return "only Linux knows this"
    if libc.prctl(option, value, 0, 0, 0):
        return f"the kernel refused (errno {ctypes.get_errno()})"
    return ""


def _filter_calls(libc: ctypes.CDLL | None) -> str:
    return "only Linux can filter system calls" if libc is None else allow_only_listed(libc)
