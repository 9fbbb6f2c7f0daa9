"""What commands say in the course of a story, held against a file: a golden transcript.

`BLOCKROBOT_WRITE_TRANSCRIPTS=1 pytest tests/unit/clients/wallet` writes the files anew. They are what people read: look at
what changed before you commit it.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from click.testing import Result

WRITE_VARIABLE = "BLOCKROBOT_WRITE_TRANSCRIPTS"
TRANSCRIPTS = Path(__file__).parents[1] / "unit" / "clients" / "wallet" / "transcripts"
VARYING = re.compile(
    r"(?P<moment>\d{4}-\d\d-\d\d[ T]\d\d:\d\d(?::\d\d)?(?: UTC(?:[+-]\d\d:\d\d)?)?)"
    r"|(?P<handle>\bbrh1-[a-z0-9-]+|\b(?:[0-9a-f]{8} ){7}[0-9a-f]{8}\b)"
    r"|\b(?P<block>block|bloco) +\d+\b"
    r"|\b(?P<id>[0-9a-f]{8})[0-9a-f]*\b"
)
"""What is another each time, or counts blocks that a test's world made."""


class Transcript:
    """Commands, each with who typed it, and what they said; names and moments of one run stand as numbers and words."""

    def __init__(self, folder: Path) -> None:
        self._folder = str(folder)
        self._lines: list[str] = []
        self._names: dict[str, str] = {}

    def follow(self, run: Callable[..., Result], who: str = "") -> Callable[..., None]:
        """Return what calls a command by `run` and notes it. All is typed by `who`, or by whom the first argument names."""

        def say(*arguments: object, **more: Any) -> None:
            result = run(*arguments, **more)
            typist, *typed = (who, *arguments) if who else arguments
            self.note(str(typist), typed, result)

        return say

    def note(self, who: str, arguments: Sequence[object], result: Result) -> None:
        ending = f"[exit {result.exit_code}]" if result.exit_code else ""
        said = (line.rstrip() for line in result.output.rstrip().splitlines())
        self._lines += [f"{who} $ {' '.join(map(str, arguments))} {ending}".rstrip(), *said, ""]

    def compare(self, name: str) -> None:
        """Hold all that was noted against the file of this name."""
        told = VARYING.sub(self._steady, "\n".join(self._lines).replace(self._folder, "FOLDER"))
        path = TRANSCRIPTS / f"{name}.txt"
        if os.environ.get(WRITE_VARIABLE):
            path.write_text(told, encoding="utf-8")
        assert told.splitlines() == path.read_text(encoding="utf-8").splitlines()

    def _steady(self, found: re.Match[str]) -> str:
        if found["moment"]:
            return "<moment>"
        if found["block"]:
            return f"{found['block']} <height>"
        kind, name = ("handle", found["handle"]) if found["handle"] else ("id", found["id"])
        return self._names.setdefault(name, f"<{kind} {len(self._names) + 1}>")
