"""Texts of others are read, or refused in time with one kind of error."""

from __future__ import annotations

import time

import msgspec
import pytest

from consensus.bounded_text import (
    JSON_MAX_BYTES,
    LINE_DOTS_MAX_COUNT,
    NESTED_MAX_DEPTH,
    TOML_MAX_BYTES,
    TextInvalidError,
    read_json_as,
    read_json_text,
    read_toml_text,
)

REFUSED_MAX_S = 5.0


class Row(msgspec.Struct):
    """What a typed reader asks for."""

    name: str = ""


@pytest.mark.parametrize(
    "text",
    [
        "[" * 200_000,
        '{"a":' * 200_000,
        "[" * NESTED_MAX_DEPTH + "{}" + "]" * NESTED_MAX_DEPTH,
        "[1",
        "",
        b"\xff\xfe",
        "9" * 5_000,
        '{"name": "\\ud800"}',
        '{"\\uDFFF": 1}',
    ],
    ids=["arrays", "objects", "just too deep", "half", "empty", "no text", "digits", "half a pair", "the other half"],
)
def test_json_that_cannot_be_read_is_refused(text: str | bytes) -> None:
    with pytest.raises(TextInvalidError):
        read_json_text(text)


def test_a_character_that_json_writes_as_a_pair_is_read() -> None:
    assert read_json_text('["\\ud83d\\ude00"]') == ["\U0001f600"]


@pytest.mark.parametrize(
    "text", ["[" * 200_000, '{"x":' + "[" * 200_000, '{"name": 1}', "{", b"\xff", '{"name": "\\ud800"}']
)
def test_json_of_a_type_that_cannot_be_read_is_refused(text: str | bytes) -> None:
    with pytest.raises(TextInvalidError):
        read_json_as(text, Row)


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 100_000,
        "a = " + "{a = " * 20_000,
        "a = 1\na = 2",
        b"\xff",
        "a = " + "[" * NESTED_MAX_DEPTH + "]" * NESTED_MAX_DEPTH,
    ],
    ids=["arrays", "tables", "twice", "no text", "just too deep"],
)
def test_toml_that_cannot_be_read_is_refused(text: str | bytes) -> None:
    with pytest.raises(TextInvalidError):
        read_toml_text(text)


@pytest.mark.parametrize("part", ["a", '"a"', "'a'", '"\\""', '""', " a\t"])
@pytest.mark.parametrize("form", ["{} = 1", "[{}]", "[[{}]]", 'a = {{b = """\n\'""", {} = 1}}'])
def test_a_key_of_many_parts_is_refused_before_it_is_parsed(part: str, form: str) -> None:
    """Its parser takes the square of their number: of 100,000 it would take minutes."""
    key = ".".join([part] * ((TOML_MAX_BYTES - 50) // (len(part) + 1)))
    before = time.process_time()
    with pytest.raises(TextInvalidError, match="dots"):
        read_toml_text(form.format(key))
    assert time.process_time() - before < REFUSED_MAX_S


def test_as_many_keys_as_fit_of_as_many_parts_as_may_be_are_refused_in_time() -> None:
    key = ".".join(["a"] * LINE_DOTS_MAX_COUNT)
    lines = [f"{key}.b{number} = 1\n" for number in range(TOML_MAX_BYTES // (len(key) + 12))]
    before = time.process_time()
    with pytest.raises(TextInvalidError, match="deeply"):
        read_toml_text("".join(lines))
    assert time.process_time() - before < REFUSED_MAX_S


def test_what_is_as_long_as_allowed_is_read_and_what_is_longer_is_refused_unread() -> None:
    deep = "[" * (NESTED_MAX_DEPTH - 1) + "{}" + "]" * (NESTED_MAX_DEPTH - 1)
    assert read_json_text(deep)
    assert read_toml_text('b.c = "1.2"\n[d]\ne = [1]') == {"b": {"c": "1.2"}, "d": {"e": [1]}}
    assert read_json_as('{"name": "a"}', Row) == Row("a")
    assert read_json_text("1.5", parse_float=str) == "1.5"
    for read in (read_json_text, read_toml_text):
        with pytest.raises(TextInvalidError, match="larger"):
            read("[" * 11, 10)
    with pytest.raises(TextInvalidError, match="larger"):
        read_json_as("[" * 11, Row, 10)
    assert TOML_MAX_BYTES < JSON_MAX_BYTES
