"""Cleans up after a run of experiments that was killed.

A process that reads lines from the run: `pid N`, `network FOLDER` at each start, `end` after a clean stop. If the input
ends without `end` (SIGKILL), it stops everything named.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from network.run_folder import stop_network

_COMMAND_MODULE = b"network.cli.main"


class Guard:
    """The run's side of the guard process. Context manager."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None

    def __enter__(self) -> Guard:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "network.experiments.guard"],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._tell("end")
        if self._process is not None:
            if self._process.stdin is not None:
                with contextlib.suppress(BrokenPipeError):
                    self._process.stdin.close()
            self._process.wait()

    def watch_process(self, pid: int) -> None:
        self._tell(f"pid {pid}")

    def watch_network(self, folder: Path) -> None:
        self._tell(f"network {folder}")

    def _tell(self, line: str) -> None:
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._process.stdin.write(line + "\n")
                self._process.stdin.flush()


def run_guard(lines: Iterable[str]) -> None:
    """At end of input without `end`, stop everything named."""
    pids: list[int] = []
    networks: list[Path] = []
    for line in lines:
        word, _, value = line.rstrip("\n").partition(" ")
        if word == "end":
            return
        if word == "pid":
            pids.append(int(value))
        elif word == "network":
            networks.append(Path(value))
    for pid in pids:
        if _is_own_command(pid):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    for network in networks:
        stop_network(network)


def _is_own_command(pid: int) -> bool:
    """If known."""
    try:
        return _COMMAND_MODULE in Path(f"/proc/{pid}/cmdline").read_bytes().split(b"\0")
    except OSError:
        return False


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    run_guard(sys.stdin)
