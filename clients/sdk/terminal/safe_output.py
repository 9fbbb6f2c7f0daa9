"""What reaches a terminal: our own colours and pictures, and of everything else no control character but the line's end.

All output of a command goes through here: `SafeConsole` for what is styled, `SafeStream` in place of standard output and
standard error for whatever else is written. Controls become `\\u001b`, as JSON writes them, so JSON keeps its values.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import IO, Any, TextIO, cast

from rich.console import Console, ConsoleOptions, RenderableType
from rich.markup import escape
from rich.segment import Segment
from rich.text import Text

from consensus.visible_text import escape_controls

MARKUP_TAGS = frozenset({"bold", "red", "green", "yellow"})
"""The tags that our own sentences use; whatever else stands in brackets is text."""
_TAG = re.compile(r"(\\*)\[(/?)([^\[\]]*)\]")
_ALLOWED = "\n\t"


class SafeStream:
    """A stream that writes controls as escapes; everything else is as the stream's own."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    @property
    def trusted(self) -> TextIO:
        """The stream itself, for what was made safe, and for what we make up ourselves."""
        return self._stream

    def write(self, text: str) -> int:
        """Write a text; return how many of its characters (all of them)."""
        if not isinstance(text, str):
            raise TypeError("this stream takes text alone")
        self._stream.write(escape_controls(text, _ALLOWED))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write texts one after another."""
        for line in lines:
            self.write(line)

    def __iter__(self) -> Iterator[str]:
        return iter(self._stream)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


class SafeConsole(Console):
    """A console on which text of others stays text: no controls, no markup but our own tags."""

    @property
    def file(self) -> IO[str]:
        """The stream below: what comes out of here is safe, and holds our own colours."""
        stream = super().file
        return stream.trusted if isinstance(stream, SafeStream) else stream

    @file.setter
    def file(self, new_file: IO[str]) -> None:
        self._file = new_file

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a text with its markup, if that is ours and whole; otherwise as it stands."""
        text = escape_controls(text, _ALLOWED)
        if options.get("markup") is False:
            return super().render_str(text, **options)
        return super().render_str(keep_own_tags(text), **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render with controls as escapes; what moves the cursor comes from segments of our own alone."""
        for segment in super().render(renderable, options):
            safe = segment.text if segment.control else escape_controls(segment.text, _ALLOWED)
            yield segment if safe == segment.text else Segment(safe, segment.style)


def keep_own_tags(text: str) -> str:
    """Return markup in which only our own tags have a meaning, each closed after it was opened."""
    opened: list[str] = []

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
    """Write what we made up ourselves to standard output, controls and all."""
    stream = sys.stdout
    (stream.trusted if isinstance(stream, SafeStream) else stream).write(text)


def overwrite_line(text: str = "", *, ends: bool = False) -> None:
    """Write a line of standard error anew, as progress does; `ends` if the next one comes below it."""
    stream = sys.stderr
    end = "\n" if ends else ""
    (stream.trusted if isinstance(stream, SafeStream) else stream).write(f"\r{escape_controls(text, '')}\x1b[K{end}")
    stream.flush()


@contextmanager
def safe_streams() -> Iterator[None]:
    """While inside, standard output and standard error write no control that we did not make up."""
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (cast(TextIO, _safe(stream)) for stream in before)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _safe(stream: TextIO | SafeStream) -> SafeStream:
    return stream if isinstance(stream, SafeStream) else SafeStream(stream)
