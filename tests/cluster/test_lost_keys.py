"""A lost key on real nodes: two officers erase by robot and minutes, custodians destroy and sign, the next person is told.

Whoever was met in those minutes is hit, lost key or not: she finds in her own wallet who did it, and why.
"""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from clients.officer.lost_keys import LostKeys, Span
from clients.robot.recording import sealing, visit_keyring
from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.records.erasure import ErasureClient
from clients.wallet.records.viewing import RecordViewer
from consensus.errors import BlockRobotError
from consensus.limits import TIME_BUCKET_MS
from tests.cluster.network_under_test import NetworkUnderTest
from tests.cluster.test_rights import UID, Ward, quiet


@pytest.fixture
def late_robot(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot that delivers five minutes late, as after a cut of the network: the span is over when it is looked at."""
    now = sealing.compute_time_bucket
    for module in (sealing, visit_keyring):
        monkeypatch.setattr(module, "compute_time_bucket", lambda time_ms: now(time_ms - TIME_BUCKET_MS))


async def record_for(ward: Ward, ann: Wallet) -> list[RecordEntry]:
    """Let the robot record her, and return what it recorded."""
    assert (await ward.record()).kept > 0
    return [entry for report in await ann.records() for entry in report.records]


async def wait_until_erased(wallet: Wallet, entries: list[RecordEntry]) -> None:
    """Wait for the receipts of every custodian."""
    keys = [b"records\x00record/" + entry.record_id for entry in entries]
    for _ in range(120):
        states = await wallet.values(keys, wallet.keys.identity)
        if {state["status"] for state in states.values()} == {"erased"}:
            return
        await asyncio.sleep(0.25)
    raise AssertionError([state["status"] for state in states.values()])


@pytest.mark.usefixtures("late_robot")
async def test_two_officers_erase_what_a_lost_key_cannot_and_who_was_hit_is_told(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    ward = Ward(network, tmp_path)
    async with ward.wallet("ann") as ann, ward.wallet("eva") as eva, ward.wallet("max") as other:
        await ann.register(ward.desk.issue(UID, "subject"), [])
        await eva.register(ward.desk.issue("0FF1CE01", "officer"), [])
        await other.register(ward.desk.issue("0FF1CE02", "officer"), [])
        await ConsentClient(ann).give(["demo"], ["depth"])
        await ward.prepare_robot()
        entries = await record_for(ward, ann)
        robot = entries[0].visit.robot.hex()[:10]
        from_ms = min(entry.visit.bucket_ms for entry in entries)
        first, second = LostKeys(eva), LostKeys(other)

        found = await first.preview(robot, from_ms, from_ms + TIME_BUCKET_MS)
        assert (len(found.touched), found.records_count) == (1, len(entries))
        to_come = Span(found.span.robot, found.span.from_ms, found.span.until_ms + 2 * TIME_BUCKET_MS)
        with pytest.raises(BlockRobotError, match="SPAN_WRONG"):
            await first.propose(to_come, "key-lost", 1)
        proposal_id = (await first.propose(found.span, "key-lost", 1)).hex()
        with pytest.raises(BlockRobotError, match="NOT_APPROVED"):
            await first.erase(await first.find(proposal_id), quiet)
        with pytest.raises(BlockRobotError, match="OFFICER_THE_SAME"):
            await first.approve(await first.find(proposal_id))
        await second.approve(await second.find(proposal_id))
        ordered = await second.erase(await second.find(proposal_id), quiet)
        assert (ordered.visits, ordered.records) == (1, len(entries))

        await wait_until_erased(ann, entries)
        (report,) = await ann.records()
        (told,) = report.rights.officers
        assert (told.reason, told.records, told.proposal_id.hex()) == ("key-lost", len(entries), proposal_id)
        assert len(report.erased_ids) == len(entries)
        done = await ErasureClient(ann).report(report.visit, ordered.erasure_ids[0])
        assert done.complete
        with pytest.raises(BlockRobotError, match="RECORD_ERASED"):
            await RecordViewer(ann).request_access(entries[:1], "own-access")
