"""The passphrase asked for again: who comes to an open page shares, erases, takes along and registers nothing."""

from __future__ import annotations

import asyncio
import re
from pathlib import Path
from typing import Any, NoReturn, cast

import msgspec
import pytest

import clients.wallet.page as page_package
from clients.wallet.page.passphrase_check import ATTEMPTS_MAX_COUNT, PassphraseGate
from clients.wallet.store.keystore import Keystore
from consensus.errors import BlockRobotError
from consensus.members.vouchers import encode_card_code
from tests.unit.clients.wallet.page.conftest import PASSPHRASE, PageHarness
from tests.world.sharing import WEEK_MS

GUARDED = ("/api/shares", "/api/erasures", "/api/exports", "/api/registration")
NO_PASSPHRASES: tuple[dict[str, Any], ...] = ({}, {"passphrase": None}, {"passphrase": 7}, {"passphrase": "t" * 1_025})
WRONG_PASSPHRASES = ("", "Tea", "coffee")


async def wish_for(desk: PageHarness, path: str) -> dict[str, Any]:
    """Return what the page sends to a guarded route, but for the passphrase: what is asked can be done as it stands."""
    _, ids = desk.ward.record_visit()
    await desk.read()
    records = [record_id.hex() for record_id in ids]
    if path == "/api/shares":
        doctor = desk.ward.come_in("doctor", "staff")
        whom = {"with": doctor.store.content.handle.hex(), "name": "Dr Weber", "purpose": "care"}
        return {"records": records, **whom, "until_ms": desk.ward.chain.time_ms + WEEK_MS}
    if path == "/api/erasures":
        return {"records": records}
    if path == "/api/exports":
        return {"now": True, "identity": False}
    code = encode_card_code(desk.ward.chain.card("bea"))
    return {"code": code, "organisation": "hospital", "notice_version": 0, "notice_hash": ""}


def all_that_is(desk: PageHarness) -> dict[str, Any]:
    """Return what a guarded route could change: the chain, the wallet, its files, and what the page does and holds."""
    session = desk.session
    return {
        "block": desk.ward.chain.head.height,
        "state": desk.ward.chain.head.state_root,
        "wallet": msgspec.msgpack.encode(desk.ward.wallet.store.content),
        "custody": (sorted(desk.ward.custody.clips), sorted(desk.ward.custody.parts)),
        "files": sorted((path.name, path.read_bytes()) for path in desk.ward.folder.rglob("*") if path.is_file()),
        "jobs": dict(session.jobs._jobs),
        "exports": dict(session.exports),
        "clips": session.clips.with_record(next(iter(session.snapshot.entries))),
    }


@pytest.mark.parametrize("path", GUARDED)
async def test_without_the_passphrase_nothing_begins_and_nothing_changes(desk: PageHarness, path: str) -> None:
    wish = await wish_for(desk, path)
    before = all_that_is(desk)
    for passphrase in NO_PASSPHRASES:
        assert await desk.page.refused("POST", path, wish | passphrase) == "REQUEST_INVALID"
    assert all_that_is(desk) == before


@pytest.mark.parametrize("path", GUARDED)
async def test_with_a_wrong_passphrase_nothing_begins_and_nothing_changes(desk: PageHarness, path: str) -> None:
    wish = await wish_for(desk, path)
    before = all_that_is(desk)
    for passphrase in WRONG_PASSPHRASES:
        assert await desk.page.refused("POST", path, wish | {"passphrase": passphrase}) == "WALLET_PASSPHRASE_WRONG", (
            passphrase
        )
    assert all_that_is(desk) == before


@pytest.mark.parametrize("path", GUARDED)
async def test_the_same_wish_with_the_passphrase_begins(desk: PageHarness, path: str) -> None:
    """Else a wish that is refused for another reason would pass for one that is guarded."""
    wish = await wish_for(desk, path)
    desk.session.ended.set()  # an erasure waits for no receipts then
    before = all_that_is(desk)
    accepted = await desk.page.post(path, wish | {"passphrase": PASSPHRASE})
    job = await desk.page.follow(accepted)
    assert accepted["job"] not in before["jobs"]
    if path != "/api/registration":  # she is a member already: the contract has the last word
        assert job["state"] == "done", job["error"]


def test_every_route_that_asks_for_the_passphrase_is_among_those_tried_here() -> None:
    """A route that is guarded from now on belongs into GUARDED; one that lost its question fails above."""
    sources = [path.read_text(encoding="utf-8") for path in Path(page_package.__path__[0]).rglob("*_routes.py")]
    asking = sum(len(re.findall(r'asked\.text\("passphrase"\)', source)) for source in sources)
    guarding = sum(source.count("session.gate.require(passphrase)") for source in sources)
    assert asking == guarding == len(GUARDED)


class _Store:
    """What a gate asks of a wallet's file; one passphrase opens it."""

    def __init__(self) -> None:
        self.asked_count = 0

    def opens_with(self, passphrase: str) -> bool:
        self.asked_count += 1
        return passphrase == PASSPHRASE


async def test_after_the_tenth_wrong_passphrase_not_even_the_right_one_that_waited_behind_it_is_let_through() -> None:
    store, given_up, now_ms = _Store(), [], 0
    gate = PassphraseGate(cast(Keystore, store), lambda: now_ms, lambda: given_up.append(True))
    for _ in range(ATTEMPTS_MAX_COUNT - 1):
        with pytest.raises(BlockRobotError):
            await gate.require("guess")
        now_ms += 10**9
    waiting = await asyncio.gather(*map(gate.require, ["guess", "guess", PASSPHRASE]), return_exceptions=True)
    assert [error.code for error in waiting if isinstance(error, BlockRobotError)] == ["PASSPHRASE_LOCKED"] * 3
    assert (store.asked_count, given_up) == (ATTEMPTS_MAX_COUNT, [True])


async def test_a_check_that_breaks_off_is_not_taken_for_one_that_let_through(monkeypatch: pytest.MonkeyPatch) -> None:
    def break_off(_: str) -> NoReturn:
        raise MemoryError

    store = _Store()
    gate = PassphraseGate(cast(Keystore, store), lambda: 0, lambda: None)
    monkeypatch.setattr(store, "opens_with", break_off)
    asked = asyncio.create_task(gate.require(PASSPHRASE))
    await asyncio.sleep(0)
    assert gate.is_asked
    assert not await gate.finish_checks()
    with pytest.raises(MemoryError):
        await asked
