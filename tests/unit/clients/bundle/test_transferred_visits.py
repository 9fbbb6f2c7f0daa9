"""Which key has to sign for a visit: no former one does, whatever proof its holder leaves out or keeps back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from clients.bundle.checks import visit_check
from clients.bundle.checks.bundle_check import Verdict, verify_bundle
from clients.wallet.export.export_building import ExportChoice
from clients.wallet.ledger.proof_collection import StateCollector
from clients.wallet.ledger.visit_scan import find_own_visits
from clients.wallet.recovery.key_rotation import KeyRotation
from consensus.errors import BlockRobotError
from consensus.state.audit import ENTRY
from consensus.state.records import CURRENT
from tests.unit.clients.bundle.conftest import make
from tests.world.ward import Ward

TRAIL_ONLY = ExportChoice(pictures=False, identity=False)


class Thief(Ward):
    """Who has the words that were in force before, and every proof that he asks for."""

    def __init__(self, ward: Ward, words: str) -> None:
        self.chain, self.patient, self.network = ward.chain, ward.patient, ward.network
        self.wallet = ward.open_wallet("thief", words)
        self.wallet.store.content.handle = ward.patient.handle

    async def learn(self) -> None:
        """Find her visits as they were opened, and look no further."""
        page = await self.network.announcements(0, self.patient.identity)
        found = find_own_visits(page.items, self.wallet.keys, self.wallet.genesis.chain_id)[:1]
        self.wallet.store.content.visits = found

        async def scan(**_: object) -> object:
            return found

        self.wallet.scan = scan  # type: ignore[assignment,method-assign]


async def steal(ward: Ward) -> Thief:
    """A visit with a record, moved away from the words that a thief has."""
    visit = ward.open_visit()
    ward.record(visit)
    ward.close_visit(visit)
    thief = Thief(ward, ward.wallet.store.content.words)
    await thief.learn()
    rotating = KeyRotation(ward.wallet)
    rotating.prepare()
    rotating.confirm_shown()
    await rotating.rotate()
    assert len((await rotating.transfer_all(0.0, lambda *_: None)).done) == 1
    return thief


async def judged(ward: Ward, thief: Thief, path: Path) -> str:
    try:
        await make(thief, path, TRAIL_ONLY)
        verify_bundle(path, ward.genesis)
    except BlockRobotError as error:
        return error.code
    return "OK"


async def test_the_new_key_signs_for_a_transferred_visit(ward: Ward, tmp_path: Path) -> None:
    await steal(ward)
    await make(ward, tmp_path / "hers.zip", TRAIL_ONLY)
    assert isinstance(verify_bundle(tmp_path / "hers.zip", ward.genesis), Verdict)


def without_current(keys: Callable[[bytes], list[bytes]]) -> Callable[[bytes], list[bytes]]:
    return lambda owner: [key for key in keys(owner) if not CURRENT.owns(key)]


async def test_old_words_sign_no_bundle_by_leaving_out_which_key_decides(
    ward: Ward, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    thief = await steal(ward)
    monkeypatch.setattr(visit_check, "trail_keys", without_current(visit_check.trail_keys))
    assert await judged(ward, thief, tmp_path / "his.zip") == "BUNDLE_UNPROVEN"


async def test_nor_by_leaving_out_the_entry_that_tells_of_it_as_well(
    ward: Ward, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    thief = await steal(ward)
    monkeypatch.setattr(visit_check, "trail_keys", without_current(visit_check.trail_keys))
    document = StateCollector.document

    def shortened(collector: StateCollector) -> object:
        for key in [key for key in collector.values if ENTRY.owns(key)]:
            if collector.values[key]["kind"] == "transferred":
                collector.leave_out(key)
        return document(collector)

    monkeypatch.setattr(StateCollector, "document", shortened)
    assert await judged(ward, thief, tmp_path / "his.zip") == "BUNDLE_UNPROVEN"


async def test_nor_by_a_proof_from_before(ward: Ward, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A proof that the visit was not transferred, of a block in which it was not, beside the trail of today."""
    before: dict[str, StateCollector] = {}
    learn = Thief.learn

    async def keep(thief: Thief) -> None:
        await learn(thief)
        (visit,) = thief.wallet.store.content.visits
        before["it"] = StateCollector(thief.wallet, thief.wallet.owner_key(visit))
        await before["it"].read([CURRENT.key(visit.owner)])

    monkeypatch.setattr(Thief, "learn", keep)
    thief = await steal(ward)
    document = StateCollector.document

    def mixed(collector: StateCollector) -> object:
        collector._found.update(before["it"]._found)
        return document(collector)

    monkeypatch.setattr(StateCollector, "document", mixed)
    assert await judged(ward, thief, tmp_path / "his.zip") == "BUNDLE_UNPROVEN"
