"""Arguments as people type them: read by the entry's types, refused where they do not fit."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.errors import BlockRobotError
from contracts.kit.arguments import find_entry, read_arguments, signature_of
from contracts.vm.frontend.abi import Entry


def entry(*kinds: str, required: int | None = None) -> Entry:
    params = tuple((f"p{place}", kind) for place, kind in enumerate(kinds))
    return Entry("act", "export", params, "None", len(kinds) if required is None else required, 1)


@pytest.mark.parametrize(
    ("kind", "text", "value"),
    [
        ("int", "12", 12),
        ("int", "-3", -3),
        ("int", "0xff", 255),
        ("str", "12", "12"),
        ("str", "0xff", "0xff"),
        ("bytes", "0x00ff", b"\x00\xff"),
        ("bytes", "hex:00FF", b"\x00\xff"),
        ("bytes", "text:hello", b"hello"),
        ("bytes", "0x", b""),
        ("bool", "true", True),
        ("bool", "false", False),
        ("None", "null", None),
        ("int | None", "null", None),
        ("int | None", "7", 7),
        ("str | int", "7", 7),
        ("str | bytes", "0x07", b"\x07"),
        ("str | bytes", "seven", "seven"),
        ("list[bytes]", '["0x01", "hex:02"]', [b"\x01", b"\x02"]),
        ("list[str]", '["0x01"]', ["0x01"]),
        ("list", '["0x01", "one", 1, true, null, {"a": "text:0x01"}]', [b"\x01", "one", 1, True, None, {"a": "0x01"}]),
        ("dict[str, int]", '{"a": 1}', {"a": 1}),
        ("dict[int, list[int]]", '{"5": [1]}', {5: [1]}),
        ("dict[bytes, bytes | None]", '{"0x05": null}', {b"\x05": None}),
        ("dict", '{"0x05": 1}', {b"\x05": 1}),
        ("object", "plain words", "plain words"),
        ("object", "0x0a", b"\x0a"),
        ("object", "[1]", [1]),
    ],
)
def test_a_text_is_read_by_the_type_of_its_parameter(kind: str, text: str, value: Any) -> None:
    (read,) = read_arguments(entry(kind), [text])
    assert (type(read), read) == (type(value), value)


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("int", "twelve"),
        ("int", "1.5"),
        ("int", "１"),
        ("int", "0x" + "f" * 65),
        ("bytes", "hello"),
        ("bytes", "0x0"),
        ("bool", "1"),
        ("None", "0"),
        ("list[int]", '["1"]'),
        ("list[int]", "[1.5]"),
        ("list[int]", "1"),
        ("list[int]", "[true]"),
        ("list[bytes]", '["one"]'),
        ("dict[str, int]", "[]"),
        ("dict[str, int]", '{"a": "b"}'),
        ("list", "[" * 100_000),
        ("tuple", "[1]"),
        ("int (", "1"),
        ("[" * 100_000, "1"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(kind: str, text: str) -> None:
    with pytest.raises(BlockRobotError, match="act: p0 takes") as refusal:
        read_arguments(entry(kind), [text])
    assert refusal.value.code == "CONTRACT_ARGUMENTS_INVALID"
    assert len(refusal.value.detail) < 200


def test_arguments_are_counted_and_an_entry_is_found_by_name_and_kind() -> None:
    both = entry("int", "str", required=1)
    assert read_arguments(both, ["1"]) == [1]
    assert signature_of(both) == "act(p0: int, p1: str = ...) -> None"
    with pytest.raises(BlockRobotError, match=r"act\(p0: int, p1: str = ...\) -> None takes 1 to 2 arguments, not 3"):
        read_arguments(both, ["1", "2", "3"])
    entries = (entry("int"),)
    assert find_entry("notes", entries, "act", "export").name == "act"
    with pytest.raises(BlockRobotError, match=r"notes.act is no view but one marked @export. There are: none."):
        find_entry("notes", entries, "act", "view")
    with pytest.raises(BlockRobotError, match=r"notes.write is no export of it. There are: act."):
        find_entry("notes", entries, "write", "export")
