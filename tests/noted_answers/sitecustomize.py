"""Runs in every Python that a test starts with this folder on PYTHONPATH: notes what commands answer with --json.

The answers of processes that other processes start are nowhere else to be had. Must never change an answer.
"""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

WATCHED = "clients.sdk.terminal.terminal"
FILE_VARIABLE = "BLOCKROBOT_TEST_ANSWERS_FILE"


def note_answers(terminal: Any, file: str) -> None:
    """Let each answer, with the names of the commands that lead to the one that prints it, be a line of the file."""
    import click

    write = terminal.write_json

    def noting(value: Any) -> str:
        context = click.get_current_context(silent=True)
        names = []
        while context is not None and context.parent is not None:
            names.append(context.command.name)
            context = context.parent
        line = json.dumps({"words": " ".join(map(str, reversed(names))), "told": value}) + "\n"
        descriptor = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600)
        try:
            os.write(descriptor, line.encode())
        finally:
            os.close(descriptor)
        return str(write(value))

    terminal.write_json = noting


class _Noting(MetaPathFinder):
    """Finds the one module as others would, and notes its answers once it is loaded."""

    def __init__(self, file: str) -> None:
        self._file = file

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None,
        target: ModuleType | None = None,
    ) -> ModuleSpec | None:
        if fullname != WATCHED:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            run = spec.loader.exec_module

            def run_and_note(module: ModuleType) -> None:
                run(module)
                note_answers(module, self._file)

            spec.loader.exec_module = run_and_note  # type: ignore[method-assign]
        return spec


if FILE_VARIABLE in os.environ:
    sys.meta_path.insert(0, _Noting(os.environ[FILE_VARIABLE]))
