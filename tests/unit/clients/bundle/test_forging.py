"""Forging: whatever byte of a bundle is changed, by a stranger or by its own maker, it shows.

A stranger has the file alone. The maker has the keys, lists and signs anew what she changed; what she may say without
proof is listed here, and the verifier calls it her word.
"""

from __future__ import annotations

import dataclasses
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from clients.bundle import documents as doc
from clients.bundle import layout
from clients.bundle.checks.bundle_check import Verdict, unproved
from clients.bundle.writing import Contents, write_bundle
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.records.metadata import RecordMetadata
from consensus.state.access import VERDICT
from consensus.state.audit import COUNT, ENTRY
from consensus.state.erasure import REQUEST
from consensus.state.keys import Rows
from consensus.state.records import RECORD
from consensus.state.rights import RESTRICTION
from tests.effort import EFFORT, EFFORT_OF_ALL
from tests.unit.clients.bundle.conftest import Made
from tests.unit.clients.bundle.repacking import judge, list_anew, pack, sign_anew

SEED = 20_261_121
CHANGES_A_FILE_COUNT = 10
HEX = b"0123456789abcdef"


def changed(content: bytes, place: int, draw: random.Random) -> bytes:
    """The content with one byte changed, into one that is likely to be understood."""
    old = content[place]
    choices = HEX if old in HEX else bytes([old ^ 1, old ^ 0x20, draw.randrange(256)])
    new = draw.choice([byte for byte in choices if byte != old])
    return content[:place] + bytes([new]) + content[place + 1 :]


def test_the_bundle_itself_is_sound(made: Made, tmp_path: Path) -> None:
    """And taking it apart and packing it again changes nothing: what fails below fails for what was changed."""
    again = made.forge(made.files)
    assert again == made.path.read_bytes()
    verdict = judge(tmp_path / "again.zip", again, made.genesis)
    assert isinstance(verdict, Verdict)
    assert {frame.status for frame in verdict.frames} == {"picture"}
    assert (len(verdict.visits), len(verdict.records), verdict.erasures) == (2, 3, 1)
    assert verdict.consents.history[-1].kind == "given"


def test_no_byte_is_changed_by_a_stranger_without_showing(made: Made, tmp_path: Path) -> None:
    draw, content = random.Random(SEED), made.path.read_bytes()
    places = [*range(40), *draw.sample(range(len(content)), 400), *range(len(content) - 60, len(content))]
    for place in places:
        assert isinstance(judge(tmp_path / "x.zip", changed(content, place, draw), made.genesis), BlockRobotError), (
            place
        )


def test_no_byte_is_changed_by_a_stranger_who_lists_the_files_anew(made: Made, tmp_path: Path) -> None:
    """The hashes are right then; the signatures are not."""
    draw, files = random.Random(SEED), made.files
    for name in files:
        if name in {layout.SIGNATURES, layout.MANIFEST}:
            continue
        spoilt = files | {name: changed(files[name], draw.randrange(len(files[name])), draw)}
        assert isinstance(judge(tmp_path / "x.zip", pack(list_anew(spoilt)), made.genesis), BlockRobotError), name


def test_no_byte_is_changed_by_its_maker_who_signs_anew(made: Made, tmp_path: Path) -> None:
    draw, files = random.Random(SEED), made.files
    for name, content in files.items():
        if name in {layout.SIGNATURES, layout.MANIFEST}:
            continue
        for place in draw.sample(range(len(content)), min(CHANGES_A_FILE_COUNT, len(content))):
            forged = made.forge(files | {name: changed(content, place, draw)})
            verdict = judge(tmp_path / "x.zip", forged, made.genesis)
            assert isinstance(verdict, BlockRobotError), (name, place)


@pytest.mark.long
@pytest.mark.timeout(3_000)
def test_no_byte_of_a_proof_picture_or_metadata_is_changed_by_its_maker(made: Made, tmp_path: Path) -> None:
    """Each tenth byte of what is small (every picture, every salt and leaf); all of them with an effort of ten."""
    draw, files = random.Random(SEED), made.files
    for name, content in files.items():
        if name in {layout.SIGNATURES, layout.MANIFEST, layout.SCHEMA, layout.README}:
            continue
        step = max(1, (230 if len(content) > 1_200 else EFFORT_OF_ALL) // EFFORT)
        for place in range(0, len(content), step):
            forged = made.forge(files | {name: changed(content, place, draw)})
            verdict = judge(tmp_path / "x.zip", forged, made.genesis)
            assert isinstance(verdict, BlockRobotError), (name, place)


def with_first_entry(manifest: doc.Manifest, **fields: object) -> doc.Manifest:
    first, *others = manifest.entries
    return msgspec.structs.replace(manifest, entries=[msgspec.structs.replace(first, **fields), *others])


def manifest_changes() -> dict[str, Callable[[doc.Manifest], doc.Manifest]]:
    def change(**fields: object) -> Callable[[doc.Manifest], doc.Manifest]:
        return lambda manifest: msgspec.structs.replace(manifest, **fields)

    return {
        "format": change(format="other"),
        "version": change(version=2),
        "network": change(network="other"),
        "chain_id": change(chain_id="00" * 32),
        "genesis_id": change(genesis_id="00" * 32),
        "entries": lambda manifest: msgspec.structs.replace(manifest, entries=manifest.entries[1:]),
        "more entries": lambda manifest: msgspec.structs.replace(manifest, entries=manifest.entries * 2),
        "the hash of an entry": lambda manifest: with_first_entry(manifest, sha256="00" * 32),
        "the size of an entry": lambda manifest: with_first_entry(manifest, size=0),
        "pictures": lambda manifest: msgspec.structs.replace(
            manifest, selection=msgspec.structs.replace(manifest.selection, pictures=False)
        ),
        "identity": lambda manifest: msgspec.structs.replace(
            manifest, selection=msgspec.structs.replace(manifest.selection, identity=False)
        ),
    }


@pytest.mark.parametrize("field", sorted(manifest_changes()))
def test_what_the_manifest_says_and_the_proofs_know_is_not_changed_by_its_maker(
    made: Made, tmp_path: Path, field: str
) -> None:
    manifest = msgspec.json.decode(made.files[layout.MANIFEST], type=doc.Manifest)
    files = made.files | {layout.MANIFEST: doc.write_document(manifest_changes()[field](manifest))}
    forged = pack(sign_anew(files, made.genesis, lambda key: made.keys[key]))
    assert isinstance(judge(tmp_path / "x.zip", forged, made.genesis), BlockRobotError)


def test_the_makers_own_word_is_called_her_word(made: Made, tmp_path: Path) -> None:
    """When it was made, what was asked for, what is missing and why: nothing proves it, and the verifier says so."""
    manifest = msgspec.json.decode(made.files[layout.MANIFEST], type=doc.Manifest)
    selection = msgspec.structs.replace(manifest.selection, purpose="audit", from_ms=5)
    words = {"created_at_ms": 1, "problems": [doc.Problem("", "NOT_FOUND", "So they say.")], "selection": selection}
    told = msgspec.structs.replace(manifest, **words)
    files = made.files | {layout.MANIFEST: doc.write_document(told)}
    forged = pack(sign_anew(files, made.genesis, lambda key: made.keys[key]))
    verdict = judge(tmp_path / "x.zip", forged, made.genesis)
    assert isinstance(verdict, Verdict)
    assert "the exporter's word" in unproved(verdict)[-1]


@pytest.mark.parametrize("case", ["none", "less", "swapped", "other", "twice"])
def test_signatures_are_of_all_visits_and_the_member_and_of_nobody_else(made: Made, tmp_path: Path, case: str) -> None:
    rows = msgspec.json.decode(made.files[layout.SIGNATURES], type=doc.Signatures).signatures
    other = doc.Signature(rows[0].key, rows[1].signature)
    cases = {
        "none": [],
        "less": rows[:-1],
        "swapped": rows[::-1],
        "other": [other, *rows[1:]],
        "twice": [*rows, rows[0]],
    }
    files = made.files | {layout.SIGNATURES: doc.write_document(doc.Signatures(cases[case]))}
    assert isinstance(judge(tmp_path / "x.zip", pack(files), made.genesis), BlockRobotError)


# The maker also makes everything anew that follows from the proofs


def rewrite(tmp_path: Path, contents: Contents) -> Verdict:
    return write_bundle(tmp_path / "rewritten.zip", contents)


def with_visit(contents: Contents, keep: Callable[[bytes], bool]) -> Contents:
    """The contents with only some of the proofs of the first visit."""
    first = contents.proofs.visits[0]
    snapshots = [
        doc.Snapshot(each.finality, [key for key in each.keys if keep(bytes.fromhex(key.key))])
        for each in first.snapshots
    ]
    visits = (doc.StateProofs([each for each in snapshots if each.keys]), *contents.proofs.visits[1:])
    return dataclasses.replace(contents, proofs=dataclasses.replace(contents.proofs, visits=visits))


def with_openings(contents: Contents, change: Callable[[doc.RecordOpening], doc.RecordOpening]) -> Contents:
    openings = doc.RecordOpenings([change(row) for row in contents.proofs.openings.records], [])
    return dataclasses.replace(contents, proofs=dataclasses.replace(contents.proofs, openings=openings))


def test_an_event_that_is_left_out_shows(made: Made, tmp_path: Path) -> None:
    (closing,) = [
        bytes.fromhex(key.key)
        for each in made.contents.proofs.visits[0].snapshots
        for key in each.keys
        if ENTRY.owns(bytes.fromhex(key.key)) and b"visit_closed" in bytes.fromhex(key.value or "")
    ]
    verdict = rewrite(tmp_path, with_visit(made.contents, lambda key: key != closing))
    assert [visit.is_whole for visit in verdict.visits] == [False, True]
    assert any("only a part" in line for line in unproved(verdict))


@pytest.mark.parametrize("rows", [COUNT, REQUEST, RECORD, RESTRICTION, VERDICT], ids=lambda rows: rows.name)
def test_what_the_trail_leads_to_cannot_be_left_out(made: Made, tmp_path: Path, rows: Rows[Any]) -> None:
    with pytest.raises(BlockRobotError):
        rewrite(tmp_path, with_visit(made.contents, lambda key: not rows.owns(key)))
    assert not (tmp_path / "rewritten.zip").exists()


def test_a_last_word_on_consent_that_is_left_out_shows(made: Made, tmp_path: Path) -> None:
    contents = dataclasses.replace(
        made.contents, proofs=dataclasses.replace(made.contents.proofs, receipts=doc.ReceiptProofs([]))
    )
    verdict = rewrite(tmp_path, contents)
    assert verdict.consents.last_word_height > 0
    assert any(f"in block {verdict.consents.last_word_height}" in line for line in unproved(verdict))


def lie(row: doc.RecordOpening, **fields: object) -> str:
    metadata = decode(bytes.fromhex(row.metadata), RecordMetadata)
    return encode(msgspec.structs.replace(metadata, **fields)).hex()


def test_metadata_is_what_the_robot_sealed_or_only_the_makers_word(made: Made, tmp_path: Path) -> None:
    def forge(row: doc.RecordOpening) -> doc.RecordOpening:
        return msgspec.structs.replace(row, metadata=lie(row, started_at_ms=0))

    with pytest.raises(BlockRobotError, match="not what the robot sealed"):
        rewrite(tmp_path, with_openings(made.contents, forge))
    told = with_openings(made.contents, lambda row: msgspec.structs.replace(forge(row), box_key=""))
    verdict = rewrite(tmp_path, told)
    assert not any(record.metadata_proved for record in verdict.records)
    assert any("2 records, which are the exporter's word" in line for line in unproved(verdict))


def test_an_impossible_place_in_a_visit_is_refused_before_anybody_counts_up_to_it(made: Made, tmp_path: Path) -> None:
    def forge(row: doc.RecordOpening) -> doc.RecordOpening:
        return msgspec.structs.replace(row, metadata=lie(row, index_in_visit=1 << 40), box_key="")

    with pytest.raises(BlockRobotError, match="impossible place"):
        rewrite(tmp_path, with_openings(made.contents, forge))


def test_a_picture_that_is_kept_back_shows(made: Made, tmp_path: Path) -> None:
    def keep_back(row: doc.RecordOpening) -> doc.RecordOpening:
        return msgspec.structs.replace(row, salts=["" for _ in row.salts])

    verdict = rewrite(tmp_path, with_openings(made.contents, keep_back))
    assert {frame.status for frame in verdict.frames} == {"absent"}
    assert any("3 pictures" in line for line in unproved(verdict))


def test_pictures_that_are_not_even_named_show(made: Made, tmp_path: Path) -> None:
    def leave_out(row: doc.RecordOpening) -> doc.RecordOpening:
        return msgspec.structs.replace(row, commitment_leaves=[], salts=[])

    line = "anything of the pictures of 2 records, which the bundle does not name"
    assert line in unproved(rewrite(tmp_path, with_openings(made.contents, leave_out)))
    whole = judge(tmp_path / "whole.zip", made.path.read_bytes(), made.genesis)
    assert isinstance(whole, Verdict)
    assert line not in unproved(whole)


@pytest.mark.parametrize("change", [{"commitment_leaves": []}, {"salts": []}, {"salts": ["00" * 32, "00" * 32]}])
def test_leaves_and_salts_belong_together(made: Made, tmp_path: Path, change: dict[str, object]) -> None:
    with pytest.raises(BlockRobotError):
        rewrite(tmp_path, with_openings(made.contents, lambda row: msgspec.structs.replace(row, **change)))


def test_an_opening_of_a_record_that_nothing_proves_is_refused(made: Made, tmp_path: Path) -> None:
    rows = made.contents.proofs.openings.records
    more = doc.RecordOpenings([*rows, msgspec.structs.replace(rows[0], record_id="00" * 16)], [])
    proofs = dataclasses.replace(made.contents.proofs, openings=more)
    with pytest.raises(BlockRobotError, match="does not tell of"):
        rewrite(tmp_path, dataclasses.replace(made.contents, proofs=proofs))
