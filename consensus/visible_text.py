"""Makes untrusted text safe to show: escapes and line ends."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator

from consensus.unicode_table import CONTROL_RANGES

# Letters, marks and spaces that show nothing, or a space that is none: Default_Ignorable_Code_Point beyond the
# controls, and Zs but the space itself. Then signs that are empty by definition: the Tifinagh joiner, the braille
# pattern without a dot, the place of an object, the Khitan filler, the joiners of Brahmi, Zanabazar and Soyombo, the
# note without a head. What joins letters in scripts of today (the viramas of Khmer and Myanmar) stays.
_INVISIBLE_RANGES = """
A0 34F 115F-1160 1680 17B4-17B5 180B-180D 180F 2000-200A 202F 205F 3000 3164 FE00-FE0F FFA0 E0100-E01EF
2D7F 2800 FFFC 16FE4 1107F 11A47 11A99 1D159
"""
STRANGE_MAX_CHARS = 1_000
_SPACES = dict.fromkeys(map(ord, "\n\r\t"), " ")
FURTHER_LINE = "    | "
"""What stands before each further line of an entry (`one_entry`)."""
_ASCII_CONTROL = re.compile(r"[\x00-\x1f\x7f]")
_NOT_PLAIN = re.compile(r"[^\x20-\x7e]")


def _ranges(table: str) -> tuple[list[int], list[int]]:
    pairs = [(first, last or first) for first, _, last in (word.partition("-") for word in table.split())]
    pairs.sort(key=lambda pair: int(pair[0], 16))
    return [int(first, 16) for first, _ in pairs], [int(last, 16) for _, last in pairs]


_CONTROLS = _ranges(CONTROL_RANGES)
_HIDDEN = _ranges(CONTROL_RANGES + _INVISIBLE_RANGES)


def _stands_in(ranges: tuple[list[int], list[int]], character: str) -> bool:
    code = ord(character)
    place = bisect_right(ranges[0], code) - 1
    return place >= 0 and code <= ranges[1][place]


def is_control(character: str) -> bool:
    """Return whether a character is a control, format or unassigned."""
    return _stands_in(_CONTROLS, character)


def is_hidden(character: str) -> bool:
    return _stands_in(_HIDDEN, character)


def find_hidden(text: str, allowed: str = "") -> Iterator[int]:
    wanted = _ASCII_CONTROL if text.isascii() else _NOT_PLAIN
    return (found.start() for found in wanted.finditer(text) if found[0] not in allowed and is_hidden(found[0]))


def escape_controls(text: str, allowed: str = "\n") -> str:
    """Write controls as JSON escapes, except allowed ones; JSON keeps its value."""
    if text.isascii() and text.isprintable():
        return text
    return _NOT_PLAIN.sub(lambda found: found[0] if found[0] in allowed else _escaped(found[0]), text)


def printable(text: str, max_chars: int = STRANGE_MAX_CHARS) -> str:
    """One line, no controls, limited length."""
    return escape_controls(text[:max_chars].translate(_SPACES), "")[:max_chars]


def _escaped(character: str) -> str:
    if not is_control(character):
        return character
    units = character.encode("utf-16-be", "surrogatepass")
    return "".join(f"\\u{units[place : place + 2].hex()}" for place in range(0, len(units), 2))


def one_entry(text: str) -> str:
    """Mark each further line, once."""
    return text.replace(f"\n{FURTHER_LINE}", "\n").replace("\n", f"\n{FURTHER_LINE}")


def split_lines(text: str) -> list[str]:
    """Split at line feeds only, without a last empty line."""
    lines = text.split("\n")
    return lines[:-1] if lines[-1] == "" else lines
