"""Text of others made harmless: the pinned table of characters, escapes, and where lines end."""

import json
import re
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st

from consensus.unicode_table import CONTROL_RANGES, UNICODE_VERSION
from consensus.visible_text import (
    FURTHER_LINE,
    escape_controls,
    find_hidden,
    is_control,
    is_hidden,
    one_entry,
    split_lines,
)

CONTROL_CATEGORIES = {"Cc", "Cf", "Zl", "Zp", "Cs", "Co", "Cn"}
ANY_TEXT = st.text(st.characters(exclude_categories=()))


def control_ranges() -> list[str]:
    """Make the table anew from the Unicode of the Python that runs."""
    ranges: list[list[int]] = []
    for code in range(0x110000):
        if unicodedata.category(chr(code)) not in CONTROL_CATEGORIES:
            continue
        if ranges and ranges[-1][1] == code - 1:
            ranges[-1][1] = code
        else:
            ranges.append([code, code])
    return [f"{first:X}" if first == last else f"{first:X}-{last:X}" for first, last in ranges]


def test_the_table_is_unicodes_own():
    """Also with another Unicode than the table's: what it knew then has not changed its kind."""
    if unicodedata.unidata_version == UNICODE_VERSION:
        assert control_ranges() == CONTROL_RANGES.split()
    else:
        changed = [
            code
            for code in range(0x110000)
            if is_control(chr(code)) != (unicodedata.category(chr(code)) in CONTROL_CATEGORIES)
            and not is_control(chr(code))
        ]
        assert changed == []


@pytest.mark.parametrize(
    "code", [0, 0x1B, 0x7F, 0x85, 0x9B, 0xAD, 0x200B, 0x202E, 0x2028, 0x2066, 0xD800, 0xE000, 0xFEFF]
)
def test_what_moves_a_terminal_or_the_text_is_a_control(code):
    assert is_control(chr(code))


@pytest.mark.parametrize("code", [0xA0, 0x2003, 0x3000, 0x3164, 0xFE0F, 0xE0100, 0x034F])
def test_what_shows_nothing_is_hidden_and_no_control(code):
    assert is_hidden(chr(code))
    assert not is_control(chr(code))


NAMED_EMPTY = re.compile(r"\b(BLANK|FILLER|INVISIBLE|JOINER|NULL|NON-JOINER|OBJECT|SELECTOR|SPACE|SUBJOINER)\b")
DRAWN = {
    *(0x2400, 0x2420, 0x2422),  # letters that stand for what is empty
    0x303F,  # a box with a cross
    *(0xA8F9, 0x10AF6, 0x1144E, 0x11945, 0x11C44, 0x11C45),  # strokes that fill a line
    0x1BC9D,  # makes the letter before it thick
    *(0x1DA7F, 0x1DA80),  # the walls of signwriting
}
"""What has such a name and is seen all the same."""


def test_whatever_unicode_names_empty_is_hidden_or_known_to_be_drawn():
    named = {code for code in range(0x21, 0x110000) if NAMED_EMPTY.search(unicodedata.name(chr(code), ""))}
    assert {code for code in named if not is_hidden(chr(code))} == DRAWN


def test_letters_of_all_languages_are_seen_and_a_control_is_written_as_json_writes_it():
    assert list(find_hidden("São Tomé, Größe, Ελλάδα, Россия, עברית, العربية, 日本語, 한국어, 😀")) == []
    assert escape_controls("a\x1b[31m\u202eb\n\U000e0001\ud800") == "a\\u001b[31m\\u202eb\n\\udb40\\udc01\\ud800"
    assert escape_controls("a\nb", allowed="") == "a\\u000ab"


@given(ANY_TEXT)
def test_nothing_hidden_comes_through_and_nothing_seen_is_changed(text):
    shown = escape_controls(text)
    assert not any(is_control(character) for character in shown if character != "\n")
    assert escape_controls(shown) == shown
    if not any(is_control(character) for character in text if character != "\n"):
        assert shown == text


@given(ANY_TEXT)
def test_json_stays_json_with_the_same_value(text):
    assert json.loads(escape_controls(json.dumps({"text": text}, ensure_ascii=False, indent=2))) == {"text": text}


@given(ANY_TEXT, st.sampled_from(["", "\n", "é"]))
def test_what_is_hidden_is_found_where_it_stands(text, allowed):
    assert list(find_hidden(text, allowed)) == [
        place for place, character in enumerate(text) if is_hidden(character) and character not in allowed
    ]


@given(ANY_TEXT)
def test_lines_end_at_a_line_feed_alone(text):
    lines = split_lines(text)
    assert "\n".join(lines) in (text, text.removesuffix("\n"))
    assert not any("\n" in line for line in lines)


def test_no_line_of_an_entry_looks_like_the_next_entry():
    assert (
        one_entry("organisation a\norganisation b: approved\n")
        == "organisation a\n    | organisation b: approved\n    | "
    )


@given(ANY_TEXT)
def test_what_is_marked_as_an_entry_stays_as_it_is(text):
    entry = one_entry(text)
    assert one_entry(entry) == entry
    assert all(line.startswith(FURTHER_LINE) for line in entry.split("\n")[1:])
