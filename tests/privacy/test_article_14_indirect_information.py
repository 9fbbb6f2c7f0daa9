"""GDPR Article 14: what she is told of data that come not from herself, but from the registrar and from robots.

14(1)(d): which categories; 14(2)(f): from which source; 14(3): at the latest when she is first spoken to.
"""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from clients.wallet.consent.notice_reading import Notices
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import draw_words
from consensus.errors import BlockRobotError
from consensus.members.vouchers import encode_card_code
from consensus.rights.notices import SOURCES, encode_notice
from network.notices.demo_notice import demo_notice
from tests.unit.clients.bundle.receipting import NoticeWard
from tests.unit.clients.wallet.conftest import CHEAP


@pytest.fixture
def ward(tmp_path: Path) -> NoticeWard:
    ward = NoticeWard(tmp_path)
    ward.publish(demo_notice())
    return ward


async def test_14_1_d_and_2_f_each_category_names_its_source(ward: NoticeWard) -> None:
    text = "\n".join((await Notices(ward.wallet).current()).lines())
    for category in demo_notice().categories:
        assert f"Data: {category.what} From: {category.origin}" in text
    assert {category.source for category in demo_notice().categories} == set(SOURCES)


def test_14_2_f_a_notice_that_is_silent_on_the_registrar_is_never_published() -> None:
    own = [each for each in demo_notice().categories if each.source != "registrar"]
    with pytest.raises(BlockRobotError, match=r"Art\. 14"):
        encode_notice(msgspec.structs.replace(demo_notice(), categories=own))


async def test_14_what_the_registrar_gives_is_what_the_notice_says(ward: NoticeWard) -> None:
    """The chain holds of who registers what came from the card, and nothing that the notice does not name."""
    row = ward.chain.value("identity", b"member/" + ward.wallet.keys.identity.public_key)
    said = {"handle", "role", "org", "since", "status"}
    keys = {"spend", "view", "sealing"}
    assert set(row) == said | keys
    assert "uid" not in str(sorted(row)).lower()
    words = " ".join(each.what for each in demo_notice().categories)
    for named in ("handle", "role", "organisation", "public keys", "tag"):
        assert named in words


async def test_14_3_it_is_there_at_the_first_contact_without_any_account(ward: NoticeWard, tmp_path: Path) -> None:
    """A card was issued, nothing more: its holder reads what its issuer knows of her, in nobody's session."""
    holder = Wallet(Keystore.create(tmp_path / "holder.wallet", draw_words(), "tea", CHEAP), ward.genesis)
    holder.network = ward.network  # type: ignore[assignment]
    asked = len(ward.network.asked)
    told = await Notices(holder).for_card(encode_card_code(ward.chain.card("holder")))
    assert told.organisation == "ward"
    assert any("registration desk" in line for line in told.lines())
    assert len(ward.network.asked) == asked, "no question was asked in anybody's name"
