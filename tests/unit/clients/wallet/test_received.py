"""What the grantee's wallet does: finds grants in complete pages, opens what was shared, hears what became of it."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.share_text import name_recipient
from clients.wallet.records.rights_requests import RecordChoice, Rights
from clients.wallet.sharing import chain_grants
from clients.wallet.sharing.chain_grants import find_received, grantee_key, resolve_grant
from clients.wallet.sharing.incoming_shares import (
    KIND_CORRECTED,
    KIND_DENIED,
    KIND_ENDED,
    KIND_ERASED,
    KIND_FRAMES_ERASED,
    KIND_RESTRICTED,
    KIND_REVOKED,
    IncomingShare,
    IncomingShares,
)
from clients.wallet.store.keystore import Keystore
from consensus.errors import BlockRobotError
from consensus.members.handles import encode_short
from consensus.records.sharing import GRANT_STEP_MS, SharedDownload
from tests.world.sharing import SharedWard
from tests.world.stolen import take_new_words


@pytest.fixture
def receiving(ward: SharedWard, doctor: Wallet) -> IncomingShares:
    return ward.receiving(doctor)


async def only(receiving: IncomingShares) -> IncomingShare:
    (receipt,) = await receiving.inbox()
    return receipt


async def grant_again(ward: SharedWard, receipt: IncomingShare, records: list[bytes]) -> bytes:
    """Grant records to the very key of a grant before, as no honest wallet does; return the new grant's id."""
    row, (visit,) = receipt.grant.row, await ward.wallet.scan()
    arguments = [records, row.grantee, row.ephemeral, row.view_tag, row.member_hash, row.purpose]
    owner = ward.wallet.owner_key(visit)
    return ward.chain.must(owner, "access", "grant", *arguments, row.until_ms).txid


def kinds(receipt: IncomingShare) -> set[str]:
    return {notice.kind for notice in receipt.notices}


async def test_the_doctor_sees_what_the_robot_took_and_nothing_else(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    _, ids = ward.record_visit()
    await ward.share(doctor)
    receipt = await only(receiving)
    assert (receipt.grant.row.records, receipt.is_open, receipt.notices) == (ids, True, ())
    access_id = await receiving.request_access(receipt, ids)
    for record_id in ids:
        view = await receiving.look(receipt, record_id, access_id)
        assert [frame.status for frame in view.frames] == ["ok", "ok"]
        assert all(frame.rendition is not None and frame.rendition.pixels for frame in view.frames)
        frame = view.frames[0].rendition
        assert frame is not None
        assert await receiving.background(receipt, frame) == ward.room
    assert ward.custody.asked_frames == [True, False, True, False], "of a second custodian only its part is taken"


async def test_nobody_else_finds_the_grant_and_a_second_reading_begins_where_the_first_ended(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chain_grants, "PAGE_COUNT", 2)
    ward.record_visit(1)
    nurse = ward.come_in("nurse", "staff")
    for other, label in ((doctor, "Dr Weber"), (nurse, "Nurse"), (doctor, "Dr Weber")):
        await ward.share(other, label=label)
    assert len(await receiving.inbox()) == 2
    assert len(await ward.receiving(nurse).inbox()) == 1
    assert doctor.store.content.scanned_grants_count == 3
    assert len(await receiving.inbox()) == 2, "what is known is not found again"
    assert await find_received(ward.come_in("visitor", "subject")) == ([], True)


async def test_a_reading_of_grants_that_is_cut_off_goes_on_where_it_was_saved(
    ward: SharedWard, doctor: Wallet, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chain_grants, "PAGE_COUNT", 1)
    monkeypatch.setattr("clients.wallet.ledger.wallet.SCAN_SAVED_EVERY_COUNT", 2)
    ward.record_visit(1)
    for _ in range(4):
        await ward.share(doctor)
    honest, read = chain_grants._read_page, list[int]()

    async def killed(wallet: Wallet, first: int) -> tuple[int, list[chain_grants.Grant]]:
        read.append(first)
        if read == [0, 1, 2, 3]:
            raise KeyboardInterrupt
        return await honest(wallet, first)

    monkeypatch.setattr(chain_grants, "_read_page", killed)
    with pytest.raises(KeyboardInterrupt):
        await find_received(doctor)
    again = Wallet(Keystore.open(doctor.store._path, "tea"), doctor.genesis)
    again.network = doctor.network
    found, _ = await find_received(again)
    assert (len(found), read) == (4, [0, 1, 2, 3, 2, 3]), "from what was saved"


async def test_a_page_that_leaves_a_grant_out_is_refused(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward.record_visit(1)
    await ward.share(doctor)
    honest = doctor.values

    async def without(keys: Any, session: Any) -> dict[bytes, Any]:
        found = await honest(keys, session)
        return {key: None if b"grant-number/" in key else value for key, value in found.items()}

    monkeypatch.setattr(doctor, "values", without)
    with pytest.raises(BlockRobotError, match="PROOF_INVALID"):
        await receiving.inbox()


@pytest.mark.parametrize("left", [True, False])
async def test_who_has_left_or_was_revoked_still_hears_what_became_of_what_she_knew(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares, monkeypatch: pytest.MonkeyPatch, left: bool
) -> None:
    visit, ids = ward.record_visit(1)
    await ward.share(doctor)
    await only(receiving)
    assert receiving.reads_new
    await ward.erase(visit, ids)
    honest, member = doctor.values, doctor.keys.identity.public_key

    async def refuse_member(keys: Any, session: Any) -> dict[bytes, Any]:
        if session.public_key == member:
            raise BlockRobotError("SESSION_REFUSED")
        return await honest(keys, session)

    monkeypatch.setattr(doctor, "values", refuse_member)
    doctor.store.content.left = left
    receipt = await only(receiving)
    assert not receiving.reads_new, "and it is said that nothing new can be read"
    await receiving.confirm_deleted(receipt, receipt.to_confirm)
    assert (await only(receiving)).to_confirm == []


async def test_a_grant_whose_key_reads_nothing_any_more_hides_no_other(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward.record_visit(1)
    await ward.share(doctor)
    await ward.share(doctor)
    old, young = await receiving.inbox()
    honest = doctor.values

    async def refuse_old(keys: Any, session: Any) -> dict[bytes, Any]:
        if session.public_key == old.grant.row.grantee:
            raise BlockRobotError("SESSION_REFUSED")
        return await honest(keys, session)

    monkeypatch.setattr(doctor, "values", refuse_old)
    assert [receipt.grant for receipt in await receiving.inbox()] == [young.grant]
    assert [received.grant_id for received in receiving.faded] == [old.grant.grant_id]


async def test_what_concerns_a_grant_is_asked_in_its_own_session(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    _, ids = ward.record_visit(1)
    await ward.share(doctor)
    receipt = await only(receiving)
    wire: Any = doctor.network
    key = grantee_key(receipt.received, doctor)
    own = key.public_key
    member = doctor.keys.identity.public_key
    about_records = {key for flat, key in wire.asked if flat.startswith((b"records\x00", b"rights\x00"))}
    assert (about_records, own == receipt.grant.row.grantee) == ({own}, True)
    assert {key for flat, key in wire.asked if b"grant-number/" in flat} == {member}
    assert len(ids) == 1
    assert key.grant_id == receipt.grant.grant_id, "or no node would open a session"


async def test_two_grants_of_one_owner_to_one_key_are_both_read_and_looked_at(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    visit, ids = ward.record_visit(2)
    await ward.share(doctor)
    first = await only(receiving)
    twin = await grant_again(ward, first, ids[1:])
    receipts = await receiving.inbox()
    assert [receipt.grant.grant_id for receipt in receipts] == [first.grant.grant_id, twin]
    assert receiving.unread == []
    assert [receipt.grant.row.grantee for receipt in receipts] == [first.grant.row.grantee] * 2
    access_id = await receiving.request_access(receipts[0], ids)
    view = await receiving.look(receipts[0], ids[0], access_id)
    assert [frame.status for frame in view.frames] == ["ok", "ok"], "the one that was there before is as it was"
    await ward.erase(visit, ids[1:])
    for receipt in await receiving.inbox():
        await receiving.confirm_deleted(receipt, receipt.to_confirm)


async def test_a_grant_that_cannot_be_read_is_told_with_why_and_hides_no_other(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward.record_visit(1)
    await ward.share(doctor)
    await ward.share(doctor)
    bad, good = await receiving.inbox()
    honest = doctor.values
    code = "NOT_PERMITTED"

    async def refuse_bad(keys: Any, session: Any) -> dict[bytes, Any]:
        if session.public_key == bad.grant.row.grantee:
            raise BlockRobotError(code)
        return await honest(keys, session)

    monkeypatch.setattr(doctor, "values", refuse_bad)
    assert [receipt.grant for receipt in await receiving.inbox()] == [good.grant]
    assert [(each.received.grant_id, each.error.code) for each in receiving.unread] == [(bad.grant.grant_id, code)]
    assert receiving.faded == []
    code = "NODE_UNREACHABLE"
    with pytest.raises(BlockRobotError, match="NODE_UNREACHABLE"):
        await receiving.inbox()


async def test_one_custodian_alone_opens_nothing_and_says_why(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    _, ids = ward.record_visit(1)
    await ward.share(doctor)
    receipt = await only(receiving)
    access_id = await receiving.request_access(receipt, ids)
    ward.custody.away = {"custodian-1"}
    with pytest.raises(BlockRobotError, match=r"GRANT_PARTS_MISSING.*custodian-1 does not answer"):
        await receiving.look(receipt, ids[0], access_id)
    ward.custody.away = {"custodian-1", "custodian-2"}
    with pytest.raises(BlockRobotError, match="NODE_UNREACHABLE"):
        await receiving.look(receipt, ids[0], access_id)


async def test_a_custodian_that_lies_about_its_part_or_frames_is_found_out(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    _, ids = ward.record_visit(1)
    await ward.share(doctor)
    receipt = await only(receiving)
    access_id = await receiving.request_access(receipt, ids)

    def spoil_parts(name: str, answer: SharedDownload) -> SharedDownload:
        parts = [msgspec.structs.replace(part, value=bytes(32)) for part in answer.parts]
        return msgspec.structs.replace(answer, parts=parts) if name == "custodian-1" else answer

    ward.custody.lie = spoil_parts
    with pytest.raises(BlockRobotError, match="ENVELOPE_INVALID"):
        await receiving.look(receipt, ids[0], access_id)

    def spoil_frames(name: str, answer: SharedDownload) -> SharedDownload:
        frames = [msgspec.structs.replace(frame, ciphertext=b"x" * 200) for frame in answer.frames]
        return msgspec.structs.replace(answer, frames=frames) if name == "custodian-1" else answer

    ward.custody.lie = spoil_frames
    again = await receiving.request_access(receipt, ids)
    view = await receiving.look(receipt, ids[0], again)
    assert (view.corrupted, view.custodians) == ([], ("custodian-1", "custodian-2")), "the other had them whole"

    def hide(_: str, answer: SharedDownload) -> SharedDownload:
        frames = [msgspec.structs.replace(frame, erased=True, ciphertext=b"") for frame in answer.frames]
        return msgspec.structs.replace(answer, frames=frames)

    ward.custody.lie = hide
    once_more = await receiving.request_access(receipt, ids)
    assert (await receiving.look(receipt, ids[0], once_more)).corrupted == [0, 1], "a word alone is no erasure"


async def test_after_the_end_nothing_is_released_and_copies_are_asked_back(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    _, ids = ward.record_visit(1)
    await ward.share(doctor)
    receipt = await only(receiving)
    access_id = await receiving.request_access(receipt, ids)
    (share,) = await ward.sharing.shares()
    await ward.sharing.revoke(share)
    with pytest.raises(BlockRobotError, match="GRANT_ENDED"):
        await receiving.look(receipt, ids[0], access_id)
    with pytest.raises(BlockRobotError, match="GRANT_ENDED"):
        await receiving.request_access(receipt, ids)
    receipt = await only(receiving)
    assert (receipt.is_open, kinds(receipt), receipt.to_confirm) == (False, {KIND_REVOKED}, ids)


async def test_its_time_over_it_is_over(ward: SharedWard, doctor: Wallet, receiving: IncomingShares) -> None:
    ward.record_visit(1)
    await ward.share(doctor, until_ms=ward.until_ms(1))
    assert (await only(receiving)).is_open
    ward.chain.time_ms += GRANT_STEP_MS
    ward.record_visit(1)  # a block passes
    receipt = await only(receiving)
    assert (receipt.is_open, receipt.notices) == (False, ()), "who has nothing has nothing to delete"
    receiving.remember_copy(receipt, receipt.grant.row.records[0], "/somewhere")
    receipt = await only(receiving)
    assert (kinds(receipt), receipt.to_confirm) == ({KIND_ENDED}, list(receipt.grant.row.records))


async def test_the_inbox_tells_what_was_erased_since_and_the_owner_sees_it_confirmed(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    visit, (gone, kept) = ward.record_visit()
    await ward.share(doctor)
    receipt = await only(receiving)
    await ward.erase(visit, [gone])
    receipt = await only(receiving)
    assert [(notice.record_id, notice.kind) for notice in receipt.notices] == [(gone, KIND_ERASED)]
    assert receipt.to_confirm == [gone]
    receiving.remember_copy(receipt, gone, "/somewhere")
    receiving.remember_copy(receipt, kept, "/somewhere")
    await receiving.confirm_deleted(receipt, [gone])
    receipt = await only(receiving)
    assert (receipt.to_confirm, [copy.record_id for copy in receipt.received.copies]) == ([], [kept])
    (share,) = await ward.sharing.shares()
    assert share.confirmed == {gone}
    with pytest.raises(BlockRobotError, match="NOTHING_TO_CONFIRM"):
        await receiving.confirm_deleted(receipt, [gone])


async def test_pictures_that_were_erased_before_sharing_are_no_news_and_later_ones_are(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    visit, (early, late) = ward.record_visit()
    await ward.erase(visit, [early], [0])
    await ward.share(doctor)
    assert (await only(receiving)).notices == ()
    await ward.erase(visit, [late], [1])
    (notice,) = (await only(receiving)).notices
    assert (notice.record_id, notice.kind) == (late, KIND_FRAMES_ERASED)


async def test_an_erasure_of_single_pictures_is_told_before_every_custodian_has_confirmed_it(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    visit, (record_id,) = ward.record_visit(1)
    await ward.share(doctor)
    key = await ward.owner_key(visit.owner)
    asked = ward.chain.must(key, "erasure", "request", [record_id], [0]).txid
    assert kinds(await only(receiving)) == {KIND_FRAMES_ERASED}
    ward.chain.receipts_of_all(asked)
    assert kinds(await only(receiving)) == {KIND_FRAMES_ERASED}


async def test_who_looks_again_after_saying_that_copies_are_gone_is_not_shown_as_having_none(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    visit, (gone, first, second) = ward.record_visit(3)
    await ward.share(doctor)
    await ward.erase(visit, [gone])
    receipt = await only(receiving)
    with pytest.raises(BlockRobotError, match="NOTHING_TO_CONFIRM"):
        await receiving.confirm_deleted(receipt, [gone, first])
    wire: Any = doctor.network
    key = grantee_key(receipt.received, doctor)
    await wire.call(key, "access", "noticed", [receipt.grant.grant_id, [gone, first, second]])
    (share,) = await ward.sharing.shares()
    assert share.confirmed == {gone, first, second}, "that is her word, by a program of her own"
    await receiving.request_access(receipt, [first])
    (share,) = await ward.sharing.shares()
    assert share.confirmed == {gone, second}
    await receiving.request_access(receipt, [first, second])
    (share,) = await ward.sharing.shares()
    assert share.confirmed == {gone}, "of what she did not ask for again it stands"


async def test_corrections_restrictions_and_denials_are_told_of_the_records_they_are_about(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    _, (first, _) = ward.record_visit()
    rights, visit = Rights(ward.wallet), await ward.known_visit()
    one = RecordChoice(visit, tuple(entry for entry in await ward.entries() if entry.record_id == first))
    await rights.correct(one, "attribution", "Before it was shared.")
    await ward.share(doctor)
    assert (await only(receiving)).notices == ()
    await rights.correct(one, "attribution", "That is my sister.")
    await rights.restrict(one, "accuracy")
    notices = (await only(receiving)).notices
    assert {(notice.record_id, notice.kind) for notice in notices} == {
        (first, KIND_CORRECTED),
        (first, KIND_RESTRICTED),
    }
    assert (await only(receiving)).to_confirm == [], "a copy may stay"
    await rights.deny(visit)
    receipt = await only(receiving)
    assert KIND_DENIED in kinds(receipt)
    assert len(receipt.to_confirm) == 2
    await receiving.confirm_deleted(receipt, receipt.to_confirm)
    assert (await only(receiving)).to_confirm == [], "confirmed of this notice, as the wallet remembers"


async def test_a_restriction_that_came_later_bars_the_doctor(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    _, ids = ward.record_visit(1)
    await ward.share(doctor)
    receipt = await only(receiving)
    await Rights(ward.wallet).restrict(RecordChoice(await ward.known_visit()), "legal-claim")
    with pytest.raises(BlockRobotError, match="RECORD_RESTRICTED"):
        await receiving.request_access(receipt, ids)


def test_a_grant_is_named_by_its_beginning() -> None:
    ids = [bytes([1] * 32), bytes([1] * 31 + [2]), bytes([9] * 32)]
    assert resolve_grant(ids, "09090909") == ids[2]
    for start, code in (("0101", "NAME_TOO_SHORT"), ("01010101", "NAME_AMBIGUOUS"), ("abababab", "GRANT_NOT_FOUND")):
        with pytest.raises(BlockRobotError, match=code):
            resolve_grant(ids, start)


async def change_words(wallet: Wallet) -> None:
    """Everything that `wallet rotate` does after a theft."""

    rotating = await take_new_words(wallet)
    for visit in await rotating.exposed_visits():
        await rotating.transfer(visit)


async def test_who_has_new_words_since_still_opens_what_was_shared_before_and_after(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    _, ids = ward.record_visit(1)
    await ward.share(doctor)
    await change_words(doctor)
    await ward.share(doctor)
    receipts = await receiving.inbox()
    assert [receipt.received.era for receipt in receipts] == [0, 1]
    for receipt in receipts:
        access_id = await receiving.request_access(receipt, ids)
        assert (await receiving.look(receipt, ids[0], access_id)).corrupted == []


async def test_an_owner_with_new_words_still_sees_and_ends_what_she_shared(
    ward: SharedWard, doctor: Wallet, receiving: IncomingShares
) -> None:
    ward.record_visit(1)
    await ward.share(doctor)
    await change_words(ward.wallet)
    await ward.share(doctor)
    first, second = await ward.sharing.shares()
    assert {name_recipient(share) for share in (first, second)} == {
        f"Dr Weber (handle {encode_short(doctor.store.content.handle)})"
    }
    await ward.sharing.revoke(first)
    assert [receipt.is_open for receipt in await receiving.inbox()] == [False, True]
