"""A source shows what it does: no character that cannot be seen, or that moves the text around it, is in the language."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from consensus.visible_text import is_hidden
from contracts.vm import compile_contract, find_problems

SOURCE = '''"""Who was here.

Two paragraphs."""

LIMIT = 3  # how many

@export
def enter(name: str) -> str:
    """Let in who is named."""
    # only a few
    require(len(name) < LIMIT, "TOO_LONG", f"Longer than {LIMIT}.")
    state.put(b"name", [name, 'é', """a
b"""])
    return name
'''
HIDDEN = st.characters(exclude_categories=()).filter(lambda character: is_hidden(character) and character != "\n")


@given(HIDDEN, st.integers(0, len(SOURCE)))
def test_a_hidden_character_is_refused_wherever_it_stands(character, place):
    """Also at its place: the editor's line and column, in texts of many lines too."""
    problems = find_problems(SOURCE[:place] + character + SOURCE[place:], "it")
    before = SOURCE[:place]
    here = (before.count("\n") + 1, len(before) - before.rfind("\n"))
    assert here in [(one.line, one.column) for one in problems], problems


@pytest.mark.parametrize("empty", ["\u2800", "\U00016fe4", "\U0001d159", "\u2d7f", "\ufffc"])
@pytest.mark.parametrize("line", ["    return 'aEMPTYb'", "    # aEMPTYb\n    return 'a'"])
def test_a_sign_without_a_mark_is_refused_in_texts_and_comments(empty, line):
    source = f"@export\ndef f() -> str:\n{line}\n".replace("EMPTY", empty)
    assert {one.code for one in find_problems(source, "it")} == {"CHARACTER"}


@pytest.mark.parametrize("end", ["\x0b", "\x0c", "\x1c", "\x1d", "\x1e", "\x85", "\u2028", "\u2029", "\r"])
def test_what_other_readers_take_for_the_end_of_a_line_cannot_hide_a_check(end):
    source = (
        f"@export\ndef take(who: bytes):\n    # only he may{end}    require(ctx.caller == who, 'NOT_HE')\n    pass\n"
    )
    assert [(one.code, one.line, one.column) for one in find_problems(source, "it")] == [("CHARACTER", 3, 18)]


@pytest.mark.parametrize("text", ["\\x1b", "\\u202e", "\\u2028", "\\U000e0001", "\\n", "\\t", "ção", "日本語 😀"])
def test_a_text_may_hold_it_as_an_escape_and_every_letter_as_it_is(text):
    compile_contract(f'# ção, 日本語\n@export\ndef f() -> str:\n    return "{text}"\n', "it")
