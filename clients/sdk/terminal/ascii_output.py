"""Output for terminals that do not speak UTF-8: accents and lines become ASCII."""

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
    """Return a text in ASCII: letters without their accents, lines as `-|+`, what has no likeness as `?`."""
    bare = unicodedata.normalize("NFKD", text.translate(_LINES))
    kept = "".join(letter for letter in bare if not unicodedata.combining(letter))
    return kept.encode("ascii", "replace").decode("ascii")


def printable(text: str, max_chars: int = STRANGE_MAX_CHARS) -> str:
    """Return what somebody else wrote as a terminal may show it: one line, no control characters, not without end."""
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
    """Tell whether who reads a stream takes UTF-8: by its encoding, at a terminal also by what the locale says."""
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
    """Let standard output and standard error write plain letters where UTF-8 is not understood."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and not is_utf8(stream):
            stream.reconfigure(encoding=PLAIN_ENCODING)
