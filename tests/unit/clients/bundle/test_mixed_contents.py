"""Mixing: a maker has all keys, and puts together what is real and does not belong together.

Pictures that she fetched before they were erased, proofs of an earlier block, visits that are of somebody else.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from clients.bundle import documents as doc
from clients.bundle.checks.bundle_check import unproved
from clients.bundle.cli import verify
from clients.bundle.writing import Contents, write_bundle
from clients.robot.recording.sealing import VisitChain
from clients.wallet.ledger.proof_collection import PersonProofs, collect_person
from clients.wallet.ledger.wallet import Wallet
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.state.rights import RESTRICTION
from tests.unit.clients.bundle.conftest import collect
from tests.world.ward import Ward


@pytest.fixture
def visit(ward: Ward) -> VisitChain:
    """A visit with one record of two pictures."""
    visit = ward.open_visit()
    ward.record(visit)
    return visit


def opened_by(newer: Contents, older: Contents) -> Contents:
    """What the ledger says now, with the pictures and openings of before."""
    proofs = dataclasses.replace(newer.proofs, openings=older.proofs.openings)
    return dataclasses.replace(newer, proofs=proofs, source=older.source)


async def test_a_picture_that_was_kept_and_is_erased_on_the_ledger_is_refused(
    ward: Ward, visit: VisitChain, tmp_path: Path
) -> None:
    before = await collect(ward)
    record_id = bytes.fromhex(before.proofs.openings.records[0].record_id)
    await ward.erase(visit, [record_id], [0])
    now = await collect(ward)
    assert [frame.status for frame in write_bundle(tmp_path / "now.zip", now).frames] == ["erased", "picture"]
    with pytest.raises(BlockRobotError, match="erased") as caught:
        write_bundle(tmp_path / "mixed.zip", opened_by(now, before))
    assert caught.value.code == "BUNDLE_UNPROVEN"


async def test_a_record_of_a_quarantined_visit_that_was_kept_is_refused(
    ward: Ward, visit: VisitChain, tmp_path: Path
) -> None:
    """It may show somebody else: nothing of it is opened, and the wallet's own export does not."""
    before = await collect(ward)
    ward.chain.must(await ward.owner_key(visit.owner), "rights", "wrong_person")
    now = await collect(ward)
    assert now.proofs.openings.records == []
    with pytest.raises(BlockRobotError, match="quarantined") as caught:
        write_bundle(tmp_path / "mixed.zip", opened_by(now, before))
    assert caught.value.code == "BUNDLE_UNPROVEN"


async def register_bob(ward: Ward) -> tuple[Wallet, PersonProofs]:
    """Another member of the same network, and what proves who he is."""
    wallet = ward.come_in("bob")
    return wallet, await collect_person(wallet)


def told(path: Path, ward: Ward) -> tuple[str, str]:
    """What `verify` says is proved, and what it says is not, on one line each."""
    result = CliRunner().invoke(verify, [str(path), "--genesis", ward.genesis.block_id.hex()])
    assert result.exit_code == 0, result.output
    proved, open_questions = " ".join(result.output.split()).split("Not proved:")
    return proved, open_questions


async def test_the_visits_of_one_are_never_called_those_of_another_who_signed_too(
    ward: Ward, visit: VisitChain, tmp_path: Path
) -> None:
    """Two who agree can put both their keys under one file: only what a robot sealed says whose a visit is."""
    anns = await collect(ward)
    bob, person = await register_bob(ward)
    openings = [msgspec.structs.replace(row, box_key="") for row in anns.proofs.openings.records]
    proofs = dataclasses.replace(
        anns.proofs,
        person=person.state,
        receipts=doc.ReceiptProofs(list(person.receipts)),
        openings=doc.RecordOpenings(openings, []),
    )

    def find_key(key: bytes) -> PrivateKey:
        return bob.keys.identity if key == bob.keys.identity.public_key else anns.find_key(key)

    verdict = write_bundle(tmp_path / "mixed.zip", dataclasses.replace(anns, proofs=proofs, find_key=find_key))
    assert verdict.visits_of_member == ()
    assert any("that visit 1 is of the member that it names" in line for line in unproved(verdict))
    proved, open_questions = told(tmp_path / "mixed.zip", ward)
    assert "of that member" not in proved
    assert "that visit 1 is of the member that it names" in open_questions


async def test_a_visit_is_called_the_members_where_a_robot_sealed_a_record_of_it_to_her(
    ward: Ward, visit: VisitChain, tmp_path: Path
) -> None:
    second = ward.open_visit()
    erased = ward.record(second)
    await ward.erase(second, [erased])
    verdict = write_bundle(tmp_path / "mine.zip", await collect(ward))
    assert verdict.visits_of_member == (1,)
    proved, open_questions = told(tmp_path / "mine.zip", ward)
    assert "visit 1 is of that member" in proved
    assert "that visit 2 is of the member that it names" in open_questions


async def test_an_old_state_is_not_shown_as_that_of_a_newer_block_that_stands_beside_it(
    ward: Ward, visit: VisitChain, tmp_path: Path
) -> None:
    """Each proof is sound: the visit's is of before the erasure, the person's and the other visit's of after."""
    before = await collect(ward)
    then = ward.chain.height
    record_id = bytes.fromhex(before.proofs.openings.records[0].record_id)
    await ward.erase(visit, [record_id])
    ward.record(ward.open_visit())
    now = await collect(ward)
    rows = [*before.proofs.openings.records, *now.proofs.openings.records]
    proofs = dataclasses.replace(
        now.proofs,
        visits=(before.proofs.visits[0], now.proofs.visits[1]),
        openings=doc.RecordOpenings([msgspec.structs.replace(row, commitment_leaves=[], salts=[]) for row in rows], []),
    )
    verdict = write_bundle(tmp_path / "mixed.zip", dataclasses.replace(now, proofs=proofs))
    assert (verdict.records[0].status, verdict.erasures) == ("active", 0)
    assert ward.chain.height > then
    proved, open_questions = told(tmp_path / "mixed.zip", ward)
    assert f"Up to which block: {then}, of " in proved
    assert f"visit 1 is told as of block {then}" in proved
    assert f"visit 2 is told as of block {ward.chain.height}" in proved
    assert f"the member and their consents are told as of block {ward.chain.height}" in proved
    assert f"what happened after block {then}" in open_questions
    assert verdict.as_of_height == then


async def test_one_visit_of_two_blocks_is_told_as_of_the_older(ward: Ward, visit: VisitChain, tmp_path: Path) -> None:
    """That nothing was denied or restricted was proved before it was; the trail goes on after it."""
    before = await collect(ward)
    then = ward.chain.height
    ward.chain.must(await ward.owner_key(visit.owner), "rights", "restrict", [], "accuracy")
    old = [snapshot for snapshot in before.proofs.visits[0].snapshots if snapshot.keys]
    now = await collect(ward)
    proved_before = {key.key: key for each in old for key in each.keys}
    (newer,) = now.proofs.visits[0].snapshots
    stale = proved_before[RESTRICTION.key(visit.owner).hex()]
    kept = [key for key in newer.keys if key.key != stale.key]
    state = doc.StateProofs([doc.Snapshot(old[0].finality, [stale]), doc.Snapshot(newer.finality, kept)])
    contents = dataclasses.replace(now, proofs=dataclasses.replace(now.proofs, visits=(state,)))
    verdict = write_bundle(tmp_path / "mixed.zip", contents)
    assert verdict.as_of_height == then
    assert f"visit 1 is told as of block {then}" in told(tmp_path / "mixed.zip", ward)[0]
