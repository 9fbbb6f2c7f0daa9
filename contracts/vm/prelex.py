"""The pre-lexer: bounds a source before Python's own parser sees it. Must never let through what parsers of different
versions read differently.

It knows strings, numbers, names and signs, refuses what the language has no use for, and limits nesting, so that
`ast.parse` can neither warn, nor run deep, nor depend on the version of Python.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from contracts.vm.faults import Diagnostic

SOURCE_MAX_BYTES = 60_000
BRACKETS_MAX_COUNT = 16
OPERATORS_MAX_COUNT = 150
ELIF_MAX_COUNT = 60
INDENT_MAX_COUNT = 10
INDENT_MAX_CHARS = 40

_TOKEN = re.compile(
    r"""
    (?P<space>[ ]+)
  | (?P<comment>\#[^\n]*)
  | (?P<newline>\n)
  | (?P<string>(?P<prefix>[A-Za-z]*)(?P<quoted>
        \"\"\"(?:[^\\]|\\.|\\\n)*?\"\"\" | '''(?:[^\\]|\\.|\\\n)*?'''
      | "(?:[^"\\\n]|\\.)*" | '(?:[^'\\\n]|\\.)*'))
  | (?P<number>(?:0[xX][0-9a-fA-F_]+|[0-9][0-9_]*)(?P<tail>[0-9A-Za-z_]*(?:\.[0-9A-Za-z_]*)?))
  | (?P<name>[A-Za-z_][A-Za-z0-9_]*)
  | (?P<sign>\*\*=|//=|<<=|>>=|->|:=|!=|==|<=|>=|\+=|-=|\*=|%=|&=|\|=|\^=|\*\*|//|<<|>>|[-+*/%&|^~<>=()\[\]{},:.@;\\])
    """,
    re.VERBOSE | re.DOTALL,
)
_FIELD = re.compile(r"\{[A-Za-z0-9_ .,+\-*()\[\]]{1,80}\}", re.ASCII)
_GOOD_ESCAPE = re.compile(r"\\(?:[\\'\"nrt\n]|x[0-9a-fA-F]{2}|u[0-9a-fA-F]{4}|U00(?:0[0-9a-fA-F]|10)[0-9a-fA-F]{4})")
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]|\\U0000[dD][89a-fA-F]")
_WORD_OPERATORS = frozenset({"not", "and", "or", "if", "else", "in", "is", "for", "lambda", "await", "async"})
_FREE_SIGNS = frozenset("()[]{},:")


@dataclass(slots=True)
class _State:
    source: str
    diagnostics: list[Diagnostic] = field(default_factory=list)
    fatal: bool = False
    line: int = 1
    line_start: int = 0
    brackets: list[str] = field(default_factory=list)
    operators: int = 0
    elifs: int = 0
    indents: list[int] = field(default_factory=lambda: [0])
    at_line_start: bool = True
    told: set[tuple[str, int]] = field(default_factory=set)

    def report(self, code: str, position: int, message: str, fix: str, *, fatal: bool = False) -> None:
        self.fatal = self.fatal or fatal
        if (code, self.line) in self.told:
            return
        self.told.add((code, self.line))
        self.diagnostics.append(Diagnostic(code, self.line, position - self.line_start + 1, message, fix))


def prelex(source: str) -> tuple[list[Diagnostic], bool]:
    """Return the problems of a source's text and whether they forbid parsing it at all."""
    state = _State(source)
    if len(source) > SOURCE_MAX_BYTES or len(source.encode("utf-8", "replace")) > SOURCE_MAX_BYTES:
        state.report(
            "SOURCE_TOO_LONG", 0, f"A source has at most {SOURCE_MAX_BYTES} bytes.", "Split the contract.", fatal=True
        )
        return state.diagnostics, True
    position = 0
    while position < len(source) and not (state.fatal and len(state.diagnostics) > 20):
        match = _TOKEN.match(source, position)
        if match is None:
            _report_stray(state, position)
            position += 1
            continue
        _take(state, match)
        position = match.end()
    if state.brackets:
        state.report("BRACKET_OPEN", len(source), "A bracket is never closed.", "Close it.", fatal=True)
    return state.diagnostics, state.fatal


def _report_stray(state: _State, position: int) -> None:
    character = state.source[position]
    if character == "\t":
        state.report("TAB", position, "There is a tab.", "Indent with spaces.", fatal=True)
    elif character == "\r":
        state.report(
            "LINE_END", position, "There is a carriage return.", "End lines with a line feed only.", fatal=True
        )
    elif character in "\"'":
        state.report(
            "STRING_OPEN", position, "A text is not closed on its line.", "Close it with the same quote.", fatal=True
        )
    elif ord(character) > 127:
        state.report(
            "NOT_ASCII", position, "Outside texts and comments a source is ASCII.", "Use ASCII letters.", fatal=True
        )
    else:
        state.report("CHARACTER", position, "This character has no meaning here.", "Remove it.", fatal=True)


def _take(state: _State, match: re.Match[str]) -> None:
    kind = match.lastgroup
    if match["string"] is not None:
        kind = "string"
    elif match["number"] is not None:
        kind = "number"
    if kind == "newline":
        _end_line(state, match)
        return
    if kind == "comment":
        _check_comment(state, match)
        return
    if kind == "space":
        return
    if state.at_line_start:
        _begin_line(state, match)
    if kind == "string":
        _check_string(state, match)
    elif kind == "number":
        _check_number(state, match)
    elif kind == "sign":
        _check_sign(state, match)
    else:
        _check_name(state, match)
    if state.operators > OPERATORS_MAX_COUNT:
        state.report(
            "STATEMENT_TOO_LONG", match.start(),
            f"A statement has more than {OPERATORS_MAX_COUNT} operators.", "Split it.", fatal=True,
        )  # fmt: skip


def _check_comment(state: _State, match: re.Match[str]) -> None:
    for offset, character in enumerate(match[0]):
        if ord(character) < 32 and character != "\t":
            state.report(
                "CHARACTER", match.start() + offset, "A comment holds a control character.", "Remove it.", fatal=True
            )
    if "coding" in match[0] and state.line <= 2 and re.search(r"coding[=:]", match[0]):
        state.report("ENCODING_COMMENT", match.start(), "A source is always UTF-8.", "Remove the comment.", fatal=True)


def _end_line(state: _State, match: re.Match[str]) -> None:
    state.line += 1
    state.line_start = match.end()
    if not state.brackets:
        state.at_line_start = True
        state.operators = 0


def _begin_line(state: _State, match: re.Match[str]) -> None:
    state.at_line_start = False
    indent = match.start() - state.line_start
    while indent < state.indents[-1]:
        state.indents.pop()
    if indent > state.indents[-1]:
        state.indents.append(indent)
    if len(state.indents) > INDENT_MAX_COUNT + 1 or indent > INDENT_MAX_CHARS:
        state.report(
            "NESTED_TOO_DEEP", match.start(),
            f"Blocks nest at most {INDENT_MAX_COUNT} deep, {INDENT_MAX_CHARS} columns.",
            "Move the inner part to a function.", fatal=True,
        )  # fmt: skip
    if match[0] != "elif":
        state.elifs = state.elifs if indent else 0
        return
    state.elifs += 1
    if state.elifs > ELIF_MAX_COUNT:
        state.report(
            "ELIF_TOO_MANY", match.start(), f"A function has at most {ELIF_MAX_COUNT} elif.", "Use a dict.", fatal=True
        )


def _check_string(state: _State, match: re.Match[str]) -> None:
    prefix, quoted, start = match["prefix"], match["quoted"], match.start()
    if prefix not in ("", "b", "f"):
        state.report("STRING_PREFIX", start, f"A text has no prefix {prefix!r}.", "Use none, b or f.")
    triple = quoted[:3] in ('"""', "'''")
    content = quoted[3:-3] if triple else quoted[1:-1]
    escapes = re.findall(r"\\(?:[uUxN].{0,8}|.)", content, re.DOTALL)
    for escape in escapes:
        if _GOOD_ESCAPE.match(escape) is None or (prefix == "b" and escape[1] in "uU"):
            state.report(
                "ESCAPE", start, f"There is no escape {escape[:2]!r}.", "Use \\\\, \\n, \\t, \\xHH or \\uHHHH."
            )
        elif _SURROGATE.match(escape):
            state.report("SURROGATE", start, "A text cannot hold half of a character.", "Use \\UHHHHHHHH.")
    if any((ord(character) < 32 and character != "\n") or 0xD800 <= ord(character) < 0xE000 for character in content):
        state.report(
            "CHARACTER", start, "A text holds a control character or half of one.", "Write it as an escape.", fatal=True
        )
    if prefix == "f":
        plain = content.replace("{{", "").replace("}}", "")
        if triple or "\\" in content or re.search(r"[{}]", _FIELD.sub("", plain)):
            state.report(
                "F_STRING", start, "An f-string holds only short expressions without quotes, ':', '!' and '\\'.",
                "Give the value a name first.", fatal=True,
            )  # fmt: skip
        state.operators += len(re.findall(r"[.+\-*(\[]| not | and | or | if | in ", plain))
    state.operators += 1
    newlines = match[0].count("\n")
    if newlines:
        state.line += newlines
        state.line_start = match.start() + match[0].rindex("\n") + 1


def _check_number(state: _State, match: re.Match[str]) -> None:
    if match["tail"]:
        message = "Numbers are whole and decimal or hexadecimal."
        state.report("NUMBER", match.start(), message, "Use an int, e.g. of thousandths.")
    elif len(match[0]) > 100:
        state.report(
            "NUMBER", match.start(), "The number has too many digits.", "An int has at most 256 bits.", fatal=True
        )


def _check_name(state: _State, match: re.Match[str]) -> None:
    if match[0] in _WORD_OPERATORS:
        state.operators += 1


def _check_sign(state: _State, match: re.Match[str]) -> None:
    sign = match[0]
    if sign in "([{":
        state.brackets.append(sign)
        state.operators += 1
        if len(state.brackets) > BRACKETS_MAX_COUNT:
            message = f"Brackets nest at most {BRACKETS_MAX_COUNT} deep."
            state.report("NESTED_TOO_DEEP", match.start(), message, "Give the inner part a name.", fatal=True)
    elif sign in ")]}":
        if not state.brackets or state.brackets.pop() + sign not in ("()", "[]", "{}"):
            state.report("BRACKET", match.start(), "This bracket closes none.", "Remove it or open it.", fatal=True)
    elif sign == ";":
        state.report("SEMICOLON", match.start(), "There is one statement per line.", "Start a new line.")
    elif sign == "\\":
        state.report("BACKSLASH", match.start(), "Lines are not continued by a backslash.", "Use brackets.", fatal=True)
    elif sign not in _FREE_SIGNS:
        state.operators += 1
