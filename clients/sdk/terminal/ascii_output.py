"""ASCII output for terminals without UTF-8."""

from __future__ import annotations

import codecs
import io
import os
import sys
from collections.abc import Mapping
from encodings import ascii as ascii_encoding
from typing import TextIO

PLAIN_ENCODING = "blockrobot-plain"


def _plain(error: UnicodeError) -> tuple[str, int]:
    """What stands for letters that ASCII lacks; see codecs.register_error."""
    from anyascii import anyascii  # noqa: PLC0415 - most outputs need none

    assert isinstance(error, UnicodeEncodeError)
    return anyascii(error.object[error.start : error.end]), error.end


def _find(name: str) -> codecs.CodecInfo | None:
    """ASCII under another name: click writes UTF-8 to an output whose encoding is called ASCII."""
    if name.replace("_", "-") != PLAIN_ENCODING:
        return None
    codec = ascii_encoding.Codec()
    return codecs.CodecInfo(
        codec.encode,
        codec.decode,
        incrementalencoder=ascii_encoding.IncrementalEncoder,
        incrementaldecoder=ascii_encoding.IncrementalDecoder,
        name=PLAIN_ENCODING,
    )


codecs.register_error(PLAIN_ENCODING, _plain)
codecs.register(_find)


def is_utf8(stream: TextIO, environment: Mapping[str, str] | None = None) -> bool:
    """Decide by the stream's encoding and the locale."""
    try:
        utf8 = codecs.lookup(getattr(stream, "encoding", None) or "ascii").name == "utf-8"
    except LookupError:
        return False
    if not utf8 or not stream.isatty():
        return utf8
    environment = os.environ if environment is None else environment
    locale_name = next((environment[name] for name in ("LC_ALL", "LC_CTYPE", "LANG") if environment.get(name)), "")
    return not locale_name or "utf8" in locale_name.lower().replace("-", "")


def prepare_output() -> None:
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper) and not is_utf8(stream):
            stream.reconfigure(encoding=PLAIN_ENCODING, errors=PLAIN_ENCODING)
