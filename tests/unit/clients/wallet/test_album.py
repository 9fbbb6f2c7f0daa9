"""Contact sheets and animations of what was viewed: few of many, named, and for their viewer's eyes alone."""

from __future__ import annotations

import io
import itertools
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rich.console import Console

from clients.sdk.pictures.depth_colours import colour_pixels
from clients.wallet.cli.group_options import complete_profiles, complete_records
from clients.wallet.commands.view_commands import _print_views
from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.presentation.album import Album
from clients.wallet.records import contact_sheet
from clients.wallet.records.contact_sheet import (
    FRAMES_MAX_COUNT,
    TILES_MAX_COUNT,
    PictureSampler,
    draw_animation,
    evenly,
)
from clients.wallet.records.picture_files import write_frames
from clients.wallet.records.viewing import FrameView, RecordView
from clients.wallet.store.keystore import KnownVisit
from consensus.records.metadata import RecordMetadata
from consensus.records.renditions import ENCODING_JPEG, Rendition

BEGAN_MS = 1_800_000_000_000
VISIT = KnownVisit(owner=b"\x02" * 33, ephemeral=bytes(33), robot=bytes(33), sequence=0, bucket_ms=0)


def entry(number: int, frames: int = 3) -> RecordEntry:
    metadata = RecordMetadata("rgb", BEGAN_MS, BEGAN_MS + 500, frames, number, bytes(32), (), 64, 48)
    return RecordEntry(number.to_bytes(16, "big"), VISIT, {"status": "active"}, metadata)


def frame(number: int) -> FrameView:
    packed = BytesIO()
    Image.new("RGB", (64, 48), (60 * number % 256, 90, 120)).save(packed, "JPEG")
    rendition = Rendition(
        1, BEGAN_MS + 100 * number, number, 64, 48, 0, 0, 64, 48, bytes(32), ENCODING_JPEG, packed.getvalue()
    )
    return FrameView(number, "ok", rendition)


async def nothing(_: Rendition) -> bytes:
    raise AssertionError("a colour picture has no empty frame")


async def write(album: Album, number: int, frames: int) -> RecordEntry:
    one = entry(number)
    shown = [frame(each) for each in range(frames)]
    await write_frames(nothing, one.record_id, shown, album.out, album.seen_by(one))
    return one


async def test_a_record_gets_a_sheet_and_an_animation_that_others_cannot_read(tmp_path: Path) -> None:
    album = Album(tmp_path)
    one = await write(album, 1, 3)
    sheet, animation = album.write_record(one)
    assert sheet == tmp_path / one.record_id.hex() / "contact-sheet.png"
    assert {path.stat().st_mode & 0o777 for path in (sheet, animation)} == {0o600}
    with Image.open(animation) as moving:
        assert (moving.format, moving.n_frames) == ("GIF", 3)
    assert album.write_visits() == [], "one record of a visit has said it all"


async def test_a_visit_gets_one_of_all_records_that_were_viewed(tmp_path: Path) -> None:
    album = Album(tmp_path)
    for number in (1, 2):
        await write(album, number, 2)
    sheet, animation = album.write_visits()
    assert sheet.name == f"visit-{VISIT.owner.hex()[:12]}-contact-sheet.png"
    with Image.open(animation) as moving:
        assert moving.n_frames == 4


async def test_a_record_without_pictures_gets_neither(tmp_path: Path) -> None:
    album = Album(tmp_path)
    one = await write(album, 1, 0)
    assert album.write_record(one) == []
    assert album.write_visits() == []


async def test_one_picture_does_not_move(tmp_path: Path) -> None:
    album = Album(tmp_path)
    (sheet,) = album.write_record(await write(album, 1, 1))
    assert sheet.suffix == ".png"


def test_of_five_thousand_pictures_few_are_made_and_kept_at_equal_distances() -> None:
    made: list[int] = []

    def make(number: int) -> Image.Image:
        made.append(number)
        return Image.new("RGB", (64, 48))

    collection = PictureSampler()
    for number in range(5_000):
        collection.take("", BEGAN_MS + number, lambda number=number: make(number))
        assert len(collection._kept) < 2 * FRAMES_MAX_COUNT
    assert collection.count == 5_000
    assert len(made) < 1_500
    tiles = collection.some(TILES_MAX_COUNT)
    times = [tile.captured_at_ms - BEGAN_MS for tile in tiles]
    assert (len(tiles), times[0], times == sorted(set(times))) == (TILES_MAX_COUNT, 0, True)
    assert times[-1] > 4_900
    gaps = {later - time for time, later in itertools.pairwise(times)}
    assert max(gaps) <= 2 * min(gaps)


@pytest.mark.parametrize(("count", "most"), [(1, 1), (5, 1), (5, 2), (48, 48), (49, 48)])
def test_never_more_are_taken_than_are_wanted_and_first_and_last_are_among_them(count: int, most: int) -> None:
    tiles = [contact_sheet.Tile(str(number + 1), number, Image.new("RGB", (1, 1))) for number in range(count)]
    taken = evenly(tiles, most)
    assert len(taken) == min(count, most)
    assert taken[0] is tiles[0]
    assert most == 1 or taken[-1] is tiles[-1]


@pytest.mark.parametrize("size", [(1, 8192), (8192, 1), (64, 48), (48, 64)])
def test_a_picture_of_any_shape_is_as_wide_as_a_tile_and_never_far_higher(size: tuple[int, int]) -> None:
    collection = PictureSampler()
    collection.take("1", BEGAN_MS, lambda: Image.new("RGB", size, (200, 0, 0)))
    (tile,) = collection.some(1)
    assert tile.picture.width == contact_sheet.TILE_WIDTH_PX
    assert 1 <= tile.picture.height <= contact_sheet.TILE_HEIGHT_MAX_PX
    assert tile.picture.getpixel((119, 0)) == (200, 0, 0)


def test_an_animation_keeps_the_pace_within_what_one_can_see() -> None:
    pictures = [Image.new("RGB", (240, 180), (shade, 0, 0)) for shade in (0, 80, 160, 240)]
    times = [0, 10, 210, 90_000]
    tiles = [contact_sheet.Tile("", time, picture) for time, picture in zip(times, pictures, strict=True)]
    with Image.open(BytesIO(draw_animation(tiles))) as moving:
        pauses = []
        for number in range(moving.n_frames):
            moving.seek(number)
            pauses.append(moving.info["duration"])
    assert pauses == [40, 200, 1000, 1000]


def test_an_animation_of_depth_shows_the_colours_of_its_pictures() -> None:
    depth = np.tile(np.linspace(400, 8_000, 240).astype(np.uint16), (180, 1))
    colours = [colour_pixels(np.roll(depth, 60 * turn, axis=1))[..., ::-1] for turn in range(4)]
    tiles = [
        contact_sheet.Tile("", 40 * turn, Image.fromarray(each), is_depth=True) for turn, each in enumerate(colours)
    ]
    with Image.open(BytesIO(draw_animation(tiles))) as moving:
        assert moving.n_frames == len(tiles)
        for turn, each in enumerate(colours):
            moving.seek(turn)
            shown = np.asarray(moving.convert("RGB"), dtype=np.int16)[:180]
            assert np.abs(shown - each).mean() < 4
            assert np.abs(shown - each).max() < 32


async def test_a_terminal_gets_a_strip_and_a_file_gets_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    album = Album(tmp_path)
    await write(album, 1, 3)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    terminal = Console(file=io.StringIO(), force_terminal=True, width=80, color_system="truecolor")
    album.show(terminal)
    piped = Console(file=io.StringIO(), force_terminal=False, width=80)
    album.show(piped)
    assert isinstance(terminal.file, io.StringIO)
    assert isinstance(piped.file, io.StringIO)
    assert entry(1).record_id.hex()[:12] in terminal.file.getvalue()
    assert piped.file.getvalue() == ""


def test_a_shell_completes_what_is_on_this_machine_and_nothing_where_nothing_is(tmp_path: Path) -> None:
    import click

    (tmp_path / "ann.wallet").touch()
    (tmp_path / "anton.wallet").touch()
    (tmp_path / ("3f" * 16)).mkdir()
    (tmp_path / "notes").mkdir()
    context = click.Context(click.Command("view"))
    parameter = click.Option(["--profile"])
    context.params = {"wallet_dir": tmp_path, "out": tmp_path}
    assert complete_profiles(context, parameter, "an") == ["ann", "anton"]
    assert complete_profiles(context, parameter, "b") == []
    assert complete_records(context, parameter, "3F3f") == ["3f" * 6]
    assert complete_records(context, parameter, "3f" * 7) == ["3f" * 16]
    context.params = {"wallet_dir": tmp_path / "none", "out": tmp_path / "none"}
    assert complete_profiles(context, parameter, "") == []
    assert complete_records(context, parameter, "") == []


def test_a_record_without_pictures_is_said_to_have_none_and_a_changed_one_which(
    capsys: pytest.CaptureFixture[str],
) -> None:
    notice = RecordView(entry(1, 1), (FrameView(0, "notice", None),), ("node-1",))
    erased = RecordView(entry(2, 2), (FrameView(0, "ok", None), FrameView(1, "erased", None)), ("node-1",))
    changed = RecordView(entry(3, 2), (FrameView(0, "ok", None), FrameView(1, "corrupted", None)), ("node-1",))
    _print_views([notice, erased, changed])
    said = " ".join(capsys.readouterr().out.split())
    assert f"{entry(1).record_id.hex()}: it holds no pictures" in said
    assert "1 of 2 pictures are as the robot took them; 1 erased." in said
    assert "1 of 2 pictures are as the robot took them; did not pass every check: 2." in said
    assert "count" not in said
    short = RecordView(entry(4, 5), (FrameView(0, "ok", None),), ("node-1",))
    noted = RecordView(entry(5, 2), (FrameView(0, "notice", None),), ("node-1",))
    _print_views([short, noted])
    said = " ".join(capsys.readouterr().out.split())
    assert "1 of 1 picture is as the robot took it; the robot's own count is 5, and it put 1 into the ledger;" in said
    assert "the robot's own count is 2, and it put 1 into the ledger; ask the hospital why." in said
    _print_views([])
    assert "There is nothing to show." in capsys.readouterr().out
