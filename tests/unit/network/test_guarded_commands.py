"""Every command line leaves no core file and is read by no other process of its user: any of them may open a key."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

LOOK = """
import ctypes, resource, sys
from network.cli.main import main
try:
    main.main(sys.argv[1:], prog_name="blockrobot")
except SystemExit:
    pass
is_readable = ctypes.CDLL(None).prctl(3, 0, 0, 0, 0) if sys.platform == "linux" else "-"
print()
print(resource.getrlimit(resource.RLIMIT_CORE)[0] if sys.platform == "linux" else 0, is_readable)
"""


@pytest.mark.parametrize(
    "line", ["", "--version", "explore --no-such", "verify --no-such", "wallet --help", "no-such-command --json"]
)
def test_every_command_line_is_guarded(line: str) -> None:
    look(line.split(), {})


def test_what_a_shell_asks_for_is_guarded() -> None:
    look([], {"_BLOCKROBOT_COMPLETE": "bash_complete", "COMP_WORDS": "blockrobot wallet ", "COMP_CWORD": "2"})


def look(arguments: list[str], settings: dict[str, str]) -> None:
    child = subprocess.run(
        [sys.executable, "-c", LOOK, *arguments], capture_output=True, text=True, check=True, env=os.environ | settings
    )
    assert child.stdout.split()[-2:] == ["0", "0" if sys.platform == "linux" else "-"], child.stderr
