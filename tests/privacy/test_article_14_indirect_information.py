"""GDPR Article 14: what she is told of data that come not from herself, but from the registrar and from robots.

14(1)(d): which categories; 14(2)(f): from which source; 14(3): at the latest when she is first spoken to.
"""

from __future__ import annotations

from clients.wallet.consent.notice_reading import Notices
from clients.wallet.presentation.consent_text import notice_text
from consensus.members.vouchers import encode_card_code
from consensus.rights.notices import SOURCES
from network.notices.notice_publishing import demo_notice
from tests.world.notices import NoticeWard


async def test_14_1_d_and_2_f_each_category_names_its_source(published: NoticeWard) -> None:
    text = "\n".join(notice_text(await Notices(published.wallet).current()))
    for category in demo_notice().categories:
        assert f"Data: {category.what} From: {category.origin}" in text
    assert {category.source for category in demo_notice().categories} == set(SOURCES)


async def test_14_what_the_registrar_gives_is_what_the_notice_says(published: NoticeWard) -> None:
    """The chain holds of who registers what came from the card, and nothing that the notice does not name."""
    row = published.chain.value("identity", b"member/" + published.wallet.keys.identity.public_key)
    said = {"handle", "role", "org", "since", "status"}
    keys = {"spend", "view", "sealing"}
    assert set(row) == said | keys
    assert "uid" not in str(sorted(row)).lower()
    words = " ".join(each.what for each in demo_notice().categories)
    for named in ("handle", "role", "organisation", "public keys", "tag"):
        assert named in words


async def test_14_3_it_is_there_at_the_first_contact_without_any_account(published: NoticeWard) -> None:
    """A card was issued, nothing more: its holder reads what its issuer knows of her, in nobody's session."""
    holder = published.open_wallet("holder")
    asked = len(published.network.asked)
    told = await Notices(holder).for_card(encode_card_code(published.chain.card("holder")))
    assert told.organisation == "ward"
    assert any("registration desk" in line for line in notice_text(told))
    assert len(published.network.asked) == asked, "no question was asked in anybody's name"
