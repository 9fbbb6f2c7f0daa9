"""A program of ours on a host that takes a line of JSON and answers with one, in time."""

from __future__ import annotations

import subprocess
import tempfile
from contextlib import suppress
from threading import Timer
from types import TracebackType
from typing import Self

import msgspec
from msgspec import Struct

from consensus.errors import BlockRobotError
from network.lab.hosts.founded_network import FoundedNetwork
from network.lab.hosts.namespaces import Host

ANSWER_MAX_S, END_MAX_S = 180.0, 30.0


class RemoteProgram:
    """Ends with `with`. What it writes on standard error goes to a file, where it never fills a pipe."""

    def __init__(self, network: FoundedNetwork, host: Host, module: str) -> None:
        self._where = f"`{module}` on {host.name}"
        self._said = tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace")  # noqa: SIM115 - closed by __exit__
        self._process = network.spawn(host, module, stderr=self._said)

    def __enter__(self) -> Self:
        return self

    def ask(self, order: Struct | None = None) -> str:
        """Raises HOSTS_STORY_FAILED."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write((msgspec.json.encode(order).decode() if order else "{}") + "\n")
            self._process.stdin.flush()
        except OSError:
            raise self._failed("ended early") from None
        return self.answer()

    def answer(self) -> str:
        """Its next line. Raises HOSTS_STORY_FAILED."""
        assert self._process.stdout is not None
        late = Timer(ANSWER_MAX_S, self._process.kill)
        late.start()
        try:
            line = self._process.stdout.readline()
        finally:
            late.cancel()
        if not line:
            raise self._failed(f"ended early, or said nothing within {ANSWER_MAX_S:g} s")
        return line

    def end(self) -> str:
        """No more orders come: its last line. Raises HOSTS_STORY_FAILED."""
        self._close_input()
        return self.answer()

    def _close_input(self) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.close()

    def _failed(self, how: str) -> BlockRobotError:
        self._said.seek(0)
        return BlockRobotError("HOSTS_STORY_FAILED", f"{self._where} {how}: {self._said.read().strip()}")

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._close_input()
        try:
            self._process.wait(0.1 if error else END_MAX_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for stream in (self._process.stdout, self._said):
            if stream is not None:
                stream.close()
