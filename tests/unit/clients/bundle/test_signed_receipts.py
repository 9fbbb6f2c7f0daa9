"""Consent receipts in a bundle: each checked offline, of this person, about consents that the bundle proves."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest
from click.testing import CliRunner

from clients.bundle import documents as doc
from clients.bundle import layout
from clients.bundle.checks import signed_receipts
from clients.bundle.checks.bundle_check import unproved, verify_bundle
from clients.bundle.checks.signed_receipts import require_owners
from clients.bundle.cli import verify
from clients.bundle.proving import schema_text
from clients.bundle.writing import Contents, write_bundle
from clients.wallet.export.export_building import ExportChoice
from consensus.errors import BlockRobotError
from consensus.rights.consent_receipts import sign_as_controller, sign_as_person
from consensus.state.identity import MemberRow
from network.notices.notice_publishing import demo_notice
from tests.unit.clients.bundle.conftest import make
from tests.unit.clients.bundle.repacking import judge, list_anew, pack, sign_anew, unpack
from tests.unit.contracts.privacy.hospital import key_of
from tests.world.notices import NoticeWard, entry_of

NO_PICTURES = ExportChoice(pictures=False)


def new_ward(folder: Path) -> NoticeWard:
    ward = NoticeWard(folder)
    ward.publish(demo_notice())
    return ward


def say(ward: NoticeWard, entry: str, *arguments: Any) -> bytes:
    return ward.chain.must(ward.patient.identity, "consent", entry, ward.patient.handle, *arguments).txid


def say_three(ward: NoticeWard) -> None:
    say(ward, "give", ["care"], ["rgb"], 0, 0, 0, ward.chain.height)
    say(ward, "refuse", ["research"], [])
    say(ward, "withdraw", [], [])


@dataclass(frozen=True)
class Taken:
    """A bundle with four receipts: of registering, a yes, a no and a withdrawal; and one of somebody else."""

    ward: NoticeWard
    path: Path
    contents: Contents
    theirs: doc.ReceiptEntry

    @property
    def entries(self) -> list[doc.ReceiptEntry]:
        assert self.contents.proofs.signed is not None
        return self.contents.proofs.signed.receipts

    def refusal(self, path: Path, entries: list[doc.ReceiptEntry], **proofs: Any) -> BlockRobotError:
        """Why a bundle with other receipts is refused: to its own maker, who checks as a stranger does."""
        changed = replace(self.contents.proofs, signed=doc.SignedReceipts(entries), **proofs)
        with pytest.raises(BlockRobotError) as caught:
            write_bundle(path, replace(self.contents, proofs=changed))
        assert not path.exists()
        return caught.value


async def _take(folder: Path) -> Taken:
    ward = new_ward(folder)
    say_three(ward)
    ben = ward.chain.enrol("ben")
    theirs = ward.chain.must(ben.identity, "consent", "refuse", ben.handle, ["care"], [])
    contents = await make(ward, folder / "mine.zip", NO_PICTURES)
    return Taken(ward, folder / "mine.zip", contents, await entry_of(ward, ben.identity, theirs.txid))


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> Taken:
    return asyncio.run(_take(tmp_path_factory.mktemp("receipts")))


@pytest.fixture
def ward(tmp_path: Path) -> NoticeWard:
    return new_ward(tmp_path)


# What is in the bundle


def test_every_word_has_its_receipt_and_each_is_checked_offline(taken: Taken) -> None:
    verdict = verify_bundle(taken.path, taken.ward.genesis)
    assert [each.statement.status for each in verdict.signed] == ["given", "given", "refused", "withdrawn"]
    assert [word.kind for word in verdict.consents.history] == ["given", "refused", "withdrawn"]
    assert (verdict.manifest.version, verdict.manifest.problems) == (2, [])
    assert any("read the notices" in line for line in unproved(verdict))
    assert not any("under which notice" in line for line in unproved(verdict))
    told = json.loads(unpack(taken.path)[layout.TOLD_RECEIPTS])["receipts"]
    assert [row["receipt"]["events"][0]["event_state"] for row in told] == [row["status"] for row in told]
    assert told[1]["notice_hash"] == told[1]["receipt"]["privacy_notice"]["hash"]
    assert (told[0]["notice_version"], told[0]["notice_hash"]) == (0, ""), "she registered before there was a notice"


def test_what_is_told_is_what_both_sides_signed(taken: Taken) -> None:
    """With nothing but data/receipts.json, and the rule by which its bytes are written."""
    for row in json.loads(unpack(taken.path)[layout.TOLD_RECEIPTS])["receipts"]:
        document = json.dumps(row["receipt"], sort_keys=True, separators=(",", ":"), ensure_ascii=True).encode()
        signature = sign_as_controller(key_of("custodian-1"), document)
        own = sign_as_person(taken.ward.wallet.keys.identity, document, signature)
        assert (row["controller_signature"], row["person_signature"]) == (signature.hex(), own.hex())
        assert row["person_key"] == taken.ward.wallet.keys.identity.public_key.hex()


@pytest.mark.parametrize("place", [layout.TOLD_RECEIPTS, layout.SIGNED_RECEIPTS])
def test_they_keep_to_the_schema_of_their_version(taken: Taken, place: str) -> None:
    files, schema = unpack(taken.path), json.loads(schema_text(2))
    assert files[layout.SCHEMA] == schema_text(2)
    assert layout.KEY_HISTORY not in files, "nothing was rotated"
    part = schema["x-files"][place] | {"$defs": schema["$defs"]}
    jsonschema.Draft202012Validator(part).validate(json.loads(files[place]))


def test_verify_says_in_plain_words_what_they_show(taken: Taken) -> None:
    output = " ".join(CliRunner().invoke(verify, [str(taken.path)]).output.split())
    organisation = verify_bundle(taken.path).signed[0].organisation
    assert f"4 receipts of consent are signed by both sides, by the owner and by {organisation}, which reg" in output
    assert "are as told; 3 words on consent from after registering, with the chain's receipts" in output
    assert "withdrawn: everything by every sensor" in output
    told = json.loads(CliRunner().invoke(verify, [str(taken.path), "--json"]).output)
    assert [row["status"] for row in told["signed_consent_receipts"]] == ["given", "given", "refused", "withdrawn"]
    assert all(row["is_registrars"] for row in told["signed_consent_receipts"])


async def test_of_one_receipt_is_spoken_in_the_singular(ward: NoticeWard, tmp_path: Path) -> None:
    await make(ward, tmp_path / "mine.zip", NO_PICTURES)
    output = " ".join(CliRunner().invoke(verify, [str(tmp_path / "mine.zip")]).output.split())
    assert "0 words on consent from after registering" in output
    assert "1 receipt of consent is signed by both sides" in output
    assert "which registered them, and says what the ledger says:" in output


# What is refused


def flipped(text: str) -> str:
    return text.replace("given", "civen", 1) if "given" in text else text.replace("refused", "refuxed", 1)


def other_notice(state: doc.StateProofs) -> doc.StateProofs:
    """The notice in the proofs, with another word in it."""
    (snapshot,) = state.snapshots
    was, word = b"registration desk".hex(), b"registration dusk".hex()
    assert any(part.value and was in part.value for part in snapshot.keys)
    keys = [msgspec.structs.replace(part, value=part.value and part.value.replace(was, word)) for part in snapshot.keys]
    return doc.StateProofs([msgspec.structs.replace(snapshot, keys=keys)])


CHANGES: dict[str, Callable[[doc.ReceiptEntry], dict[str, Any]]] = {
    "the organisation did not sign": lambda each: {"controller_signature": "00" * 64},
    "she did not sign": lambda each: {"person_signature": each.controller_signature},
    "she has not signed yet": lambda each: {"person_signature": ""},
    "who signed is no custodian": lambda each: {"controller_key": key_of("stranger").public_key.hex()},
    "other words": lambda each: {"document": flipped(each.document)},
    "no receipt at all": lambda each: {"document": "[]"},
    "one bit of the transaction": lambda each: {"transaction": f"{int(each.transaction, 16) ^ 1:x}"},
    "nothing proved": lambda each: {"state": doc.StateProofs([])},
    "another notice": lambda each: {"state": other_notice(each.state)},
    "no bytes": lambda each: {"controller_key": "zz"},
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_forged_receipt_is_refused_and_named_by_its_number(taken: Taken, tmp_path: Path, change: str) -> None:
    first, second, *rest = taken.entries
    forged = msgspec.structs.replace(second, **CHANGES[change](second))
    error = taken.refusal(tmp_path / "forged.zip", [first, forged, *rest])
    assert error.code == "BUNDLE_UNPROVEN"
    assert error.detail.startswith("Consent receipt 2: ")


def test_the_receipt_of_another_person_is_refused(taken: Taken, tmp_path: Path) -> None:
    """It is sound: she could have got it from him, with his consent's proof."""
    error = taken.refusal(tmp_path / "his.zip", [*taken.entries, taken.theirs])
    assert error.detail == "Consent receipt 5: It is of another person."


def test_a_receipt_counts_only_by_who_registered_her(taken: Taken) -> None:
    checked = verify_bundle(taken.path).signed[1]
    row = MemberRow(checked.statement.handle, "subject", checked.organisation, b"", b"", b"", "active", 0)
    require_owners(checked, row)
    with pytest.raises(BlockRobotError, match="did not register the owner"):
        require_owners(checked, msgspec.structs.replace(row, org="another"))


def test_a_receipt_whose_consent_is_not_in_the_bundle_is_refused(taken: Taken, tmp_path: Path) -> None:
    words = taken.contents.proofs.receipts.receipts
    for place, number in ((0, 2), (1, 3), (2, 4)):
        fewer = doc.ReceiptProofs(words[:place] + words[place + 1 :])
        error = taken.refusal(tmp_path / "fewer.zip", taken.entries, receipts=fewer)
        assert error.code == "BUNDLE_UNPROVEN"
        assert error.detail == f"Consent receipt {number} is of a consent that the bundle does not prove."


def test_a_receipt_twice_or_in_another_order_and_a_list_of_none_are_refused(taken: Taken, tmp_path: Path) -> None:
    entries = taken.entries
    for listed in ([], entries[:1] * 2, [*entries, entries[0]], entries[::-1]):
        assert taken.refusal(tmp_path / "other.zip", listed).code == "BUNDLE_INVALID"


def test_receipts_without_saying_whose_are_refused(taken: Taken, tmp_path: Path) -> None:
    error = taken.refusal(tmp_path / "whose.zip", taken.entries, person=None, receipts=doc.ReceiptProofs([]))
    assert (error.code, "whose" in error.detail) == ("BUNDLE_INVALID", True)


def test_too_many_receipts_are_refused(taken: Taken, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(signed_receipts, "RECEIPTS_MAX_COUNT", 3)
    assert "too many" in taken.refusal(tmp_path / "many.zip", taken.entries).detail


def test_receipts_that_are_too_large_are_refused(taken: Taken, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layout, "SIGNED_RECEIPTS_MAX_BYTES", 1_000)
    with pytest.raises(BlockRobotError, match="larger than the 1000 bytes") as caught:
        verify_bundle(taken.path)
    assert caught.value.code == "BUNDLE_INVALID"


def test_a_bit_anywhere_in_them_does_not_change_without_showing(taken: Taken, tmp_path: Path) -> None:
    """Though her own keys sign the changed file: 24 places of the proofs, 8 of what is told."""
    files = unpack(taken.path)
    for name, count in ((layout.SIGNED_RECEIPTS, 24), (layout.TOLD_RECEIPTS, 8)):
        content = files[name]
        for place in range(len(content) // (2 * count), len(content), len(content) // count):
            changed = bytearray(content)
            changed[place] ^= 1
            listed = list_anew(files | {name: bytes(changed)})
            bundle = pack(sign_anew(listed, taken.ward.genesis, taken.contents.find_key))
            assert isinstance(judge(tmp_path / "bit.zip", bundle, taken.ward.genesis), BlockRobotError), (name, place)


def test_receipts_cannot_be_taken_out_and_the_rest_called_whole(taken: Taken, tmp_path: Path) -> None:
    files = unpack(taken.path)
    del files[layout.SIGNED_RECEIPTS], files[layout.TOLD_RECEIPTS]
    bundle = pack(sign_anew(list_anew(files), taken.ward.genesis, taken.contents.find_key))
    error = judge(tmp_path / "out.zip", bundle, taken.ward.genesis)
    assert isinstance(error, BlockRobotError)
    assert "calls itself version 2" in error.detail


def test_an_older_reader_is_not_told_that_it_is_version_1(taken: Taken, tmp_path: Path) -> None:
    files = unpack(taken.path)
    manifest = msgspec.structs.replace(msgspec.json.decode(files[layout.MANIFEST], type=doc.Manifest), version=1)
    files |= {layout.MANIFEST: doc.write_document(manifest), layout.SCHEMA: schema_text(1)}
    bundle = pack(sign_anew(list_anew(files), taken.ward.genesis, taken.contents.find_key))
    error = judge(tmp_path / "older.zip", bundle, taken.ward.genesis)
    assert isinstance(error, BlockRobotError)


# What cannot be signed


def test_of_an_objection_there_is_no_receipt_but_the_word_itself(ward: NoticeWard, tmp_path: Path) -> None:
    """The organisation's side signs words of consent alone; an objection goes along as the ledger has it."""
    objected = ward.chain.must(ward.patient.identity, "rights", "object_to", ward.patient.handle, ["research"])
    with pytest.raises(BlockRobotError, match=r"^CONSENT_WORD_MISSING:"):
        ward.network.issuer.issue(ward.network.ledger, objected.txid, ward.patient.identity.public_key)
    asyncio.run(make(ward, tmp_path / "mine.zip", NO_PICTURES))
    verdict = verify_bundle(tmp_path / "mine.zip", ward.genesis)
    assert [word.kind for word in verdict.consents.history] == ["objected"]
    assert [each.statement.status for each in verdict.signed] == ["given"]
    assert verdict.manifest.problems == []
    assert not any("under which notice" in line for line in unproved(verdict))


def test_who_names_no_member_names_no_receipt(ward: NoticeWard, tmp_path: Path) -> None:
    say_three(ward)
    ward.record(ward.open_visit())
    asyncio.run(make(ward, tmp_path / "mine.zip", ExportChoice(identity=False, pictures=False)))
    verdict = verify_bundle(tmp_path / "mine.zip", ward.genesis)
    assert (verdict.signed, verdict.manifest.version, verdict.manifest.problems) == ((), 1, [])
    assert ward.wallet.store.content.receipts == [], "and nobody was asked"
