"""Viewed pictures as contact sheets, animations and terminal strips."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from PIL import Image
from rich.console import Console

from clients.sdk.new_files import write_private
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
SHOWN_RECORDS_MAX = 3
_NAME_CHARS = 12
_STRIP_COLUMNS = 36
_STRIP_TILES_MAX = 4


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
        """Write contact sheet, and animation for several pictures."""
        name = entry.record_id.hex()
        title = text("view.sheet_record", name=name[:_NAME_CHARS], moment=format_time(entry.metadata.started_at_ms))
        files = _write(self.out / name, "", self.records[entry.record_id], title)
        self.written.update(files)
        return files

    def write_visits(self) -> list[Path]:
        """Write each visit's sheet and animation for several records."""
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
        for name, collection in shown[:SHOWN_RECORDS_MAX]:
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
