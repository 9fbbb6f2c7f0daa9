"""GDPR Article 19: whoever received data hears what became of it, and its owner hears who received it.

Each recipient to whom records were shared is told of (1) erasure, of a record or of single pictures, (2) rectification,
and (3) restriction, and of the end of what was shared; she confirms on the chain that copies are gone (4). Where the
owner asks who that was, she is told: by her own wallet, since the chain does not know it (5). What a recipient does with
a copy outside of BlockRobot is for people to see to: the confirmation is her word.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest
from click.testing import CliRunner

from clients.wallet.cli import main
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.share_text import name_recipient
from clients.wallet.records.rights_requests import RecordChoice, Rights
from clients.wallet.sharing.incoming_shares import ChangeNotice, IncomingShare
from tests.world.commands import open_for_commands
from tests.world.sharing import SharedWard


@pytest.fixture
def ward(tmp_path: Path) -> SharedWard:
    return SharedWard(tmp_path)


@pytest.fixture
def doctor(ward: SharedWard) -> Wallet:
    return ward.come_in("doctor", "staff")


async def inbox_of(ward: SharedWard, wallet: Wallet) -> IncomingShare:
    (receipt,) = await ward.receiving(wallet).inbox()
    return receipt


async def test_1_every_recipient_hears_of_an_erasure_and_nobody_else_has_a_notice(
    ward: SharedWard, doctor: Wallet
) -> None:
    visit, (gone, cut) = ward.record_visit()
    nurse, stranger = ward.come_in("nurse", "staff"), ward.come_in("stranger", "staff")
    for recipient, label in ((doctor, "Dr Weber"), (nurse, "Nurse")):
        await ward.share(recipient, label=label)
    await ward.erase(visit, [gone])
    await ward.erase(visit, [cut], [0])
    for recipient in (doctor, nurse):
        assert (await inbox_of(ward, recipient)).notices == (
            ChangeNotice(gone, "erased", confirmed=False),
            ChangeNotice(cut, "pictures-erased", confirmed=False),
        )
    assert await ward.receiving(stranger).inbox() == []


async def test_2_and_3_every_recipient_hears_of_a_correction_and_of_a_restriction(
    ward: SharedWard, doctor: Wallet
) -> None:
    _, (first, _) = ward.record_visit()
    await ward.share(doctor)
    rights, visit = Rights(ward.wallet), await ward.known_visit()
    one = RecordChoice(visit, tuple(entry for entry in await ward.entries() if entry.record_id == first))
    await rights.correct(one, "attribution", "That is my sister.")
    await rights.restrict(one, "accuracy")
    receipt = await inbox_of(ward, doctor)
    assert {(notice.record_id, notice.kind) for notice in receipt.notices} == {
        (first, "corrected"),
        (first, "restricted"),
    }
    await rights.lift(one)
    assert {notice.kind for notice in (await inbox_of(ward, doctor)).notices} == {"corrected"}


async def test_4_what_a_recipient_confirms_stands_in_the_owners_trail(ward: SharedWard, doctor: Wallet) -> None:
    visit, (gone, _) = ward.record_visit()
    await ward.share(doctor)
    await ward.erase(visit, [gone])
    receipt = await inbox_of(ward, doctor)
    await ward.receiving(doctor).confirm_deleted(receipt, receipt.to_confirm)
    (share,) = await ward.sharing.shares()
    assert name_recipient(share).startswith("Dr Weber (handle ")
    assert share.confirmed == {gone}


def test_5_who_erases_is_told_who_had_received_it(
    ward: SharedWard, doctor: Wallet, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, ids = ward.record_visit()

    async def share_and_look() -> None:
        await ward.share(doctor)
        receipt, receiving = await inbox_of(ward, doctor), ward.receiving(doctor)
        access_id = await receiving.request_access(receipt, ids[:1])
        await receiving.look(receipt, ids[0], access_id)

    asyncio.run(share_and_look())
    open_for_commands(monkeypatch, lambda: ward.wallet)
    told = CliRunner().invoke(main.wallet, ["erase", ids[0].hex(), "--yes"])
    assert told.exit_code == 0, told.output
    for part in ("Dr Weber", "looked", "is told", "wallet shares"):
        assert part in told.output


async def test_5_the_chain_names_no_recipient(ward: SharedWard, doctor: Wallet) -> None:
    ward.record_visit()
    await ward.share(doctor)
    handle, member = doctor.store.content.handle, doctor.keys.identity.public_key
    about = [row for key, row in ward.chain.state.scan(b"access\x00", 1000)]
    assert about
    assert not [row for row in about if handle in row or member in row]
