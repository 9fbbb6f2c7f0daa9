"""Receipts to take along: what the wallet keeps and what can be had; nothing that is missing keeps an export back."""

from __future__ import annotations

import errno
from pathlib import Path

import msgspec
import pytest

from clients.bundle.checks.bundle_check import Verdict, unproved, verify_bundle
from clients.wallet.consent import receipt_collection
from clients.wallet.consent.receipt_fetching import ConsentReceipts
from clients.wallet.export.export_building import ExportChoice
from clients.wallet.recovery.key_rotation import KeyRotation
from consensus.errors import BlockRobotError
from network.notices.notice_publishing import demo_notice
from tests.unit.clients.bundle.conftest import make
from tests.world.notices import NoticeWard, entry_of


@pytest.fixture
def ward(tmp_path: Path) -> NoticeWard:
    """A yes, a no and a withdrawal, all said with another copy of the wallet."""
    ward = NoticeWard(tmp_path)
    ward.publish(demo_notice())
    say(ward, "give", ["care"], ["rgb"], 0, 0, 0, ward.chain.height)
    say(ward, "refuse", ["research"], [])
    say(ward, "withdraw", [], [])
    return ward


def say(ward: NoticeWard, entry: str, *arguments: object) -> bytes:
    return ward.chain.must(ward.patient.identity, "consent", entry, ward.patient.handle, *arguments).txid


async def export(ward: NoticeWard, path: Path) -> Verdict:
    await make(ward, path, ExportChoice(pictures=False))
    return verify_bundle(path, ward.genesis)


def statuses(verdict: Verdict) -> list[str]:
    return [each.statement.status for each in verdict.signed]


def codes(verdict: Verdict) -> list[str]:
    return [problem.code for problem in verdict.manifest.problems]


async def test_what_the_wallet_holds_and_what_it_lacks_go_along_and_are_kept(ward: NoticeWard, tmp_path: Path) -> None:
    await ConsentReceipts(ward.wallet).all()
    verdict = await export(ward, tmp_path / "mine.zip")
    assert (statuses(verdict), codes(verdict)) == (["given", "given", "refused", "withdrawn"], [])
    assert len(ward.wallet.store.content.receipts) == 4
    ward.network.custody.custodians = ()
    again = await export(ward, tmp_path / "again.zip")
    assert (statuses(again), codes(again)) == (statuses(verdict), []), "nobody has to be asked twice"


async def test_a_receipt_that_nobody_gives_is_said_and_the_rest_is_there(ward: NoticeWard, tmp_path: Path) -> None:
    await ConsentReceipts(ward.wallet).all(search=True)
    say(ward, "refuse", ["demo"], [])
    ward.network.custody.custodians = ()
    verdict = await export(ward, tmp_path / "mine.zip")
    assert (len(verdict.signed), codes(verdict)) == (4, ["CONSENT_RECEIPT_ELSEWHERE"])
    assert "signed by both sides" in verdict.manifest.problems[0].sentence
    assert len(verdict.consents.history) == 4
    assert any("under which notice 1 of the owner's words" in line for line in unproved(verdict))


async def test_with_no_receipt_at_all_the_bundle_is_one_that_older_programs_read(
    ward: NoticeWard, tmp_path: Path
) -> None:
    ward.network.custody.custodians = ()
    verdict = await export(ward, tmp_path / "mine.zip")
    assert (verdict.signed, verdict.manifest.version) == ((), 1)
    assert codes(verdict) == ["CONSENT_RECEIPT_ELSEWHERE"] * 4


async def test_who_asks_too_long_in_vain_asks_no_more(
    ward: NoticeWard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    async def nobody(_: ConsentReceipts, txid: bytes, **__: object) -> None:
        asked.append(txid)
        raise BlockRobotError("NODE_UNREACHABLE")

    monkeypatch.setattr(ConsentReceipts, "obtain", nobody)
    monkeypatch.setattr(receipt_collection, "FAILING_MAX_S", 1e-9)
    verdict = await export(ward, tmp_path / "mine.zip")
    assert (len(asked), codes(verdict)) == (1, ["NODE_UNREACHABLE"] * 4)
    assert sum("was not asked for" in each.sentence for each in verdict.manifest.problems) == 3


@pytest.mark.parametrize("damage", [b"", b"{", b"\xff", b"[]", b"cut"])
async def test_a_receipt_that_is_damaged_in_the_wallet_is_said_and_fetched_anew(
    ward: NoticeWard, tmp_path: Path, damage: bytes
) -> None:
    await ConsentReceipts(ward.wallet).all(search=True)
    content = ward.wallet.store.content
    content.receipts[1] = content.receipts[1][:-90] if damage == b"cut" else damage
    verdict = await export(ward, tmp_path / "mine.zip")
    assert (len(verdict.signed), codes(verdict)) == (4, ["CONSENT_RECEIPT_INVALID"])
    assert "left out" in verdict.manifest.problems[0].sentence


async def test_a_receipt_that_was_changed_in_the_wallet_never_goes_along(ward: NoticeWard, tmp_path: Path) -> None:
    await ConsentReceipts(ward.wallet).all(search=True)
    content = ward.wallet.store.content
    content.receipts[2] = content.receipts[2].replace(b"refused", b"refuxed", 1)
    ward.network.custody.custodians = ()
    verdict = await export(ward, tmp_path / "mine.zip")
    assert statuses(verdict) == ["given", "given", "withdrawn"]
    assert sorted(codes(verdict)) == ["CONSENT_RECEIPT_ELSEWHERE", "CONSENT_RECEIPT_INVALID"]


async def test_the_receipt_of_another_person_in_the_wallet_is_left_out(ward: NoticeWard, tmp_path: Path) -> None:
    await ConsentReceipts(ward.wallet).all(search=True)
    ben = ward.chain.enrol("ben")
    word = ward.chain.must(ben.identity, "consent", "refuse", ben.handle, ["care"], [])
    his = await entry_of(ward, ben.identity, word.txid)
    ward.wallet.store.content.receipts.append(msgspec.json.encode(his))
    verdict = await export(ward, tmp_path / "mine.zip")
    assert (len(verdict.signed), codes(verdict)) == (4, ["CONSENT_RECEIPT_INVALID"])
    assert "another person" in verdict.manifest.problems[0].sentence


async def test_more_than_a_bundle_takes_leaves_out_the_oldest(
    ward: NoticeWard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(receipt_collection, "RECEIPTS_MAX_COUNT", 2)
    verdict = await export(ward, tmp_path / "many.zip")
    assert (statuses(verdict), codes(verdict)) == (["refused", "withdrawn"], ["EXPORT_TOO_LARGE"])
    monkeypatch.setattr(receipt_collection, "SIGNED_RECEIPTS_MAX_BYTES", 2_000)
    verdict = await export(ward, tmp_path / "large.zip")
    assert (verdict.signed, verdict.manifest.version, codes(verdict)) == ((), 1, ["EXPORT_TOO_LARGE"])


async def test_a_wallet_that_cannot_be_written_keeps_no_export_back(
    ward: NoticeWard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full() -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(ward.wallet.store, "save", full)
    verdict = await export(ward, tmp_path / "mine.zip")
    assert set(codes(verdict)) == {"FILE_UNUSABLE"}


async def test_a_receipt_that_came_and_could_not_be_stored_goes_along(
    ward: NoticeWard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full_once_it_is_there() -> None:
        if len(ward.wallet.store.content.receipts) == 4:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(ward.wallet.store, "save", full_once_it_is_there)
    verdict = await export(ward, tmp_path / "mine.zip")
    assert (len(verdict.signed), codes(verdict)) == (4, [])


async def test_a_ledger_whose_events_cannot_be_read_is_said(
    ward: NoticeWard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def unread(_: ConsentReceipts) -> list[bytes]:
        raise BlockRobotError("NODE_UNREACHABLE")

    await ConsentReceipts(ward.wallet).all(search=True)
    monkeypatch.setattr(ConsentReceipts, "find_words", unread)
    verdict = await export(ward, tmp_path / "mine.zip")
    assert (len(verdict.signed), codes(verdict)) == (4, ["NODE_UNREACHABLE"])


async def test_what_was_said_by_a_former_key_goes_along_and_stands_in_the_history(
    ward: NoticeWard, tmp_path: Path
) -> None:
    """The handle joins them: the chain takes words under it from its member alone."""
    await ConsentReceipts(ward.wallet).all(search=True)
    rotating = KeyRotation(ward.wallet)
    rotating.prepare()
    rotating.confirm_shown()
    assert await rotating.rotate()
    ward.patient.keys = ward.wallet.keys
    say(ward, "give", ["care"], ["depth"], 0, 0, 0, ward.chain.height)
    verdict = await export(ward, tmp_path / "mine.zip")
    assert (statuses(verdict), codes(verdict)) == (["given", "given", "refused", "withdrawn", "given"], [])
    assert [word.kind for word in verdict.consents.history] == ["given", "refused", "withdrawn", "given"]
    assert len({each.statement.member for each in verdict.signed}) == 2
