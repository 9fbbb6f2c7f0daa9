"""A node's process: secrets are wiped where they lie, it leaves no core file, and a signal in its start does not end it."""

from __future__ import annotations

import secrets
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from node import main
from node.process_memory import wipe


def test_a_reload_before_the_node_is_open_does_not_end_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def load(_data_dir: Path) -> None:
        signal.raise_signal(signal.SIGHUP)
        seen.append(signal.getsignal(signal.SIGHUP))
        raise BlockRobotError("DATA_DIRECTORY_INVALID")

    monkeypatch.setattr(main, "load_config", load)
    before = signal.signal(signal.SIGHUP, lambda *_: seen.append("ended"))
    try:
        assert main.run_process(tmp_path) == 1
    finally:
        signal.signal(signal.SIGHUP, before)
    assert seen == [signal.SIG_IGN]


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
