"""Pictures on a terminal: which way is taken, and what is written then."""

from __future__ import annotations

import base64
import io
from io import BytesIO

import pytest
from PIL import Image
from rich.console import Console

from clients.sdk.terminal import terminal_pictures
from clients.sdk.terminal.terminal_pictures import (
    ROWS_MAX,
    PictureProtocol,
    find_picture_protocol,
    half_blocks,
    iterm,
    kitty,
    letters,
    show_picture,
    sixel,
)


def a_console(*, width: int = 80, terminal: bool = True, **settings: object) -> Console:
    return Console(file=io.StringIO(), force_terminal=terminal, width=width, color_system="truecolor", **settings)  # type: ignore[arg-type]


def half_red() -> Image.Image:
    picture = Image.new("RGB", (8, 8), (0, 0, 0))
    picture.paste((255, 0, 0), (0, 0, 8, 4))
    return picture


@pytest.fixture(autouse=True)
def speaks_utf8(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal_pictures, "is_utf8", lambda *_: True)


@pytest.mark.parametrize(
    ("environment", "way"),
    [
        ({"TERM": "xterm-256color"}, PictureProtocol.BLOCKS),
        ({"TERM": "xterm-kitty"}, PictureProtocol.KITTY),
        ({"TERM": "xterm-ghostty"}, PictureProtocol.KITTY),
        ({"TERM": "foot"}, PictureProtocol.SIXEL),
        ({"TERM": "xterm-256color", "TERM_PROGRAM": "iTerm.app"}, PictureProtocol.ITERM),
        ({"TERM": "xterm-256color", "KITTY_WINDOW_ID": "1"}, PictureProtocol.BLOCKS),
        ({"TERM": "xterm-kitty", "TMUX": "/run/x"}, PictureProtocol.BLOCKS),
        ({"TERM": "screen", "TERM_PROGRAM": "iTerm.app"}, PictureProtocol.BLOCKS),
        ({"TERM": "xterm-kitty", "NO_COLOR": "1"}, PictureProtocol.LETTERS),
        ({"TERM": "dumb"}, PictureProtocol.NONE),
        ({}, PictureProtocol.NONE),
    ],
)
def test_a_protocol_is_used_only_where_the_terminal_names_itself(
    environment: dict[str, str], way: PictureProtocol
) -> None:
    assert find_picture_protocol(a_console(), environment) is way


def test_nothing_is_shown_but_on_a_terminal_nor_on_one_too_narrow() -> None:
    assert find_picture_protocol(a_console(terminal=False), {"TERM": "xterm-kitty"}) is PictureProtocol.NONE
    assert find_picture_protocol(a_console(width=19), {"TERM": "xterm-kitty"}) is PictureProtocol.NONE
    piped = a_console(terminal=False)
    show_picture(piped, half_red())
    assert isinstance(piped.file, io.StringIO)
    assert piped.file.getvalue() == ""


def test_without_utf8_letters_take_the_place_of_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(terminal_pictures, "is_utf8", lambda *_: False)
    assert find_picture_protocol(a_console(), {"TERM": "xterm"}) is PictureProtocol.LETTERS


def test_a_half_block_holds_two_pixels_in_their_colours() -> None:
    rows = list(half_blocks(half_red(), 8))
    assert [row.plain for row in rows] == ["▀" * 8] * 4
    console = a_console()
    show_picture(console, half_red(), PictureProtocol.BLOCKS)
    assert isinstance(console.file, io.StringIO)
    assert "38;2;255;0;0" in console.file.getvalue()


def test_letters_are_denser_where_the_picture_is_brighter_and_take_no_colour() -> None:
    picture = Image.new("RGB", (2, 2), (255, 255, 255))
    picture.putpixel((0, 0), (0, 0, 0))
    picture.putpixel((0, 1), (0, 0, 0))
    assert [row.plain for row in letters(picture, 2)] == [" @"]


def test_a_high_picture_is_never_more_than_a_screen() -> None:
    assert len(list(half_blocks(Image.new("RGB", (10, 5000)), 80))) == ROWS_MAX


@pytest.mark.parametrize("size", [(1, 1), (700, 500)])
def test_kitty_gets_a_png_in_pieces_of_which_the_last_says_so(size: tuple[int, int]) -> None:
    noisy = Image.effect_noise(size, 90).convert("RGB")
    pieces = kitty(noisy).split("\x1b\\")[:-1]
    assert pieces[0].startswith("\x1b_Ga=T,f=100,q=2,m=")
    assert [piece.split(";")[0][-1] for piece in pieces] == ["1"] * (len(pieces) - 1) + ["0"]
    data = base64.b64decode("".join(piece.split(";")[1] for piece in pieces))
    assert Image.open(BytesIO(data)).size == size


def test_iterm_gets_a_whole_png_with_its_size() -> None:
    told, data = iterm(half_red()).removeprefix("\x1b]1337;File=").removesuffix("\x07").split(":")
    picture = base64.b64decode(data)
    assert f"size={len(picture)}" in told
    assert Image.open(BytesIO(picture)).size == (8, 8)


def test_sixels_are_bands_of_six_rows_for_each_colour() -> None:
    said = sixel(half_red())
    assert said.startswith('\x1bPq"1;1;8;8#')
    assert said.endswith("-\x1b\\")
    assert said.count("-") == 2
    assert ";2;100;0;0" in said
    assert "O" * 8 not in said.split("-")[1], "the second band has two rows, both black"


@pytest.mark.parametrize(
    "way", [PictureProtocol.KITTY, PictureProtocol.ITERM, PictureProtocol.SIXEL, PictureProtocol.LETTERS]
)
def test_every_way_writes_something(way: PictureProtocol) -> None:
    console = a_console()
    show_picture(console, half_red(), way)
    assert isinstance(console.file, io.StringIO)
    assert console.file.getvalue().strip()
