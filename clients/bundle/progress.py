"""Terminal progress of an export or check."""

from __future__ import annotations

import sys
import time

from clients.bundle.proving import Heard, never_heard
from clients.sdk.terminal.safe_output import overwrite_line


def show_progress(*, quiet: bool) -> Heard:
    """Return a standard-error progress callback, four updates a second."""
    if quiet or not sys.stderr.isatty():
        return never_heard
    last = 0.0

    def hear(what: str, done: int, of: int) -> None:
        nonlocal last
        now = time.monotonic()
        if done < of and now - last > 0.25:
            last = now
            overwrite_line(f"{what}: {100 * done // of} %")
        elif done == of:
            overwrite_line()

    return hear
