"""GDPR Article 13: what she is told where data come from herself, before they do, and when it changes.

13(1): who, why, on what ground, who receives it, where to; 13(2): how long, rights, taking consent back, complaints,
whether she has to, automated decisions; 13(3): a further purpose is told before.
"""

from __future__ import annotations

import msgspec

from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.consent.notice_reading import Notices
from clients.wallet.consent.receipt_fetching import ConsentReceipts
from clients.wallet.presentation.consent_text import notice_text
from consensus.members.vouchers import encode_card_code
from consensus.rights.notices import RIGHTS_NAMED, Notice
from network.notices.notice_publishing import demo_notice
from tests.world.notices import NoticeWard


def further_purpose() -> Notice:
    teaching = msgspec.structs.replace(
        demo_notice().purposes[0], code="teaching", words="Teaching and training of staff."
    )
    return msgspec.structs.replace(demo_notice(), purposes=[*demo_notice().purposes, teaching])


async def told(published: NoticeWard) -> str:
    return "\n".join(notice_text(await Notices(published.wallet).current()))


async def test_13_1_before_the_first_word_she_is_told_who_why_on_what_ground_and_who_receives(
    published: NoticeWard,
) -> None:
    """Nothing of her is on the chain yet: no session, no handle, and what is read is proved."""
    new = published.open_wallet("new")
    height = published.chain.height
    text = "\n".join(notice_text(await Notices(new).for_card(encode_card_code(published.chain.card("new")))))
    notice = demo_notice()
    for words in (notice.controller.contact, notice.officer.contact, notice.third_countries):
        assert words in text
    for purpose in notice.purposes:
        assert f"Purpose {purpose.code}: {purpose.words} Ground: {purpose.lawful_basis}" in text
    assert "Art. 9(2)(a)" in text
    assert all(each.who in text for each in notice.recipients)
    assert published.chain.height == height, "reading puts nothing on the chain"
    assert not new.store.content.handle


async def test_13_2_how_long_which_rights_where_to_complain_and_whether_she_has_to(published: NoticeWard) -> None:
    text = await told(published)
    for article in RIGHTS_NAMED:
        assert f"Your right (Art. {article})" in text
    for words in ("withdraw", demo_notice().authority.contact, demo_notice().obligation, "for as long as this chain"):
        assert words in text
    assert "Automated decisions: None." in text


async def test_13_3_a_further_purpose_is_shown_before_she_consents_to_it(published: NoticeWard) -> None:
    notices = Notices(published.wallet)
    first = await notices.due()
    assert first is not None
    notices.note_shown(first)
    word = await ConsentClient(published.wallet).give(["care"], ["depth"])
    receipt = await ConsentReceipts(published.wallet).obtain(word.txid)
    assert receipt.published is not None
    assert await notices.due() is None
    assert await notices.changed_since_consent() is None
    published.publish(further_purpose())
    due, changed = await notices.due(), await notices.changed_since_consent()
    assert due is not None
    assert changed is not None
    assert (due.version, changed.version) == (2, 2)
    (line,) = (await notices.current()).changes
    assert line.startswith("+ Purpose teaching: Teaching and training of staff.")


async def test_13_what_she_was_told_stands_in_her_receipt_and_cannot_be_changed_afterwards(
    published: NoticeWard,
) -> None:
    word = await ConsentClient(published.wallet).give(["care"], ["depth"])
    published.publish(further_purpose())
    receipt = await ConsentReceipts(published.wallet).obtain(word.txid)
    assert receipt.published is not None
    assert (receipt.published.row.version, receipt.published.notice) == (1, demo_notice())
    assert receipt.fields["privacy_notice"]["hash"] == receipt.published.row.digest.hex()
