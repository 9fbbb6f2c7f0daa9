"""Exporting: what goes along, what is left out on purpose, and that whatever cannot be had is named, never silent."""

from __future__ import annotations

import json
import re
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from clients.bundle import documents, layout
from clients.bundle.checks.bundle_check import Verdict, unproved, verify_bundle
from clients.bundle.cli import verify
from clients.bundle.document_building import open_corrections
from clients.bundle.documents import read_document
from clients.bundle.writing import write_bundle
from clients.wallet.export import export_building as exporting_module
from clients.wallet.export.export_building import ExportChoice, Exporter
from clients.wallet.records.rights_requests import RecordChoice, Rights
from clients.wallet.records.viewing import RecordViewer
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.envelopes import open_data_key
from consensus.records.renditions import Rendition
from tests.miscounting_robot import miscounting
from tests.unit.clients.bundle.conftest import NOW_MS, collect
from tests.world.ward import HEIGHT, WIDTH, Ward


async def export(ward: Ward, path: Path, wanted: ExportChoice | None = None, *, now_ms: int = NOW_MS) -> Verdict:
    return write_bundle(path, await collect(ward, wanted, now_ms))


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def problem_codes(verdict: Verdict) -> list[tuple[str, str]]:
    return [(problem.record_id, problem.code) for problem in verdict.manifest.problems]


async def test_everything_goes_along_and_a_stranger_can_check_it(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    ids = [ward.record(visit) for _ in range(3)]
    ward.close_visit(visit)
    verdict = await export(ward, tmp_path / "mine.zip")
    assert verify_bundle(tmp_path / "mine.zip", ward.genesis).is_anchored
    assert [record.record_id for record in verdict.records] == [record_id.hex() for record_id in ids]
    assert all(record.metadata_proved for record in verdict.records)
    assert [frame.status for frame in verdict.frames] == ["picture"] * 6
    assert verdict.manifest.problems == []
    with zipfile.ZipFile(tmp_path / "mine.zip") as packed:
        told = json.loads(packed.read("data/visits.json"))
        pictures = [name for name in packed.namelist() if name.startswith("pictures/")]
        page = packed.read("play.html").decode()
    assert told["visits"][0]["missing"] == 0
    assert pictures == sorted(pictures)
    assert len(pictures) == 6
    places = [page.index(name) for name in pictures]
    assert places == sorted(places)


async def test_access_is_asked_for_on_the_chain_with_a_purpose_and_stands_in_the_bundle(
    ward: Ward, tmp_path: Path
) -> None:
    visit = ward.open_visit()
    record_id = ward.record(visit)
    await export(ward, tmp_path / "mine.zip", ExportChoice(purpose="complaint"))
    with zipfile.ZipFile(tmp_path / "mine.zip") as packed:
        (access,) = json.loads(packed.read("data/access.json"))["accesses"]
        kinds = [entry["kind"] for entry in json.loads(packed.read("data/audit.json"))["entries"]]
    assert (access["purpose"], access["records"], access["owner"]) == (
        "complaint",
        [record_id.hex()],
        visit.owner.hex(),
    )
    assert kinds == ["visit_opened", "recorded", "access_requested"]


async def test_looking_what_there_is_asks_for_nothing(ward: Ward) -> None:
    ward.record(ward.open_visit())
    height = ward.chain.height
    plan = await Exporter(ward.wallet).plan(ExportChoice())
    assert (plan.record_count, ward.chain.height) == (1, height)


async def test_two_visits_are_never_asked_for_in_one_session(ward: Ward, tmp_path: Path) -> None:
    visits = [ward.open_visit(), ward.open_visit()]
    for visit in visits:
        ward.record(visit)
    await export(ward, tmp_path / "mine.zip")
    for visit in visits:
        askers = {key for flat, key in ward.network.asked if visit.owner in flat}
        assert askers == {visit.owner}


async def test_visits_are_asked_for_after_pauses_and_not_side_by_side(ward: Ward, tmp_path: Path) -> None:
    """Whoever reads the ledger could join them by time; `at_once` is the user's own choice."""
    for _ in range(4):
        ward.record(ward.open_visit())
    pauses: list[float] = []

    async def sleep(seconds: float) -> None:
        pauses.append(seconds)

    exporting = Exporter(ward.wallet, viewing=RecordViewer(ward.wallet, follow_max_ms=0), sleep=sleep)
    contents = await exporting.collect(await exporting.plan(ExportChoice()), NOW_MS)
    assert len(pauses) == 3
    assert all(0 <= pause < exporting_module.SPREAD_MAX_MS / 1000 for pause in pauses)
    verdict = write_bundle(tmp_path / "mine.zip", contents)
    assert [visit.number for visit in verdict.visits] == [1, 2, 3, 4]


async def test_equal_contents_make_equal_bytes_apart_from_the_stated_time(ward: Ward, tmp_path: Path) -> None:
    ward.record(ward.open_visit())
    contents = await collect(ward)
    for name in ("one.zip", "two.zip"):
        write_bundle(tmp_path / name, contents)
    assert (tmp_path / "one.zip").read_bytes() == (tmp_path / "two.zip").read_bytes()
    quiet = ExportChoice(pictures=False)
    await export(ward, tmp_path / "then.zip", quiet)
    await export(ward, tmp_path / "later.zip", quiet, now_ms=NOW_MS + 1)
    with zipfile.ZipFile(tmp_path / "then.zip") as then, zipfile.ZipFile(tmp_path / "later.zip") as later:
        differing = [name for name in then.namelist() if then.read(name) != later.read(name)]
    assert differing == ["manifest.json", "signatures.json"]


async def test_no_key_of_the_wallet_is_in_a_bundle(ward: Ward, tmp_path: Path) -> None:
    """Neither as bytes nor as text: words, the four private keys, the visits' keys, the pictures' data keys."""
    visit = ward.open_visit()
    ward.record(visit)
    await export(ward, tmp_path / "mine.zip")
    keys = ward.wallet.keys
    secrets = [keys.identity.secret, keys.spend.secret, keys.view.secret, keys.sealing]
    secrets.append((await ward.owner_key(visit.owner)).secret)
    content = (tmp_path / "mine.zip").read_bytes()
    for secret in secrets:
        assert secret not in content
        assert secret.hex().encode() not in content
    assert ward.wallet.store.content.words.encode() not in content
    for clip in ward.network.custody.clips.values():
        for frame in clip.frames:
            data_key = open_data_key(keys.sealing, frame.sealed_key)
            assert data_key.hex().encode() not in content


# What is left out on purpose


async def test_without_identity_nothing_names_the_member(ward: Ward, tmp_path: Path) -> None:
    ward.record(ward.open_visit())
    verdict = await export(ward, tmp_path / "mine.zip", ExportChoice(identity=False))
    content = (tmp_path / "mine.zip").read_bytes()
    keys = ward.wallet.keys
    for public in (keys.identity.public_key, ward.patient.handle, keys.sealing_public, keys.view.public_key):
        assert public.hex().encode() not in content
    assert verdict.consents.member == ""
    assert not any(record.metadata_proved for record in verdict.records)
    assert [frame.status for frame in verdict.frames] == ["picture", "picture"]
    assert any("exporter's word" in line for line in unproved(verdict))


async def test_without_pictures_nothing_is_asked_for(ward: Ward, tmp_path: Path) -> None:
    ward.record(ward.open_visit())
    height = ward.chain.height
    verdict = await export(ward, tmp_path / "mine.zip", ExportChoice(pictures=False))
    assert ward.chain.height == height
    assert (len(verdict.records), verdict.frames, verdict.accesses) == (1, [], 0)
    assert verdict.records[0].metadata_proved


async def test_chosen_records_go_along_and_the_others_are_not_told_of(ward: Ward, tmp_path: Path) -> None:
    visit, other = ward.open_visit(), ward.open_visit()
    ids = [ward.record(visit) for _ in range(3)]
    ward.record(other)
    verdict = await export(ward, tmp_path / "mine.zip", ExportChoice(records=(ids[1],)))
    content = (tmp_path / "mine.zip").read_bytes()
    assert [record.record_id for record in verdict.records] == [ids[1].hex()]
    assert ids[0].hex().encode() not in content
    assert other.owner.hex().encode() not in content
    assert [visit.is_whole for visit in verdict.visits] == [False]


async def test_one_visit_and_one_record_are_told_in_the_singular(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    chosen = ward.record(visit, frames=1)
    ward.record(visit)
    ward.close_visit(visit)
    await export(ward, tmp_path / "one.zip", ExportChoice(records=(chosen,)))
    told = CliRunner().invoke(verify, [str(tmp_path / "one.zip")])
    assert told.exit_code == 0, told.output
    said = " ".join(told.output.split())
    assert "1 visit with 1 record is on the ledger as told, and the record opened as the robot sealed it" in said
    assert "nothing else happened in 1 visit of which" in said
    assert "(1 signature)" in said or "(2 signatures)" in said
    plurals = {"visits", "records", "pictures", "events", "requests", "erasures", "signatures", "words", "epochs"}
    assert not plurals.intersection(re.findall(r"(?<![\d.])1 (\w+)", said)), said


async def test_a_span_of_time_chooses_by_when_it_was_recorded(ward: Ward, tmp_path: Path) -> None:
    first = ward.open_visit()
    early = ward.record(first)
    ward.chain.time_ms += 3_600_000
    middle_ms = ward.chain.time_ms - 1_800_000
    late = ward.record(ward.open_visit())
    after = await export(ward, tmp_path / "after.zip", ExportChoice(from_ms=middle_ms))
    before = await export(ward, tmp_path / "before.zip", ExportChoice(until_ms=middle_ms))
    assert [record.record_id for record in after.records] == [late.hex()]
    assert [record.record_id for record in before.records] == [early.hex()]


async def test_a_record_of_somebody_else_and_an_empty_choice_are_told(ward: Ward) -> None:
    ward.record(ward.open_visit())
    for wanted in (ExportChoice(records=(bytes(16),)), ExportChoice(from_ms=NOW_MS)):
        with pytest.raises(BlockRobotError, match=r"^RECORD_NOT_FOUND:"):
            await Exporter(ward.wallet).plan(wanted)


async def test_a_person_of_whom_nothing_was_recorded_takes_her_consents_along(ward: Ward, tmp_path: Path) -> None:
    verdict = await export(ward, tmp_path / "mine.zip")
    assert verdict.visits == ()
    assert [choice.purpose for choice in verdict.consents.choices] == ["care", "demo"]


async def test_the_history_of_consent_comes_with_its_receipts(ward: Ward, tmp_path: Path) -> None:
    handle, key = ward.patient.handle, ward.patient.identity
    stranger = ward.chain.enrol("stranger")
    ward.chain.must(key, "consent", "give", handle, ["care"], ["rgb"], 0, 0, 0, ward.chain.height)
    ward.chain.must(stranger.identity, "consent", "withdraw", stranger.handle, [], [])
    ward.chain.must(key, "consent", "refuse", handle, ["research"], [])
    ward.chain.must(key, "consent", "withdraw", handle, [], [])
    verdict = await export(ward, tmp_path / "mine.zip")
    assert [word.kind for word in verdict.consents.history] == ["given", "refused", "withdrawn"]
    assert verdict.consents.last_word_height == verdict.consents.history[-1].height
    assert not any("in block" in line for line in unproved(verdict))


async def test_words_by_a_mandate_are_named_so_and_are_nobodys_own(ward: Ward, tmp_path: Path) -> None:
    """She acts for a child, and somebody acts for her later: neither is told as what she said herself."""
    chain, handle, key = ward.chain, ward.patient.handle, ward.patient.identity
    eva, other, child = (
        chain.enrol(name, role) for name, role in (("e", "officer"), ("o", "officer"), ("c", "subject"))
    )
    until_ms = chain.bucket() + 86_400_000

    def give_mandate(represented: bytes, representative: bytes, connection_acceptor: PrivateKey) -> bytes:
        arguments = [represented, representative, bytes(32), ["consent"], until_ms]
        mandate_id = chain.must(eva.identity, "mandates", "propose", *arguments).txid
        chain.must(other.identity, "mandates", "approve", mandate_id)
        chain.must(connection_acceptor, "mandates", "accept", mandate_id)
        return mandate_id

    own = give_mandate(child.handle, handle, key)
    chain.must(key, "consent", "give", child.handle, ["care"], ["depth"], 0, until_ms, 0, chain.height)
    chain.must(key, "mandates", "end", own)
    mandate_id = give_mandate(handle, child.handle, child.identity)
    chain.must(child.identity, "consent", "give", handle, ["care"], ["rgb"], 0, until_ms, 0, chain.height)
    verdict = await export(ward, tmp_path / "mine.zip")
    assert verdict.consents.history == []
    told = {(choice.purpose, choice.sensor): choice.steps[-1].mandate for choice in verdict.consents.choices}
    assert told == {("care", "depth"): "", ("demo", "depth"): "", ("care", "rgb"): mandate_id.hex()}


# What cannot be had


async def test_a_record_that_no_custodian_gives_is_named_and_the_others_are_there(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    away, there = ward.record(visit), ward.record(visit)
    ward.network.custody.refusals[away] = "NODE_UNREACHABLE"
    verdict = await export(ward, tmp_path / "mine.zip")
    assert problem_codes(verdict) == [(away.hex(), "NODE_UNREACHABLE")]
    frames = {record.record_id: [frame.status for frame in record.frames] for record in verdict.records}
    assert frames == {away.hex(): [], there.hex(): ["picture", "picture"]}


async def test_a_picture_that_was_changed_is_named_and_the_others_are_there(ward: Ward, tmp_path: Path) -> None:
    record_id = ward.record(ward.open_visit(), frames=3)
    ward.spoil(record_id, 1)
    verdict = await export(ward, tmp_path / "mine.zip")
    assert problem_codes(verdict) == [(record_id.hex(), "RENDITION_CORRUPTED")]
    assert [frame.status for frame in verdict.frames] == ["picture", "absent", "picture"]
    assert any("of 1 picture" in line for line in unproved(verdict))


async def test_a_record_that_its_robot_miscounted_is_named_and_its_pictures_are_there(
    ward: Ward, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    miscounting(monkeypatch, 5)
    record_id = ward.record(ward.open_visit(), frames=1)
    verdict = await export(ward, tmp_path / "mine.zip")
    assert problem_codes(verdict) == [(record_id.hex(), "FRAMES_MISCOUNTED")]
    (problem,) = verdict.manifest.problems
    assert "5 by the robot's own count, 1 that it committed to" in problem.sentence
    assert [frame.status for frame in verdict.frames] == ["picture"]
    assert any(line.startswith("which pictures 1 record should hold") for line in unproved(verdict))


async def test_erased_records_and_frames_are_told_with_their_receipts(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    whole, part = ward.record(visit), ward.record(visit, frames=3)
    await ward.erase(visit, [whole])
    await ward.erase(visit, [part], [1])
    clip = ward.network.custody.clips[part]
    frames = list(clip.frames)
    frames[1] = msgspec.structs.replace(frames[1], erased=True, ciphertext=b"", sealed_key=b"")
    ward.network.custody.clips[part] = msgspec.structs.replace(clip, frames=frames)
    verdict = await export(ward, tmp_path / "mine.zip")
    statuses = {record.record_id: record.status for record in verdict.records}
    assert statuses == {whole.hex(): "erased", part.hex(): "active"}
    assert [frame.status for frame in verdict.frames] == ["picture", "erased", "picture"]
    with zipfile.ZipFile(tmp_path / "mine.zip") as packed:
        page = packed.read("play.html").decode()
    (listed,) = re.findall(r"const visits = (.*);", page)
    (names,) = re.findall(r"const custodians = (.*);", page)
    custodians = ward.genesis.custodians
    assert json.loads(names) == {each.custodian_key.hex(): f"{each.name} of {each.organisation}" for each in custodians}
    (played,) = json.loads(listed)
    told = {(name == "", record, index) for name, _, record, index in played["pictures"]}
    assert {(True, whole.hex(), -1), (True, part.hex(), 1), (False, part.hex(), 0)} <= told
    assert [len(each["receipts"]) for each in played["erasures"]] == [2, 2]
    assert (verdict.erasures, verdict.visits[0].missing, verdict.manifest.problems) == (2, 0, [])
    with zipfile.ZipFile(tmp_path / "mine.zip") as packed:
        erasures = json.loads(packed.read("data/erasures.json"))["erasures"]
    assert [len(erasure["receipts"]) for erasure in erasures] == [2, 2]
    assert {receipt["remains"] for erasure in erasures for receipt in erasure["receipts"]} == {"backups of the host"}


async def test_a_record_that_is_erased_while_the_export_runs_is_left_out_and_named(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    gone, kept = ward.record(visit), ward.record(visit)
    key = await ward.owner_key(visit.owner)
    exporting = Exporter(ward.wallet, viewing=RecordViewer(ward.wallet, follow_max_ms=0), at_once=True)
    plan = await exporting.plan(ExportChoice())
    pending = [gone]

    def erase() -> None:
        while pending:
            receipt = ward.chain.must(key, "erasure", "request", [pending.pop()], [])
            ward.chain.receipts_of_all(receipt.txid)

    ward.network.before_proofs = erase
    verdict = write_bundle(tmp_path / "mine.zip", await exporting.collect(plan, NOW_MS))
    assert problem_codes(verdict) == [(gone.hex(), "CLIP_ERASED")]
    shown = {record.record_id: len(record.frames) for record in verdict.records}
    assert shown == {gone.hex(): 0, kept.hex(): 2}
    assert verdict.erasures in {0, 1}, "the trail may have been read before"


async def test_an_access_that_the_chain_refuses_for_one_record_keeps_back_no_other(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    gone, kept = ward.record(visit), ward.record(visit)
    exporting = Exporter(ward.wallet, viewing=RecordViewer(ward.wallet, follow_max_ms=0), at_once=True)
    plan = await exporting.plan(ExportChoice())
    await ward.erase(visit, [gone])
    verdict = write_bundle(tmp_path / "mine.zip", await exporting.collect(plan, NOW_MS))
    assert {code for record_id, code in problem_codes(verdict) if record_id == gone.hex()} >= {"CALL_REFUSED"}
    assert {record.record_id: len(record.frames) for record in verdict.records}[kept.hex()] == 2


async def test_an_empty_room_that_nobody_has_leaves_the_person_alone_in_her_pictures(
    ward: Ward, tmp_path: Path
) -> None:
    ward.record(ward.open_visit())
    ward.network.custody.rooms.clear()
    verdict = await export(ward, tmp_path / "mine.zip")
    assert problem_codes(verdict) == [("", "EMPTY_FRAME_WITHDRAWN")]
    assert [name.split("/")[0] for frame in verdict.frames for name in frame.files] == ["depth", "depth"]


async def test_a_frame_that_is_committed_to_and_cannot_be_drawn_goes_along_as_it_is(ward: Ward, tmp_path: Path) -> None:
    broken = msgspec.structs.replace(ward.rendition(), pixels=b"no picture")
    ward.record(ward.open_visit(), renditions=[broken, ward.rendition()])
    verdict = await export(ward, tmp_path / "mine.zip")
    assert [frame.status for frame in verdict.frames] == ["undrawable", "picture"]
    assert any("cannot be shown" in line for line in unproved(verdict))


async def test_a_hole_in_a_visit_is_counted_by_the_reader_too(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    ward.record(visit)
    visit.record_count += 2
    ward.close_visit(visit)
    verdict = await export(ward, tmp_path / "mine.zip")
    assert verdict.visits[0].missing == 2
    assert any("2 records that the robot numbered" in line for line in unproved(verdict))


async def test_more_pictures_than_a_bundle_takes_are_refused_and_nothing_is_written(
    ward: Ward, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward.record(ward.open_visit())
    monkeypatch.setattr(exporting_module, "HELD_MAX_BYTES", 200)
    before = names(tmp_path)
    with pytest.raises(BlockRobotError, match=r"^EXPORT_TOO_LARGE:"):
        await export(ward, tmp_path / "mine.zip")
    assert names(tmp_path) == before


async def test_other_senses_go_along_as_files_of_their_own(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    label = Rendition(1, 5, 7, 1, 1, 0, 0, 0, 0, bytes(32), "label", b'{"label": "calm"}')
    colour = Rendition(1, 5, 8, WIDTH, HEIGHT, 1, 2, 3, 4, bytes(32), "png-rgba", colour_png())
    ward.record(visit, renditions=[label], sensor="emotion")
    ward.record(visit, renditions=[colour], sensor="rgb")
    ward.record(visit, renditions=[msgspec.structs.replace(ward.rendition(), pixels=b"")], sensor="notice")
    verdict = await export(ward, tmp_path / "mine.zip")
    files = [frame.files for frame in verdict.frames]
    assert files == [["labels/0001/00001-00.label.json"], ["pictures/0001/00002-00.rgb.png"], []]
    assert [frame.status for frame in verdict.frames] == ["picture", "picture", "notice"]
    assert [record.sensor for record in verdict.records] == ["emotion", "rgb", "notice"]


def colour_png() -> bytes:
    done, data = cv2.imencode(".png", np.full((4, 3, 4), 200, dtype=np.uint8))
    assert done
    return data.tobytes()


async def test_restrictions_and_corrections_go_along_with_what_they_say(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    record_id = ward.record(visit)
    (known,) = await ward.wallet.scan()
    said, _ = await Rights(ward.wallet).correct(RecordChoice(known), "attribution", "That is my sister.")
    await Rights(ward.wallet).restrict(RecordChoice(known), "accuracy")
    assert said.visit.owner == visit.owner
    await export(ward, tmp_path / "mine.zip")
    with zipfile.ZipFile(tmp_path / "mine.zip") as packed:
        (rights,) = json.loads(packed.read("data/rights.json"))["visits"]
        openings = read_document(layout.RECORD_OPENINGS, packed.read(layout.RECORD_OPENINGS), documents.RecordOpenings)
    assert [row["text"] for row in rights["corrections"]] == ["That is my sister."]
    assert rights["restriction"]["ground"] == "accuracy"
    await export(ward, tmp_path / "unnamed.zip", ExportChoice(records=(record_id,), identity=False))
    assert b"my sister" not in (tmp_path / "unnamed.zip").read_bytes()
    lie = msgspec.structs.replace(openings.corrections[0], text="That is my brother.")
    facts = SimpleNamespace(owner=visit.owner, corrections=[SimpleNamespace(commitment=said_commitment(rights))])
    assert open_corrections([facts], openings.corrections)
    for rows in ([lie], openings.corrections * 2, [msgspec.structs.replace(lie, visit="00")]):
        with pytest.raises(BlockRobotError):
            open_corrections([facts], rows)


def said_commitment(rights: dict[str, Any]) -> bytes:
    return bytes.fromhex(rights["corrections"][0]["commitment"])
