"""GDPR Article 30: the controller's register of processing activities, made from the chain and the notice.

30(1)(a) to (g): who, why, whose and what data, recipients, third countries, time limits, measures; 30(3): in writing.
"""

from __future__ import annotations

from pathlib import Path

import pytest

from clients.sdk.chain.governance import MembershipView
from consensus.errors import BlockRobotError
from consensus.state.membership import NodeRow, OrganisationRow
from network.cli.governance.notice_commands import activities_answer
from network.notices.notice_publishing import demo_notice
from network.notices.processing_register import OPEN, Activities, activities_text, read_activities
from tests.world.notices import NoticeWard


def membership(ward: NoticeWard) -> MembershipView:
    """What the chain says of organisations and nodes, with one more that keeps clips."""
    nodes = [
        NodeRow(name, org, "127.0.0.1", 1, "http://127.0.0.1:2", b"", b"", key, "active", 0)
        for name, org, key in (("node-1", "ward", b"k"), ("node-2", "uni|versity", b"k"), ("node-3", "third", b""))
    ]
    organisations = tuple(OrganisationRow(name, "", "active", 0) for name in ("ward", "uni|versity", "third"))
    return MembershipView(ward.chain.height, ward.chain.time_ms, organisations, tuple(nodes), ())


@pytest.fixture
def ward(tmp_path: Path) -> NoticeWard:
    return NoticeWard(tmp_path)


async def register_of(ward: NoticeWard) -> Activities:
    ward.publish(demo_notice())
    return await read_activities(ward.network, "ward", membership(ward))  # type: ignore[arg-type]


async def test_30_1_a_to_g_everything_that_the_article_names_is_in_it(ward: NoticeWard) -> None:
    text, notice = activities_text(await register_of(ward)), demo_notice()
    for part in ("(a) Who", "(b) Purposes", "(c) Data", "(d) Recipients", "(e) Third", "(f) Time", "(g) Measures"):
        assert f"## {part}" in text
    for words in (notice.controller.contact, notice.officer.contact, notice.third_countries, *notice.measures):
        assert words in text
    for purpose in notice.purposes:
        assert f"| {purpose.code} | {purpose.words} | {purpose.lawful_basis} | {purpose.special_basis} |" in text
    for recipient in notice.recipients:
        assert f"| {recipient.who} | {recipient.what} |" in text
    for kept in notice.retention:
        assert f"| {kept.what} | {kept.how_long} |" in text


async def test_30_1_d_who_else_keeps_clips_comes_from_the_chain_and_not_from_the_notice(ward: NoticeWard) -> None:
    found = await register_of(ward)
    assert found.processors == ("uni|versity",), "who keeps no clips is none"
    assert "uni\\|versity | http://127.0.0.1:2 | ledger and encrypted clips |" in activities_text(found)


async def test_30_3_it_is_in_writing_also_for_programs_and_says_as_of_when(ward: NoticeWard) -> None:
    found = await register_of(ward)
    told = activities_answer(found, None)
    assert (told.organisation, told.height, told.notice.version) == ("ward", found.height, 1)
    assert [row.name for row in told.activities] == [purpose.code for purpose in demo_notice().purposes]
    assert f"as of block {found.height}" in activities_text(found)


async def test_30_what_no_program_knows_is_named_as_open(ward: NoticeWard) -> None:
    found = await register_of(ward)
    assert all(f"- {line}" in activities_text(found) for line in OPEN)
    assert activities_answer(found, None).open == list(OPEN)


async def test_30_without_a_notice_there_is_no_register(ward: NoticeWard) -> None:
    with pytest.raises(BlockRobotError, match=r"^NOTICE_NOT_FOUND:"):
        await read_activities(ward.network, "ward", membership(ward))  # type: ignore[arg-type]
