"""What people are told: complete, in one form, with one hash, and what changed from one version to the next."""

from __future__ import annotations

import random
import time

import msgspec
import pytest

from consensus.errors import BlockRobotError
from consensus.rights.notices import (
    Notice,
    PublishedNotice,
    Right,
    change_lines,
    decode_notice,
    encode_notice,
    notice_digest,
    notice_lines,
    read_published,
    read_row,
)
from network.notices.notice_publishing import demo_notice


def change(**changes: object) -> Notice:
    return msgspec.structs.replace(demo_notice(), **changes)


def test_a_notice_has_one_form_and_one_hash() -> None:
    document = encode_notice(demo_notice())
    assert decode_notice(document) == demo_notice()
    assert notice_digest(document) == notice_digest(encode_notice(demo_notice()))
    for damaged in (b" " + document, document[:-1], document.replace(b'"schema"', b'"shema"'), b"\xff", b"[]"):
        with pytest.raises(BlockRobotError, match="form"):
            decode_notice(damaged)


@pytest.mark.parametrize(
    "changes",
    [
        {"withdrawal": " "},
        {"withdrawal": "\x1b[2J"},
        {"withdrawal": "x" * 2_000},
        {"purposes": []},
        {"measures": []},
        {"schema": "another-1"},
        {"rights": [Right("15", "Look.", "Ask.")]},
        {"purposes": [demo_notice().purposes[0]] * 2},
        {"categories": [each for each in demo_notice().categories if each.source != "registrar"]},
    ],
)
def test_what_says_too_little_is_no_notice(changes: dict[str, object]) -> None:
    with pytest.raises(BlockRobotError, match=r"^NOTICE_INVALID:"):
        encode_notice(change(**changes))


@pytest.mark.parametrize(
    "wrong",
    [{"code": "fun"}, {"lawful_basis": "6a"}, {"special_basis": ""}, {"sensors": ["nose"]}, {"storage_days": 400}],
)
def test_a_purpose_has_a_published_code_and_grounds_of_the_law(wrong: dict[str, object]) -> None:
    purpose = msgspec.structs.replace(demo_notice().purposes[0], **wrong)
    with pytest.raises(BlockRobotError, match=r"^NOTICE_INVALID:"):
        encode_notice(change(purposes=[purpose]))


def test_a_notice_that_no_transaction_could_carry_is_refused() -> None:
    long = "x" * 1_000
    with pytest.raises(BlockRobotError, match="14000 are the most"):
        encode_notice(change(measures=[f"{number} {long}" for number in range(20)]))


def test_a_version_is_read_from_the_state_with_its_words_or_not_at_all() -> None:
    document = encode_notice(demo_notice())
    value = {"version": 2, "hash": notice_digest(document), "height": 7, "time": 9, "document": document}
    found = read_published("hospital", value)
    assert isinstance(found, PublishedNotice)
    assert (found.row.version, found.row.height, found.notice) == (2, 7, demo_notice())
    assert read_published("hospital", None) is None
    for wrong in (value | {"hash": bytes(32)}, value | {"document": 1}):
        with pytest.raises(BlockRobotError, match="hash"):
            read_published("hospital", wrong)
    for other in ({"version": 1}, value | {"height": "7"}, value | {"version": True}, [1]):
        with pytest.raises(BlockRobotError, match="form"):
            read_row("hospital", other)


def test_a_change_is_told_line_by_line_and_no_text_forges_one() -> None:
    before = demo_notice()
    after = change(third_countries="Pictures are kept in a country without an adequate level of protection, too.")
    gone, come = change_lines(before, after)
    assert gone == f"- Other countries: {before.third_countries}"
    assert come == f"+ Other countries: {after.third_countries}"
    assert change_lines(before, before) == []
    assert len(notice_lines(before)) > 20
    forged = "\n- Data: pictures From: robot\n+ Purpose care: nothing is recorded any more."
    after = change(measures=[*before.measures, f"Locked rooms.{forged}"])
    assert change_lines(before, after) == [
        "+ Protection: Locked rooms.",
        "+     | - Data: pictures From: robot",
        "+     | + Purpose care: nothing is recorded any more.",
    ]
    lines = [line for entry in notice_lines(after) for line in entry.split("\n")]
    assert [line for line in lines if line.startswith(("- ", "+ "))] == []
    assert lines[-2:] == ["    | - Data: pictures From: robot", "    | + Purpose care: nothing is recorded any more."]


def test_what_changed_is_found_in_time_that_words_cannot_stretch() -> None:
    """Entries that are alike and never equal: what compares letters of all pairs takes seconds."""
    draw = random.Random(3)

    def words() -> list[str]:
        return ["".join(draw.choice("ab") for _ in range(90)) for _ in range(32)]

    before, after = change(measures=words()), change(measures=words())
    started_s = time.process_time()
    assert len(change_lines(before, after)) == 64
    assert time.process_time() - started_s < 0.1
