"""Opens a file in the user's own browser."""

from __future__ import annotations

import os
import sys
import webbrowser
from pathlib import Path

_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


def open_in_browser(file: Path) -> bool:
    """Let the user's browser open a file, if there is a screen for one or she named a browser; tell whether it was told.

    Without either, Python would start a browser of text in her terminal, which shows none of our pages.
    """
    has_screen = sys.platform == "darwin" or any(os.environ.get(name) for name in _SCREENS)
    return has_screen and webbrowser.open(file.resolve().as_uri())
