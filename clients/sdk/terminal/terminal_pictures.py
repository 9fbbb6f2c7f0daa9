"""Terminal pictures: native protocol where known safe, else half blocks or letters."""

from __future__ import annotations

import base64
import os
import sys
from collections.abc import Iterator, Mapping
from enum import Enum
from io import BytesIO

from PIL import Image
from rich.color import Color
from rich.console import Console
from rich.style import Style
from rich.text import Text

from clients.sdk.terminal.ascii_output import is_utf8

COLUMNS_MIN = 20
ROWS_MAX = 24
CELL_PIXELS = 8
"""How many pixels of a picture a column stands for, where a terminal draws pictures itself."""
_KITTY_CHUNK = 4096
_SIXEL_COLOURS = 64
_LETTERS = " .:-=+*#%@"


class PictureProtocol(Enum):
    """How a terminal shows a picture."""

    KITTY = "kitty"
    ITERM = "iterm2"
    SIXEL = "sixel"
    BLOCKS = "blocks"
    LETTERS = "letters"
    NONE = "none"


_KITTY_TERMS = frozenset({"xterm-kitty", "xterm-ghostty"})
_SIXEL_TERMS = frozenset({"foot", "foot-extra", "mlterm", "contour", "contour-latest"})


def find_picture_protocol(console: Console, environment: Mapping[str, str] | None = None) -> PictureProtocol:
    """Protocols only if TERM names them, blocks in tmux or screen, letters without colour."""
    environment = os.environ if environment is None else environment
    term = environment.get("TERM", "")
    if not console.is_terminal or console.width < COLUMNS_MIN or term in {"", "dumb", "unknown"}:
        return PictureProtocol.NONE
    if console.no_color or console.color_system is None or environment.get("NO_COLOR"):
        return PictureProtocol.LETTERS
    program = environment.get("TERM_PROGRAM", "")
    if not environment.get("TMUX") and not environment.get("STY"):
        if term in _KITTY_TERMS:
            return PictureProtocol.KITTY
        if term in _SIXEL_TERMS:
            return PictureProtocol.SIXEL
        if term.startswith("xterm") and program in {"iTerm.app", "WezTerm"}:
            return PictureProtocol.ITERM
    return PictureProtocol.BLOCKS if is_utf8(sys.stdout, environment) else PictureProtocol.LETTERS


def show_picture(console: Console, picture: Image.Image, way: PictureProtocol | None = None) -> None:
    """At most as wide as the terminal."""
    way = find_picture_protocol(console) if way is None else way
    columns = min(console.width - 1, 120)
    if way is PictureProtocol.NONE:
        return
    if way in {PictureProtocol.BLOCKS, PictureProtocol.LETTERS}:
        rows = half_blocks(picture, columns) if way is PictureProtocol.BLOCKS else letters(picture, columns)
        for row in rows:
            console.print(row, soft_wrap=False, no_wrap=True, overflow="crop")
        return
    width = min(picture.width, columns * CELL_PIXELS)
    fitted = picture.convert("RGB").resize((width, max(1, picture.height * width // picture.width)))
    sequence = {PictureProtocol.KITTY: kitty, PictureProtocol.ITERM: iterm, PictureProtocol.SIXEL: sixel}[way](fitted)
    console.file.write(sequence + "\n")
    console.file.flush()


def _cells(picture: Image.Image, columns: int, pixels_a_row: int) -> Image.Image:
    wide = min(columns, max(1, picture.width))
    rows = max(1, round(picture.height * wide / picture.width / 2))
    if rows > ROWS_MAX:
        wide, rows = max(1, wide * ROWS_MAX // rows), ROWS_MAX
    return picture.convert("RGB").resize((wide, rows * pixels_a_row), Image.Resampling.BOX)


def _pixel(small: Image.Image, x: int, y: int) -> tuple[int, int, int]:
    found = small.getpixel((x, y))
    assert isinstance(found, tuple)
    return int(found[0]), int(found[1]), int(found[2])


def half_blocks(picture: Image.Image, columns: int) -> Iterator[Text]:
    """Two pixels per cell, in the terminal's colours."""
    small = _cells(picture, columns, 2)
    for y in range(0, small.height, 2):
        row = Text()
        for x in range(small.width):
            upper, lower = Color.from_rgb(*_pixel(small, x, y)), Color.from_rgb(*_pixel(small, x, y + 1))
            row.append("▀", Style(color=upper, bgcolor=lower))
        yield row


def letters(picture: Image.Image, columns: int) -> Iterator[Text]:
    """Draw in letters, denser ones for brighter parts."""
    small = _cells(picture, columns, 1).convert("L")
    for y in range(small.height):
        greys = small.crop((0, y, small.width, y + 1)).tobytes()
        yield Text("".join(_LETTERS[grey * len(_LETTERS) // 256] for grey in greys))


def _png(picture: Image.Image) -> bytes:
    packed = BytesIO()
    picture.save(packed, "PNG")
    return packed.getvalue()


def kitty(picture: Image.Image) -> str:
    """Chunked PNG at the cursor, no replies."""
    data = base64.standard_b64encode(_png(picture)).decode("ascii")
    pieces = [data[start : start + _KITTY_CHUNK] for start in range(0, len(data), _KITTY_CHUNK)]
    last = len(pieces) - 1
    return "".join(
        f"\x1b_G{'a=T,f=100,q=2,' if number == 0 else ''}m={int(number < last)};{piece}\x1b\\"
        for number, piece in enumerate(pieces)
    )


def iterm(picture: Image.Image) -> str:
    """As an iTerm inline image."""
    data = _png(picture)
    header = f"inline=1;size={len(data)};width={picture.width}px;height={picture.height}px;preserveAspectRatio=1"
    return f"\x1b]1337;File={header}:{base64.standard_b64encode(data).decode('ascii')}\x07"


def sixel(picture: Image.Image) -> str:
    """DEC STD 070."""
    packed = picture.quantize(_SIXEL_COLOURS)
    palette = packed.getpalette() or []
    width, height = packed.size
    pixels = packed.tobytes()
    out = [f'\x1bPq"1;1;{width};{height}']
    for number in range(len(palette) // 3):
        red, green, blue = (palette[3 * number + part] * 100 // 255 for part in range(3))
        out.append(f"#{number};2;{red};{green};{blue}")
    for top in range(0, height, 6):
        rows = [pixels[y * width : (y + 1) * width] for y in range(top, min(top + 6, height))]
        for number in sorted(set(b"".join(rows))):
            bits = (sum(1 << bit for bit, row in enumerate(rows) if row[x] == number) for x in range(width))
            out.append(f"#{number}" + "".join(chr(63 + bit) for bit in bits) + "$")
        out.append("-")
    return "".join(out) + "\x1b\\"
