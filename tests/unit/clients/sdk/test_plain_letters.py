"""What a terminal gets that does not speak UTF-8."""

from __future__ import annotations

import io
import json
import sys

import msgspec
import pytest

from clients.sdk.node_answers import read_problem
from clients.sdk.terminal.ascii_output import PLAIN_ENCODING, is_utf8, prepare_output
from clients.sdk.terminal.terminal import print_json
from consensus.api_documents import Problem
from consensus.visible_text import STRANGE_MAX_CHARS, escape_controls


class Terminal(io.StringIO):
    """A stream of an encoding, at a terminal or not."""

    def __init__(self, encoding: str, *, tty: bool) -> None:
        super().__init__()
        self._encoding, self._tty = encoding, tty

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._encoding

    def isatty(self) -> bool:
        return self._tty


@pytest.mark.parametrize(
    ("encoding", "tty", "environment", "expected"),
    [
        ("utf-8", True, {}, True),
        ("utf-8", True, {"LANG": "pt_PT.UTF-8"}, True),
        ("utf-8", True, {"LANG": "pt_PT.utf8"}, True),
        ("utf-8", True, {"LC_ALL": "C", "LANG": "pt_PT.UTF-8"}, False),
        ("utf-8", True, {"LANG": "pt_PT.ISO-8859-1"}, False),
        ("utf-8", False, {"LC_ALL": "C"}, True),
        ("ascii", False, {"LANG": "pt_PT.UTF-8"}, False),
        ("latin-1", True, {}, False),
        ("nonsense", True, {}, False),
    ],
)
def test_utf8_is_what_the_stream_speaks_and_the_terminals_locale_does_not_deny(
    encoding: str, tty: bool, environment: dict[str, str], expected: bool
) -> None:
    assert is_utf8(Terminal(encoding, tty=tty), environment) is expected


def test_output_of_another_encoding_takes_every_text_in_plain_letters(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding="ascii", errors="strict")
    monkeypatch.setattr(sys, "stdout", stream)
    prepare_output()
    assert stream.encoding == PLAIN_ENCODING
    stream.write("Não há 漢字 ─ │ …\n")
    stream.flush()
    assert raw.getvalue() == b"Nao ha HanZi - | ...\n"


def test_json_keeps_every_letter_there_too(monkeypatch: pytest.MonkeyPatch) -> None:
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding="latin-1")
    monkeypatch.setattr(sys, "stdout", stream)
    prepare_output()
    print_json({"said": "Não"})
    stream.flush()
    assert json.loads(raw.getvalue()) == {"said": "Não"}


def test_output_that_speaks_utf8_is_left_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    monkeypatch.setattr(sys, "stdout", stream)
    prepare_output()
    assert stream.encoding == "utf-8"


@pytest.mark.parametrize("code", ["NOT_FOUND", "\x1b]0;x\x07OWNED"])
def test_what_a_node_says_went_wrong_commands_no_terminal_and_forges_no_line(code: str) -> None:
    detail = "gone\x1b[2J\x9b31m\u202e\nNext step: paste this" + "x" * 5_000
    problem = Problem("urn:x", "", 404, code, detail, "", retryable=False)
    error = read_problem(msgspec.json.encode(problem), 404)
    assert error.detail.isprintable()
    assert "gone\\u001b[2J\\u009b31m\\u202e Next step" in error.detail
    assert len(error.detail) <= STRANGE_MAX_CHARS + len(escape_controls(code)) + 2
