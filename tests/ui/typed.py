"""A command at a pseudo-terminal, typed into as a person would: `expect` what is asked, `sendline` the answer."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from pathlib import Path

import pexpect

CONTROL = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")
ANSWER_MAX_S = 60
ROWS = 40


class Typed(pexpect.spawn):
    """A wallet's command behind a pseudo-terminal."""

    def ended(self) -> int:
        """Wait for the end; return the exit code."""
        self.expect(pexpect.EOF)
        self.close()
        assert self.exitstatus is not None, f"ended by signal {self.signalstatus}"
        return int(self.exitstatus)

    def rest(self) -> str:
        """Return all that was still written, with its control sequences. `ended` has to come before."""
        return str(self.before)


def at_terminal(
    home: Path,
    *arguments: str,
    columns: int = 100,
    term: str = "xterm-256color",
    environment: Mapping[str, str] = {},
    output: Path | None = None,
) -> Typed:
    """Begin `blockrobot wallet` with these arguments, BLOCKROBOT_HOME being `home`, in English unless it says otherwise.

    Its standard output goes to a file if one is named; keyboard and standard error stay at the terminal.
    """
    kept = {name: os.environ[name] for name in ("PATH", "HOME", "VIRTUAL_ENV") if name in os.environ}
    settings = {"BLOCKROBOT_HOME": str(home), "BLOCKROBOT_LANGUAGE": "en", "LANG": "C.UTF-8", "TERM": term}
    command = ["-m", "network.cli.main", "wallet", *arguments]
    program = sys.executable
    if output is not None:
        program, command = "/bin/sh", ["-c", 'log=$1; shift; exec "$@" > "$log"', "sh", str(output), program, *command]
    return Typed(
        program,
        command,
        env=kept | settings | dict(environment),
        dimensions=(ROWS, columns),
        encoding="utf-8",
        timeout=ANSWER_MAX_S,
        cwd=str(Path(__file__).parents[2]),
    )
