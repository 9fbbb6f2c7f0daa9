"""Secrets in memory: wiped where they lie, and a process that leaves no core file."""

from __future__ import annotations

import secrets
import subprocess
import sys

import pytest

from node.process_memory import wipe


def test_bytes_and_bytearrays_are_wiped_where_they_lie() -> None:
    secret, other, buffer = secrets.token_bytes(32), secrets.token_bytes(32), bytearray(b"secret")
    copy = bytes(bytearray(other))
    wipe(secret)
    wipe(buffer)
    assert secret == bytes(32)
    assert buffer == bytes(6)
    assert other == copy


@pytest.mark.parametrize("value", [b"", b"a", b"\x07"])
def test_short_bytes_that_the_interpreter_shares_stay(value: bytes) -> None:
    before = bytes(bytearray(value))
    wipe(value)
    assert value == before


LOOK = """
import ctypes, resource, sys
from node.process_memory import guard_process
if sys.platform == "linux":
    print(guard_process(), resource.getrlimit(resource.RLIMIT_CORE)[0], ctypes.CDLL(None).prctl(3, 0, 0, 0, 0))
else:
    print(guard_process())
"""


def test_a_guarded_process_leaves_no_core_file_and_cannot_be_read() -> None:
    child = subprocess.run([sys.executable, "-c", LOOK], capture_output=True, text=True, check=True)
    if sys.platform == "linux":
        assert child.stdout.split() == ["True", "0", "0"]
    else:
        assert child.stdout.startswith("False")
