"""How a command was called, so that the next commands that it names keep what it was told."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable
from pathlib import Path


def called_with(command: str, options: Iterable[tuple[str, str | Path | None]]) -> str:
    """With those options that were given, and files by their whole paths."""
    words = [command]
    for option, value in options:
        if value is not None:
            shown = str(value.absolute()) if isinstance(value, Path) else value
            words.append(f"{option} {shlex.quote(shown)}")
    return " ".join(words)


def name_in_full(words: str, command: str, full: str) -> str:
    """Put `full` where words call the command; idempotent. One with an option behind it says itself what it means."""
    # A folder's or a file's name that has these words in it is no command.
    call = rf"(?<![\w./\\-]){command}(?! --)(?=[.,;:!?)\]`]*(?:\s|$))"
    # What is called so already is stepped over whole: the paths in it may have the command's words too.
    return re.sub(f"{re.escape(full)}|{call}", lambda _: full, words)
