"""A reader of a tutorial: types its `sh` fences as they are written, at a terminal, and compares what the page shows.

What the first line of a fence says:
`sh`: each line is typed, and succeeds. `sh at NAME`: on that host, or on each that the name stands for. `sh fails`: it
does not succeed. `sh again`: typed until the next fence's lines come.
`text`: lines that the commands of the fence before it wrote, in any order; `...` stands for anything. `text figures`:
every number but 0 may be another. `LANGUAGE file=NAME` and `append=NAME`: what the reader writes into a file.

It must never type what the page does not have a reader type, but for the placeholders that they are to replace, and a
port that is free.
"""

from __future__ import annotations

import os
import re
import subprocess
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import pexpect

from network.cluster import Cluster
from tests.ui.typed import CONTROL, Typed

CLONE = Path(__file__).resolve().parents[2]
COMMAND_TIMEOUT_S = 180
AGAIN_TIMEOUT_S = 60
AGAIN_EVERY_S = 1.0
PASSPHRASE = "tea and lemon cake"
_TAIL_CHARS = 2000
"""How far from the end a question is looked for: a command may write pictures, a megabyte of them."""
_PROMPT = "typed with code $?$ "
_ASKED = [
    r"typed with code (\d+)\$ $",
    r"(?:Passphrase|once more): $",
    r"Word number (\d+): $",
    r"\[y/N\]: $",
    "press Enter: ?$",
    pexpect.EOF,
    pexpect.TIMEOUT,
]
_FENCE = re.compile(r"^```(\w+)(?: ([^\n]*))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_WORD = re.compile(r"(\d+) ([a-z]+)")
_TOKENS = re.compile(r"\.\.\.|\d+|[^\d.]+|\.")


class Fence(NamedTuple):
    """One fence of a page: its language, what else its first line says, its text."""

    language: str
    remark: str
    content: str

    @property
    def place(self) -> str:
        """Where it is typed; empty: on the only host."""
        words = self.remark.split()
        return words[1] if words[:1] == ["at"] else ""

    @property
    def lines(self) -> list[str]:
        """Its lines, but for empty ones at its ends."""
        return self.content.strip("\n").splitlines()

    def missing_in(self, output: str) -> str | None:
        """Return the first line of this fence that the output does not have, None if it has them all."""
        for line in self.lines:
            pattern = "".join(self._pattern_of(token) for token in _TOKENS.findall(line))
            if not any(re.fullmatch(pattern, one.rstrip()) for one in output.splitlines()):
                return line
        return None

    def _pattern_of(self, token: str) -> str:
        if token == "...":
            return ".*"
        return r"\d+" if self.remark == "figures" and token.isdigit() and int(token) else re.escape(token)


def fences_of(page: str) -> list[Fence]:
    """Return the fences of a page of docs/tutorial."""
    text = (CLONE / "docs" / "tutorial" / page).read_text(encoding="utf-8")
    return [Fence(*found) for found in _FENCE.findall(text)]


class Placeholders:
    """What a reader is to replace on a page: by its words, the pattern by whose first group a command tells it."""

    def __init__(self, patterns: dict[str, str], told: dict[str, str] | None = None) -> None:
        self._patterns = {written: re.compile(pattern, re.MULTILINE) for written, pattern in patterns.items()}
        self._told = dict(told or {})

    def fill(self, command: str) -> str:
        for written, told in self._told.items():
            command = command.replace(written, told)
        return command

    def note(self, output: str) -> None:
        for written, pattern in self._patterns.items():
            if found := pattern.search(output):
                self._told[written] = found[1]


class Reader:
    """One shell at a terminal, opened in the clone, with a home below `place` that nothing was in.

    `before`: what goes before the shell, to have it on another host.
    """

    def __init__(
        self, place: Path, placeholders: Placeholders, *, base_port: int = 0, before: Sequence[str] = ()
    ) -> None:
        is_installed = subprocess.run(
            ["make", "--question", ".venv/.runtime", ".venv/.develop"], cwd=CLONE, check=False
        )
        assert is_installed.returncode == 0, (
            "What is typed would install anew beneath the tests: run `make test` first."
        )
        self.shown: dict[str, str] = {}
        self._placeholders = placeholders
        self._base_port = base_port
        self.home = place / "home"
        self.home.mkdir(parents=True)
        environment = {"HOME": str(self.home), "PATH": os.environ["PATH"], "LANG": "C.UTF-8", "PS1": _PROMPT}
        program, *words = [*before, "/bin/bash", "--norc", "--noprofile", "--noediting", "-i"]
        self._shell = Typed(
            program,
            words,
            env=environment | {"TERM": "xterm-256color"},
            cwd=str(CLONE),
            dimensions=(50, 200),
            encoding="utf-8",
            timeout=COMMAND_TIMEOUT_S,
            searchwindowsize=_TAIL_CHARS,
        )
        self._hear("the shell")

    def close(self) -> None:
        """Close the terminal, and stop what the page left running."""
        self._shell.close(force=True)
        for network in self.home.rglob("cluster.json"):
            Cluster(network.parent).stop_all()

    def type(self, command: str, *, fails: bool = False) -> str:
        """Type one line of the page, answer what is asked, and return what was written, as a person reads it."""
        command = self._placeholders.fill(command)
        bare = command.partition("#")[0].strip()
        self._shell.sendline(f"{bare} --base-port {self._base_port}" if bare == "blockrobot up" else command)
        code, output = self._hear(command)
        assert (code != 0) == fails, f"{command}\n{output}"
        self._placeholders.note(output)
        return output

    def _hear(self, command: str) -> tuple[int, str]:
        """Answer until the prompt is back; return the exit code and what was written."""
        heard = ""
        while True:
            asked = self._shell.expect(_ASKED)
            heard += self._shell.before
            assert asked < _ASKED.index(pexpect.EOF), f"{command}\n{heard[-_TAIL_CHARS:]}"
            heard += self._shell.after
            if asked == 0:
                return int(self._shell.match[1]), CONTROL.sub("", heard).replace("\r\n", "\n")
            if asked == 1:
                self._shell.sendline(PASSPHRASE)
            elif asked == 2:
                self._shell.sendline(dict(_WORD.findall(CONTROL.sub("", heard)))[self._shell.match[1]])
            else:
                self._shell.sendline("y" if asked == 3 else "")

    def follow(self, page: str) -> None:
        """Do what a page of docs/tutorial says, from its beginning to its end."""
        follow(page, {"": [self]})

    def type_all(self, fence: Fence) -> str:
        """Type the lines of a fence; return what was written."""
        for line in fence.lines:
            self.shown[line.partition("  #")[0].rstrip()] = self.type(line, fails="fails" in fence.remark.split())
        return "".join(self.shown[line.partition("  #")[0].rstrip()] for line in fence.lines)

    def write(self, fence: Fence) -> None:
        how, _, name = fence.remark.partition("=")
        path = Path(f"/proc/{self._shell.pid}/cwd") / name
        before = path.read_text(encoding="utf-8") + "\n\n" if how == "append" else ""
        path.write_text(before + fence.content, encoding="utf-8")


def follow(page: str, readers: Mapping[str, Sequence[Reader]]) -> None:
    """Do what a page of docs/tutorial says; `readers`: who types what is `at` a name, one after another."""
    fences = fences_of(page)
    written = ""
    for fence, following in zip(fences, [*fences[1:], None], strict=True):
        if fence.language == "sh":
            written = _type_everywhere(fence, readers)
            deadline_s = time.monotonic() + AGAIN_TIMEOUT_S
            while "again" in fence.remark.split() and following and following.missing_in(written):
                assert time.monotonic() < deadline_s, f"still not there: {following.missing_in(written)}\n{written}"
                time.sleep(AGAIN_EVERY_S)
                written = _type_everywhere(fence, readers)
        elif fence.language == "text":
            missing = fence.missing_in(written)
            assert missing is None, f"the page shows: {missing}\nit was: {written[-_TAIL_CHARS:]}"
        else:
            readers[""][0].write(fence)


def _type_everywhere(fence: Fence, readers: Mapping[str, Sequence[Reader]]) -> str:
    return "".join(reader.type_all(fence) for reader in readers[fence.place])
