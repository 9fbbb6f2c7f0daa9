"""The seccomp allow-list of a contract worker's system calls.

A classic BPF filter: unlisted calls fail with EPERM; another architecture's end the process.
"""

from __future__ import annotations

import ctypes
import platform
import struct

_ALLOWED_X86_64 = {
    "read": 0, "write": 1, "close": 3, "munmap": 11, "brk": 12, "rt_sigprocmask": 14, "rt_sigreturn": 15,
    "sched_yield": 24, "mremap": 25, "madvise": 28, "exit": 60, "gettimeofday": 96, "gettid": 186, "futex": 202,
    "restart_syscall": 219, "clock_gettime": 228, "exit_group": 231, "getrandom": 318, "rseq": 334,
}  # fmt: skip
_ALLOWED_AARCH64 = {
    "read": 63, "write": 64, "close": 57, "munmap": 215, "brk": 214, "rt_sigprocmask": 135, "rt_sigreturn": 139,
    "sched_yield": 124, "mremap": 216, "madvise": 233, "exit": 93, "gettimeofday": 169, "gettid": 178, "futex": 98,
    "restart_syscall": 128, "clock_gettime": 113, "exit_group": 94, "getrandom": 278, "rseq": 293,
}  # fmt: skip
_MAPPING_X86_64 = {"mmap": 9, "mprotect": 10}
_MAPPING_AARCH64 = {"mmap": 222, "mprotect": 226}
_ARCHITECTURES = {
    "x86_64": (0xC000003E, _ALLOWED_X86_64, _MAPPING_X86_64),
    "aarch64": (0xC00000B7, _ALLOWED_AARCH64, _MAPPING_AARCH64),
}
_X32_BIT = 0x40000000

_LOAD, _IF_EQUAL, _IF_AT_LEAST, _IF_ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_NUMBER_OFFSET, _ARCHITECTURE_OFFSET, _THIRD_ARGUMENT_OFFSET = 0, 4, 32
_ALLOW, _KILL_PROCESS, _FAIL = 0x7FFF0000, 0x80000000, 0x00050000
_EPERM = 1
_PROT_EXEC = 4

_PR_SET_SECCOMP = 22
_SECCOMP_MODE_FILTER = 2
_INSTRUCTION = struct.Struct("=HBBI")


class _Program(ctypes.Structure):
    _fields_ = [("length", ctypes.c_ushort), ("filter", ctypes.c_void_p)]


def build_filter(machine: str) -> bytes | None:
    """For `platform.machine()`; None if unknown."""
    known = _ARCHITECTURES.get(machine)
    if known is None:
        return None
    audit, allowed, mapping = known
    refuse = _INSTRUCTION.pack(_RETURN, 0, 0, _FAIL | _EPERM)
    allow = _INSTRUCTION.pack(_RETURN, 0, 0, _ALLOW)
    kill = _INSTRUCTION.pack(_RETURN, 0, 0, _KILL_PROCESS)
    code = [
        _INSTRUCTION.pack(_LOAD, 0, 0, _ARCHITECTURE_OFFSET),
        _INSTRUCTION.pack(_IF_EQUAL, 1, 0, audit),
        kill,
        _INSTRUCTION.pack(_LOAD, 0, 0, _NUMBER_OFFSET),
        _INSTRUCTION.pack(_IF_AT_LEAST, 0, 1, _X32_BIT),
        kill,
    ]
    for number in allowed.values():
        code += [_INSTRUCTION.pack(_IF_EQUAL, 0, 1, number), allow]
    first, second = mapping.values()  # memory may be mapped, but never as code
    code += [
        _INSTRUCTION.pack(_IF_EQUAL, 2, 0, first),
        _INSTRUCTION.pack(_IF_EQUAL, 1, 0, second),
        refuse,
        _INSTRUCTION.pack(_LOAD, 0, 0, _THIRD_ARGUMENT_OFFSET),
        _INSTRUCTION.pack(_IF_ANY_BIT, 1, 0, _PROT_EXEC),
        allow,
        refuse,
    ]
    return b"".join(code)


def allow_only_listed(libc: ctypes.CDLL) -> str:
    """Install the filter irrevocably; return the failure or an empty text. Needs `no_new_privs` first."""
    code = build_filter(platform.machine())
    if code is None:
        return f"the system calls of {platform.machine()} are not known here"
    text = ctypes.create_string_buffer(code, len(code))
    program = _Program(len(code) // _INSTRUCTION.size, ctypes.cast(text, ctypes.c_void_p))
    if libc.prctl(_PR_SET_SECCOMP, _SECCOMP_MODE_FILTER, ctypes.byref(program), 0, 0):
        return f"the kernel refused the filter (errno {ctypes.get_errno()})"
    return ""
