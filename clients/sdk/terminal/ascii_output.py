"""ASCII output for terminals without UTF-8."""

from __future__ import annotations

import codecs
import io
import os
import sys
import unicodedata
from collections.abc import Mapping
from typing import TYPE_CHECKING, TextIO

from consensus.visible_text import escape_controls

if TYPE_CHECKING:
    from typing_extensions import Buffer

PLAIN_ENCODING = "blockrobot-plain"
STRANGE_MAX_CHARS = 1_000
_LINES = str.maketrans(
    dict.fromkeys("─━═╌┄", "-")
    | dict.fromkeys("│┃║╎┆", "|")
    | dict.fromkeys("┌┐└┘├┤┬┴┼╭╮╯╰╔╗╚╝╠╣╦╩╬┏┓┗┛┡┩╇╪╞╡┠┨┯┷", "+")
    | {"–": "-", "—": "-", "…": "...", "’": "'", "‘": "'", "“": '"', "”": '"', "→": "->", "←": "<-", "×": "x", "·": "-"}
    | {"•": "*", "●": "*", "✓": "x", "✔": "x", "▀": "#", "▄": "#", "█": "#", "º": "o", "ª": "a"}
)

_SPACES = dict.fromkeys(map(ord, "\n\r\t"), " ")


def to_plain(text: str) -> str:
    """Return ASCII: unaccented letters, lines as `-|+`, else `?`."""
    bare = unicodedata.normalize("NFKD", text.translate(_LINES))
    kept = "".join(letter for letter in bare if not unicodedata.combining(letter))
    return kept.encode("ascii", "replace").decode("ascii")


def printable(text: str, max_chars: int = STRANGE_MAX_CHARS) -> str:
    """Make foreign text printable: one line, no controls, limited length."""
    return escape_controls(text[:max_chars].translate(_SPACES), "")[:max_chars]


class _Encoder(codecs.IncrementalEncoder):
    def encode(self, text: str, final: bool = False) -> bytes:  # noqa: ARG002 - codecs' signature
        return to_plain(text).encode("ascii")


class _Decoder(codecs.IncrementalDecoder):
    def decode(self, data: Buffer, final: bool = False) -> str:  # noqa: ARG002 - codecs' signature
        return _decode(data)[0]


def _encode(text: str, errors: str = "strict") -> tuple[bytes, int]:  # noqa: ARG001 - codecs' signature
    return to_plain(text).encode("ascii"), len(text)


def _decode(data: Buffer, errors: str = "strict", /) -> tuple[str, int]:  # noqa: ARG001 - codecs' signature
    read = bytes(data)
    return read.decode("ascii", "replace"), len(read)


def _find(name: str) -> codecs.CodecInfo | None:
    if name.replace("_", "-") != PLAIN_ENCODING:
        return None
    return codecs.CodecInfo(
        _encode, _decode, incrementalencoder=_Encoder, incrementaldecoder=_Decoder, name=PLAIN_ENCODING
    )


codecs.register(_find)


def is_utf8(stream: TextIO, environment: Mapping[str, str] | None = None) -> bool:
    """Return whether a stream takes UTF-8, by encoding and locale."""
    try:
        utf8 = codecs.lookup(getattr(stream, "encoding", None) or "ascii").name == "utf-8"
    except LookupError:
        return False
    if not utf8 or not stream.isatty():
        return utf8
    environment = os.environ if environment is None else environment
    said = next((environment[name] for name in ("LC_ALL", "LC_CTYPE", "LANG") if environment.get(name)), "")
    return not said or "utf8" in said.lower().replace("-", "")


def prepare_output() -> None:
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and not is_utf8(stream):
            stream.reconfigure(encoding=PLAIN_ENCODING)
