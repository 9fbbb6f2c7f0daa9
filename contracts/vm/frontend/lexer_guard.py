"""The pre-lexer: bounds a source before Python's parser sees it.

It rejects what parser versions read differently and limits nesting, so `ast.parse` cannot warn, recurse deeply or
depend on the version.
"""

from __future__ import annotations

import itertools
import re
from dataclasses import dataclass, field

from consensus.visible_text import find_hidden
from contracts.vm.model.faults import Diagnostic

SOURCE_MAX_BYTES = 60_000
PROBLEMS_MAX_COUNT = 100
BRACKETS_MAX_COUNT = 16
OPERATORS_MAX_COUNT = 150
ELIF_MAX_COUNT = 60
INDENT_MAX_COUNT = 10
INDENT_MAX_CHARS = 40
NUMBER_MAX_CHARS = 100

_TOKEN = re.compile(
    r"""
    (?P<space>[ ]+)
  | (?P<comment>\#[^\n]*)
  | (?P<newline>\n)
  | (?P<string>(?P<prefix>[A-Za-z]*)(?P<quoted>
        \"\"\"(?:[^\\]|\\.)*?\"\"\" | '''(?:[^\\]|\\.)*?'''
      | "(?:[^"\\\n]|\\.)*" | '(?:[^'\\\n]|\\.)*'))
  | (?P<number>(?:0[xX][0-9a-fA-F_]+|[0-9][0-9_]*)(?P<tail>[0-9A-Za-z_]*(?:\.[0-9A-Za-z_]*)?))
  | (?P<name>[A-Za-z_][A-Za-z0-9_]*)
  | (?P<sign>\*\*=|//=|<<=|>>=|->|:=|!=|==|<=|>=|\+=|-=|\*=|%=|&=|\|=|\^=|\*\*|//|<<|>>|[-+*/%&|^~<>=()\[\]{},:.@;\\])
    """,
    re.VERBOSE | re.DOTALL,
)
_NUMBER = re.compile(r"0[xX](?:_?[0-9a-fA-F])+|[1-9](?:_?[0-9])*|0(?:_?0)*", re.ASCII)
_FIELD = re.compile(r"[A-Za-z0-9_ .,+\-*()\[\]]{1,80}", re.ASCII)
_GOOD_ESCAPE = re.compile(r"\\(?:[\\'\"nrt\n]|x[0-9a-fA-F]{2}|u[0-9a-fA-F]{4}|U00(?:0[0-9a-fA-F]|10)[0-9a-fA-F]{4})")
_SURROGATE = re.compile(r"\\u[dD][89a-fA-F]|\\U0000[dD][89a-fA-F]")
_TYPE_STATEMENT = re.compile(r"type +(?!(?:in|is|and|or|not|if|else|for)\b)[A-Za-z_]", re.ASCII)
_TYPE_PARAMETERS = re.compile(r"def +[A-Za-z0-9_]+ *\[", re.ASCII)
_WORD_OPERATORS = frozenset({"not", "and", "or", "if", "else", "in", "is", "for", "lambda", "await", "async"})
_FREE_SIGNS = frozenset("()[]{},:")
_BEFORE_UNPACKING = frozenset({"(", "[", "{", ",", "=", "return", "in", "yield", ""})

WORDS: dict[str, tuple[str, str]] = {
    "import": ("Nothing can be imported.", "Use the names the language gives: see the reference."),
    "class": ("There are no classes.", "Use a dict with text keys."),
    "async": ("There is no async.", "Use 'def'."),
    "await": ("There is no await.", "Remove it."),
    "try": ("Failures cannot be caught.", "Test with 'if' first; what fails, fails the whole call."),
    "raise": ("There is no raise.", 'Use require(False, "CODE").'),
    "assert": ("There is no assert.", 'Use require(condition, "CODE").'),
    "with": ("There is no with.", "Write the steps out."),
    "global": ("Module names cannot be changed.", "Keep it in the state."),
    "nonlocal": ("There are no nested functions.", "Pass it as an argument."),
    "lambda": ("There is no lambda.", "Write a function at the top."),
    "yield": ("There are no generators.", "Return a list."),
    "type": ("There is no type statement.", "Write the type out."),
}
"""The words that Python gives a meaning and the language does not: what is wrong with them and what to write instead."""


@dataclass(slots=True)
class LogicalLine:
    """A statement or its head: physical lines (1-based), indentation, first word; `opens` a block, or is `broken`
    (unreadable).
    """

    first: int
    last: int
    indent: int
    word: str
    opens: bool = False
    broken: bool = False


@dataclass(slots=True)
class Prelexed:
    """The pre-lexer's findings; `fatal` forbids parsing, text after `unread` was not read."""

    diagnostics: list[Diagnostic]
    fatal: bool
    lines: list[LogicalLine]
    unread: int | None


@dataclass(slots=True)
class _State:
    source: str
    diagnostics: list[Diagnostic] = field(default_factory=list)
    fatal: bool = False
    stopped: bool = False
    line: int = 1
    line_start: int = 0
    brackets: list[tuple[str, int, int]] = field(default_factory=list)
    operators: int = 0
    elifs: int = 0
    indents: list[int] = field(default_factory=lambda: [0])
    at_line_start: bool = True
    continued: bool = False
    previous: str = ""
    lines: list[LogicalLine] = field(default_factory=list)
    reported: set[tuple[str, int]] = field(default_factory=set)

    def report(self, code: str, position: int, message: str, fix: str, *, fatal: bool = False) -> None:
        column = max(position - self.line_start, 0) + 1
        self.report_at(code, self.line, column, message, fix, fatal=fatal)

    def report_at(self, code: str, line: int, column: int, message: str, fix: str, *, fatal: bool = False) -> None:
        self.fatal = self.fatal or fatal
        if fatal and not self.at_line_start:
            self.lines[-1].broken = True
        if (code, line * 1_000_000 + column) not in self.reported and len(self.diagnostics) < PROBLEMS_MAX_COUNT:
            self.reported.add((code, line * 1_000_000 + column))
            self.diagnostics.append(Diagnostic(code, line, column, message, fix))


def prelex(source: str) -> Prelexed:
    state = _State(source)
    if len(source) > SOURCE_MAX_BYTES or len(source.encode("utf-8", "replace")) > SOURCE_MAX_BYTES:
        state.report(
            "SOURCE_TOO_LONG", 0, f"A source has at most {SOURCE_MAX_BYTES} bytes.", "Split the contract.", fatal=True
        )
        return Prelexed(state.diagnostics, True, [], 1)
    position = 0
    while position < len(source) and not state.stopped:
        match = _TOKEN.match(source, position)
        if match is None:
            position = _skip_stray(state, position)
            continue
        _take(state, match)
        position = match.end()
        state.stopped = state.stopped or (state.fatal and len(state.diagnostics) >= PROBLEMS_MAX_COUNT)
    if state.brackets and not state.stopped:
        _report_open_brackets(state)
    if not state.at_line_start:
        _close_logical_line(state)
    return Prelexed(state.diagnostics, state.fatal, state.lines, state.line if state.stopped else None)


def _report_open_brackets(state: _State) -> None:
    _, line, column = state.brackets[0]
    state.report_at("BRACKET_OPEN", line, column, "This bracket is never closed.", "Close it.", fatal=True)
    state.brackets.clear()


def _skip_stray(state: _State, position: int) -> int:
    character = state.source[position]
    end = position + 1
    if character in "\"'":
        message, fix = "A text is not closed on its line.", "Close it with the same quote."
        newline = state.source.find("\n", position)
        end = len(state.source) if newline < 0 else newline
        code = "STRING_OPEN"
    else:
        while end < len(state.source) and state.source[end] == character:
            end += 1
        code, message, fix = _describe_stray(character)
    if state.at_line_start:
        _open_logical_line(state, position - state.line_start, "")
    state.report(code, position, message, fix, fatal=True)
    return end


def _describe_stray(character: str) -> tuple[str, str, str]:
    if character == "\t":
        return "TAB", "There is a tab.", "Indent with spaces."
    if character == "\r":
        return "LINE_END", "There is a carriage return.", "End lines with a line feed only."
    if ord(character) > 127:
        return "NOT_ASCII", "Outside texts and comments a source is ASCII.", "Use ASCII letters."
    return "CHARACTER", "This character has no meaning here.", "Remove it."


def _told_hidden(character: str) -> str:
    return f"The character U+{ord(character):04X} cannot be seen, or changes how the text around it is shown."


def _take(state: _State, match: re.Match[str]) -> None:
    kind = match.lastgroup
    if match["string"] is not None:
        kind = "string"
    elif match["number"] is not None:
        kind = "number"
    if kind == "newline":
        _end_line(state, match)
    elif kind == "comment":
        _check_comment(state, match)
    elif kind != "space":
        if state.brackets and match.start() == state.line_start and match[0] in ("def", "@"):
            _report_open_brackets(state)
            _close_logical_line(state, before=True)
        if state.at_line_start:
            _begin_line(state, match)
        _check_token(state, match, kind or "")
        state.previous = match[0]


def _check_token(state: _State, match: re.Match[str], kind: str) -> None:
    if kind == "string":
        _check_string(state, match)
    elif kind == "number":
        _check_number(state, match)
    elif kind == "sign":
        _check_sign(state, match)
    else:
        _check_name(state, match)
    if state.operators > OPERATORS_MAX_COUNT and not state.lines[-1].broken:
        state.report(
            "STATEMENT_TOO_LONG", match.start(),
            f"A statement has more than {OPERATORS_MAX_COUNT} operators.", "Split it.", fatal=True,
        )  # fmt: skip


def _check_comment(state: _State, match: re.Match[str]) -> None:
    for offset in find_hidden(match[0]):
        state.report("CHARACTER", match.start() + offset, _told_hidden(match[0][offset]), "Remove it.", fatal=True)
    if "coding" in match[0] and state.line <= 2 and re.search(r"coding[=:]", match[0]):
        state.report("ENCODING_COMMENT", match.start(), "A source is always UTF-8.", "Remove the comment.", fatal=True)


def _end_line(state: _State, match: re.Match[str]) -> None:
    if not state.brackets and not state.continued and not state.at_line_start:
        _close_logical_line(state)
    state.continued = False
    state.line += 1
    state.line_start = match.end()


def _open_logical_line(state: _State, indent: int, word: str) -> None:
    state.at_line_start = False
    state.operators = 0
    state.previous = ""
    state.lines.append(LogicalLine(state.line, state.line, indent, word))


def _close_logical_line(state: _State, *, before: bool = False) -> None:
    line = state.lines[-1]
    line.last = state.line - 1 if before else state.line
    line.opens = state.previous == ":"
    state.at_line_start = True


def _begin_line(state: _State, match: re.Match[str]) -> None:
    indent = match.start() - state.line_start
    _open_logical_line(state, indent, match[0])
    if indent < state.indents[-1]:
        while indent < state.indents[-1]:
            state.indents.pop()
        if indent != state.indents[-1]:
            message = "This line is indented like no block above it."
            state.report("INDENT", match.start(), message, "Indent it as the block it belongs to.", fatal=True)
    if indent > state.indents[-1]:
        state.indents.append(indent)
    if len(state.indents) > INDENT_MAX_COUNT + 1 or indent > INDENT_MAX_CHARS:
        state.report(
            "NESTED_TOO_DEEP", match.start(),
            f"Blocks nest at most {INDENT_MAX_COUNT} deep, {INDENT_MAX_CHARS} columns.",
            "Move the inner part to a function.", fatal=True,
        )  # fmt: skip
    if _TYPE_STATEMENT.match(state.source, match.start()):
        state.report("NOT_IN_LANGUAGE", match.start(), *WORDS["type"], fatal=True)
    if _TYPE_PARAMETERS.match(state.source, match.start()):
        state.report("PARAMETERS", match.start(), "There are no type parameters.", "Remove them.", fatal=True)
    if match[0] != "elif":
        state.elifs = state.elifs if indent else 0
        return
    state.elifs += 1
    if state.elifs > ELIF_MAX_COUNT:
        state.report(
            "ELIF_TOO_MANY", match.start(), f"A function has at most {ELIF_MAX_COUNT} elif.", "Use a dict.", fatal=True
        )


def _check_hidden(state: _State, text: str, start: int) -> None:
    for offset in itertools.islice(find_hidden(text, "\n"), PROBLEMS_MAX_COUNT):
        before = text[:offset]
        line = state.line + before.count("\n")
        column = len(before) - before.rfind("\n") + (0 if "\n" in before else start - state.line_start)
        state.report_at("CHARACTER", line, column, _told_hidden(text[offset]), "Write it as an escape.", fatal=True)


def _check_string(state: _State, match: re.Match[str]) -> None:
    prefix, quoted, start = match["prefix"], match["quoted"], match.start()
    if len(quoted) == 2 and state.source[match.end() : match.end() + 1] == quoted[0]:
        message = "A text in triple quotes is never closed."
        state.report("STRING_OPEN", start, message, "Close it with the same three quotes.", fatal=True)
        _check_hidden(state, state.source[start:], start)
        state.stopped = True
        return
    if prefix not in ("", "b", "f"):
        odd = not set(prefix.lower()) <= set("bru")
        message = f"A text has no prefix {prefix[:16]!r}."
        state.report("STRING_PREFIX", start, message, "Use none, b or f.", fatal=odd)
    triple = quoted[:3] in ('"""', "'''")
    content = quoted[3:-3] if triple else quoted[1:-1]
    _check_escapes(state, content, prefix, start)
    _check_hidden(state, match[0], start)
    state.operators += 1
    if prefix == "f" and (
        triple or "\\" in content or not _check_fields(state, match.end() - len(quoted) + 1, content)
    ):
        state.report(
            "F_STRING", start, "An f-string holds only short expressions without quotes, ':', '!' and '\\'.",
            "Give the value a name first.", fatal=True,
        )  # fmt: skip
    newlines = match[0].count("\n")
    if newlines:
        state.line += newlines
        state.line_start = match.start() + match[0].rindex("\n") + 1


def _check_escapes(state: _State, content: str, prefix: str, start: int) -> None:
    for escape in re.findall(r"\\(?:[uUxN].{0,8}|.)", content, re.DOTALL):
        if _GOOD_ESCAPE.match(escape) is None or (prefix == "b" and escape[1] in "uU"):
            message = f"There is no escape {escape[:2]!r}."
            state.report("ESCAPE", start, message, "Use \\\\, \\n, \\t, \\xHH or \\uHHHH.")
        elif _SURROGATE.match(escape):
            state.report("SURROGATE", start, "A text cannot hold half of a character.", "Use \\UHHHHHHHH.")


def _check_fields(state: _State, start: int, content: str) -> bool:
    place, depth = 0, len(state.brackets)
    while place < len(content):
        character = content[place]
        if character in "{}" and content[place : place + 2] == 2 * character:
            place += 2
        elif character == "{":
            end = content.find("}", place)
            if end < 0 or _FIELD.fullmatch(content, place + 1, end) is None:
                return False
            state.previous = "{"
            position = start + place + 1
            while position < start + end:
                match = _TOKEN.match(state.source, position, start + end)
                if match is None:
                    return False
                if match["space"] is None:
                    _check_token(state, match, "number" if match["number"] else match.lastgroup or "")
                    state.previous = match[0]
                position = match.end()
            if len(state.brackets) != depth:
                del state.brackets[depth:]
                return False
            place = end + 1
        elif character == "}":
            return False
        else:
            place += 1
    return True


def _check_number(state: _State, match: re.Match[str]) -> None:
    if match["tail"] or _NUMBER.fullmatch(match[0]) is None:
        message = "Numbers are whole and decimal or hexadecimal."
        state.report("NUMBER", match.start(), message, "Use an int, e.g. of thousandths.", fatal=not match["tail"])
    elif len(match[0]) > NUMBER_MAX_CHARS:
        state.report(
            "NUMBER", match.start(), "The number has too many digits.", "An int has at most 256 bits.", fatal=True
        )


def _check_name(state: _State, match: re.Match[str]) -> None:
    word = match[0]
    if word in _WORD_OPERATORS:
        state.operators += 1
    if word in WORDS and word != "type" and state.previous != ".":
        position, at_start = match.start(), len(state.lines) > 0 and state.lines[-1].word == "from"
        if not (word == "import" and at_start):
            state.report("NOT_IN_LANGUAGE", position, *WORDS[word])
    elif word == "from" and state.previous == "":
        state.report("NOT_IN_LANGUAGE", match.start(), *WORDS["import"])


def _check_sign(state: _State, match: re.Match[str]) -> None:
    sign = match[0]
    if sign in "([{":
        state.brackets.append((sign, state.line, match.start() - state.line_start + 1))
        state.operators += 1
        if len(state.brackets) == BRACKETS_MAX_COUNT + 1:
            message = f"Brackets nest at most {BRACKETS_MAX_COUNT} deep."
            state.report("NESTED_TOO_DEEP", match.start(), message, "Give the inner part a name.", fatal=True)
    elif sign in ")]}":
        if not state.brackets or state.brackets.pop()[0] + sign not in ("()", "[]", "{}"):
            state.report("BRACKET", match.start(), "This bracket closes none.", "Remove it or open it.", fatal=True)
    elif sign == ";":
        state.report("SEMICOLON", match.start(), "There is one statement per line.", "Start a new line.")
    elif sign == "\\":
        state.continued = state.source[match.end() : match.end() + 1] == "\n"
        message = "Lines are not continued by a backslash."
        state.report("BACKSLASH", match.start(), message, "Use brackets.", fatal=not state.continued)
    elif sign not in _FREE_SIGNS:
        state.operators += 1
    if sign in ("*", "**") and state.previous in _BEFORE_UNPACKING:
        _report_unpacking(state, match)


def _report_unpacking(state: _State, match: re.Match[str]) -> None:
    """Unpacking stars parse differently between Python versions."""
    if state.lines[-1].word == "def":
        state.report("PARAMETERS", match.start(), "There are only plain parameters.", "Remove '*', '/' and '**'.")
    elif match[0] == "*":
        state.report("NOT_IN_LANGUAGE", match.start(), "There is no '*' here.", "Write the items out, or use '+'.")
    else:
        state.report("NOT_IN_LANGUAGE", match.start(), "There is no '**' here.", "Write the items out.")
