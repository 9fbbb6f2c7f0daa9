"""The demonstration's checks and report: a failure is never silent, and nothing secret is shown."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace

from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.recording.frame_answers import FrameCounts, Latency, RunLatencies
from clients.sdk.pictures.picture_names import name_picture
from clients.wallet.answers.record_answers import AuditEvent
from consensus.errors import BlockRobotError
from network.demo.checks import Check, CheckList
from network.demo.leader_kill import LeaderKill
from network.demo.processes import parse_answer
from network.demo.report import PICTURES_A_PERSON_COUNT, build_summary, write_report
from network.demo.story import DemoState, what_is_left
from network.demo.words import REASONS, events_text, name_person, refusal_text
from tests.unit.clients.robot.run_summaries import summary_of

FRAMES = FrameCounts(published=10, covered=10, kept=7, withheld=3, withheld_reasons={"no-silhouette": 3}, lost=0)


def happened(**fields: Any) -> AuditEvent:
    return AuditEvent(visit="", index=0, records=[], time_ms=0, detail="", **fields)


def checks(*held: bool) -> CheckList:
    found = CheckList(listener=lambda check: None)
    for number, ok in enumerate(held):
        found.add(f"check {number}", ok=ok, detail=f"seen {number}")
    return found


def state(tmp_path: Path) -> DemoState:
    pictures, zero = [], Latency(p50=0.0, p95=0.0, max=0.0)
    none = dict.fromkeys(("decided_to_final", "arrival_to_final", "submit_to_final"), zero)
    for number in range(10):
        path = tmp_path / name_picture(number % 4, number, "png")
        path.write_bytes(b"PNG" + bytes([number]))
        pictures.append(path)
    return DemoState(
        summary=replace(
            summary_of(FRAMES), latency_ms=RunLatencies(frame_to_final=Latency(p50=12.5, p95=40.0, max=41.0), **none)
        ),
        kill=LeaderKill(name="node-2", finalized_height_before=5, gap_s=0.9, caught_up=True, catch_up_s=1.0),
        pictures={"patient-a": pictures, "patient-b": []},
        audit=[
            happened(height=3, kind="visit_opened", record_id=""),
            happened(height=4, kind="<script>", record_id="ab" * 16),
        ],
        blocks=77,
        transactions=12,
    )


def test_no_checks_at_all_is_not_a_success() -> None:
    assert not checks().ok


@pytest.mark.parametrize("failing", [0, 1, 2])
def test_one_check_that_failed_fails_the_whole(failing: int) -> None:
    held = [True, True, True]
    assert checks(*held).ok
    held[failing] = False
    assert not checks(*held).ok


def test_each_check_is_told_as_it_is_made_and_its_outcome_returned() -> None:
    told: list[Check] = []
    found = CheckList(listener=told.append)
    assert found.add("first", ok=True, detail="yes")
    assert not found.add("second", ok=False, detail="no")
    assert told == found.checks == [Check("first", True, "yes"), Check("second", False, "no")]


def test_the_summary_says_what_was_checked_and_measured(tmp_path: Path) -> None:
    summary = build_summary(checks(True), state(tmp_path), nodes=4, store="sqlite", out=tmp_path)
    assert summary.ok is True
    assert summary.checks == [Check(name="check 0", ok=True, detail="seen 0")]
    assert summary.frames is not None
    assert (summary.frames.kept, summary.blocks, summary.leader_kill_gap_s) == (7, 77, 0.9)


def test_a_password_in_the_stores_address_is_not_in_the_summary(tmp_path: Path) -> None:
    store = "mongodb://ann:secret@db.example:27017"
    summary = build_summary(checks(True), state(tmp_path), nodes=4, store=store, out=tmp_path)
    assert b"secret" not in msgspec.json.encode(summary)
    assert summary.store == "mongodb"


def test_a_run_that_broke_off_early_still_has_a_report(tmp_path: Path) -> None:
    summary = build_summary(checks(False), DemoState(), nodes=4, store="sqlite", out=tmp_path)
    write_report(tmp_path, summary, DemoState())
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Not every check held." in page
    assert "FAILED" in page
    assert "There are no pictures." in page


def test_the_report_holds_its_pictures_and_escapes_what_it_tells(tmp_path: Path) -> None:
    known = state(tmp_path)
    summary = build_summary(checks(True, True), known, nodes=4, store="sqlite", out=tmp_path)
    write_report(tmp_path, summary, known)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == PICTURES_A_PERSON_COUNT
    assert "patient A, frame 0" in page
    assert "<script>" not in page
    assert "&lt;script&gt;" in page
    assert "Every check held." in page
    assert json.loads((tmp_path / "summary.json").read_text(encoding="utf-8")) == msgspec.to_builtins(summary)


def test_the_report_loads_nothing_from_elsewhere(tmp_path: Path) -> None:
    known = state(tmp_path)
    write_report(tmp_path, build_summary(checks(True), known, nodes=4, store="sqlite", out=tmp_path), known)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "http://" not in page
    assert "https://" not in page


class Numbered(msgspec.Struct):
    n: int


def test_a_childs_answer_is_its_json() -> None:
    assert parse_answer(b'{"ok": true, "n": 1}', b"", ["wallet"], Numbered) == Numbered(1)


def test_a_childs_refusal_is_raised_with_its_code() -> None:
    answer = json.dumps({"ok": False, "error": {"code": "NOT_FOUND", "detail": "You have no record."}}).encode()
    with pytest.raises(BlockRobotError) as caught:
        parse_answer(answer, b"", ["wallet", "view"], Numbered)
    assert (caught.value.code, caught.value.detail) == ("NOT_FOUND", "You have no record.")


@pytest.mark.parametrize("output", [b"", b"Traceback", b"[]", b'"text"', b"7"])
def test_a_child_that_says_nothing_readable_is_a_fault_that_names_it(output: bytes) -> None:
    with pytest.raises(BlockRobotError) as caught:
        parse_answer(output, b"first\nlast line\n", ["wallet", "view"], Numbered)
    assert caught.value.code == "INTERNAL"
    assert "wallet view" in caught.value.detail
    assert "last line" in caught.value.detail


def test_the_report_says_in_words_what_programs_name_by_codes(tmp_path: Path) -> None:
    known = state(tmp_path)
    summary = build_summary(checks(True), known, nodes=4, store="sqlite", out=tmp_path)
    write_report(tmp_path, summary, known)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    for words in (
        "3: they were near, but not in the picture",
        "half within 12.5, 95 of 100 within 40.0",
        "the robot met them",
    ):
        assert words in page
    for code in ("no-silhouette", "p50", "visit_opened", "withheld_reasons", "patient-a"):
        assert code not in page


def test_every_reason_and_kind_of_event_has_its_words() -> None:
    assert set(REASONS) == set(WithholdReason)
    assert refusal_text("RECORD_NOT_FOUND") == "“You have no such record” (RECORD_NOT_FOUND)"
    assert (refusal_text(None), refusal_text("NEW_CODE")) == ("with the record", "“refused” (NEW_CODE)")
    assert events_text(["recorded", "recorded", "unheard_of"]) == "recorded, unheard_of"
    assert [name_person(alias) for alias in ("patient-a", "visitor-1")] == ["patient A", "visitor-1"]


def test_pictures_that_do_not_open_are_accounted_for() -> None:
    assert what_is_left(["erased", "erased", *["ok"] * 13]) == "13 of 15 still open"
    left = what_is_left(["erased", "erased", "corrupted", *["ok"] * 12])
    assert left == "12 of 15 still open, 1 is the one whose byte was changed before"
