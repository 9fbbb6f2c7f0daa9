"""Sharing on real nodes: a patient shares with a doctor, who looks, is barred, is told; one of three custodians is away.

What the doctor's wallet gets comes over HTTP from custodians that follow a chain; nobody in between could have opened it.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.presentation.share_text import name_recipient
from clients.wallet.records.erasure import ErasureClient
from clients.wallet.records.rights_requests import RecordChoice, Rights
from clients.wallet.recovery.key_rotation import KeyRotation
from clients.wallet.sharing.incoming_shares import IncomingShare, IncomingShares
from clients.wallet.sharing.outgoing_shares import FinalGrant, Share, SharingClient, place_end
from consensus.errors import BlockRobotError
from tests.cluster.network_under_test import NetworkUnderTest, running
from tests.cluster.test_rights import Ward
from tests.walking_alone import UID

FOLLOW_MAX_COUNT, FOLLOW_PAUSE_S = 80, 0.25
DAY_MS = 24 * 3600 * 1000


@pytest.fixture
async def three_custodians(tmp_path: Path) -> AsyncIterator[NetworkUnderTest]:
    """Four running nodes, three of them custodians of three organisations."""
    async with running(NetworkUnderTest(tmp_path / "network", nodes=4, organisations=3)) as network:
        yield network


class Sides:
    """A patient who was recorded, a doctor, and what each does."""

    def __init__(self, ward: Ward, ann: Wallet, doctor: Wallet) -> None:
        self.ward = ward
        self.ann = ann
        self.doctor = doctor
        self.sharing = SharingClient(ann)
        self.receiving = IncomingShares(doctor)

    async def begin(self) -> list[RecordEntry]:
        await self.ann.register(self.ward.desk.issue(UID, "subject"), [])
        await self.doctor.register(self.ward.desk.issue("D0C", "staff"), [])
        await ConsentClient(self.ann).give(["demo"], ["depth"])
        await self.ward.prepare_robot()
        assert (await self.ward.record()).kept > 0
        (report,) = await self.ann.records()
        return list(report.records)

    async def share(self, entries: list[RecordEntry]) -> FinalGrant:
        grantee = await self.sharing.resolve_grantee(self.doctor.store.content.handle.hex(), "Dr Weber")
        now_ms = time.time_ns() // 1_000_000
        return await self.sharing.share(entries, grantee, "demo", place_end(now_ms + DAY_MS, now_ms), lambda _: None)

    async def received(self, shared: FinalGrant) -> IncomingShare:
        """Return what the doctor's wallet knows of it, once the node that it asks has followed: one may lag."""
        await self.ward.told_everywhere()
        for _ in range(FOLLOW_MAX_COUNT):
            found = [each for each in await self.receiving.inbox() if each.grant.grant_id == shared.grant_id]
            if found:
                (receipt,) = found
                return receipt
            await asyncio.sleep(FOLLOW_PAUSE_S)
        raise AssertionError("the grant did not come into the doctor's inbox")

    async def own(self, shared: FinalGrant) -> Share:
        await self.ward.told_everywhere()
        (share,) = [each for each in await self.sharing.shares() if each.grant.grant_id == shared.grant_id]
        return share

    async def look(self, shared: FinalGrant, access_id: bytes = b"") -> set[str]:
        """Look at all that was shared, under a new request or an earlier one; return the states of all frames."""
        receipt = await self.received(shared)
        access_id = access_id or await self.receiving.request_access(receipt, shared.records)
        views = [await self.receiving.look(receipt, record_id, access_id) for record_id in shared.records]
        assert all(len(view.custodians) == 2 for view in views), "no more custodians are asked than it takes"
        return {frame.status for view in views for frame in view.frames}

    async def barred(self, shared: FinalGrant, access_id: bytes) -> str:
        """Return the code by which an earlier request is refused, once all custodians have followed."""
        receipt = await self.received(shared)
        for _ in range(FOLLOW_MAX_COUNT):
            try:
                await self.receiving.look(receipt, shared.records[0], access_id)
            except BlockRobotError as error:
                if error.code != "GRANT_PARTS_MISSING":  # one has followed and another gave its part all the same
                    return error.code
            await asyncio.sleep(FOLLOW_PAUSE_S)
        return "RELEASED"


async def test_a_patient_shares_with_a_doctor_who_sees_what_she_may_and_hears_what_became_of_it(
    three_custodians: NetworkUnderTest, tmp_path: Path
) -> None:
    network = three_custodians
    ward = Ward(network, tmp_path)
    async with ward.wallet("ann") as ann, ward.wallet("doctor") as doctor, ward.wallet("visitor") as visitor:
        await visitor.register(ward.desk.issue("B0B", "subject"), [])
        sides = Sides(ward, ann, doctor)
        entries = await sides.begin()
        with pytest.raises(BlockRobotError, match="SHARE_WITH_NON_MEMBER"):
            await sides.sharing.resolve_grantee(visitor.store.content.handle.hex())

        shared = await sides.share(entries)
        assert (len(shared.custodians), shared.absent) == (3, ())
        assert "ok" in await sides.look(shared)
        assert await sides.look(shared) <= {"ok", "notice"}
        assert [look.records_count for look in (await sides.own(shared)).looks] == [len(entries)] * 2
        assert await IncomingShares(visitor).inbox() == []

        await _bar_and_lift(sides, shared)
        await _lose_custodians(network, sides, shared)
        await _revoke(sides, shared)
        await _erase_and_confirm(sides, entries)
        await _leave(sides, entries[1:])


async def _bar_and_lift(sides: Sides, shared: FinalGrant) -> None:
    """A restriction bars the doctor, under new requests and old ones; lifted, what was shared holds again."""
    early = await sides.receiving.request_access(await sides.received(shared), shared.records)
    rights, whole = Rights(sides.ann), RecordChoice(shared.visit)
    await rights.restrict(whole, "accuracy")
    receipt = await sides.received(shared)
    assert {notice.kind for notice in receipt.notices} == {"restricted"}
    with pytest.raises(BlockRobotError, match="RECORD_RESTRICTED"):
        await sides.receiving.request_access(receipt, shared.records)
    assert await sides.barred(shared, early) == "ACCESS_ENDED"
    await rights.lift(whole)
    assert "ok" in await sides.look(shared)


async def _lose_custodians(network: NetworkUnderTest, sides: Sides, shared: FinalGrant) -> None:
    """Of three custodians any two suffice; one alone opens nothing, and the wallet says so."""
    access_id = await sides.receiving.request_access(await sides.received(shared), shared.records)
    receipt = await sides.received(shared)
    names = [node.name for node in sides.doctor.network.custody.custodians]
    network.cluster.stop(names[0])
    assert "ok" in await sides.look(shared, access_id)
    network.cluster.stop(names[1])
    with pytest.raises(BlockRobotError, match="GRANT_PARTS_MISSING"):
        await sides.receiving.look(receipt, shared.records[0], access_id)
    for name in names[:2]:
        network.cluster.start(name)
    await network.cluster.wait_ready()


async def _revoke(sides: Sides, shared: FinalGrant) -> None:
    """From the block on that ends it, nobody gets anything by it; the doctor hears that copies have to go."""
    access_id = await sides.receiving.request_access(await sides.received(shared), shared.records)
    await sides.sharing.revoke(await sides.own(shared))
    # NOT_PERMITTED: a session that her key opens after the end reads what became of the grant, and nothing else.
    assert await sides.barred(shared, access_id) in {"ACCESS_ENDED", "GRANT_ENDED", "NOT_PERMITTED"}
    receipt = await sides.received(shared)
    with pytest.raises(BlockRobotError, match=r"SENDER_NOT_ADMITTED|GRANT_ENDED"):
        await sides.receiving.request_access(receipt, shared.records)
    assert {notice.kind for notice in receipt.notices} == {"revoked"}


async def _erase_and_confirm(sides: Sides, entries: list[RecordEntry]) -> None:
    """What is erased after it was shared is told in the doctor's inbox, and her confirmation to the owner."""
    shared = await sides.share(entries)
    access_id = await sides.receiving.request_access(await sides.received(shared), shared.records)
    gone = entries[0]
    (share,) = [each for each in await sides.sharing.recipients([gone]) if each.grant.grant_id == shared.grant_id]
    assert name_recipient(share).startswith("Dr Weber (handle ")
    erasing = ErasureClient(sides.ann)
    await erasing.wait_complete([(gone.visit, await erasing.request(gone.visit, [gone.record_id], []))])
    receipt = await sides.received(shared)
    with pytest.raises(BlockRobotError, match="CLIP_ERASED"):
        await sides.receiving.look(receipt, gone.record_id, access_id)
    assert [(notice.record_id, notice.kind) for notice in receipt.notices] == [(gone.record_id, "erased")]
    await sides.receiving.confirm_deleted(receipt, receipt.to_confirm)
    assert (await sides.received(shared)).to_confirm == []
    assert (await sides.own(shared)).confirmed == {gone.record_id}


async def _leave(sides: Sides, entries: list[RecordEntry]) -> None:
    """Who leaves the staff gets nothing from the next block on, also under an open request; nothing more is shared."""
    shared = await sides.share(entries)
    receipt = await sides.received(shared)
    access_id = await sides.receiving.request_access(receipt, shared.records)
    assert "ok" in await sides.look(shared, access_id)
    await KeyRotation(sides.doctor).leave()
    with pytest.raises(BlockRobotError, match="GRANTEE_NOT_A_MEMBER"):
        await sides.receiving.look(receipt, shared.records[0], access_id)
    with pytest.raises(BlockRobotError, match="SHARE_WITH_NON_MEMBER"):
        await sides.share(entries)
    await sides.sharing.revoke(await sides.own(shared))
    assert (await sides.received(shared)).to_confirm == list(shared.records), "she is still told"
