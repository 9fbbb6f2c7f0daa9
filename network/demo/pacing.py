"""Limits how often a stage of a long run prints progress lines."""

from __future__ import annotations

LINE_EVERY_S = 5.0


class ProgressThrottle:
    """Passes at most one line per five seconds and stage."""

    def __init__(self) -> None:
        self._told_s = 0.0
        self._stage = ""

    def lets_pass(self, line: str, now_s: float) -> bool:
        """Return whether to print a line; `run: 30 frames seen` is of stage `run`.

        A line without stage always passes; `now_s` is monotonic.
        """
        stage = line.rpartition(": ")[0]
        if stage and stage == self._stage and now_s - self._told_s < LINE_EVERY_S:
            return False
        self._stage, self._told_s = stage, now_s
        return True
