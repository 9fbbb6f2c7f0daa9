"""Sharing from the owner's wallet: who may be shared with, what each custodian gets, what is remembered, what ends it."""

from __future__ import annotations

import msgspec
import pytest

from clients.wallet.ledger.wallet import Wallet
from clients.wallet.presentation.share_text import name_recipient
from clients.wallet.records.rights_requests import RecordChoice, Rights, choose
from clients.wallet.sharing.outgoing_shares import SharingClient, place_end, require_purpose_to_share, select_shareable
from clients.wallet.store.member_keys import derive_keys, draw_words
from consensus.errors import BlockRobotError
from consensus.members.handles import encode_short
from consensus.records.sharing import GRANT_MAX_MS, GRANT_STEP_MS, hash_grant_member
from consensus.rights.purposes import PURPOSES
from tests.unit.contracts.privacy.hospital import key_of
from tests.world.sharing import SharedWard


async def test_a_grant_stands_on_the_chain_and_names_nobody(ward: SharedWard, doctor: Wallet) -> None:
    visit, ids = ward.record_visit()
    shared = await ward.share(doctor)
    state = ward.chain.value("access", b"grant/" + shared.grant_id)
    assert (state["owner"], state["records"], state["purpose"], state["status"]) == (visit.owner, ids, "care", "active")
    assert (shared.pictures_count, shared.left_out, shared.absent) == (4, (), ())
    keys = doctor.keys
    known = (doctor.store.content.handle, keys.identity.public_key, keys.spend.public_key, keys.sealing_public)
    assert not any(part in repr(state).encode() or part in state.values() for part in known)


async def test_each_custodian_gets_its_own_parts_and_no_key_that_opens_anything(
    ward: SharedWard, doctor: Wallet
) -> None:
    visit, ids = ward.record_visit()
    shared = await ward.share(doctor)
    custody = ward.custody
    for record_id in ids:
        first, second = (custody.parts[name, shared.grant_id, record_id] for name in ("custodian-1", "custodian-2"))
        assert first.package == second.package
        assert [part.custodian for part in first.parts] == [key_of("custodian-2").public_key]
        assert [part.custodian for part in second.parts] == [key_of("custodian-1").public_key]
        assert first.parts[0].value != second.parts[0].value
    assert len({upload.package for upload in custody.parts.values()}) == len(ids)
    assert set(custody.uploaders) == {visit.owner}, "in the session of the visit's owner key"


def replace_keys(ward: SharedWard, doctor: Wallet) -> None:
    """The doctor's words were stolen: he puts new keys in place of his."""
    old, new, handle = doctor.keys.identity, derive_keys(draw_words()), doctor.store.content.handle
    keys = (new.identity.public_key, new.spend.public_key, new.view.public_key, new.sealing_public)
    agreed = new.identity.sign("blockrobot/rotation", ward.chain.chain_id + handle + old.public_key + b"".join(keys))
    ward.chain.must(old, "identity", "rotate", handle, *keys, agreed)


async def test_nothing_is_shared_with_keys_that_one_node_says_are_still_somebodys(
    ward: SharedWard, doctor: Wallet
) -> None:
    """What it proves is true of its block; only another node knows that there are later ones."""
    ward.record_visit()
    await ward.entries()
    ward.network.keep_quiet()
    replace_keys(ward, doctor)
    with pytest.raises(BlockRobotError, match="PROOF_STALE"):
        await ward.grantee(doctor)


async def test_nothing_is_shared_while_one_node_alone_answers(ward: SharedWard, doctor: Wallet) -> None:
    ward.record_visit()
    entries, grantee = await ward.entries(), await ward.grantee(doctor)
    ward.network.keep_quiet()
    replace_keys(ward, doctor)
    ward.network.away = {"custodian-2"}
    with pytest.raises(BlockRobotError, match="QUORUM_UNREACHABLE"):
        await ward.grantee(doctor)
    with pytest.raises(BlockRobotError, match="QUORUM_UNREACHABLE"):
        await ward.sharing.share(entries, grantee, "care", ward.until_ms(), ward.told.append)
    assert not ward.custody.parts, "and nobody got a part of a key"


async def test_the_wallet_remembers_with_whom_and_shows_who_looked_by_the_chain(
    ward: SharedWard, doctor: Wallet
) -> None:
    ward.record_visit()
    shared = await ward.share(doctor)
    (share,) = await ward.sharing.shares()
    assert (share.grant.grant_id, share.looks) == (shared.grant_id, ())
    assert name_recipient(share).startswith("Dr Weber (handle ")
    assert share.given is not None
    assert hash_grant_member(share.given.salt, share.given.handle) == share.grant.row.member_hash
    receiving = ward.receiving(doctor)
    (receipt,) = await receiving.inbox()
    access_id = await receiving.request_access(receipt, receipt.grant.row.records[:1])
    await receiving.look(receipt, receipt.grant.row.records[0], access_id)
    (share,) = await ward.sharing.shares()
    assert [(look.records_count, look.released_count) for look in share.looks] == [(1, 2)]


async def test_a_wallet_restored_from_its_words_shows_the_grant_and_no_longer_with_whom(
    ward: SharedWard, doctor: Wallet
) -> None:
    ward.record_visit()
    shared = await ward.share(doctor)
    again = ward.open_wallet("again", ward.wallet.store.content.words)
    (share,) = await SharingClient(again).shares()
    assert (share.grant.grant_id, share.given) == (shared.grant_id, None)
    assert "the chain does not say who" in name_recipient(share)


async def test_a_name_that_was_given_once_finds_the_same_member_again(ward: SharedWard, doctor: Wallet) -> None:
    ward.record_visit()
    await ward.share(doctor)
    again = await ward.sharing.resolve_grantee("dr weber")
    assert (again.member.handle, again.label, again.member.role) == (doctor.store.content.handle, "Dr Weber", "staff")
    text = doctor.store.content.handle.hex()
    spaced = " ".join(text[start : start + 8] for start in range(0, 64, 8))
    assert (await ward.sharing.resolve_grantee(spaced)).member == again.member


async def test_a_name_never_moves_to_another_person(ward: SharedWard, doctor: Wallet) -> None:
    ward.record_visit()
    await ward.share(doctor)
    nurse = ward.come_in("nurse", "staff").store.content.handle
    with pytest.raises(BlockRobotError, match=r"SHARE_NOT_POSSIBLE.*already call") as refused:
        await ward.sharing.resolve_grantee(nurse.hex(), " dr weber ")
    assert encode_short(doctor.store.content.handle) in str(refused.value)
    assert (await ward.sharing.resolve_grantee(doctor.store.content.handle.hex(), "Dr Weber")).label == "Dr Weber"
    (share,) = await ward.sharing.shares()
    assert name_recipient(share) == f"Dr Weber (handle {encode_short(doctor.store.content.handle)})"


async def test_a_name_that_stands_for_two_in_an_older_wallet_finds_neither(ward: SharedWard, doctor: Wallet) -> None:
    ward.record_visit()
    await ward.share(doctor)
    given = ward.wallet.store.content.given_grants
    given.append(msgspec.structs.replace(given[0], grant_id=bytes(32), handle=b"\x07" * 32))
    with pytest.raises(BlockRobotError, match=r"SHARE_NOT_POSSIBLE.*handle"):
        await ward.sharing.resolve_grantee("Dr Weber")


@pytest.mark.parametrize("role", ["subject", "robot", "auditor"])
async def test_nothing_is_shared_with_who_is_neither_staff_nor_officer(ward: SharedWard, role: str) -> None:
    other = ward.come_in("other", role)
    with pytest.raises(BlockRobotError, match="SHARE_WITH_NON_MEMBER"):
        await ward.grantee(other)


async def test_an_officer_may_be_shared_with_and_a_stranger_or_oneself_not(ward: SharedWard) -> None:
    assert (await ward.grantee(ward.come_in("officer", "officer"))).member.role == "officer"
    with pytest.raises(BlockRobotError, match="SHARE_WITH_NON_MEMBER"):
        await ward.sharing.resolve_grantee("ab" * 32)
    with pytest.raises(BlockRobotError, match="SHARE_NOT_POSSIBLE"):
        await ward.sharing.resolve_grantee("Dr Nobody")
    with pytest.raises(BlockRobotError, match="SHARE_NOT_POSSIBLE"):
        await ward.sharing.resolve_grantee(ward.wallet.store.content.handle.hex())


async def test_with_one_of_two_custodians_away_nothing_is_shared_and_nothing_remembered(
    ward: SharedWard, doctor: Wallet
) -> None:
    ward.record_visit()
    ward.custody.away = {"custodian-2"}
    with pytest.raises(BlockRobotError, match=r"SHARE_CUSTODIANS_MISSING.*custodian-2"):
        await ward.share(doctor)
    assert ward.chain.value("access", b"grant-count") is None
    assert ward.wallet.store.content.given_grants == []


async def test_a_custodian_that_is_a_moment_behind_is_waited_for_and_one_that_stays_so_is_not(
    ward: SharedWard, doctor: Wallet
) -> None:
    ward.record_visit(1)
    ward.custody.not_yet = 3
    assert (await ward.share(doctor)).absent == ()
    assert len(ward.pauses_s) == 3
    ward.custody.not_yet = 1000
    with pytest.raises(BlockRobotError, match="SHARE_CUSTODIANS_MISSING"):
        await ward.share(doctor)


async def test_a_refusal_of_the_chain_is_forgotten_and_an_open_end_is_not(ward: SharedWard, doctor: Wallet) -> None:
    ward.record_visit()
    with pytest.raises(BlockRobotError, match="PURPOSE_OWN"):
        await ward.share(doctor, "own-access")
    assert ward.wallet.store.content.given_grants == []
    ward.network.refusal = "TRANSACTION_NOT_FINAL_IN_TIME"
    with pytest.raises(BlockRobotError, match="TRANSACTION_NOT_FINAL_IN_TIME"):
        await ward.share(doctor)
    assert len(ward.wallet.store.content.given_grants) == 1, "it may become final yet"
    assert await ward.sharing.shares() == []


async def test_a_record_without_a_picture_that_opens_is_left_out(ward: SharedWard, doctor: Wallet) -> None:
    _, (whole, spoiled) = ward.record_visit()
    for index in (0, 1):
        ward.spoil(spoiled, index)
    shared = await ward.share(doctor)
    assert (shared.records, shared.left_out) == ((whole,), (spoiled,))


async def test_what_was_ended_is_ended_and_not_twice(ward: SharedWard, doctor: Wallet) -> None:
    ward.record_visit()
    await ward.share(doctor)
    (share,) = await ward.sharing.shares()
    await ward.sharing.revoke(share)
    (share,) = await ward.sharing.shares()
    assert not share.grant.row.is_open(ward.chain.time_ms)
    with pytest.raises(BlockRobotError, match="GRANT_ENDED"):
        await ward.sharing.revoke(share)


async def test_a_record_of_which_a_picture_was_erased_is_shared_no_more(ward: SharedWard, doctor: Wallet) -> None:
    visit, (first, second) = ward.record_visit()
    await ward.share(doctor)
    (share,) = await ward.sharing.shares()
    now_ms = ward.chain.time_ms
    assert (share.cut, share.shows(first, now_ms), share.shows(second, now_ms)) == (frozenset(), True, True)
    await ward.erase(visit, [first], [1])
    (share,) = await ward.sharing.shares()
    assert (share.cut, share.shows(first, now_ms), share.shows(second, now_ms)) == ({first}, False, True)
    await ward.erase(visit, [first])
    (share,) = await ward.sharing.shares()
    assert (share.cut, share.erased, share.shows(first, now_ms)) == (frozenset(), {first}, False)


async def test_records_that_were_erased_together_are_shared_no_more(ward: SharedWard, doctor: Wallet) -> None:
    visit, ids = ward.record_visit()
    await ward.share(doctor)
    await ward.erase(visit, ids)
    (share,) = await ward.sharing.shares()
    assert (share.erased, share.cut) == (frozenset(ids), frozenset())


async def test_erasing_names_who_had_received_it(ward: SharedWard, doctor: Wallet) -> None:
    _, (first, second) = ward.record_visit()
    entries = await ward.entries()
    assert await ward.sharing.recipients(entries) == []
    grantee = await ward.grantee(doctor)
    only = [entry for entry in entries if entry.record_id == first]
    await ward.sharing.share(only, grantee, "care", ward.until_ms(), ward.told.append)
    (share,) = await ward.sharing.recipients(only)
    assert name_recipient(share).startswith("Dr Weber (handle ")
    assert await ward.sharing.recipients([entry for entry in entries if entry.record_id == second]) == []


async def test_what_the_chain_would_refuse_is_refused_before_anything_is_asked_for(ward: SharedWard) -> None:
    _, (first, second) = ward.record_visit()
    rights = Rights(ward.wallet)
    visit = await ward.known_visit()

    async def select(purpose: str = "care") -> int:
        reports = await ward.wallet.records()
        return len(select_shareable(reports, choose(reports, (), (visit.owner.hex()[:12],)), purpose))

    assert await select() == 2
    await rights.object_to_release(["research"], at_once=True, on_progress=lambda _, __: None)
    with pytest.raises(BlockRobotError, match="PURPOSE_OBJECTED"):
        await select("research")
    one = RecordChoice(visit, tuple(entry for entry in await ward.entries() if entry.record_id == first))
    await rights.restrict(one, "accuracy")
    with pytest.raises(BlockRobotError, match="RECORD_RESTRICTED"):
        await select()
    await rights.lift(one)
    await rights.deny(visit)
    with pytest.raises(BlockRobotError, match="VISIT_QUARANTINED"):
        await select()
    assert second in {entry.record_id for entry in await ward.entries()}


async def test_records_of_two_visits_are_not_shared_side_by_side(ward: SharedWard) -> None:
    ward.record_visit(1)
    ward.record_visit(1)
    reports = await ward.wallet.records()
    chosen = choose(reports, (), tuple(report.visit.owner.hex()[:12] for report in reports))
    with pytest.raises(BlockRobotError, match="one visit at a time"):
        select_shareable(reports, chosen, "care")


def test_an_end_is_on_five_full_minutes_ahead_and_within_a_year() -> None:
    now_ms = 10 * GRANT_STEP_MS + 1
    assert place_end(now_ms + 1, now_ms) == 11 * GRANT_STEP_MS
    assert place_end(12 * GRANT_STEP_MS, now_ms) == 12 * GRANT_STEP_MS
    for wrong in (now_ms - GRANT_STEP_MS, now_ms + GRANT_MAX_MS + GRANT_STEP_MS):
        with pytest.raises(BlockRobotError, match="SHARE_NOT_POSSIBLE"):
            place_end(wrong, now_ms)


def test_ones_own_access_is_nothing_to_share_for() -> None:
    require_purpose_to_share("care", tuple(PURPOSES))
    for wrong in ("own-access", "gossip"):
        with pytest.raises(BlockRobotError, match="SHARE_NOT_POSSIBLE"):
            require_purpose_to_share(wrong, tuple(PURPOSES))
