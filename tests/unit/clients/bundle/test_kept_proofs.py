"""The wallet's own proofs: they hold without any node, and nothing that was changed in the file does."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path

import msgspec
import pytest

from clients.bundle import documents as doc
from clients.bundle.checks.bundle_check import verify_bundle
from clients.bundle.checks.chain_proofs import ProvedChain
from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.records.erasure import ErasureClient
from clients.wallet.store import kept_proofs
from clients.wallet.store.kept_proofs import CheckedProof, KeptProof, check_all, check_kept, keep_receipt, read_kept
from clients.wallet.store.keystore import Keystore
from consensus.errors import BlockRobotError
from consensus.state.erasure import REQUEST
from tests.unit.clients.bundle.test_key_history import NO_PICTURES, make, proved, rotate
from tests.world.ward import Ward


async def erase_one(ward: Ward) -> bytes:
    """A visit's record, erased and confirmed by every custodian; return the erasure's id."""
    ward.record(ward.open_visit(), frames=1)
    (visit,) = await ward.wallet.scan()
    (report,) = await ward.wallet.records()
    erasing = ErasureClient(ward.wallet)
    (erasure_id,) = await erasing.request(visit, [report.records[0].record_id], [])
    assert not (await erasing.report(visit, erasure_id)).complete
    ward.chain.receipts_of_all(erasure_id)
    assert (await erasing.report(visit, erasure_id)).complete
    return erasure_id


def chain_of(ward: Ward) -> ProvedChain:
    return ProvedChain(ward.genesis, [])


async def test_an_erasures_receipts_hold_after_the_network_is_gone(tmp_path: Path) -> None:
    ward = Ward(tmp_path)
    erasure_id = await erase_one(ward)
    ward.wallet.store.save()
    content = Keystore.open(tmp_path / "ann.wallet", "tea").content
    (checked,) = check_all(content, chain_of(ward), ward.genesis.chain_id)
    assert isinstance(checked, CheckedProof)
    assert (checked.receipt.txid, checked.receipt.ok) == (erasure_id, True)
    assert checked.erasure is not None
    assert set(checked.erasure.receipts) == {key.public_key for key in ward.chain.custodians}
    assert checked.proved_height > checked.height


async def test_a_proof_that_was_changed_or_is_of_another_transaction_is_refused(tmp_path: Path) -> None:
    ward = Ward(tmp_path)
    erasure_id = await erase_one(ward)
    await ConsentClient(ward.wallet).refuse(["care"], [])
    content, chain_id = ward.wallet.store.content, ward.genesis.chain_id
    kept, other = read_kept(content, erasure_id), read_kept(content, next(t for t in content.proofs if t != erasure_id))
    assert kept is not None
    assert kept.state is not None
    assert other is not None
    (snapshot,) = kept.state.snapshots
    (part,) = snapshot.keys
    assert part.value is not None
    lie = msgspec.structs.replace(part, value=part.value.replace("63", "64", 1))
    changed = msgspec.structs.replace
    wrong: list[KeptProof] = [
        changed(kept, transaction=other.transaction),
        changed(kept, proof=other.proof),
        changed(kept, proof=changed(kept.proof, count=2)),
        changed(kept, proof=changed(kept.proof, finality=other.proof.finality)),
        changed(kept, proof=changed(kept.proof, headers=kept.proof.headers[:-1])),
        changed(kept, state=doc.StateProofs([])),
        changed(kept, state=doc.StateProofs([doc.Snapshot(snapshot.finality, [lie])])),
        changed(kept, transaction="00"),
        changed(kept, transaction="no"),
    ]
    for each in wrong:
        with pytest.raises(BlockRobotError, match=r"^KEPT_PROOF_DAMAGED:"):
            check_kept(chain_of(ward), chain_id, erasure_id, each)
    with pytest.raises(BlockRobotError, match=r"^KEPT_PROOF_DAMAGED:"):
        check_kept(chain_of(ward), bytes(32), erasure_id, kept)
    content.proofs[erasure_id] = b"{"
    found = list(check_all(content, chain_of(ward), chain_id))
    assert [isinstance(each, CheckedProof) for each in found] == [False, True]


async def test_only_the_proofs_of_the_contract_that_is_asked_for_are_checked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward, checked = Ward(tmp_path), list[bytes]()
    erasure_id = await erase_one(ward)
    await ConsentClient(ward.wallet).refuse(["care"], [])
    proofs, check = ward.wallet.store.content.proofs, kept_proofs.check_kept

    def count(chain: ProvedChain, chain_id: bytes, txid: bytes, kept: KeptProof) -> CheckedProof:
        checked.append(txid)
        return check(chain, chain_id, txid, kept)

    monkeypatch.setattr(kept_proofs, "check_kept", count)
    ((txid, _),) = kept_proofs.kept_of(proofs, chain_of(ward), ward.genesis.chain_id, "erasure")
    assert (txid, checked, len(proofs)) == (erasure_id, [erasure_id], 2)
    proofs[erasure_id] = b"{"
    assert kept_proofs.kept_of(proofs, chain_of(ward), ward.genesis.chain_id, "erasure") == []


async def test_an_erasure_that_is_not_complete_is_never_kept_as_complete(tmp_path: Path) -> None:
    ward = Ward(tmp_path)
    ward.record(ward.open_visit(), frames=1)
    (visit,) = await ward.wallet.scan()
    (report,) = await ward.wallet.records()
    (erasure_id,) = await ErasureClient(ward.wallet).request(visit, [report.records[0].record_id], [])
    state = await ward.network.state_values([REQUEST.key(erasure_id)], ward.wallet.owner_key(visit))
    kept_proofs.keep_erasure(ward.wallet.store.content, erasure_id, state)
    (found,) = check_all(ward.wallet.store.content, chain_of(ward), ward.genesis.chain_id)
    assert isinstance(found, BlockRobotError)
    assert "not proved complete" in found.detail


@dataclass
class Holder:
    proofs: dict[bytes, bytes] = field(default_factory=dict)
    proofs_dropped_count: int = 0


async def test_the_file_stays_bounded_and_the_oldest_proofs_go(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ward, holder = Ward(tmp_path), Holder()
    handle = ward.wallet.store.content.handle
    receipts = [
        await ward.network.call(ward.wallet.keys.identity, "consent", "refuse", [handle, ["care"], []])
        for _ in range(4)
    ]
    keep_receipt(holder, receipts[0])
    size = len(holder.proofs[receipts[0].txid])
    assert size < 16 * 1024
    monkeypatch.setattr(kept_proofs, "KEPT_PROOFS_MAX_BYTES", 3 * size + size // 2)
    for receipt in receipts:
        keep_receipt(holder, receipt)
    assert list(holder.proofs) == [receipt.txid for receipt in receipts[1:]]
    assert holder.proofs_dropped_count == 1


async def test_a_receipt_without_its_proof_is_not_kept(tmp_path: Path) -> None:
    ward, holder = Ward(tmp_path), Holder()
    handle = ward.wallet.store.content.handle
    receipt = await ward.network.call(ward.wallet.keys.identity, "consent", "refuse", [handle, ["care"], []])
    for lacking in (replace(receipt, evidence=None), replace(receipt, transaction=None)):
        keep_receipt(holder, lacking)
    assert holder.proofs == {}


async def test_rotations_and_words_whose_blocks_every_node_dropped_are_proved_in_an_export(tmp_path: Path) -> None:
    ward = Ward(tmp_path)
    for _ in range(2):
        ward.record(ward.open_visit(), frames=1)
        await rotate(ward)
    await ConsentClient(ward.wallet).refuse(["care"], [])
    ward.record(ward.open_visit(), frames=1)
    ward.network.pruned_below = len(ward.chain.receipts) + 1
    with pytest.raises(BlockRobotError, match=r"^BLOCK_PRUNED:"):
        await ward.network.wait_final(next(iter(ward.wallet.store.content.proofs)))
    contents = await make(ward, tmp_path / "mine.zip", NO_PICTURES)
    assert contents.proofs.keys is not None
    assert len(contents.proofs.keys.steps) == 2
    verdict = verify_bundle(tmp_path / "mine.zip", ward.genesis)
    assert proved(verdict) == [False, True, True]
    assert len(contents.proofs.receipts.receipts) == 1
