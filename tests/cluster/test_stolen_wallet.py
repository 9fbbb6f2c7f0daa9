"""A stolen wallet on real nodes: a thief with the old words looks in, she changes them, and he is refused everywhere.

She sees what was recorded before and after, erases of it, takes it along, and a stranger can check that.
"""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from clients.robot.identity.robot_keys import load_identity
from clients.sdk.chain.receipts import FinalReceipt
from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.ledger.visit_audit import audit_all
from clients.wallet.ledger.wallet import RecordEntry, VisitReport, Wallet
from clients.wallet.records.erasure import ErasureClient
from clients.wallet.records.rights_requests import RecordChoice, Rights
from clients.wallet.records.viewing import RecordViewer
from clients.wallet.recovery.key_rotation import KeyRotation
from clients.wallet.store.keystore import Keystore
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.sharing import GRANT_STEP_MS
from consensus.state.access import GRANT
from tests.cluster.commands import run
from tests.cluster.network_under_test import NetworkUnderTest
from tests.cluster.test_rights import Ward, settle
from tests.walking_alone import UID
from tests.world.dicts import CHEAP


def quiet(_: int, __: int, ___: float) -> None:
    """Nobody looks at the progress."""


async def begin(ward: Ward, ann: Wallet) -> VisitReport:
    await ann.register(ward.desk.issue(UID, "subject"), [])
    await ConsentClient(ann).give(["demo"], ["depth"])
    await ward.prepare_robot()
    assert (await ward.record()).kept > 0
    (report,) = await ann.records()
    return report


async def renew_roster(ward: Ward) -> None:
    """Let the desk tell the robot anew whom there is to record."""
    sealed = (await ward.desk.make_roster(load_identity(ward.robot).identity.public_key)).sealed
    (ward.robot / "roster.sealed").write_bytes(sealed)


async def change_words(ann: Wallet, *, shared: bytes) -> None:
    """Change the words; what the thief shared ends with that."""
    rotating = KeyRotation(ann)
    rotating.prepare()
    rotating.confirm_shown()
    assert await rotating.rotate()
    done = await rotating.transfer_all(0.0, quiet)
    assert (len(done.done), done.taken, done.refusal) == (1, (), None)
    assert done.ended == (shared,)
    state = await ann.network.state_values([GRANT.key(shared)], ann.keys.identity)
    assert state.values[GRANT.key(shared)]["status"] == "revoked"


async def share(thief: Wallet, entry: RecordEntry) -> bytes:
    """Share a record by the old words with a key of the thief's own; return the grant's id."""
    until_ms = (time.time_ns() // 1_000_000 // GRANT_STEP_MS + 12) * GRANT_STEP_MS
    keys = [PrivateKey(bytes([number]) * 32).public_key for number in (1, 2)]
    arguments = [[entry.record_id], *keys, 1, bytes(32), "research", until_ms]
    return await thief.sign_and_wait(entry.visit, "access", "grant", arguments)


async def look(wallet: Wallet, entry: RecordEntry) -> str:
    """Ask anew, fetch and check one record; return the verdict."""
    viewing = RecordViewer(wallet)
    return (await viewing.view(entry, await viewing.request_access([entry], "own-access"))).verdict


async def refuse_the_thief(thief: Wallet, report: VisitReport, early: bytes) -> None:
    """Whatever the old words sign is refused, and what he had asked for before is not handed out."""
    entry, visit = report.records[0], report.visit
    await settle(thief, entry, early, "SESSION_REFUSED")
    with pytest.raises(BlockRobotError, match="MEMBERSHIP_ENDED"):
        await thief.records()
    for work in (
        RecordViewer(thief).request_access([entry], "own-access"),
        ErasureClient(thief).request(visit, [entry.record_id], []),
        Rights(thief).restrict(RecordChoice(visit), "accuracy"),
        Rights(thief).deny(visit),
        KeyRotation(thief).transfer(visit),
        thief.network.call(thief.keys.identity, "identity", "leave", [thief.store.content.handle]),
    ):
        with pytest.raises(BlockRobotError, match="SENDER_NOT_ADMITTED"):
            await work
    with pytest.raises(BlockRobotError, match="SESSION_REFUSED"):
        await thief.visit_report(visit)


async def test_who_has_the_old_words_is_refused_everywhere_and_she_goes_on(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    ward = Ward(network, tmp_path)
    async with ward.wallet("ann") as ann:
        report = await begin(ward, ann)
        words = ann.store.content.words
        copied = Keystore.create(tmp_path / "thief.wallet", words, "tea", CHEAP)
        async with Wallet(copied, network.genesis) as thief:
            (seen,) = await thief.records()
            early = await RecordViewer(thief).request_access(list(seen.records[:1]), "own-access")
            await settle(thief, seen.records[0], early, "RELEASED")

            await change_words(ann, shared=await share(thief, seen.records[0]))
            await refuse_the_thief(thief, seen, early)

            (again,) = await ann.records()
            assert [entry.record_id for entry in again.records] == [entry.record_id for entry in report.records]
            assert again.missing_count == 0
            await settle(ann, again.records[0], early, "ACCESS_ENDED")
            assert await look(ann, again.records[0]) == "verified"

            assert (await ward.record()).kept == 0, "a roster with the old keys records nobody"
            await renew_roster(ward)
            assert (await ward.record()).kept > 0, "and a new one records her under the new keys"
            first, second = await ann.records()
            assert (first.visit.era, second.visit.era, second.visit.current) == (1, 1, b"")
            assert await look(ann, second.records[0]) == "verified"
            with pytest.raises(BlockRobotError, match="SESSION_REFUSED"):
                await thief.network.announcements(0, thief.keys.identity)

        erasing = ErasureClient(ann)
        ids = await erasing.request(first.visit, [first.records[-1].record_id], [])
        await erasing.wait_complete([(first.visit, ids)], timeout_s=30)
        kinds = [entry.kind for entry in await audit_all(ann) if entry.owner == first.visit.owner]
        assert kinds.count("transferred") == 1
        assert kinds[-1] == "erasure_complete"
        new_words = ann.store.content.words
    restored = Keystore.create(tmp_path / "again.wallet", new_words, "tea", CHEAP, former=[words])
    async with Wallet(restored, network.genesis) as later:
        reports = await later.records()
        assert [len(each.records) for each in reports] == [len(first.records) - 1, len(second.records)]
        assert await look(later, reports[0].records[0]) == "verified"
    await take_along(network, tmp_path, records=sum(len(each.records) for each in reports))
    async with Wallet(Keystore.open(tmp_path / "again.wallet", "tea"), network.genesis) as leaving:
        await leave_unheard(leaving)


async def leave_unheard(wallet: Wallet) -> None:
    """Her word is final, the answer is lost: what she left by is proven without a session, and her records stay hers."""
    send = wallet.network.submit_and_wait

    async def deaf(transaction: Transaction) -> FinalReceipt:
        await send(transaction)
        raise BlockRobotError("TRANSACTION_NOT_FINAL_IN_TIME")

    wallet.network.submit_and_wait = deaf  # type: ignore[method-assign,assignment]
    with pytest.raises(BlockRobotError, match="TRANSACTION_NOT_FINAL_IN_TIME"):
        await KeyRotation(wallet).leave()
    assert not wallet.store.content.left
    assert len(await wallet.records()) == 2
    assert wallet.store.content.left
    assert not wallet.member_gone
    assert await KeyRotation(wallet).leave() == 0


async def take_along(network: NetworkUnderTest, folder: Path, records: int) -> None:
    """The bundle is signed by the keys that decide now, and proves what was sealed to her former ones too."""
    home, bundle, genesis = folder / "home", folder / "mine.zip", folder / "genesis.json"
    home.mkdir()
    (home / "passphrase").write_text("tea\n")
    genesis.write_bytes((network.folder / "genesis.json").read_bytes())
    place = ("wallet", "--genesis", genesis, "--wallet-dir", folder, "--profile", "again")
    code, exported = await run(*place, "export", bundle, "--yes", "--now", "--json", home=home)
    assert (code, exported["ok"], exported["problems"]) == (0, True, []), exported
    code, told = await run("verify", bundle, "--genesis", genesis, "--json", home=home)
    assert (code, told["is_anchored"], told["is_complete"]) == (0, True, True), told
    assert told["records"] == records + 1
    assert told["metadata_proved"] == records, "by her registration and by each change of her words"
