"""The page tells who holds words of the wallet and what to type. It has no route for words, and shows none."""

from __future__ import annotations

import json

from clients.wallet.recovery.slip39_shares import split_mnemonic
from clients.wallet.store.keystore import GuardianSet
from tests.unit.clients.wallet.page.conftest import PageHarness


async def test_the_page_tells_of_guardians_and_how_to_name_them(desk: PageHarness) -> None:
    (first, second) = (await desk.page.get("/api/overview"))["guardians"]
    assert first["sentence"].startswith("This wallet knows of no guardians.")
    assert first["at_ms"] is None
    assert second["sentence"].endswith("blockrobot wallet --profile ann guardians split" + " --guardian NAME" * 3)
    content = desk.session.wallet.store.content
    shares = split_mnemonic(content.words, 2, 3)
    content.guardian_sets.append(GuardianSet(1_800_000_000_000, 2, ["Ann", "Ben", "Cleo"], 4711, 0, 2))
    overview = await desk.page.get("/api/overview")
    line, cut_short, stay = overview["guardians"]
    assert line == {
        "sentence": "Set 04711: any 2 of 3 bring this wallet back: Ann, Ben, Cleo.",
        "at_ms": 1_800_000_000_000,
    }
    assert cut_short["sentence"].startswith("Cut short: 2 of 3")
    assert "rotate" in stay["sentence"]
    told = json.dumps(overview).split()
    assert not any(" ".join(share.split()[:5]) in " ".join(told) for share in shares)
