"""A mandate on real nodes: two officers give it, the mother consents for her child, a robot records, the mandate ends.

From the block of its end on nothing more is recorded; the trail names who did what, and the child's own no stands above it.
"""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from clients.officer.mandate_papers import check_papers, make_receipt
from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.ledger.mandates import Mandate, Mandates
from clients.wallet.ledger.wallet import Wallet
from consensus.errors import BlockRobotError
from consensus.limits import TIME_BUCKET_MS
from consensus.rights.mandates import ACTS
from tests.cluster.network_under_test import NetworkUnderTest
from tests.cluster.test_rights import UID, Ward

DAY_MS = 24 * 3600 * 1000


async def give(officers: tuple[Wallet, Wallet], child: Wallet, mother: Wallet, papers: list[Path]) -> Mandate:
    """Two officers give a mandate on papers that both saw, and the mother accepts it."""
    first, second, own = (Mandates(wallet) for wallet in (*officers, mother))
    receipt = make_receipt(papers, "minor")
    until_ms = (round(time.time() * 1000) + 30 * DAY_MS) // TIME_BUCKET_MS * TIME_BUCKET_MS
    handles = [wallet.store.content.handle for wallet in (child, mother)]
    proposed = await first.find((await first.propose(handles[0], handles[1], receipt.commitment, ACTS, until_ms)).hex())
    with pytest.raises(BlockRobotError, match="OFFICER_THE_SAME"):
        await first.approve(proposed)
    with pytest.raises(BlockRobotError, match="MANDATE_DECIDED"):
        await own.accept(proposed)
    seen = await second.find(proposed.mandate_id.hex())
    check_papers(receipt, seen.state.papers, papers)
    await second.approve(seen)
    await own.accept(proposed)
    return await own.acting_for(handles[0])


async def test_a_mother_consents_for_her_child_and_with_the_mandate_it_ends(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    ward, paper = Ward(network, tmp_path), tmp_path / "birth.pdf"
    paper.write_bytes(b"Mother: Maria")
    async with (
        ward.wallet("child") as child,
        ward.wallet("mother") as mother,
        ward.wallet("eva") as eva,
        ward.wallet("max") as other,
    ):
        await child.register(ward.desk.issue(UID, "subject"), [])
        await mother.register(ward.desk.issue("0B0B0B0B", "subject"), [])
        await eva.register(ward.desk.issue("0FF1CE01", "officer"), [])
        await other.register(ward.desk.issue("0FF1CE02", "officer"), [])
        await ward.prepare_robot()
        handle = child.store.content.handle
        assert (await ward.record()).kept == 0, "nobody said anything"
        speaking = ConsentClient(mother, handle)
        with pytest.raises(BlockRobotError, match="NOT_THE_MEMBER"):
            await speaking.withdraw([], [])

        mandate = await give((eva, other), child, mother, [paper])
        until_ms = mandate.state.until_ms
        with pytest.raises(BlockRobotError, match="BEYOND_MANDATE"):
            await speaking.give(["demo"], ["depth"])
        word = await speaking.give(["demo"], ["depth"], until_ms=until_ms)
        await ward.told_everywhere(word.from_height)
        kept = (await ward.record()).kept
        assert kept > 0
        reports = await child.records()
        assert sum(entry.metadata.frame_count for report in reports for entry in report.records) >= kept
        assert await mother.records() == [], "whoever acts for somebody sees nothing by it"

        (own,) = await Mandates(child).read_own()
        await Mandates(child).end(own)
        await ward.told_everywhere()
        assert (await ward.record()).kept == 0
        with pytest.raises(BlockRobotError, match="NOT_THE_MEMBER"):
            await speaking.give(["demo"], ["depth"], until_ms=until_ms)
        (row,) = (await ConsentClient(child).choices()).rows
        assert (row.last.status, row.last.mandate) == ("withdrawn", own.mandate_id)
        await ended_as_it_was(eva, other, child, mother, own)

        await ConsentClient(child).refuse(["demo"], [])
        await give((eva, other), child, mother, [paper])
        with pytest.raises(BlockRobotError, match="OWN_NO_STANDS"):
            await speaking.give(["demo"], ["depth"], until_ms=until_ms)
        assert (await ward.record()).kept == 0


async def ended_as_it_was(eva: Wallet, other: Wallet, child: Wallet, mother: Wallet, own: Mandate) -> None:
    """The chain names all of them, and what was said, to whoever is a member."""
    after = await Mandates(eva).find(own.mandate_id.hex())
    named = [after.state.proposer, after.state.approver, after.state.ended_by]
    assert named == [wallet.keys.identity.public_key for wallet in (eva, other, child)]
    assert after.state.representative == mother.store.content.handle
    assert after.status == "ended"
    (act,) = await Mandates(child).trail(after)
    assert (act.kind, act.data["purposes"], act.data["until_ms"]) == ("given", ["demo"], own.state.until_ms)
