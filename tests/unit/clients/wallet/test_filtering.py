"""`wallet records`: by day, time of day, robot and sensor, a page at a time, in two languages, for people and programs."""

from __future__ import annotations

import datetime
import json
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import msgspec
import pytest
from click.testing import CliRunner, Result

from clients.robot.recording.sealing import ClipContent, seal_clip
from clients.wallet.cli import filter_options
from clients.wallet.cli.filter_options import read_days, read_filter, read_minutes
from clients.wallet.cli.main import wallet
from clients.wallet.commands import records_commands
from clients.wallet.ledger.record_filter import Filter, choose_records, refuse_erased, select
from clients.wallet.ledger.wallet import RecordEntry, VisitReport, Wallet
from clients.wallet.presentation.translations import LANGUAGES
from clients.wallet.store.keystore import KnownVisit
from clients.wallet.text_catalogue import load
from consensus.errors import BlockRobotError
from consensus.records.metadata import NOTICE_SENSOR, RecordMetadata
from consensus.state.records import RecordRow
from tests.json_answers import differences
from tests.world.commands import open_for_commands
from tests.world.dicts import NOW_MS, World, rendition

TODAY = datetime.date(2027, 1, 31)


def at(text: str) -> int:
    return round(datetime.datetime.fromisoformat(text).astimezone().timestamp() * 1000)


def entry(moment: str, number: int = 0, *, robot: bytes = b"\x0a" * 33, sensor: str = "depth") -> RecordEntry:
    began = at(moment)
    return RecordEntry(
        record_id=number.to_bytes(16, "big"),
        visit=KnownVisit(owner=bytes(33), ephemeral=bytes(33), robot=robot, sequence=0, bucket_ms=0),
        state=RecordRow(bytes(33), robot, b"", b"", b"", began, began, 1, bytes(32), "active", [], []),
        metadata=RecordMetadata(sensor, began, began, 1, number, bytes(32), (), 64, 48),
    )


def visit(*records: RecordEntry, missing: int = 0, unreadable: tuple[bytes, ...] = ()) -> VisitReport:
    known = records[0].visit if records else entry("2027-01-01").visit
    return VisitReport(known, records, (), closed=True, missing_count=missing, unreadable_ids=unreadable)


@pytest.mark.parametrize(
    ("written", "first", "last"),
    [
        ("today", TODAY, TODAY),
        ("yesterday", datetime.date(2027, 1, 30), datetime.date(2027, 1, 30)),
        ("2027-01-02", datetime.date(2027, 1, 2), datetime.date(2027, 1, 2)),
        ("2027-01-02..today", datetime.date(2027, 1, 2), TODAY),
    ],
)
def test_a_day_is_named_or_a_span_of_days(written: str, first: datetime.date, last: datetime.date) -> None:
    assert read_days(written, TODAY) == (first, last)


@pytest.mark.parametrize("written", ["", "tomorrow", "31.1.2027", "2027-02-30", "today..yesterday", "..", "a..b"])
def test_what_is_no_day_is_wrong_usage(written: str) -> None:
    with pytest.raises(click.UsageError):
        read_days(written, TODAY)


@pytest.mark.parametrize("written", ["noon", "9-12", "25:00-26:00", "09:00-09:00", "09:70-10:00", "09:00"])
def test_what_is_no_time_of_day_is_wrong_usage(written: str) -> None:
    with pytest.raises(click.UsageError):
        read_minutes(written)


def test_a_sensor_that_is_none_is_named() -> None:
    with pytest.raises(BlockRobotError, match="SENSOR_UNKNOWN"):
        read_filter(None, None, (), ("lidar",), TODAY)


@pytest.mark.parametrize(
    ("wanted", "moment", "taken"),
    [
        (Filter(days=(str(TODAY), str(TODAY))), "2027-01-31T00:00", True),
        (Filter(days=(str(TODAY), str(TODAY))), "2027-01-31T23:59:59", True),
        (Filter(days=(str(TODAY), str(TODAY))), "2027-02-01T00:00", False),
        (Filter(minutes=(540, 750)), "2027-01-31T09:00", True),
        (Filter(minutes=(540, 750)), "2027-01-31T12:30", False),
        (Filter(minutes=(1320, 360)), "2027-01-31T23:00", True),
        (Filter(minutes=(1320, 360)), "2027-01-31T05:59", True),
        (Filter(minutes=(1320, 360)), "2027-01-31T06:00", False),
        (Filter(robots=("0a0a",)), "2027-01-31", True),
        (Filter(robots=("0b", "0a")), "2027-01-31", True),
        (Filter(robots=("0b",)), "2027-01-31", False),
        (Filter(sensors=("rgb",)), "2027-01-31", False),
        (Filter(sensors=("rgb", "depth")), "2027-01-31", True),
        (Filter(), "1999-01-01", True),
    ],
)
def test_a_record_fits_by_when_it_began_where_and_how(wanted: Filter, moment: str, taken: bool) -> None:
    assert wanted.takes(entry(moment)) is taken


def test_a_visit_of_which_something_is_missing_is_shown_whatever_is_asked_for() -> None:
    reports = [
        visit(entry("2027-01-30")),
        visit(entry("2027-01-29"), missing=2),
        visit(unreadable=(b"x",)),
        visit(entry("2027-01-31")),
    ]
    page = select(reports, Filter(days=(str(TODAY), str(TODAY))))
    assert [shown.number for shown in page.visits] == [2, 3, 4]
    assert (page.matching_count, page.records_count, page.shown_count) == (1, 3, 1)


def test_pages_hold_every_record_once_in_order_and_visits_keep_their_numbers() -> None:
    entries = [entry("2027-01-31", number) for number in range(5000)]
    reports = [visit(), visit(*entries[:30]), visit(*entries[30:])]
    pages = [select(reports, Filter(), number, 50) for number in range(1, 102)]
    found = [each for page in pages for shown in page.visits for each in shown.records]
    assert found == entries
    assert {page.pages_count for page in pages} == {101}
    assert [shown.number for shown in pages[0].visits] == [1, 2, 3]
    beyond = select(reports, Filter(), 102, 50)
    assert (beyond.visits, beyond.pages_count) == ((), 101)


def test_an_empty_history_is_one_empty_page() -> None:
    page = select([], Filter(), 1, 50)
    assert (page.visits, page.pages_count, page.matching_count) == ((), 1, 0)


# As people call it


@pytest.fixture
def run(world: World, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    class NoNotices:
        def __init__(self, _: Wallet) -> None: ...

        async def changed_since_consent(self) -> None:
            return None

    open_for_commands(monkeypatch, lambda: world.wallet)
    monkeypatch.setattr(records_commands, "Notices", NoNotices)
    return lambda *arguments: CliRunner().invoke(wallet, list(arguments))


def test_an_empty_history_is_said_in_both_languages(run: Callable[..., Result]) -> None:
    for language in LANGUAGES:
        done = run("--language", language, "records")
        assert (done.exit_code, done.output.strip()) == (0, load(language)["records.none"])


def test_what_fits_is_listed_and_what_does_not_is_counted(world: World, run: Callable[..., Result]) -> None:
    chain = world.open_visit()
    first, second = world.record(chain), world.record(chain)
    listed = run("records").output
    assert first.upload.record_id.hex() in listed
    assert second.upload.record_id.hex() in listed
    assert "None of your 2 records fits." in run("records", "--day", "2001-01-01").output
    assert "Nenhuma das suas 2 gravações" in run("--language", "pt", "records", "--day", "2001-01-01").output
    paged = run("records", "--per-page", "1").output
    assert second.upload.record_id.hex() not in paged
    assert "Page 1 of 2. The next: --page 2" in paged
    assert second.upload.record_id.hex() in run("records", "--per-page", "1", "--page", "2").output
    beyond = run("records", "--page", "99", "--per-page", "1")
    assert (beyond.exit_code, "there are 2 pages, the last is --page 2" in beyond.output) == (2, True)
    assert "há 1 página, --page 1." in run("--language", "pt", "records", "--page", "99").output


def test_sensors_are_named_in_the_language_of_the_person(world: World, run: Callable[..., Result]) -> None:
    world.record(world.open_visit())
    assert "(depth)" in run("records").output
    assert "imagens, profundidade (depth)" in run("--language", "pt", "records").output
    assert run("records", "--sensor", "lidar").exit_code == 2


def test_the_reasons_of_withheld_pictures_are_told_in_words(
    world: World, run: Callable[..., Result], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    visit, held = world.open_visit(), (("not-alone", 2), ("no-distance", 39), ("of-tomorrow", 1))
    note = msgspec.structs.replace(rendition(0), pixels=b"")
    for withheld in (held[1:2], held):
        world.hold(seal_clip(ClipContent((note,), withheld, NOTICE_SENSOR, NOW_MS), visit, now_ms=NOW_MS))
    told = " ".join(run("records").output.split())
    assert "no picture, only a note of what was not kept, 39 withheld before (the reader gave no distance)" in told
    assert "0 pictures (" not in told
    assert "42 withheld before (39: the reader gave no distance; 2: you were not alone; 1: of-tomorrow)" in told
    assert "42 retidas antes (39: o leitor não deu a distância; 2: " in run("--language", "pt", "records").output
    monkeypatch.chdir(tmp_path)
    seen = " ".join(run("view", "--no-show").output.split())
    assert "only a note of what was not kept: 39 withheld before (the reader gave no distance)." in seen
    assert "The pictures are in" not in seen


def test_a_note_of_what_was_not_kept_has_no_picture_that_could_be_erased(
    world: World, run: Callable[..., Result]
) -> None:
    note = msgspec.structs.replace(rendition(0), pixels=b"")
    clip = seal_clip(ClipContent((note,), (("merged", 3),), NOTICE_SENSOR, NOW_MS), world.open_visit(), now_ms=NOW_MS)
    world.hold(clip)
    refused = run("erase", clip.upload.record_id.hex(), "--frames", "1", "--yes")
    assert (refused.exit_code, "holds no pictures, only a note" in refused.output) == (2, True)


def test_a_program_gets_the_documented_fields(world: World, run: Callable[..., Result]) -> None:
    world.record(world.open_visit())
    told = json.loads(run("records", "--sensor", "depth", "--json").stdout)
    assert (told["page"], told["pages"], told["matching_records"], told["all_records"]) == (1, 1, 1, 1)
    (visit,) = told["visits"]
    assert [entry["visit"] for entry in visit["records"]] == [visit["visit"]]
    assert differences("wallet records", told) == []


@pytest.mark.parametrize("width", [20, 40, 59, 200])
def test_a_narrow_terminal_gets_the_beginning_of_a_name(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(records_commands, "console", filtering_console(width))
    line = records_commands._line(entry("2027-01-31", 7))
    assert (entry("2027-01-31", 7).record_id.hex() in line) == (width >= 60)


def filtering_console(width: int) -> Any:
    from rich.console import Console

    return Console(force_terminal=True, width=width)


def test_parts_of_the_day_cover_it_once() -> None:
    hours = sorted(filter_options.PARTS_OF_DAY.values())
    assert [first for first, _ in hours] + [24] == [0] + [end for _, end in hours]


async def test_a_start_that_several_erased_records_share_says_of_none_that_it_was_erased() -> None:
    erased: Any = SimpleNamespace(records=(), erased_ids=(bytes.fromhex("a1" * 32), bytes.fromhex("a2" * 32)))
    opened: Any = None
    with pytest.raises(BlockRobotError, match=r"^NAME_AMBIGUOUS:"):
        await refuse_erased(opened, [erased], ["A"])
    await refuse_erased(opened, [erased], ["b", ""])


async def test_records_are_chosen_by_name_by_visit_or_all_that_are_not_denied() -> None:
    first, second, denied = (
        visit(*(entry("2027-01-31", 10 * place + number) for number in range(3))) for place in range(3)
    )
    owners = [bytes([place + 1]) * 33 for place in range(3)]
    reports = [
        _owned(report, owner, breach=owner == owners[2])
        for report, owner in zip((first, second, denied), owners, strict=True)
    ]
    opened: Any = SimpleNamespace(records=_answering(reports))
    everything = [one.record_id for report in reports for one in report.records]

    async def chosen(*record_ids: str, visits: tuple[str, ...] = ()) -> list[bytes]:
        return [one.record_id for one in await choose_records(opened, record_ids, visits)]

    assert await chosen() == everything[:6]
    assert await chosen(visits=("02020202",)) == everything[3:6]
    assert await chosen(everything[0].hex(), everything[4].hex(), visits=("02020202",)) == [
        everything[0],
        everything[4],
        everything[3],
        everything[5],
    ]
    with pytest.raises(BlockRobotError, match=r"^VISIT_NOT_FOUND:"):
        await chosen(visits=("0a0b0c0d",))


def _owned(report: VisitReport, owner: bytes, *, breach: bool) -> VisitReport:
    known = msgspec.structs.replace(report.visit, owner=owner)
    rights: Any = SimpleNamespace(breach_id=b"b" * 32 if breach else b"")
    return replace(
        report, visit=known, records=tuple(replace(one, visit=known) for one in report.records), rights=rights
    )


def _answering(reports: list[VisitReport]) -> Callable[[], Awaitable[list[VisitReport]]]:
    async def records() -> list[VisitReport]:
        return reports

    return records
