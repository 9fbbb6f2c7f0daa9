"""Registering in the page: with the very notice of the very organisation that was on the screen, or not at all."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest

from clients.wallet.ledger.wallet import Wallet
from clients.wallet.page.page import make_page
from clients.wallet.page.session import PageSession
from consensus.members.vouchers import encode_card_code
from network.notices.notice_publishing import demo_notice
from tests.wallet_page_client import WalletPage
from tests.world.notices import NoticeWard

PASSPHRASE = "tea"


@dataclass
class Newcomer:
    """Somebody with a card before the page of her new wallet."""

    ward: NoticeWard
    wallet: Wallet
    page: WalletPage
    code: str

    async def look(self) -> dict[str, Any]:
        """Have the page tell what she is told; return what it then sends if she registers."""
        notice = (await self.page.post("/api/registration/plan", {"code": self.code}))["notice"]
        shown = {"organisation": notice["organisation"], "notice_version": notice["version"]}
        return {"code": self.code, **shown, "notice_hash": notice["hash"] or "", "passphrase": PASSPHRASE}

    async def register(self, wish: dict[str, Any]) -> Any:
        """Return why it was refused, or None."""
        job = await self.page.follow(await self.page.post("/api/registration", wish))
        return job["error"] and job["error"]["code"]

    @property
    def is_registered(self) -> bool:
        member = self.wallet.keys.identity.public_key
        return self.ward.chain.value("identity", b"member/" + member) is not None


@pytest.fixture
async def newcomer(tmp_path: Path) -> AsyncIterator[Newcomer]:
    ward = NoticeWard(tmp_path)
    wallet = ward.open_wallet("new")
    code = encode_card_code(ward.chain.card("newcomer"))
    async with PageSession(wallet, "new", tmp_path / ".new.page", read_every_s=3_600.0) as session:
        served = make_page(session)
        async with WalletPage((await served.start()).redirect_file) as page:
            yield Newcomer(ward, wallet, page, code)
        await served.stop()


async def test_the_page_shows_published_words_under_headings_in_its_language(newcomer: Newcomer) -> None:
    newcomer.ward.publish(demo_notice())
    for language, heading in (("pt", "O seu direito (art. 17): "), ("en", "Your right (Art. 17): ")):
        newcomer.page.headers["Accept-Language"] = language
        lines = (await newcomer.page.post("/api/registration/plan", {"code": newcomer.code}))["notice"]["lines"]
        assert [line for line in lines if line.startswith(heading)]
        assert demo_notice().rights[0].words in "".join(lines)


@pytest.mark.parametrize("published", [True, False])
async def test_who_was_told_what_is_in_force_is_registered_and_the_wallet_knows_that_she_was(
    newcomer: Newcomer, published: bool
) -> None:
    if published:
        newcomer.ward.publish(demo_notice())
    assert await newcomer.register(await newcomer.look()) is None
    assert newcomer.is_registered
    assert newcomer.wallet.store.content.notice_shown_version == int(published)


async def test_nobody_is_registered_under_a_version_that_came_after_the_one_on_the_screen(newcomer: Newcomer) -> None:
    newcomer.ward.publish(demo_notice())
    wish = await newcomer.look()
    newcomer.ward.publish(msgspec.structs.replace(demo_notice(), automated_decisions="None, in other words."))
    assert await newcomer.register(wish) == "NOTICE_NOT_SHOWN"
    assert not newcomer.is_registered
    assert newcomer.wallet.store.content.notice_shown_version == 0
    assert await newcomer.register(await newcomer.look()) is None, "now she has seen it"


@pytest.mark.parametrize("shown", [{"organisation": "Another clinic"}, {"notice_hash": "00" * 32}, {"notice_hash": ""}])
async def test_nobody_is_registered_by_a_card_whose_notice_is_not_the_one_on_the_screen(
    newcomer: Newcomer, shown: dict[str, str]
) -> None:
    newcomer.ward.publish(demo_notice())
    wish = await newcomer.look()
    assert await newcomer.register(wish | shown) == "NOTICE_NOT_SHOWN", "versions count per organisation"
    assert not newcomer.is_registered
    assert newcomer.wallet.store.content.notice_shown_version == 0


@pytest.mark.parametrize("left_out", ["organisation", "notice_version", "notice_hash"])
async def test_nobody_is_registered_without_saying_all_of_what_was_shown(newcomer: Newcomer, left_out: str) -> None:
    wish = await newcomer.look()
    del wish[left_out]
    assert await newcomer.page.refused("POST", "/api/registration", wish) == "REQUEST_INVALID"
