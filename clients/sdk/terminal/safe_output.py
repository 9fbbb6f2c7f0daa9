"""Terminal output without foreign control characters.

All command output passes `SafeConsole` (styled) or `SafeStream`; controls become Unicode escapes as in JSON.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import IO, Any, TextIO, cast

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from consensus.visible_text import escape_controls

MARKUP_TAGS = frozenset({"bold", "red", "green", "yellow"})
"""The tags that our own sentences use; whatever else stands in brackets is text."""
# Neither starts within a run of backslashes: rich's own expression does, and takes a time that is quadratic in its length.
_TAG = re.compile(r"(?<!\\)(\\*)\[(/?)([^\[\]]*)\]")
_MARKUP = re.compile(r"(?<!\\)(\\*)(\[[a-z#/@][^\[]*?])")
_BACKSLASHES_SHOWN_MAX_COUNT = 256
_LONG_RUN = re.compile(rf"\\{{{_BACKSLASHES_SHOWN_MAX_COUNT + 1},}}")
_ALLOWED = "\n\t"


class SafeStream:
    """A stream that escapes control characters."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    @property
    def trusted(self) -> TextIO:
        """The stream for text that is safe already."""
        return self._stream

    def write(self, text: str) -> int:
        if not isinstance(text, str):
            raise TypeError("this stream takes text alone")
        self._stream.write(escape_controls(text, _ALLOWED))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def __iter__(self) -> Iterator[str]:
        return iter(self._stream)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class SafeConsole(Console):
    """A console that escapes controls and foreign markup."""

    @property
    def file(self) -> IO[str]:
        stream = super().file
        return stream.trusted if isinstance(stream, SafeStream) else stream

    @file.setter
    def file(self, new_file: IO[str]) -> None:
        self._file = new_file

    def render_str(self, text: str, **options: Any) -> Text:
        """Apply markup only if it is valid and ours."""
        text = escape_controls(text, _ALLOWED)
        if options.get("markup") is False:
            return super().render_str(text, **options)
        return super().render_str(keep_own_tags(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Only our own segments move the cursor."""
        for segment in super().render(renderable, options):
            safe = segment.text if segment.control else escape_controls(segment.text, _ALLOWED)
            yield segment if safe == segment.text else Segment(safe, segment.style)


def escape(text: str) -> str:
    """Markup that shows the text, as `rich.markup.escape` does; a longer run of backslashes is shown by number."""
    text = _LONG_RUN.sub(lambda run: f"({len(run[0])} backslashes)", text)
    text = _MARKUP.sub(lambda found: f"{found[1] * 2}\\{found[2]}", text)
    return text + "\\" if text.endswith("\\") and not text.endswith("\\\\") else text


def keep_own_tags(text: str) -> str:
    """Only our own, balanced tags stay active."""
    opened: list[str] = []
    text = _LONG_RUN.sub(lambda run: f"({len(run[0])} backslashes)", text)

    def keep(found: re.Match[str]) -> str:
        backslashes, closes, tag = found.groups()
        if len(backslashes) % 2:
            return found[0]
        if not closes and tag in MARKUP_TAGS:
            opened.append(tag)
            return found[0]
        if closes and opened and tag in ("", opened[-1]):
            opened.pop()
            return found[0]
        return backslashes + escape(f"[{closes}{tag}]")

    return _TAG.sub(keep, text)


def write_trusted(text: str) -> None:
    """Write our own text as it is."""
    stream = sys.stdout
    (stream.trusted if isinstance(stream, SafeStream) else stream).write(text)


def overwrite_line(text: str = "", *, ends: bool = False) -> None:
    """Overwrite standard error's line, as for progress; `ends` adds a newline."""
    stream = sys.stderr
    end = "\n" if ends else ""
    (stream.trusted if isinstance(stream, SafeStream) else stream).write(f"\r{escape_controls(text, '')}\x1b[K{end}")
    stream.flush()


@contextmanager
def safe_streams() -> Iterator[None]:
    """On standard output and error."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (cast(TextIO, _safe(stream)) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _safe(stream: TextIO | SafeStream) -> SafeStream:
    return stream if isinstance(stream, SafeStream) else SafeStream(stream)
