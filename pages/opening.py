"""Opens a file in the user's own browser."""

from __future__ import annotations

import os
import sys
import webbrowser
from pathlib import Path

_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")


def open_in_browser(file: Path) -> bool:
    """Open a file in a graphical or configured browser; return success."""
    has_screen = sys.platform == "darwin" or any(os.environ.get(name) for name in _SCREENS)
    return has_screen and webbrowser.open(file.resolve().as_uri())
