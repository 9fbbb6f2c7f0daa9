"""What a stranger's bundle says is shown as it stands: it styles, moves and ends nothing on the terminal."""

from __future__ import annotations

import pytest
from rich.text import Text

from clients.bundle.cli import _plain


@pytest.mark.parametrize("text", ["[bold]proved[/bold]", "[red]", "[/]", "a\\[b]"])
def test_it_has_no_markup(text: str) -> None:
    shown = Text.from_markup(_plain(text))
    assert (shown.plain, shown.spans) == (text, [])


def test_it_has_no_controls() -> None:
    assert _plain("\x1b[2Jproved\r\n") == "\\u001b[2Jproved\\u000d\\u000a"
