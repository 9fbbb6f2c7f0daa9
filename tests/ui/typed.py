"""A command at a pseudo-terminal, typed into as a person would: `expect` what is asked, `sendline` the answer."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pexpect

from tests.waiting_process import wait_for_reading

WIPED = "\x1b[H\x1b[2J\x1b[3J"
CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
ANSWER_MAX_S = 60
ROWS = 40


class Typed(pexpect.spawn):
    """A wallet's command behind a pseudo-terminal."""

    def answer(self, question: str, said: str) -> None:
        """Wait until it is asked, and type the answer."""
        self.expect(question)
        self.sendline(said)

    def choose_passphrase(self, passphrase: str) -> None:
        """Answer both questions for a new one. What is typed sooner, at the advice before them, is thrown away."""
        self.answer("(?:Passphrase|Frase-passe): ", passphrase)
        self.answer("(?:once more|outra vez): ", passphrase)

    def press_ctrl_c(self, until: Any) -> None:
        """Press Ctrl-C once, as soon as a key is waited for; expect what it must bring: a pattern, or the end."""
        wait_for_reading(self.pid)
        self.sendintr()
        self.expect(until)

    def ended_by_ctrl_c(self) -> int:
        """Press Ctrl-C once, as soon as a key is waited for; return the exit code of the command that it ends."""
        self.press_ctrl_c(pexpect.EOF)
        return self._exit_code()

    def ended(self) -> int:
        """Wait for the end; return the exit code."""
        self.expect(pexpect.EOF)
        return self._exit_code()

    def _exit_code(self) -> int:
        self.close()
        assert self.exitstatus is not None, f"ended by signal {self.signalstatus}"
        return int(self.exitstatus)

    def rest(self) -> str:
        """Return all that was still written, with its control sequences. It has to have ended before."""
        return str(self.before)


def plain(text: str) -> str:
    """Return what a person reads: without control sequences, every run of white space as one space."""
    return " ".join(CONTROL.sub("", text).split())


def at_terminal(home: Path, *arguments: str, output: Path | None = None, **terminal: Any) -> Typed:
    """Begin `blockrobot wallet` with these arguments, BLOCKROBOT_HOME being `home`, in English unless it says otherwise.

    Its standard output goes to a file if one is named; keyboard and standard error stay at the terminal.
    """
    program, command = sys.executable, ["-m", "network.cli.main", "wallet", *arguments]
    if output is not None:
        program, command = "/bin/sh", ["-c", 'log=$1; shift; exec "$@" > "$log"', "sh", str(output), program, *command]
    return _begin(home, program, command, **terminal)


def type_line(home: Path, line: str, **terminal: Any) -> Typed:
    """Begin a command exactly as it was printed, `blockrobot` and quotes and all, as a shell reads it."""
    return _begin(home, "/bin/sh", ["-c", line], **terminal)


def _begin(
    home: Path,
    program: str,
    command: list[str],
    *,
    columns: int = 100,
    term: str = "xterm-256color",
    environment: Mapping[str, str] = {},
    folder: Path = Path(__file__).parents[2],
) -> Typed:
    kept = {name: os.environ[name] for name in ("HOME", "VIRTUAL_ENV") if name in os.environ}
    kept["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath)])
    settings = {"BLOCKROBOT_HOME": str(home), "BLOCKROBOT_LANGUAGE": "en", "LANG": "C.UTF-8", "TERM": term}
    return Typed(
        program,
        command,
        env=kept | settings | dict(environment),
        dimensions=(ROWS, columns),
        encoding="utf-8",
        timeout=ANSWER_MAX_S,
        cwd=str(folder),
    )
