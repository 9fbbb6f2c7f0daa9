"""Every command that opens keys, tags or erase keys leaves no core file and is read by no other process of its user."""

from __future__ import annotations

import subprocess
import sys

import pytest

from network.cli.main import SECTIONS, WITHOUT_SECRETS

COMMANDS = {name for names in SECTIONS.values() for name in names}
LOOK = """
import ctypes, resource, sys
from network.cli.main import main
try:
    main.main(sys.argv[1:], standalone_mode=False)
except BaseException as error:
    print(type(error).__name__, file=sys.stderr)
is_readable = ctypes.CDLL(None).prctl(3, 0, 0, 0, 0) if sys.platform == "linux" else "-"
print(resource.getrlimit(resource.RLIMIT_CORE)[0] if sys.platform == "linux" else 0, is_readable)
"""


def test_what_is_not_guarded_is_a_command() -> None:
    assert WITHOUT_SECRETS < COMMANDS


@pytest.mark.parametrize("command", sorted(COMMANDS - WITHOUT_SECRETS))
def test_a_command_that_may_open_secrets_is_guarded(command: str) -> None:
    arguments = [sys.executable, "-c", LOOK, command, "--no-such"]
    child = subprocess.run(arguments, capture_output=True, text=True, check=True)
    assert child.stdout.split()[-2:] == ["0", "0" if sys.platform == "linux" else "-"], child.stderr
