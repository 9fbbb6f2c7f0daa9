"""The pictures that were viewed, gathered: contact sheets and animations as files, a strip of them on the terminal.

Must never hold a picture that its viewer did not ask for, nor write one that others can read.
"""

from __future__ import annotations

import datetime
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from PIL import Image
from rich.console import Console

from clients.sdk.terminal_pictures import Way, find_way, show_picture
from clients.wallet.contact_sheet import (
    FRAMES_MAX_COUNT,
    TILES_MAX_COUNT,
    Collection,
    Tile,
    draw_animation,
    draw_sheet,
    draw_strip,
)
from clients.wallet.language import text
from clients.wallet.opening import show_moment
from clients.wallet.pictures import Seen, write_private
from clients.wallet.wallet import RecordEntry

SHEET_NAME = "contact-sheet.png"
ANIMATION_NAME = "animation.gif"
SHOWN_RECORDS_MAX = 3
_STRIP_COLUMNS = 36
_STRIP_TILES_MAX = 4


def _clock(time_ms: int) -> str:
    moment = datetime.datetime.fromtimestamp(time_ms / 1000).astimezone()
    return moment.strftime("%H:%M:%S.") + f"{time_ms % 1000 // 100}"


@dataclass
class Album:
    """Gathers pictures of records and of whole visits while they are written below `out`."""

    out: Path
    records: dict[bytes, Collection] = field(default_factory=dict)
    visits: dict[bytes, Collection] = field(default_factory=dict)
    visit_records: dict[bytes, int] = field(default_factory=dict)

    def seen_by(self, entry: RecordEntry) -> Seen:
        """Return what is to be told of each picture of a record."""
        own = self.records.setdefault(entry.record_id, Collection())
        whole = self.visits.setdefault(entry.visit.owner, Collection())
        self.visit_records[entry.visit.owner] = self.visit_records.get(entry.visit.owner, 0) + 1

        def seen(captured_at_ms: int, make: Callable[[], Image.Image]) -> None:
            own.take(captured_at_ms, make)
            whole.take(captured_at_ms, make)

        return seen

    def write_record(self, entry: RecordEntry) -> list[Path]:
        """Write a record's contact sheet, and its animation if it has more than one picture, into its folder."""
        name = entry.record_id.hex()
        title = text("view.sheet_record", name=name[:12], moment=show_moment(entry.metadata.started_at_ms))
        return _write(self.out / name, "", self.records[entry.record_id], title)

    def write_visits(self) -> list[Path]:
        """Write a sheet and an animation of each visit of which more than one record was viewed."""
        written = []
        for owner, collection in self.visits.items():
            if self.visit_records[owner] > 1 and collection.count:
                name = owner.hex()[:12]
                first = collection.some(1)[0].captured_at_ms
                title = text("view.sheet_visit", name=name, moment=show_moment(first))
                written += _write(self.out, f"visit-{name}-", collection, title)
        return written

    def show(self, console: Console) -> None:
        """Show some pictures of the first records on a terminal that can; nothing elsewhere."""
        way = find_way(console)
        if way is Way.NONE:
            return
        wide = max(1, min(_STRIP_TILES_MAX, console.width // _STRIP_COLUMNS))
        shown = [(name, kept) for name, kept in self.records.items() if kept.count]
        for name, collection in shown[:SHOWN_RECORDS_MAX]:
            tiles = collection.some(wide)
            console.print(f"{name.hex()[:12]}  " + "  ".join(_clock(tile.captured_at_ms) for tile in tiles))
            show_picture(console, draw_strip(tiles), way)


def _write(folder: Path, prefix: str, collection: Collection, title: str) -> list[Path]:
    tiles: list[Tile] = collection.some(TILES_MAX_COUNT)
    if not tiles:
        return []
    counted = text("view.sheet_count", shown=len(tiles), count=collection.count)
    sheet = folder / f"{prefix}{SHEET_NAME}"
    write_private(sheet, draw_sheet(tiles, f"{title}  {counted}", [_clock(tile.captured_at_ms) for tile in tiles]))
    if collection.count < 2:
        return [sheet]
    animation = folder / f"{prefix}{ANIMATION_NAME}"
    write_private(animation, draw_animation(collection.some(FRAMES_MAX_COUNT)))
    return [sheet, animation]
