"""Viewed pictures as contact sheets, animations and terminal strips; files of earlier views that were not rewritten."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

from PIL import Image
from rich.console import Console

from clients.sdk.new_files import write_private
from clients.sdk.pictures.picture_names import is_picture_name
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import console
from clients.sdk.terminal.terminal_pictures import PictureProtocol, find_picture_protocol, show_picture
from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.presentation.translations import text
from clients.wallet.records.contact_sheet import (
    FRAMES_MAX_COUNT,
    TILES_MAX_COUNT,
    PictureSampler,
    Tile,
    draw_animation,
    draw_sheet,
    draw_strip,
)
from clients.wallet.records.picture_files import Seen
from consensus.errors import BlockRobotError
from pages.time_format import format_clock, format_time

SHEET_NAME = "contact-sheet.png"
ANIMATION_NAME = "animation.gif"
SHOWN_RECORDS_MAX_COUNT = 3
_NAME_CHARS = 12
_STRIP_COLUMNS = 36
_STRIP_TILES_MAX = 4
FOLDERS_NAMED_MAX_COUNT = 5
FILES_NAMED_MAX_COUNT = 4
_SHEETS = frozenset({SHEET_NAME, ANIMATION_NAME})
_RECORD = re.compile(r"[0-9a-f]{32}")
_OF_VISIT = re.compile(rf"visit-[0-9a-f]{{12}}-(?:{re.escape(SHEET_NAME)}|{re.escape(ANIMATION_NAME)})")


def visit_prefix(owner: bytes) -> str:
    return f"visit-{owner.hex()[:_NAME_CHARS]}-"


def _caption(tile: Tile) -> str:
    return f"{tile.label}  {format_clock(tile.captured_at_ms)}"


@dataclass
class Album:
    """Collects pictures written below `out`."""

    out: Path
    records: dict[bytes, PictureSampler] = field(default_factory=dict)
    visits: dict[bytes, PictureSampler] = field(default_factory=dict)
    visit_records: dict[bytes, int] = field(default_factory=dict)
    missing_rooms: dict[bytes, BlockRobotError] = field(default_factory=dict)
    """Empty frames that nobody had, by their hash, and why."""
    written: set[Path] = field(default_factory=set)
    """All files of this look: its sheets and animations, and the pictures that its user says here."""

    def seen_by(self, entry: RecordEntry) -> Seen:
        own = self.records.setdefault(entry.record_id, PictureSampler())
        whole = self.visits.setdefault(entry.visit.owner, PictureSampler())
        self.visit_records[entry.visit.owner] = self.visit_records.get(entry.visit.owner, 0) + 1

        def seen(number: int, captured_at_ms: int, make: Callable[[], Image.Image], is_depth: bool) -> None:
            own.take(str(number), captured_at_ms, make, is_depth=is_depth)
            whole.take(f"{number} ({entry.record_id.hex()[:_NAME_CHARS]})", captured_at_ms, make, is_depth=is_depth)

        return seen

    def write_record(self, entry: RecordEntry) -> list[Path]:
        """An animation for several pictures."""
        name = entry.record_id.hex()
        title = text("view.sheet_record", name=name[:_NAME_CHARS], moment=format_time(entry.metadata.started_at_ms))
        files = _write(self.out / name, "", self.records[entry.record_id], title)
        self.written.update(files)
        return files

    def write_visits(self) -> list[Path]:
        """Write a sheet for each visit of several records."""
        written = []
        for owner, collection in self.visits.items():
            if self.visit_records[owner] > 1 and collection.count:
                name = owner.hex()[:_NAME_CHARS]
                first = collection.some(1)[0].captured_at_ms
                title = text("view.sheet_visit", name=name, moment=format_time(first))
                written += _write(self.out, visit_prefix(owner), collection, title)
        self.written.update(written)
        return written

    def show(self, console: Console) -> None:
        way = find_picture_protocol(console)
        if way is PictureProtocol.NONE:
            return
        wide = max(1, min(_STRIP_TILES_MAX, console.width // _STRIP_COLUMNS))
        shown = [(name, kept) for name, kept in self.records.items() if kept.count]
        for name, collection in shown[:SHOWN_RECORDS_MAX_COUNT]:
            tiles = collection.some(wide)
            console.print(f"{name.hex()[:_NAME_CHARS]}  " + "  ".join(map(_caption, tiles)))
            show_picture(console, draw_strip(tiles), way)


def _write(folder: Path, prefix: str, collection: PictureSampler, title: str) -> list[Path]:
    tiles: list[Tile] = collection.some(TILES_MAX_COUNT)
    if not tiles:
        return []
    counted = text("view.sheet_count", shown=len(tiles), count=collection.count)
    sheet = folder / f"{prefix}{SHEET_NAME}"
    write_private(sheet, draw_sheet(tiles, f"{title}  {counted}", [_caption(tile) for tile in tiles]))
    if collection.count < 2:
        return [sheet]
    animation = folder / f"{prefix}{ANIMATION_NAME}"
    write_private(animation, draw_animation(collection.some(FRAMES_MAX_COUNT)))
    return [sheet, animation]


def find_earlier_of(
    out: Path, written: Collection[Path], records: Iterable[bytes], visits: Iterable[bytes] = ()
) -> list[Path]:
    found = [path for record_id in records for path in _of_record(out / record_id.hex())]
    sheets = [out / f"{visit_prefix(owner)}{name}" for owner in visits for name in sorted(_SHEETS)]
    return [path for path in (*found, *sheets) if path.is_file() and path not in written]


def find_earlier(out: Path, written: Collection[Path]) -> list[Path]:
    if not out.is_dir():
        return []
    there = sorted(out.iterdir())
    found = [path for folder in there if _RECORD.fullmatch(folder.name) for path in _of_record(folder)]
    found += [path for path in there if _OF_VISIT.fullmatch(path.name)]
    return [path for path in found if path.is_file() and path not in written]


def _of_record(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    return [path for path in sorted(folder.iterdir()) if is_picture_name(path.name) or path.name in _SHEETS]


def print_earlier_files(files: Collection[Path]) -> None:
    if not files:
        return
    folders = [(folder, [path.name for path in group]) for folder, group in groupby(files, lambda path: path.parent)]
    for folder, names in folders[:FOLDERS_NAMED_MAX_COUNT]:
        listed = ", ".join(names[:FILES_NAMED_MAX_COUNT]) + (", ..." if len(names) > FILES_NAMED_MAX_COUNT else "")
        console.print(escape(text("earlier.files", count=len(names), folder=folder, names=listed)))
    others = folders[FOLDERS_NAMED_MAX_COUNT:]
    if others:
        folders_told = text("count.folders", count=len(others))
        console.print(text("earlier.more", count=sum(len(names) for _, names in others), folders=folders_told))
    console.print(text("earlier.next"))
