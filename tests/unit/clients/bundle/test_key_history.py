"""What was sealed to keys of before is proved to be hers: by her registration and each rotation on the ledger."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest

from clients.bundle import documents as doc
from clients.bundle import layout
from clients.bundle.checks.bundle_check import Verdict, unproved, verify_bundle
from clients.bundle.proving import schema_text
from clients.bundle.writing import Contents, write_bundle
from clients.wallet.export.export_building import ExportChoice
from clients.wallet.ledger.proof_collection import read_transaction
from clients.wallet.recovery.key_rotation import KeyRotation
from clients.wallet.store.kept_proofs import receipt_proof
from consensus.errors import BlockRobotError
from tests.unit.clients.bundle.conftest import make
from tests.unit.clients.bundle.repacking import unpack
from tests.unit.contracts.privacy.hospital import Person
from tests.world.ward import Ward

NO_PICTURES = ExportChoice(pictures=False)


async def rotate(ward: Ward) -> None:
    """New words, for the membership and each visit."""
    rotating = KeyRotation(ward.wallet)
    rotating.prepare()
    rotating.confirm_shown()
    assert await rotating.rotate()
    assert (await rotating.transfer_all(0.0, lambda *_: None)).refusal is None
    ward.patient.keys = ward.wallet.keys


@pytest.fixture
async def ward(tmp_path: Path) -> Ward:
    """A record under each of three sets of words."""
    ward = Ward(tmp_path)
    ward.record(ward.open_visit(), frames=1)
    for _ in range(2):
        await rotate(ward)
        ward.record(ward.open_visit(), frames=1)
    return ward


def proved(verdict: Verdict) -> list[bool]:
    return [record.metadata_proved for record in verdict.records]


async def test_after_two_rotations_all_metadata_are_proved_and_so_is_whose_visits_they_are(
    ward: Ward, tmp_path: Path
) -> None:
    await make(ward, tmp_path / "mine.zip")
    verdict = verify_bundle(tmp_path / "mine.zip", ward.genesis)
    assert proved(verdict) == [True, True, True]
    assert verdict.visits_of_member == (1, 2, 3)
    assert not any("exporter's word, signed" not in line and "exporter's word" in line for line in unproved(verdict))
    assert verdict.manifest.version == 2
    assert verdict.manifest.problems == []


async def test_who_never_changed_her_words_gets_a_bundle_that_older_programs_read(tmp_path: Path) -> None:
    ward = Ward(tmp_path)
    ward.record(ward.open_visit(), frames=1)
    await make(ward, tmp_path / "mine.zip")
    assert verify_bundle(tmp_path / "mine.zip", ward.genesis).manifest.version == 1
    assert unpack(tmp_path / "mine.zip")[layout.SCHEMA] == schema_text(1)


async def test_without_identity_no_key_is_named(ward: Ward, tmp_path: Path) -> None:
    await make(ward, tmp_path / "mine.zip", ExportChoice(pictures=False, identity=False))
    verdict = verify_bundle(tmp_path / "mine.zip", ward.genesis)
    assert (proved(verdict), verdict.manifest.version) == ([False, False, False], 1)


async def test_the_history_keeps_to_the_schema_of_its_version(ward: Ward, tmp_path: Path) -> None:
    await make(ward, tmp_path / "mine.zip", NO_PICTURES)
    files, schema = unpack(tmp_path / "mine.zip"), json.loads(schema_text(2))
    assert files[layout.SCHEMA] == schema_text(2)
    part = schema["x-files"][layout.KEY_HISTORY] | {"$defs": schema["$defs"]}
    jsonschema.Draft202012Validator(part).validate(json.loads(files[layout.KEY_HISTORY]))


async def test_what_no_node_keeps_any_more_is_said_and_the_rest_is_proved(ward: Ward, tmp_path: Path) -> None:
    """The registration's block is pruned: the oldest key stays her own word."""
    ward.network.pruned_height = max(
        height
        for height, receipts in enumerate(ward.chain.receipts, 1)
        if any(event.name == "registered" for receipt in receipts for event in receipt.events)
    )
    await make(ward, tmp_path / "mine.zip", NO_PICTURES)
    verdict = verify_bundle(tmp_path / "mine.zip", ward.genesis)
    assert proved(verdict) == [False, True, True]
    (problem,) = verdict.manifest.problems
    assert problem.code == "BLOCK_PRUNED"
    assert "former keys" in problem.sentence


async def written(contents: Contents, keys: doc.KeyHistory | None, path: Path) -> str:
    """Write with another history; return the code of the refusal."""
    try:
        write_bundle(path, replace(contents, proofs=replace(contents.proofs, keys=keys)))
    except BlockRobotError as error:
        return error.code
    return "OK"


async def test_a_history_with_a_step_missing_moved_or_changed_proves_nothing(ward: Ward, tmp_path: Path) -> None:
    contents = await make(ward, tmp_path / "mine.zip", NO_PICTURES)
    assert contents.proofs.keys is not None
    first, second, third = contents.proofs.keys.steps
    failed = msgspec.structs.replace(second, proof=first.proof)
    for steps in ([], [first, third], [second, first, third], [first, second], [first, failed, third]):
        assert await written(contents, doc.KeyHistory(steps), tmp_path / "his.zip") in {
            "BUNDLE_INVALID",
            "BUNDLE_UNPROVEN",
        }
    assert await written(contents, None, tmp_path / "his.zip") == "BUNDLE_UNPROVEN"
    assert not (tmp_path / "his.zip").exists()


async def test_nobody_adds_another_persons_keys_to_her_own(ward: Ward, tmp_path: Path) -> None:
    """Bob registers; his key is final on the ledger, and no rotation of hers leads to it."""
    contents = await make(ward, tmp_path / "mine.zip", NO_PICTURES)
    other = Person("bob")
    ward.chain.must(
        other.identity, "identity", "register", *ward.chain.register_arguments(other, ward.chain.card("bob"))
    )
    his = await bobs_step(ward)
    assert contents.proofs.keys is not None
    for steps in ([his, *contents.proofs.keys.steps], [his], [his, *contents.proofs.keys.steps[1:]]):
        assert await written(contents, doc.KeyHistory(list(steps)), tmp_path / "his.zip") == "BUNDLE_UNPROVEN"


async def bobs_step(ward: Ward) -> doc.KeyChange:
    """The newest transaction, as a step."""
    receipt = ward.chain.receipts[-1][0]
    final = await ward.network.wait_final(receipt.txid)
    network: Any = ward.network
    transaction = await read_transaction(network, ward.patient.identity, final.height, receipt.txid)
    assert final.evidence is not None
    return doc.KeyChange(transaction.wire.hex(), receipt_proof(final, final.evidence))
